"""SIGKILL of the recorder at random times under load: data loss by the sender's account, and the remaining files."""

import csv
import os
import random
import signal
import time
from pathlib import Path

import pytest

from caris_desktop.recording.recorder.recorder_messages import RecorderReport, StopRecording
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from tests.recording.driving import start
from tests.recording.export_checks import check_export, formats_there
from tests.recording.loaded_console import CAMERAS, LoadedConsole

# Every fifth kill happens while the session is being closed.
EVERY_TIME = 4
MOMENTS = [
    *range(2, 2 + EVERY_TIME),
    *(pytest.param(moment, marks=pytest.mark.long) for moment in (1, *range(2 + EVERY_TIME, 51))),
]
MOST_EVENTS_LOST_S, MOST_MEDIA_LOST_S = 1.0, 2.0


@pytest.mark.alone
@pytest.mark.logs(r"is excluded from the archive: it was saved by a repair")
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_recording_opens_and_lacks_only_its_last_moment(
    tmp_path: Path, moment: int, request: pytest.FixtureRequest
) -> None:
    latest_s = 2.6 if moment < 2 + EVERY_TIME else 9.0
    chosen = random.Random(moment)  # noqa: S311 - a test, not cryptography
    kill_after_s, closing_s = chosen.uniform(0.05, latest_s), chosen.uniform(0.0, 0.25)
    while_closing = moment % 5 == 0
    folder = tmp_path / "session"
    console = LoadedConsole()
    try:
        console.recorder.send(start(folder))
        console.recorder.wait_for(RecorderReport, state="recording")
        console.send_for(kill_after_s)
        if while_closing:
            console.recorder.send(StopRecording())
            time.sleep(closing_s)
        assert console.recorder.process.pid is not None
        os.kill(console.recorder.process.pid, signal.SIGKILL)
        console.recorder.process.join()
    finally:
        console.close()
    sent = console.account

    session = open_session(folder)
    if not while_closing:
        assert (session.reason, session.closed_properly) == ("recovered", False)
        assert session.notices
    assert open_session(folder).notices == ()
    assert verify_manifest(folder) == []

    marks = [value for _, value in session.values("event/marked")]
    assert [value.label for value in marks] == [str(number) for number in range(len(marks))], "no event is left out"
    assert [value.stamp_ns for value in marks] == sent.marks_ns[: len(marks)]
    last_ns = marks[-1].stamp_ns if marks else session.started_ns
    lost = request.node.user_properties
    lost.append(("events_lost_s", (sent.marks_ns[-1] - last_ns) / 1e9))
    assert (sent.marks_ns[-1] - last_ns) / 1e9 <= MOST_EVENTS_LOST_S
    assert (sent.marks_ns[-1] - session.ended_ns) / 1e9 <= MOST_EVENTS_LOST_S

    with VideoReader(session) as videos:
        for camera in CAMERAS:
            times_ns = videos.frame_times_ns(camera)
            assert set(times_ns) <= set(sent.frames_ns[camera]), "every frame is shown at the moment it was taken"
            last_ns = times_ns[-1] if times_ns else sent.frames_ns[camera][0]
            lost.append((f"video_lost_s of {camera}", (sent.frames_ns[camera][-1] - last_ns) / 1e9))
            assert (sent.frames_ns[camera][-1] - last_ns) / 1e9 <= MOST_MEDIA_LOST_S
            assert not times_ns or videos.frame(camera, len(times_ns) - 1) is not None, "the last frame decodes"
        assert videos.problems == []
    sounds = {sound["source"]: sound for sound in session.header.to_json()["audio"]}
    for source, ended_ns in sent.sound_ends_ns.items():
        last_ns = sounds[source]["last_stamp_ns"] if source in sounds else session.started_ns
        assert (ended_ns - last_ns) / 1e9 <= MOST_MEDIA_LOST_S

    formats = formats_there() if request.config.getoption("--long") else ["csv", "vtt"]
    for fmt in formats:
        export_session(folder, fmt, tmp_path / fmt)
        check_export(fmt, tmp_path / fmt)
    if marks:
        with (tmp_path / "csv" / "event_marked.csv").open(newline="", encoding="utf-8") as file:
            assert [row["label"] for row in csv.DictReader(file)] == [value.label for value in marks]
