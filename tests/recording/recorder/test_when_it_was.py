"""Measurement times of robot values and frames in recording, video, captions and ELAN."""

import json
import pickle
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import webvtt

from caris_desktop.domain import clock
from caris_desktop.domain.events import Gap, LinkQuality, RecordingPaused, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import AudioChunk, BatteryState, FrameRef, Odometry, StatusShown
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.recorder.recorder_messages import ARRIVED, PauseRecording
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_header import rebuilt_header
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from tests.recording.driving import RecorderUnderTest, picture, start
from tests.recording.recorder.test_recorder_process import mcap_messages

MS = 1_000_000
OFFSET_NS = 1_700_000_000_000 * MS
LATE_NS = 180 * MS


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Ten frames with a delay of 180 ms; the robot speaks while the fourth one is taken."""
    folder = tmp_path_factory.mktemp("moments") / "s"
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring)
    begin_ns = clock.now_ns()
    recorder.send(start(folder))
    recorder.send(Odometry(begin_ns, begin_ns + OFFSET_NS, Pose2D(0, 0, 0), Twist2D()))
    recorder.send(LinkQuality(begin_ns, 5.0, OFFSET_NS / MS, 1.5))
    recorder.send(Odometry(begin_ns, begin_ns + OFFSET_NS - LATE_NS, Pose2D(0, 0, 0), Twist2D()))
    utterance_ns = 0
    for number in range(10):
        came_ns = begin_ns + number * 100 * MS + LATE_NS
        ref = ring.write(picture(number), stamp_ns=came_ns, robot_stamp_ns=came_ns + OFFSET_NS, camera="front")
        recorder.send(replace(ref, taken_ns=came_ns - LATE_NS, taken_uncertainty_ns=1_500_000))
        if number == 3:
            utterance_ns = came_ns - LATE_NS
    for state, at_ns in (("started", utterance_ns), ("finished", utterance_ns + 100 * MS)):
        recorder.send(UtteranceChanged(at_ns, "u1", "robot", "Hello!", "phrase", state, "espeak"))
    recorder.stop_session()
    recorder.close()
    ring.close()
    yield folder


def test_robot_stamps_are_published_with_the_time_of_measurement(session: Path) -> None:
    header = json.loads((session / "session.json").read_text())
    anchor = clock.ClockAnchor(header["clock"]["monotonic_ns"], header["clock"]["utc_ns"])
    messages = mcap_messages(session)
    unknown, known = (found for found in messages if found[0] == "/odometry")
    assert unknown[1] == anchor.utc_ns_at(unknown[2]["stamp_ns"]), "nothing was known of its clock yet"
    assert known[1] == pytest.approx(anchor.utc_ns_at(known[2]["stamp_ns"] - LATE_NS), abs=MS)
    for _topic, published_ns, frame in (found for found in messages if found[0] == "/frame"):
        assert published_ns == anchor.utc_ns_at(frame["stamp_ns"] - LATE_NS)


def test_the_video_begins_when_its_first_picture_was_taken(session: Path) -> None:
    [video] = json.loads((session / "session.json").read_text())["videos"]
    [first, *_rest] = [data for topic, _, data in mcap_messages(session) if topic == "/frame"]
    assert video["first_stamp_ns"] == first["stamp_ns"] - LATE_NS
    assert (video["delay_ms"], video["uncertainty_ms"]) == (180.0, 1.5)


def test_captions_and_elan_fit_what_is_seen(session: Path, tmp_path: Path) -> None:
    export_session(session, "vtt", tmp_path / "vtt")
    [caption] = webvtt.read(str(tmp_path / "vtt" / "video-front.vtt"))
    assert caption.start_in_seconds + caption.start_time.milliseconds / 1000 == pytest.approx(0.3, abs=0.002)
    text = (tmp_path / "vtt" / "video-front.vtt").read_text()
    assert "at their capture time" in text
    assert "accurate to 1.5 ms; they reached the computer 180 ms later" in text
    export_session(session, "eaf", tmp_path / "elan")
    header = json.loads((session / "session.json").read_text())
    began_ms = (header["videos"][0]["first_stamp_ns"] - header["started_ns"]) / MS
    [eaf] = (tmp_path / "elan").glob("*.eaf")
    descriptors = ET.parse(eaf).iterfind("HEADER/MEDIA_DESCRIPTOR")  # noqa: S314 - written by this program
    [descriptor] = [media for media in descriptors if "video" in media.get("MEDIA_URL", "")]
    # A video that starts before the session is cut by its origin, a later one was moved.
    assert float(descriptor.get("TIME_ORIGIN", "0")) == pytest.approx(max(0.0, -began_ms), abs=1.0)
    assert "accurate to 1.5 ms" in (tmp_path / "elan" / "media.txt").read_text()


def test_a_late_recorder_keeps_the_time_of_values_next_to_sound(tmp_path: Path) -> None:
    """A replay shows each value from its arrival on, and never before earlier values of the recording."""
    recorder = RecorderUnderTest(in_thread=True)
    begun_ns = clock.now_ns() - 4000 * MS

    def arrived(at_ms: int, message: object) -> None:
        arrival = (begun_ns + at_ms * MS).to_bytes(8, "little", signed=True)
        recorder.connection.send_bytes(ARRIVED + arrival + pickle.dumps(message))

    arrived(0, start(tmp_path / "s"))
    arrived(100, StatusShown(begun_ns, "camera", "front"))
    for at_ms in range(200, 1200, 100):
        arrived(at_ms, AudioChunk(begun_ns + (at_ms - 100) * MS, "microphone", 16_000, np.ones((1600, 1), np.int16)))
    arrived(1300, StatusShown(begun_ns + 1300 * MS, "camera", "rear"))
    # A gap reported by the recorder itself, at the latest in a pause.
    arrived(1320, AudioChunk(begun_ns + 200 * MS, "microphone", 16_000, np.ones((160, 1), np.int16)))
    arrived(1350, PauseRecording(True))
    arrived(1400, PauseRecording(False))
    arrived(1450, StatusShown(begun_ns + 1450 * MS, "camera", "desk"))
    recorder.stop_session()
    recorder.close()
    with SessionTimeline(open_session(tmp_path / "s")) as timeline:
        shown = {
            at_ms: [value.content for value in timeline.state_at(begun_ns + at_ms * MS) if type(value) is StatusShown]
            for at_ms in (1290, 1310, 1440, 1460)
        }
        pauses_ms = [round((at_ns - begun_ns) / MS) for at_ns, _ in timeline.events(RecordingPaused)]
        gaps = [gap.stream for _, gap in timeline.events(Gap)]
    assert shown == {1290: ["front"], 1310: ["rear"], 1440: ["rear"], 1460: ["desk"]}
    assert (pauses_ms, gaps) == ([1350, 1400], ["audio"])


def test_a_head_made_again_does_not_take_a_measured_moment_for_an_arrival(tmp_path: Path) -> None:
    """The remaining events start with a frame."""
    anchor = clock.ClockAnchor(5_000 * MS, OFFSET_NS)
    file = DiskFile(tmp_path / "events.mcap", on_full=lambda: False)
    log = EventLog(file, anchor=anchor, metadata={})
    came_ns = 6_000 * MS
    frame = FrameRef(came_ns, 7, "front", "r", 0, 1, 64, 48, came_ns - LATE_NS, MS)
    for value in (frame, BatteryState(came_ns, 0.5)):
        log.write(BY_TYPE[type(value)], value, came_ns)
    log.close()
    rebuilt = rebuilt_header(tmp_path, missing=True)
    assert rebuilt is not None
    assert rebuilt.clock.utc_ns - rebuilt.clock.monotonic_ns == anchor.utc_ns - anchor.monotonic_ns
