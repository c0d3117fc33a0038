"""Conversation of an interrupted session, for the trial that resumes it."""

from dataclasses import replace
from pathlib import Path

import pytest

from caris_desktop import __version__
from caris_desktop.app.composition import conversation_of_session
from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import StartRecording
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from caris_desktop.recording.session.session_header import RecordedScenario, SessionHeader

_HOUR_NS = 3_600_000_000_000


def test_it_is_read_from_a_recording_that_was_made_before_a_reboot(tmp_path: Path) -> None:
    """The monotonic clock began anew since."""
    now = ClockAnchor.take()
    before = ClockAnchor(now.monotonic_ns + _HOUR_NS, now.utc_ns - 60_000_000_000)
    header = SessionHeader(clock=before, program_version=__version__, scenario=RecordedScenario("Tour"))
    recorder = SessionRecorder(
        StartRecording(tmp_path / "one", header), frames=FrameRings(()), report=lambda _: None,
        limits=DiskLimits(reserve_bytes=4096), started_ns=before.monotonic_ns,
    )  # fmt: skip
    said = UtteranceChanged(before.monotonic_ns, "u", "robot", "Hello.", "typed", "started")
    asked = replace(said, utterance_id="v", state="requested")
    for event in (said, replace(said, stamp_ns=said.stamp_ns + 1_000_000_000, state="finished"), asked):
        recorder.write(event)
    recorder.close("wizard")
    (turn,) = conversation_of_session(tmp_path / "one")
    assert (turn.text, turn.state) == ("Hello.", "finished")
    assert turn.started_ns is not None and turn.ended_ns is not None
    assert turn.ended_ns - turn.started_ns == 1_000_000_000
    assert abs(clock.now_ns() - turn.started_ns - 60_000_000_000) < 30_000_000_000


@pytest.mark.logs("caris_desktop.app.composition")
def test_a_session_that_cannot_be_read_has_none(tmp_path: Path) -> None:
    assert conversation_of_session(tmp_path / "gone") == ()
