"""Small study in which one of several people is named, seen, heard and photographed."""

import secrets
from pathlib import Path
from unittest import mock

import numpy as np

from tests.support import recorded_session
from tests.support.recorded_session import SessionPlan, make_session

NAME, OTHER = "Zoë Quillfeather", "Basil Thornapple"
PERSON, OTHER_PERSON = "p-1", "p-2"
UTTERANCES = (
    ("robot", f"Hello {NAME}, welcome to our laboratory."),
    ("participant", "Hi. What can you show me?"),
    ("robot", f"{OTHER} is here too."),
    ("participant", "I am Quillfeather, by the way."),
)


def make_study(folder: Path, *, sessions: int = 1, seconds: float = 13.0, fps: float = 10.0) -> Path:
    """Sessions of ``seconds`` with two people, in which the robot says their names."""
    with mock.patch.object(recorded_session, "UTTERANCES", UTTERANCES):
        for number in range(sessions):
            plan = SessionPlan(
                seconds=seconds,
                cameras=("front",),
                fps=fps,
                size_px=(320, 180),
                scans_hz=1.0,
                beams=20,
                odometry_hz=2.0,
                people=2,
                people_hz=5.0,
                utterance_every_s=2.0,
                person_every_s=0.0,
                photo_every_s=5.0,
                map_cells=(10, 16),
                started_utc_ns=(1_790_000_000 + 3600 * number) * 1_000_000_000,
            )
            make_session(folder / "sessions" / f"2026-11-2{number}_10-00-00_P0{number}", plan)
    return folder


def every_file(study: Path) -> dict[str, bytes]:
    return {str(path.relative_to(study)): path.read_bytes() for path in sorted(study.rglob("*")) if path.is_file()}


def portrait() -> bytes:
    """Image of noise, as JPEG."""
    import cv2

    noise = np.frombuffer(secrets.token_bytes(64 * 64 * 3), np.uint8).reshape(64, 64, 3)
    return bytes(cv2.imencode(".jpg", noise)[1].tobytes())
