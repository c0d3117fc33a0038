"""TextGrids, read by Praat."""

import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import parselmouth
import pytest
from parselmouth.praat import call

from caris_desktop.domain.events import Marked
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.exporters.textgrid import FILE_NAME
from caris_desktop.recording.session_export import ExportRequest, export_all, export_session
from tests.recording.minute import LENGTH_S, S, everything, make_session, said

QUOTED = 'She said "hello"\nand left; "" \\ae'


def tiers_of(path: Path) -> dict[str, list[tuple[float, float, str]]]:
    """Tiers of a TextGrid as read by Praat: (start, end, text), with equal times for points."""
    grid = parselmouth.read(str(path))
    assert isinstance(grid, parselmouth.TextGrid)
    found = {}
    for tier in range(1, call(grid, "Get number of tiers") + 1):
        name = call(grid, "Get tier name", tier)
        if call(grid, "Is interval tier", tier):
            found[name] = [
                (
                    call(grid, "Get start time of interval", tier, number),
                    call(grid, "Get end time of interval", tier, number),
                    call(grid, "Get label of interval", tier, number),
                )
                for number in range(1, call(grid, "Get number of intervals", tier) + 1)
            ]
        else:
            found[name] = [
                (
                    call(grid, "Get time of point", tier, number),
                    call(grid, "Get time of point", tier, number),
                    call(grid, "Get label of point", tier, number),
                )
                for number in range(1, call(grid, "Get number of points", tier) + 1)
            ]
    return found


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("textgrid") / "s"

    def values(begin_ns: int) -> list[Any]:
        return [
            *everything(begin_ns),
            *said(begin_ns, at_s=8.0, for_s=0.5, text=QUOTED),
            Marked(begin_ns + 50 * S, "first", mark_id="a"),
            Marked(begin_ns + 50 * S, "second", mark_id="b", note="together"),
        ]

    make_session(folder, values)
    tier = Tier("gaze-1", "Gaze", "anna")
    coded = AnnotationDocument(
        (tier,), (), (Annotation("a1", "gaze-1", 1000, 2500, "robot"), Annotation("a2", "gaze-1", 2500, 4000, "away")),
        int(LENGTH_S * 1000),
    )  # fmt: skip
    save_coder(folder, coded, "anna")
    return folder


def test_praat_reads_the_tiers_of_the_record_and_of_the_coders(session: Path, tmp_path: Path) -> None:
    export_session(session, "textgrid", tmp_path / "out")
    tiers = tiers_of(tmp_path / "out" / FILE_NAME)
    spoken = [interval for interval in tiers["Robot speech"] if interval[2]]
    assert spoken == [(5.0, 7.5, "Welcome to the lab."), (8.0, 8.5, 'She said "hello" and left; "" \\ae')]
    assert [text for *_, text in tiers["Participant speech"] if text] == ["Ünïcode \U0001f916 \ufffd & <b>"]
    assert [interval for interval in tiers["Gaze"] if interval[2]] == [(1.0, 2.5, "robot"), (2.5, 4.0, "away")]
    assert tiers["Moments of marks"] == [
        (17.0, 17.0, "laughs"),
        (50.0, 50.0, "first | second (together)"),
    ]
    for name, intervals in tiers.items():
        if name != "Moments of marks":
            assert (intervals[0][0], intervals[-1][1]) == (0.0, LENGTH_S)
            assert all(before[1] == after[0] for before, after in itertools.pairwise(intervals))


def test_a_sound_file_has_one_by_its_own_time_so_that_praat_shows_both(session: Path, tmp_path: Path) -> None:
    shutil.copytree(session, tmp_path / "s")
    header = json.loads((tmp_path / "s" / "session.json").read_text())
    told = {"source": "microphone", "sample_rate_hz": 16_000, "channels": 1, "samples": 160_001}
    first_ns = header["started_ns"] + 6 * S
    header["audio"] = [{"file_name": "audio-microphone.wav", "first_stamp_ns": first_ns, **told}, {"file_name": 3}, 7]
    (tmp_path / "s" / "session.json").write_text(json.dumps(header))
    export_session(tmp_path / "s", "textgrid", tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {FILE_NAME, "audio-microphone.TextGrid"}
    path = tmp_path / "out" / "audio-microphone.TextGrid"
    sound = parselmouth.Sound(np.zeros(160_001), 16_000)
    assert parselmouth.read(str(path)).xmax == pytest.approx(sound.xmax, abs=1e-6)
    tiers = tiers_of(path)
    assert next(interval for interval in tiers["Robot speech"] if interval[2]) == (0.0, 1.5, "Welcome to the lab.")
    assert "Moments of marks" not in tiers, "none lies in this sound"


def test_a_session_in_which_nothing_happened_still_opens(tmp_path: Path) -> None:
    make_session(tmp_path / "s", lambda _: [])
    export_session(tmp_path / "s", "textgrid", tmp_path / "out")
    assert all(intervals[-1][1] == LENGTH_S for intervals in tiers_of(tmp_path / "out" / FILE_NAME).values())


@pytest.mark.logs(r"annotation\.annotation_store: ")
def test_damaged_annotations_are_left_out_and_reported(session: Path, tmp_path: Path) -> None:
    damaged = session / "annotations" / "bert.json"
    damaged.write_text("{")
    try:
        request = ExportRequest((session,), ("textgrid", "csv"), tmp_path / "out")
        finished = export_all(request)
    finally:
        damaged.unlink()
    assert finished.written == (tmp_path / "out" / "s",)
    assert len(finished.problems) == 2
    assert all("bert.json" in problem for problem in finished.problems)
    assert "Gaze" in tiers_of(tmp_path / "out" / "s" / "textgrid" / FILE_NAME)
    assert "C1,Gaze,robot" in (tmp_path / "out" / "s" / "csv" / "annotations.csv").read_text(encoding="utf-8")
