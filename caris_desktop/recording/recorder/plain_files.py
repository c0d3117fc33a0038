"""Plain files next to the MCAP: movement and speech as text, exchanges and people as JSON."""

import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from caris_desktop.domain.events import CommandSent, LlmExchange, PersonAppeared, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import People, RobotPose
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session.session_header import SessionClock

# A present person is seen in every frame, which is no reason to rewrite the file.
_PEOPLE_EVERY_NS = 10_000_000_000
_POSE_EVERY_NS = 1_000_000_000
# The pose of a robot at rest jitters by centimetres.
_STILL_M, _STILL_RAD = 0.05, math.radians(3.0)
_MOVEMENT_HEAD = (
    "# Driving log. Times: local time, then seconds since the start of the session.\n"
    "# command: velocity sent to the robot, at each change. pose: position in the map, after each change by\n"
    "# 5 cm or 3 degrees, at most once per second. forward and left in m/s, turn in degrees/s (left positive), x and\n"
    "# y in m, heading in degrees.\n"
    f"{'time':<12} {'session_s':>10} {'what':<8} {'forward':>8} {'left':>8} {'turn':>8}"
    f" {'x':>9} {'y':>9} {'heading':>8}  by\n"
)
_SPEECH_HEAD = (
    "# Conversation log, a line per utterance. Times: local time, then seconds since the start of the session.\n"
    "# Lines with # repeat an earlier utterance that was interrupted, failed or was corrected.\n"
)


