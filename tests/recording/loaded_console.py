"""Console under load with an account of sent values, to measure the loss of a killed recorder."""

import time
from dataclasses import dataclass, field

import numpy as np

from caris_desktop.domain import clock
from caris_desktop.domain.events import LinkQuality, Marked, UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk, People, PeopleInMap, PersonBox, PersonPlace
from caris_desktop.live.frame_ring import FrameRing
from tests.recording.driving import RecorderUnderTest, command, picture, pose, scan

CAMERAS = ("front", "rear")
SIZE_PX = (640, 480)
_RATE_HZ = 16_000
_PERIODS_S = {
    "front": 1 / 30,
    "rear": 1 / 30,
    "scan": 1 / 20,
    "pose": 1 / 20,
    "people": 1 / 10,
    "mark": 1 / 100,
    "command": 1 / 20,
    "microphone": 1 / 50,
    "robot voice": 1 / 50,
    "utterance": 1 / 2,
}


@dataclass(slots=True)
class Account:
    """Sent stamps in order: events by number, frames by camera, ends of sound by source."""

    marks_ns: list[int] = field(default_factory=list)
    frames_ns: dict[str, list[int]] = field(default_factory=lambda: {camera: [] for camera in CAMERAS})
    sound_ends_ns: dict[str, int] = field(default_factory=dict)
    scans: int = 0


class LoadedConsole:
    """Two cameras, LIDAR, ten people, two sound sources, events and commands; frames are prepared in advance."""

    def __init__(self) -> None:
        width_px, height_px = SIZE_PX
        self.rings = {camera: FrameRing.create(width_px * height_px * 3) for camera in CAMERAS}
        self.recorder = RecorderUnderTest(*self.rings.values())
        self.account = Account()
        self._pictures = [picture(number) for number in range(16)]
        self._tone = (5000 * np.sin(np.arange(_RATE_HZ // 50) * 0.1)).astype(np.int16)[:, None]
        self._numbers = dict.fromkeys(_PERIODS_S, 0)
        self._due_s: dict[str, float] = {}

    def send_for(self, seconds: float) -> None:
        """Send in real time; values due at the same time are sent together."""
        now_s = time.monotonic()
        until_s = now_s + seconds
        self._due_s = self._due_s or dict.fromkeys(_PERIODS_S, now_s)
        while (now_s := time.monotonic()) < until_s:
            for kind, due_s in self._due_s.items():
                if due_s <= now_s:
                    self._due_s[kind] = due_s + _PERIODS_S[kind]
                    self._send(kind, self._numbers[kind])
                    self._numbers[kind] += 1
            time.sleep(max(0.0, min(*self._due_s.values(), until_s) - time.monotonic()))

    def close(self) -> None:
        self.recorder.close()
        for ring in self.rings.values():
            ring.close()

    def _send(self, kind: str, number: int) -> None:
        send, account = self.recorder.send, self.account
        now_ns = clock.now_ns()
        match kind:
            case "front" | "rear":
                image_bgr = self._pictures[number % len(self._pictures)]
                send(self.rings[kind].write(image_bgr, stamp_ns=now_ns, robot_stamp_ns=now_ns + 7, camera=kind))
                account.frames_ns[kind].append(now_ns)
            case "scan":
                send(scan(720, now_ns))
                account.scans += 1
            case "pose":
                send(pose(number / 20))
            case "people":
                boxes = tuple(PersonBox(track, f"p-{track}", 9.5 * track, 4, 50, 99, 0.9) for track in range(10))
                send(People(now_ns, "front", number, *SIZE_PX, boxes, 20.0))
                send(PeopleInMap(now_ns, tuple(PersonPlace(box.person_id, 1, 2, 0.1, "lidar") for box in boxes)))
            case "mark":
                send(Marked(now_ns, str(number), mark_id=f"m{number}"))
                account.marks_ns.append(now_ns)
            case "command":
                send(command(number))
                send(LinkQuality(now_ns, 4.0, 2000.0, 3.0))
            case "utterance":
                state = "started" if number % 2 == 0 else "finished"
                send(UtteranceChanged(now_ns, f"u{number // 2}", "robot", "Hello there.", "typed", state))
            case source:
                send(AudioChunk(now_ns, source, _RATE_HZ, self._tone))
                account.sound_ends_ns[source] = now_ns + len(self._tone) * 1_000_000_000 // _RATE_HZ
