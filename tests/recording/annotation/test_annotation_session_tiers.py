"""Tiers and overview derived from the recording."""

import json
import pickle
import re
import wave
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from caris_desktop.domain import streams
from caris_desktop.domain.events import (
    AnswerUsed,
    CommandSent,
    CommandSource,
    DriveEnded,
    EmergencyStopChanged,
    GoalChanged,
    GoalState,
    GuardState,
    LinkChanged,
    LinkQuality,
    LinkState,
    LlmOutcome,
    Marked,
    PersonAppeared,
    PersonLeft,
    RecordingPaused,
    ScenarioOpened,
    StepTicked,
    StopRequested,
    UtteranceOrigin,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import AudioBlock, Odometry, RobotPose
from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.session_tiers import (
    EVENTS_IN_WORDS,
    SHOWN,
    STATES_IN_WORDS,
    session_tiers,
    type_in_words,
    types_of_tiers,
)
from caris_desktop.recording.annotation.timeline_builder import BUCKET_NS, build_overview
from caris_desktop.recording.exporters.csv import write_csv
from caris_desktop.recording.exporters.eaf import write_eaf
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.ui.replay.timeline_items import all_rows
from tests.recording.told_session import STARTED_NS, at, drive, exchange, heard, said, tell, tour


def told(folder: Path, values: list[Any], *, lasts_s: float = 60.0, **fields: Any) -> Session:
    return open_session(tell(folder / "s", values, lasts_s=lasts_s, **fields))


def rows(document: AnnotationDocument) -> dict[str, list[tuple[int, int, str]]]:
    annotation_editing.check_document(document)
    return {
        tier.name: [(item.start_ms, item.end_ms, item.value) for item in document.of_tier(tier.tier_id)]
        for tier in document.tiers
    }


def vocabulary(document: AnnotationDocument, name: str) -> list[str]:
    return [entry.value for entry in annotation_editing.vocabulary_of(document, name).entries]


def test_utterances_become_tiers_by_speaker(tmp_path: Path) -> None:
    values = [
        *heard(1, 2.0, 3.5, "Hi there"),
        # Overlapping speech of two people.
        *heard(2, 3.0, 4.0, "Me too\nhere"),
        *said(1, 4.0, 4.2, 6.0, "Welcome.", origin="phrase"),
        *said(2, 6.0, 6.0, 7.25, "This way."),
    ]
    document = session_tiers(told(tmp_path, values))
    found = rows(document)
    assert found["Participant speech"] == [(2000, 3500, "Hi there")]
    assert found["Participant speech (2)"] == [(3000, 4000, "Me too\nhere")]
    assert found["Robot speech"] == [(4200, 6000, "Welcome."), (6000, 7250, "This way.")]
    assert found["Robot speech origin"] == [(4200, 6000, "phrase"), (6000, 7250, "typed")]
    assert [tier.participant for tier in document.tiers][:3] == ["P07", "P07", "Robot"]
    assert all(tier.coder == "" for tier in document.tiers)
    assert document.duration_ms == 60_000


def test_marks_errors_and_notes(tmp_path: Path) -> None:
    values = [
        ScenarioOpened(at(-1), "x.yaml", "Tour", "0" * 64, "recording:\n  labels: [Laughs, Confused]\n"),
        Marked(at(10.0), "Laughs", mark_id="a", start_ns=at(7.0)),
        Marked(at(10.0), "Own label", mark_id="b"),
        Marked(at(10.0), "Confused", mark_id="b2"),
        Marked(at(10.1), "Laughs", mark_id="c"),
        Marked(at(20.0), "Confused", mark_id="d", state="open"),
        Marked(at(25.0), "Confused", mark_id="d", end_ns=at(25.0), note="at the arm"),
        Marked(at(21.0), "Laughs", mark_id="e"),
        Marked(at(30.0), "slip", "wizard_error", mark_id="f"),
        Marked(at(35.0), "", "wizard_error", mark_id="f2"),
        Marked(at(40.0), "", "note", mark_id="g", note="Asks twice"),
        Marked(at(41.0), "Laughs", mark_id="h"),
        Marked(at(42.0), "Laughs", mark_id="h", state="withdrawn"),
        Marked(at(60.0), "Laughs", mark_id="i"),
    ]
    document = session_tiers(told(tmp_path, values))
    found = rows(document)
    # Moments get a width, limited by the next one; overlapping ones go to a second tier.
    assert found["Wizard marks"] == [
        (7000, 7200, "Laughs"),
        (10_000, 10_100, "Own label"),
        (10_100, 10_300, "Laughs"),
        (20_000, 25_000, "Confused"),
        (59_999, 60_000, "Laughs"),
    ]
    assert found["Wizard marks (2)"] == [(10_000, 10_200, "Confused"), (21_000, 21_200, "Laughs")]
    assert found["Wizard errors"] == [(30_000, 30_200, "slip"), (35_000, 35_200, "unspecified")]
    assert found["Notes"] == [(20_000, 25_000, "at the arm"), (40_000, 40_200, "Asks twice")]
    assert vocabulary(document, "Wizard marks") == ["Laughs", "Confused", "Own label"]
    assert vocabulary(document, "Wizard errors") == ["slip", "late", "wrong branch", "unspecified"]
    assert found["Scenario"] == [(0, 60_000, "Tour")]


def test_motion_and_who_drove(tmp_path: Path) -> None:
    values: list[Any] = [
        *drive(5.0, 7.0, 0.4),
        *drive(7.0, 8.0, 0.0, 0.5, source="gamepad"),
        *drive(20.0, 21.0, -0.2, source="gamepad"),
        # Last command before the loss of the link: no command follows within half a second.
        CommandSent(at(30.0), 900, Twist2D(forward_mps=0.3), "keyboard"),
        RecordingPaused(at(40.0), True),
        RecordingPaused(at(50.0), False),
        GoalChanged(at(32.0), "g", "requested", Pose2D(1, 2, 0), "Kitchen"),
        GoalChanged(at(36.5), "g", "reached", Pose2D(1, 2, 0), "Kitchen"),
    ]
    found = rows(session_tiers(told(tmp_path, values)))
    assert found["Motion"] == [
        (0, 5000, "standing"),
        (5000, 7000, "forward"),
        (7000, 8000, "turning"),
        (8000, 20_000, "standing"),
        (20_000, 21_000, "backward"),
        (21_000, 30_000, "standing"),
        (30_000, 30_500, "forward"),
        (30_500, 40_000, "standing"),
        (50_000, 60_000, "standing"),
    ]
    assert found["Driving source"] == [
        (5000, 7000, "keyboard"),
        (7000, 8000, "gamepad"),
        (20_000, 21_000, "gamepad"),
        (30_000, 30_500, "keyboard"),
    ]
    assert found["Navigation goals"] == [(32_000, 36_500, "Kitchen: reached")]
    assert found["Pauses"] == [(40_000, 50_000, "paused")]


@pytest.mark.logs(r"session\.session_visits: ")
def test_people_assistant_and_trouble(tmp_path: Path) -> None:
    values = [
        PersonAppeared(at(5.0), "p-2", 4),
        PersonLeft(at(10.0), "p-1", 1),
        PersonLeft(at(20.0), "p-2", 4),
        exchange(1, 12.0, 13.5, "Hello."),
        AnswerUsed(at(15.0), "x-1", "edited", "Hello!"),
        LinkChanged(at(-1.0), "control", "connected", "ws://a"),
        LinkChanged(at(30.0), "control", "lost", "ws://a", "no answer"),
        LinkChanged(at(31.0), "media", "trouble", "ws://a"),
        LinkChanged(at(33.0), "control", "connected", "ws://a"),
        LinkChanged(at(34.0), "media", "connected", "ws://a"),
        EmergencyStopChanged(at(45.0), True, "wizard"),
        EmergencyStopChanged(at(47.0), False, "wizard"),
        EmergencyStopChanged(at(50.0), True, "wizard", "wizard:b"),
        EmergencyStopChanged(at(51.0), True, "robot"),
        EmergencyStopChanged(at(52.0), False, "wizard", "wizard"),
        StopRequested(at(20.0), "wizard"),
        StopRequested(at(21.0), "wizard:b"),
        DriveEnded(at(22.0), "The link was lost", "console"),
        LinkQuality(at(46.0), 3.0),
    ]
    folder = tell(tmp_path / "s", values, lasts_s=60.0)
    people = [{"person_id": "p-9", "first_seen_s": 1.0, "last_seen_s": 59.0}, {"person_id": "p-1", "first_seen_s": 0.0}]
    (folder / "people.json").write_text(json.dumps({"people": people[:1]}))
    found = rows(session_tiers(open_session(folder)))
    assert found["People present"] == [
        (0, 1000, "1"),
        (1000, 5000, "2"),
        (5000, 10_000, "3"),
        (10_000, 20_000, "2"),
        (20_000, 59_000, "1"),
    ]
    # The displayed number is not recorded, and none is invented.
    assert found["Person p-2"] == [(5000, 20_000, "present")]
    assert not [name for name in found if re.fullmatch(r"Person \d+", name)]
    assert found["LLM exchanges"] == [(12_000, 13_500, "Hello.")]
    assert found["LLM answer use"] == [(15_000, 15_200, "edited")]
    assert found["Link trouble"] == [(30_000, 33_000, "control: lost (no answer)")]
    assert found["Link trouble (2)"] == [(31_000, 34_000, "media: trouble")]
    assert found["Emergency stop"] == [
        (45_000, 47_000, "set by wizard"),
        (50_000, 51_000, "set by wizard:b"),
        (51_000, 52_000, "set by robot"),
    ]
    assert [value for _, _, value in found["Stop requested"]] == ["Stop requested", "Stop requested (by wizard:b)"]
    assert [value for _, _, value in found["Drive ended"]] == ["The link was lost"]
    # Values measured every second would hide the others.
    assert not [name for name in found if "quality" in name.lower()]
    (folder / "people.json").write_text(json.dumps({"people": people}))
    assert "Person p-9" not in rows(session_tiers(open_session(folder)))


def test_people_have_the_numbers_of_the_screen(tmp_path: Path) -> None:
    values = [
        PersonAppeared(at(0.0), "p-e", 9, 5),
        PersonAppeared(at(3.0), "p-f", 12, 6),
        PersonLeft(at(9.0), "p-e", 9),
        PersonAppeared(at(12.0), "p-e", 9, 5),
        # Another study was opened: its numbering of people starts at 1.
        PersonAppeared(at(20.0), "q-a", 1, 1),
        PersonAppeared(at(25.0), "q-e", 2, 5),
    ]
    document = session_tiers(open_session(tell(tmp_path / "s", values, lasts_s=60.0)))
    shown = {tier.name: tier.participant for tier in document.tiers if tier.name.startswith("Person ")}
    assert shown == {"Person 5": "p-e", "Person 6": "p-f", "Person 1": "q-a", "Person 5 q-e": "q-e"}
    assert len({tier.tier_id for tier in document.tiers}) == len(document.tiers)


def test_a_goal_that_was_over_before_the_recording_is_none_of_it(tmp_path: Path) -> None:
    def goal(session_s: float, name: str, state: GoalState) -> GoalChanged:
        return GoalChanged(at(session_s), name, state, Pose2D(1.0, 2.0, 0.0), name)

    values = [
        # State at the start of the recording, and again after each pause.
        goal(-0.01, "before", "cancelled"),
        RecordingPaused(at(60.0), True),
        goal(73.99, "before", "cancelled"),
        RecordingPaused(at(74.0), False),
        goal(80.0, "kitchen", "requested"),
        goal(81.0, "kitchen", "active"),
        RecordingPaused(at(85.0), True),
        goal(94.99, "kitchen", "cancelled"),
        RecordingPaused(at(95.0), False),
        RecordingPaused(at(100.0), True),
        goal(109.99, "kitchen", "cancelled"),
        RecordingPaused(at(110.0), False),
        RecordingPaused(at(111.0), True),
        goal(113.99, "asked in a pause", "reached"),
        RecordingPaused(at(114.0), False),
        goal(115.0, "refused", "failed"),
        goal(116.0, "lab", "requested"),
    ]
    session = open_session(tell(tmp_path / "s", values, lasts_s=120.0))
    found = rows(session_tiers(session))
    assert found["Navigation goals"] == [
        (80_000, 94_990, "kitchen: cancelled"),
        (115_000, 115_200, "refused: failed"),
        (116_000, 120_000, "lab: requested"),
    ]
    measures = measure(read_facts(session))
    assert measures.of("goals") == {"cancelled": 1, "failed": 1, "unfinished": 1}
    assert measures["navigating_s"] == pytest.approx(5.0 + 4.0)


@dataclass(frozen=True, slots=True)
class QuestionAsked:
    """Event type unknown to this program."""

    stamp_ns: int
    question: str
    answer_id: str = ""


@dataclass(frozen=True, slots=True)
class RoundPlayed:
    """Event type with a duration."""

    stamp_ns: int
    start_ns: int
    end_ns: int
    player: str
    points: float


def test_an_event_type_declared_in_the_stream_table_is_a_tier(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for kind, name in ((QuestionAsked, "event/question_asked"), (RoundPlayed, "event/round_played")):
        spec = streams.StreamSpec(name, kind, streams.Delivery.LOSSLESS)
        monkeypatch.setitem(streams.BY_TYPE, kind, spec)
        monkeypatch.setitem(streams.BY_NAME, name, spec)
    values: list[Any] = [
        QuestionAsked(at(1.0), "How old are you?", "q-1"),
        QuestionAsked(at(1.0), "Why?"),
        RoundPlayed(at(9.0), at(4.0), at(9.0), "P07", 2.5),
        StopRequested(at(3.0)),
    ]
    found = rows(session_tiers(told(tmp_path, values)))
    assert found["Question asked"] == [(1000, 1200, "How old are you? | Why?")]
    assert found["Round played"] == [(4000, 9000, "player: P07, points: 2.5")]
    assert found["Stop requested"] == [(3000, 3200, "Stop requested")]


def write_wav(path: Path, samples: Any, rate: int = 1000, channels: int = 1) -> None:
    with wave.open(str(path), "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes(np.asarray(samples, "<i2").tobytes())


@pytest.mark.logs(r"annotation\.timeline_builder: ")
def test_the_overview_shows_sound_where_it_was(tmp_path: Path) -> None:
    values: list[Any] = [
        *heard(1, 2.0, 3.0, "Hi"),
        *said(1, 3.0, 3.5, 4.0, "Hello"),
        Marked(at(10.0), "late", "wizard_error", mark_id="a", start_ns=at(3.2)),
        *(Odometry(at(number / 100), None, Pose2D(0, 0, 0), Twist2D(0.5, 0, -0.25)) for number in range(500)),
        # Two seconds of sound, a pause of three, one second of sound.
        *(
            AudioBlock(at(1.0 + number / 5), "microphone", "audio-m.wav", number * 200, 200, 1000)
            for number in range(10)
        ),
        *(AudioBlock(at(6.0 + n / 5), "microphone", "audio-m.wav", 2000 + n * 200, 200, 1000) for n in range(5)),
        AudioBlock(at(0.0), "gone", "audio-gone.wav", 0, 100, 1000),
        AudioBlock(at(0.0), "far", "../events.mcap", 0, 100, 1000),
    ]
    folder = tell(
        tmp_path / "s",
        values,
        lasts_s=60.0,
        videos=[
            {"camera": camera, "file_name": f"video-{camera}.mp4", "first_stamp_ns": 0} for camera in ("front", "rear")
        ],
    )
    (folder / "video-front.mp4").write_bytes(b"x")
    samples = np.zeros(3000)
    samples[500] = 16384
    samples[2500:2520] = -32768
    write_wav(folder / "audio-m.wav", samples)
    overview = build_overview(open_session(folder))
    assert [(moment.kind, moment.at_ns, moment.text) for moment in overview.moments] == [
        ("utterance", at(2.0), "participant: Hi"),
        ("mark", at(3.2), "late"),
        ("utterance", at(3.5), "robot: Hello"),
    ]
    assert overview.cameras == ("front",)
    (waveform,) = overview.waveforms
    assert (waveform.source, waveform.first_ns, waveform.bucket_ns) == ("microphone", at(1.0), BUCKET_NS)
    loud_s = (
        np.flatnonzero(np.abs(waveform.peaks).max(axis=1) > 0.1) * BUCKET_NS + waveform.first_ns - STARTED_NS
    ) / 1e9
    assert loud_s == pytest.approx([1.5, 6.5], abs=0.0201)
    assert (waveform.peaks.max(), waveform.peaks.min()) == (0.5, -1.0)
    assert overview.speed.dtype == np.float32
    assert overview.speed[:, 1:].tolist() == [[0.5, -0.25]] * 100
    assert overview.speed[:3, 0].tolist() == pytest.approx([0.0, 0.05, 0.1])


def test_the_speed_comes_from_poses_where_there_is_no_odometry(tmp_path: Path) -> None:
    values = [RobotPose(at(number / 10), None, Pose2D(number / 50, 0, 0)) for number in range(100)]
    speed = build_overview(told(tmp_path, values)).speed
    assert speed[:, 1] == pytest.approx(0.2, abs=1e-4)
    commands = build_overview(told(tmp_path / "c", list(drive(1.0, 3.0, 0.4)))).speed
    assert (commands[0].tolist(), commands[-1, 1]) == ([1.0, pytest.approx(0.4), 0.0], 0.0)


def test_a_whole_tour_keeps_the_rules(tmp_path: Path) -> None:
    found = rows(session_tiers(told(tmp_path, tour(3, minutes=4.0), lasts_s=240.0)))
    assert {"Participant speech", "Robot speech", "Wizard marks", "Motion", "Navigation goals", "Pauses"} <= set(found)


def test_the_rows_of_all_events_are_known_to_translators() -> None:
    others = set(types_of_tiers()) - SHOWN | {StepTicked}
    assert {type_in_words(kind) for kind in others} == set(EVENTS_IN_WORDS)


@pytest.mark.usefixtures("trial_language")
def test_rows_are_named_in_the_wizards_language_where_they_are_shown_and_in_english_in_files(tmp_path: Path) -> None:
    appeared = PersonAppeared(at(1), "p-1", 1, number=3)
    values = [*heard(1, 2.0, 3.5, "Hi there"), *heard(2, 3.0, 4.5, "And I"), appeared, StopRequested(at(5), "wizard")]
    session = told(tmp_path, values)
    overview = pickle.loads(pickle.dumps(build_overview(session)))  # noqa: S301
    shown = [row.name for row in all_rows(overview, AnnotationDocument()) if row.tier is not None]
    assert shown == [tr(tier.name) for tier in overview.tiers.tiers]
    assert all(name.startswith("[") for name in shown), shown
    speech = tr("Participant speech")
    assert tr("{tier} ({number})").format(tier=speech, number=2) in shown
    assert tr("Person {number}").format(number=3) in shown
    write_csv(session, tmp_path, ExportContext())
    write_eaf(session, tmp_path, ExportContext())
    written = "".join(path.read_text("utf-8") for path in tmp_path.glob("*.*") if path.suffix in (".csv", ".eaf"))
    names = [tier.name for tier in overview.tiers.tiers]
    assert "Participant speech (2)" in names and "Person 3" in names and "Stop requested" in names
    assert all(name in written for name in names) and speech not in written


def test_every_state_of_a_tier_is_known_to_translators() -> None:
    kinds = (CommandSource, UtteranceOrigin, GoalState, LinkState, GuardState, LlmOutcome)
    without_a_stretch = {"absent", "clear", "connected", "closed"}
    assert {word for kind in kinds for word in get_args(kind)} - without_a_stretch <= set(STATES_IN_WORDS)


@pytest.mark.usefixtures("trial_language")
def test_states_are_translated_where_shown_and_english_in_files(tmp_path: Path) -> None:
    point = Pose2D(1.0, 2.0, 0.0)
    values = [
        *heard(1, 2.0, 3.5, "standing"), PersonAppeared(at(1), "p-1", 1, number=3), PersonLeft(at(4), "p-1", 1),
        CommandSent(at(1), 1, Twist2D(0.4, 0.0, 0.0), "keyboard"), EmergencyStopChanged(at(5), True, "robot"),
        LinkChanged(at(2), "control", "lost", "ws://robot", "no answer"), Marked(at(3), "slip", "wizard_error", "m1"),
        Marked(at(4), "late", "mark", "m2"), GoalChanged(at(2), "g", "reached", point, "Kitchen"),
        RecordingPaused(at(6), True), RecordingPaused(at(7), False),
    ]  # fmt: skip
    session = told(tmp_path, values)
    overview = pickle.loads(pickle.dumps(build_overview(session)))  # noqa: S301
    names = {tier.tier_id: str(tier.name) for tier in overview.tiers.tiers}
    shown: dict[str, list[str]] = {}
    for item in overview.tiers.annotations:
        shown.setdefault(names[item.tier_id], []).append(tr_filled(item.value))
    assert shown["Participant speech"] == ["standing"], "what was said stays"
    assert shown["Wizard marks"] == ["late"], "so does what a wizard called it"
    assert shown["Motion"] == [tr("standing"), tr("forward"), tr("standing"), tr("standing")]
    assert (shown["Driving source"], shown["Person 3"]) == ([tr("keyboard")], [tr("present")])
    assert (shown["Pauses"], shown["Wizard errors"]) == ([tr("paused")], [tr("slip")])
    assert shown["Navigation goals"] == [tr("{place}: {state}").format(place="Kitchen", state=tr("reached"))]
    assert shown["Emergency stop"] == [tr("set by {whom}").format(whom=tr("robot"))]
    assert shown["Link trouble"] == [
        tr("{link}: {state} ({detail})").format(link=tr("control"), state=tr("lost"), detail=tr("no answer"))
    ]
    sentence = tr("{who}: {text}").format(who=tr("participant"), text="standing")
    assert sentence in [tr_filled(moment.text) for moment in overview.moments]
    write_csv(session, tmp_path, ExportContext())
    write_eaf(session, tmp_path, ExportContext())
    written = "".join(path.read_text("utf-8") for path in tmp_path.glob("*.*") if path.suffix in (".csv", ".eaf"))
    assert "control: lost (no answer)" in written and "set by robot" in written and tr("standing") not in written