class PlainFiles:
    """Accepts every value of a session and ignores those without a plain file. Methods raise OSError."""

    def __init__(self, folder: Path, clock: SessionClock, *, on_full: Callable[[], bool]) -> None:
        self._folder = folder
        self._clock = clock
        self._on_full = on_full
        self._movement = DiskFile(folder / "movement.txt", on_full=on_full)
        self._movement.write(_MOVEMENT_HEAD.encode())
        self._speech = DiskFile(folder / "speech.txt", on_full=on_full)
        self._speech.write(_SPEECH_HEAD.encode())
        self._twist = Twist2D()
        self._pose: Pose2D | None = None
        self._written_pose: Pose2D | None = None
        self._written_pose_ns = 0
        self._spoken: dict[str, tuple[str, str]] = {}  # speaker and text
        self._speech_began_ns: dict[str, int] = {}
        self._exchanges = 0
        self._people: dict[str, tuple[int, int, set[int]]] = {}
        self._people_changed = self._people_new = True
        self._people_written_ns = 0
        self._replaced: list[Path] = []
        self._replaced_bytes = 0

    @property
    def written_bytes(self) -> int:
        return self._movement.size_bytes + self._speech.size_bytes + self._replaced_bytes

    def add(self, value: Any) -> None:
        match value:
            case CommandSent():
                self._add_command(value)
            case RobotPose():
                self._add_pose(value)
            case UtteranceChanged(speaker="participant"):
                self._add_heard(value)
            case UtteranceChanged():
                self._add_utterance(value)
            case UtteranceCorrected():
                self._add_correction(value)
            case LlmExchange():
                self._add_exchange(value)
            case People():
                for box in value.boxes:
                    if box.person_id:
                        self._see(box.person_id, box.track, value.stamp_ns)
            case PersonAppeared():
                self._see(value.person_id, value.track, value.stamp_ns)

    def write_people(self) -> None:
        """Update ``people.json``: at once for a new person, else periodically."""
        waited_ns = time.monotonic_ns() - self._people_written_ns
        if self._people_new or (self._people_changed and waited_ns >= _PEOPLE_EVERY_NS):
            self._write_people()

    def _write_people(self) -> None:
        rows = [
            {
                "person_id": person_id,
                "first_seen_s": round(self._clock.session_s(first_ns), 3),
                "last_seen_s": round(self._clock.session_s(last_ns), 3),
                "first_seen_utc": self._clock.utc(first_ns),
                "last_seen_utc": self._clock.utc(last_ns),
                "tracks": sorted(tracks),
            }
            for person_id, (first_ns, last_ns, tracks) in self._people.items()
        ]
        self._replace("people.json", {"people": rows})
        self._people_changed = self._people_new = False
        self._people_written_ns = time.monotonic_ns()

    def files(self) -> list[DiskFile]:
        """Growing files."""
        return [self._movement, self._speech]

    def take_replaced(self) -> list[Path]:
        """Files replaced since the last call."""
        replaced, self._replaced = self._replaced, []
        return replaced

    def close(self) -> None:
        try:
            if self._people_changed:
                self._write_people()
        finally:
            self._movement.close()
            self._speech.close()

    def _add_command(self, command: CommandSent) -> None:
        if command.twist == self._twist:
            return
        self._twist = command.twist
        self._write_movement(command.stamp_ns, "command", command.twist, command.source)

    def _add_pose(self, pose: RobotPose) -> None:
        self._pose = pose.pose_in_map
        due = pose.stamp_ns - self._written_pose_ns >= _POSE_EVERY_NS
        if due and (self._written_pose is None or _moved(self._written_pose, self._pose)):
            self._written_pose, self._written_pose_ns = self._pose, pose.stamp_ns
            self._write_movement(pose.stamp_ns, "pose", None, "")

    def _write_movement(self, stamp_ns: int, movement: str, twist: Twist2D | None, by: str) -> None:
        velocity = f"{'':>8} {'':>8} {'':>8}"
        if twist is not None:
            velocity = f"{twist.forward_mps:>8.3f} {twist.left_mps:>8.3f} {math.degrees(twist.turn_radps):>8.2f}"
        place = f"{'-':>9} {'-':>9} {'-':>8}"
        if self._pose is not None:
            place = f"{self._pose.x_m:>9.3f} {self._pose.y_m:>9.3f} {math.degrees(self._pose.heading_rad):>8.1f}"
        line = f"{self._times(stamp_ns)} {movement:<8} {velocity} {place}  {by}"
        self._movement.write(f"{line.rstrip()}\n".encode())

    def _add_utterance(self, utterance: UtteranceChanged) -> None:
        if utterance.state == "requested":
            return
        first = utterance.utterance_id not in self._spoken
        self._spoken[utterance.utterance_id] = (utterance.speaker, utterance.text)
        if utterance.state in ("interrupted", "failed"):
            remark = f"  [{utterance.state}{': ' + utterance.detail if utterance.detail else ''}]"
        elif first:
            remark = f"  [{utterance.origin}]"
        else:
            return
        self._write_speech(utterance.stamp_ns, utterance.speaker, utterance.text, remark, again=not first)

    def _add_heard(self, utterance: UtteranceChanged) -> None:
        """Write a line when the utterance is complete, with its start time."""
        if utterance.state == "started":
            self._speech_began_ns[utterance.utterance_id] = utterance.stamp_ns
        elif utterance.state in ("finished", "interrupted") and utterance.text:
            from_ns = self._speech_began_ns.pop(utterance.utterance_id, utterance.stamp_ns)
            self._spoken[utterance.utterance_id] = ("participant", utterance.text)
            who = f" ({utterance.person_id})" if utterance.person_id else ""
            self._write_speech(from_ns, f"participant{who}", utterance.text, f"  [{utterance.origin}]")

    def _add_correction(self, corrected: UtteranceCorrected) -> None:
        """Append a line; earlier lines are never changed."""
        known = self._spoken.get(corrected.utterance_id)
        if known is None or (corrected.text is None and corrected.speaker is None and corrected.person_id is None):
            return
        who = known[0] if corrected.speaker is None else corrected.speaker
        text = known[1] if corrected.text is None else corrected.text
        self._spoken[corrected.utterance_id] = (who, text)
        who = f"{who or 'unknown speaker'}{f' ({corrected.person_id})' if corrected.person_id else ''}"
        was = f", before: {' '.join(known[1].split())}" if text != known[1] else ""
        self._write_speech(corrected.stamp_ns, who, text, f"  [corrected{was}]", again=True)

    def _write_speech(self, stamp_ns: int, who: str, text: str, remark: str, *, again: bool = False) -> None:
        line = f"{'# ' if again else ''}{self._times(stamp_ns)} {who}: {' '.join(text.split())}{remark}\n"
        self._speech.write(line.encode("utf-8", "replace"))

    def _add_exchange(self, exchange: LlmExchange) -> None:
        self._exchanges += 1
        folder = self._folder / "llm"
        folder.mkdir(exist_ok=True)
        times = {"asked_utc": self._clock.utc(exchange.asked_ns), "answered_utc": self._clock.utc(exchange.stamp_ns)}
        self._replace(f"llm/{self._exchanges:04d}.json", {**times, **to_jsonable(exchange)})

    def _see(self, person_id: str, track: int, stamp_ns: int) -> None:
        known = self._people.get(person_id)
        if known is None:
            self._people[person_id] = (stamp_ns, stamp_ns, {track})
            self._people_new = True
        else:
            first_ns, last_ns, tracks = known
            self._people_new = self._people_new or track not in tracks
            tracks.add(track)
            self._people[person_id] = (min(first_ns, stamp_ns), max(last_ns, stamp_ns), tracks)
        self._people_changed = True

    def _replace(self, name: str, data: Any) -> None:
        text = (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode("utf-8", "replace")
        replace_file(self._folder / name, text, durable=False, on_full=self._on_full)
        self._replaced.append(self._folder / name)
        self._replaced_bytes += len(text)

    def _times(self, stamp_ns: int) -> str:
        return f"{self._clock.wall(stamp_ns)} {self._clock.session_s(stamp_ns):>10.3f}"


def _moved(before: Pose2D, now: Pose2D) -> bool:
    turned_rad = abs(math.remainder(now.heading_rad - before.heading_rad, 2 * math.pi))
    return math.hypot(now.x_m - before.x_m, now.y_m - before.y_m) > _STILL_M or turned_rad > _STILL_RAD
