"""Timeline as values: scale, ruler, rows, tracks, and sound and speed by pixel."""

import numpy as np
import pytest

from caris_desktop.domain.translation import tr
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import (
    DEFAULT_TIER,
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.timeline_overview import Waveform
from caris_desktop.ui.replay.timeline_items import (
    SCENARIO_LABELS,
    Row,
    TimeScale,
    Track,
    all_rows,
    arranged,
    exact_text,
    initials,
    length_text,
    moved_key,
    picture_step_ms,
    ruler_ticks,
    snapped,
    speed_columns,
    vocabulary_title,
    wave_columns,
    whole_session,
)
from tests.ui.fake_replay import sample_coding, sample_overview


def test_zooming_keeps_the_moment_under_the_pointer() -> None:
    scale = whole_session(1000, 100_000)
    assert scale.to_px(100_000) == pytest.approx(1000)
    closer = scale.zoomed(8.0, 400, width_px=1000, duration_ms=100_000)
    assert closer.to_ms(400) == pytest.approx(scale.to_ms(400))
    assert closer.px_per_ms == pytest.approx(8 * scale.px_per_ms)


def test_the_view_stays_inside_the_session() -> None:
    scale = whole_session(1000, 100_000)
    assert scale.zoomed(0.1, 400, width_px=1000, duration_ms=100_000) == scale
    assert TimeScale(-500, 0.1).bounded(1000, 100_000).start_ms == 0
    assert TimeScale(99_000, 0.1).bounded(1000, 100_000).start_ms == 90_000


def test_ruler_labels_are_round_and_apart() -> None:
    for px_per_ms in (0.0003, 0.01, 0.1, 1.0):
        scale = TimeScale(12_345, px_per_ms)
        labelled = [tick.at_ms for tick in ruler_ticks(scale, 1000) if tick.label]
        steps = np.diff(labelled)
        assert len(set(steps.tolist())) == 1
        assert steps[0] * px_per_ms >= 88
    assert "1:00:00" in [tick.label for tick in ruler_ticks(TimeScale(3_590_000, 0.05), 600)]


def test_pictures_are_close_but_never_on_top_of_one_another() -> None:
    for px_per_ms in (0.0003, 0.004, 0.02, 0.3):
        step_px = picture_step_ms(px_per_ms, 92) * px_per_ms
        assert step_px >= 92
        assert step_px < 92 * 1.45 or picture_step_ms(px_per_ms, 92) == 250


@pytest.mark.parametrize(
    ("milliseconds", "text"),
    [(0, "00:00.000"), (62_345, "01:02.345"), (3_723_456, "1:02:03.456"), (-500, "-00:00.500")],
)
def test_times_read_to_the_millisecond(milliseconds: int, text: str) -> None:
    assert exact_text(milliseconds) == text


def test_lengths_read_as_people_say_them() -> None:
    assert [length_text(value) for value in (480, 12_300, 125_000)] == ["0.48 s", "12.3 s", "2 min 5 s"]


def _track(*stretches: tuple[int, int]) -> Track:
    return Track([Annotation(f"a{n}", "t", start, end, f"v{n}") for n, (start, end) in enumerate(stretches)])


def test_a_track_finds_what_is_in_view() -> None:
    track = _track((0, 10), (20, 30), (30, 40), (60, 70))
    assert list(track.between(25, 60)) == [1, 2]
    assert list(track.between(41, 59)) == []
    assert list(track.between(100, 200)) == []


def test_a_track_finds_what_overlaps_too() -> None:
    """Intervals of people overlap: a long one may end after later short ones."""
    track = _track((0, 100), (10, 20), (50, 60))
    assert list(track.between(70, 90)) == [0, 1, 2], (
        "the long one is in view; what lies between is passed over in drawing"
    )
    found = track.at(15)
    assert found is not None
    assert found.annotation_id == "a1"
    found = track.at(30)
    assert found is not None
    assert found.annotation_id == "a0"
    assert track.at(100) is None


def test_a_track_knows_the_neighbours_of_a_moment() -> None:
    track = _track((0, 10), (20, 30))
    found = [track.neighbour(at_ms, way) for at_ms, way in ((0, 1), (20, 1), (20, -1), (0, -1))]
    assert [item and item.annotation_id for item in found] == ["a1", None, "a0", None]


def test_an_edge_snaps_to_what_is_near() -> None:
    assert snapped(103, [0, 100, 110], within_ms=5) == 100
    assert snapped(105.5, [0, 100, 112], within_ms=5) == 105.5
    assert snapped(5, [], within_ms=5) == 5


def test_rows_are_own_tiers_pictures_sound_speed_then_the_record() -> None:
    rows = all_rows(sample_overview(), sample_coding(120_000))
    assert [row.own for row in rows[:4]] == [True, True, True, False]
    assert [row.kind for row in rows[3:7]] == ["pictures", "sound", "sound", "speed"]
    assert [row.name for row in rows if row.kind == "sound"] == ["Microphone", "Robot voice"]
    assert not any(row.own for row in rows[3:])
    assert len({row.key for row in rows}) == len(rows)
    assert all_rows(None, AnnotationDocument()) == []


def test_rows_can_be_hidden_moved_and_filtered() -> None:
    rows = [Row(f"tier {name}", "tier", name, tier=Tier(name, name, "Ana")) for name in "abc"]
    keys = [row.key for row in arranged(rows, ["tier c", "tier a"], (), "")]
    assert keys == ["tier c", "tier a", "tier b"], "b follows a, as it does by itself"
    assert [row.name for row in arranged(rows, [], {"tier a"}, "")] == ["b", "c"]
    assert [row.name for row in arranged(rows, [], (), "ana B")] == ["b"]
    assert moved_key(["a", "b", "c"], "a", 2) == ["b", "c", "a"]
    assert moved_key(["a", "b", "c"], "c", -4) == ["c", "a", "b"]


def test_a_chip_has_one_or_two_letters() -> None:
    assert [initials(name) for name in ("Ana", "ben", "Ana Maria Gil")] == ["A", "B", "AM"]


def test_sound_keeps_its_loudest_moment_at_any_zoom() -> None:
    peaks = np.zeros((1000, 2), np.float32)
    peaks[437] = (-0.9, 0.8)
    wave = Waveform("audio-microphone.wav", 5_000, 1000, peaks)
    for ns_per_px in (100, 1000, 7_300, 100_000):
        columns = wave_columns(wave, first_ns=0, ns_per_px=ns_per_px, width_px=1_100_000 // ns_per_px)
        assert np.nanmin(columns[:, 0]) == pytest.approx(-0.9)
        assert np.nanmax(columns[:, 1]) == pytest.approx(0.8)
        at_px = int(np.nanargmax(columns[:, 1]))
        assert at_px * ns_per_px <= 5_000 + 438_000
        assert (at_px + 1) * ns_per_px >= 5_000 + 437_000
    outside = wave_columns(wave, first_ns=2_000_000, ns_per_px=100, width_px=50)
    assert np.isnan(outside).all()


def test_the_last_moment_of_sound_and_speed_counts() -> None:
    peaks = np.zeros((1000, 2), np.float32)
    peaks[-1] = (-0.9, 0.8)
    wave = Waveform("audio-microphone.wav", 0, 1000, peaks)
    for ns_per_px in (100, 1000, 7_300, 100_000):
        columns = wave_columns(wave, first_ns=0, ns_per_px=ns_per_px, width_px=1_100_000 // ns_per_px)
        assert np.nanmin(columns[:, 0]) == pytest.approx(-0.9), ns_per_px
        assert np.nanmax(columns[:, 1]) == pytest.approx(0.8), ns_per_px
    speed = np.array([[0.0, 0.2, 0.0], [0.1, 0.9, 0.0]], np.float32)
    assert np.nanmax(speed_columns(speed, TimeScale(0, 0.005), 10)[:, 0]) == pytest.approx(0.9)


def test_speed_keeps_its_fastest_moment_and_is_nothing_outside() -> None:
    seconds = np.arange(0, 10, 0.1, dtype=np.float32)
    speed = np.column_stack((seconds, np.where(np.arange(100) == 55, -0.9, 0.2), np.zeros(100))).astype(np.float32)
    columns = speed_columns(speed, TimeScale(0, 0.005), 100)
    assert np.nanmax(columns[:, 0]) == pytest.approx(0.9)
    assert int(np.nanargmax(columns[:, 0])) == 27
    assert np.isnan(columns[60:, 0]).all(), "the session went on without measurements"
    fine = speed_columns(speed, TimeScale(1000, 1.0), 200)
    assert not np.isnan(fine).any(), "between two measurements the last one holds"


@pytest.mark.usefixtures("trial_language")
def test_the_vocabulary_that_the_console_made_is_named_in_the_wizards_language() -> None:
    assert vocabulary_title(SCENARIO_LABELS) == tr(SCENARIO_LABELS) != SCENARIO_LABELS
    assert vocabulary_title("Motion") == "Motion", "what a coder wrote stays as it is"


@pytest.mark.usefixtures("trial_language")
def test_the_tier_of_a_table_that_names_none_is_named_in_the_wizards_language() -> None:
    names = ("Annotations", "Annotations (2)", "Annotations of mine", "Stance (2)")
    document = AnnotationDocument(tuple(Tier(f"t{number}", name, "Ana") for number, name in enumerate(names)))
    assert [row.name for row in all_rows(None, document)] == [
        tr(DEFAULT_TIER), tr("Annotations ({number})").format(number=2), "Annotations of mine", "Stance (2)",
    ]  # fmt: skip
    coded = annotation_editing.add_annotation(document, "t0", 0, 10, "leans in")
    coded = annotation_editing.add_vocabulary(coded, Vocabulary("Stances", (VocabularyEntry("curious"),)))
    with pytest.raises(AnnotationError) as refusal:
        annotation_editing.set_tier_vocabulary(coded, "t0", "Stances")
    assert "“Annotations”" in str(refusal.value) and tr(DEFAULT_TIER) in tr(str(refusal.value))
