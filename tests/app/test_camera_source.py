"""``--camera FILE``: a street video instead of the robot's camera, processed by the whole console."""

from pathlib import Path

import pytest

from caris_desktop.domain.sensing import People
from caris_desktop.recording.session.session_reader import open_session
from tests.perception.shared_data import (
    INT8_WEIGHTS,
    MOT_SCORE,
    TUD_CAMPUS_TRUTH,
    TUD_CAMPUS_VIDEO,
    needs_int8_weights,
    needs_tud_campus,
)
from tests.perception.video_pipeline import score, write_mot
from tests.support.console_process import ConsoleProcess


@pytest.mark.long  # tests/perception runs the same video through the real perception processes
@needs_int8_weights
@needs_tud_campus
def test_the_recorded_people_of_a_street_video_score_well(tmp_path: Path) -> None:
    """Scored on the processed frames, as their number depends on other load of the machine."""
    console = ConsoleProcess(
        "ws://127.0.0.1:9",  # no robot at this address: the camera does not need one
        tmp_path / "study",
        CARIS_TEST_CAMERA=str(TUD_CAMPUS_VIDEO),
        CARIS_MODELS_DIR=str(INT8_WEIGHTS.parent),
    )
    try:
        console.wait_until_shown(recording="idle")
        console.send_command("record")
        console.wait_until_shown(recording="recording")
        console.wait_until_shown(perception="ready", timeout_s=90)
        console.wait_until_shown(video="fresh")
        console.wait_until_shown(video="lost", timeout_s=30)
        console.send_command("end_recording")
        folder = Path(console.wait_until_shown(recording="idle")["session"])
    finally:
        console.close()
    people = [value for _spec, value in open_session(folder).values("people")]
    assert all(isinstance(one, People) for one in people) and people
    processed = {one.frame_sequence for one in people}
    if len(processed) < 35:
        pytest.skip(f"this machine is too busy: {len(processed)} of 71 frames were processed in time")
    write_mot(people, tmp_path / "result.txt")
    truth = TUD_CAMPUS_TRUTH.read_text(encoding="ascii").splitlines()
    of_processed = [row for row in truth if int(row.split(",")[0]) in processed]
    (tmp_path / "truth.txt").write_text("\n".join(of_processed), encoding="ascii")
    scores = score(tmp_path / "truth.txt", tmp_path / "result.txt", MOT_SCORE)
    if scores is None:
        pytest.skip("needs the package trackeval, to be installed with --no-deps")
    print(f"{len(processed)} of 71 frames, {scores}")
    assert scores["HOTA"] >= 40.0, (scores, len(processed))
