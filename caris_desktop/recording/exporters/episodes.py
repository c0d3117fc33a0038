"""Training data for robot learning: driving episodes and dialogue turns as JSON lines."""

import bisect
import json
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from caris_desktop.domain.events import AnswerUsed, CommandSent, GoalChanged, LlmExchange
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.picture_checks import jpeg_of
from caris_desktop.domain.sensing import FrameRef, LaserScan, Odometry, People, PeopleInMap, RobotPose
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.exporters.exported_pictures import camera_file_name, picture_of
from caris_desktop.recording.exporters.tables import key_columns
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.answers import LlmUse, answer_uses, questions_of
from caris_desktop.recording.session.robot_clock_mapping import RobotClock, robot_clock
from caris_desktop.recording.session.session_driving import COMMAND_HOLDS_S
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.utterances import SpokenUtterance
from caris_desktop.recording.studies.measures import reaction_times, read_facts, response_times

STEP_NS = 100_000_000
PAUSE_NS = 2_000_000_000
"""So long without driving ends an episode."""
PICTURE_WIDTH_PX = 640
"""Pictures of steps are no wider: what learns from them makes them smaller still."""
_JPEG_QUALITY = 90
_STEPS_AFTER = 5
_OLD_NS = 5_000_000_000
_TURNS_BEFORE = 20
_EDIT_WITHIN_NS = 5_000_000_000
_STREAMS = (
    "frame", "scan", "odometry", "pose", "people", "people_in_map", "event/goal_changed", "event/command_sent"
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Written:
    """Files written, and the number of episodes (or turns) and steps."""

    paths: tuple[Path, ...]
    episodes: int
    steps: int


def session_columns(session: Session) -> dict[str, str]:
    """Session columns that begin every line, so that lines of several sessions can be distinguished."""
    return {column.name: column.read(None, None) for column in key_columns(session)}  # type: ignore[arg-type] # constants


def write_driving(session: Session, out: Path, progress: Callable[[float], None]) -> Written:
    """Write ``episodes.jsonl``, a steps file for each episode and the images they reference into ``out``.

    Raises OSError, SessionError.
    """
    out.mkdir()
    with VideoReader(session) as videos:
        return _write_driving(session, out, _StepPictures(videos, out), progress)


def _write_driving(
    session: Session, out: Path, pictures: "_StepPictures", progress: Callable[[float], None]
) -> Written:
    situation = _Situation(robot_clock(session))
    writer = _EpisodeWriter(session, out, pictures)
    step_ns, begun_with = session.started_ns, situation.known()
    span_ns = max(1, session.ended_ns - session.started_ns)

    def end_step() -> None:
        action = situation.action(step_ns + STEP_NS)
        # States are large, and a session is mostly rest.
        if writer.is_open or _moves(action):
            writer.add(step_ns, _state(begun_with, step_ns), action, _frames(begun_with, step_ns))

    try:
        for number, (arrival_ns, _, value) in enumerate(session.arrivals(*_STREAMS)):
            while arrival_ns >= step_ns + STEP_NS:
                end_step()
                step_ns, begun_with = step_ns + STEP_NS, situation.known()
            situation.take(value, arrival_ns)
            if not number % 500:
                progress(min(1.0, max(0.0, (arrival_ns - session.started_ns) / span_ns)))
        end_step()
    finally:
        writer.close()
    return Written((writer.index, *writer.paths, *pictures.paths), len(writer.paths), writer.steps)


# By type; frames by camera.
_Known = dict[type[Any] | str, tuple[Any, int]]


class _Situation:
    """Latest value of each type by arrival, with its measurement time: the console's knowledge at a step."""

    def __init__(self, clock: RobotClock) -> None:
        self._clock = clock
        self._newest: _Known = {}
        self._command: tuple[CommandSent, int] | None = None

    def take(self, value: Any, arrival_ns: int) -> None:
        if isinstance(value, CommandSent):
            self._command = value, arrival_ns
        else:
            measured = self._clock.measured(getattr(value, "robot_stamp_ns", None), arrival_ns=arrival_ns)
            key = value.camera if isinstance(value, FrameRef) else type(value)
            self._newest[key] = value, value.stamp_ns if measured is None else measured.stamp_ns

    def known(self) -> _Known:
        return dict(self._newest)

    def action(self, at_ns: int) -> dict[str, Any]:
        """Velocity in force; zero if the newest command has expired."""
        twist, source = Twist2D(), "none"
        if self._command is not None and at_ns - self._command[1] <= COMMAND_HOLDS_S * 1e9:
            twist, source = self._command[0].twist, self._command[0].source
        return {
            "forward_mps": twist.forward_mps,
            "left_mps": twist.left_mps,
            "turn_radps": twist.turn_radps,
            "source": source,
        }


def _moves(action: dict[str, Any]) -> bool:
    return any(action[name] for name in ("forward_mps", "left_mps", "turn_radps"))


def _state(known: _Known, at_ns: int) -> dict[str, Any]:
    def of(kind: type[Any], content_of: Callable[[Any], dict[str, Any]]) -> dict[str, Any] | None:
        value, moment_ns = known.get(kind, (None, 0))
        if value is None or at_ns - moment_ns > _OLD_NS:
            return None
        return {"age_s": round((at_ns - moment_ns) / 1e9, 4), **content_of(value)}

    return {
        "scan": of(LaserScan, _scan),
        "pose_in_map": of(RobotPose, lambda pose: _pose(pose.pose_in_map)),
        "odometry": of(Odometry, _odometry),
        "goal": _goal(known),
        "people_in_map": of(PeopleInMap, _people_in_map),
        "people_in_view": of(People, _people_in_view),
    }


def _goal(known: _Known) -> dict[str, Any] | None:
    goal: GoalChanged | None = known.get(GoalChanged, (None, 0))[0]
    if goal is None or goal.state not in ("requested", "active"):
        return None
    return {"goal_id": goal.goal_id, "place": goal.place, **_pose(goal.target_in_map)}


def _frames(known: _Known, at_ns: int) -> list[tuple[FrameRef, float]]:
    """Newest frame of each camera, with its age in seconds."""
    return [
        (value, (at_ns - moment_ns) / 1e9)
        for value, moment_ns in known.values()
        if isinstance(value, FrameRef) and at_ns - moment_ns <= _OLD_NS
    ]


class _StepPictures:
    """Writes the images that steps reference, each once. Fastest in order of time."""

    def __init__(self, videos: VideoReader, out: Path) -> None:
        self._videos = videos
        self._out = out
        self._folder = out / "pictures"
        self._written: dict[str, tuple[int, str | None]] = {}
        self.paths: list[Path] = []

    def names(self, frames: list[tuple[FrameRef, float]]) -> dict[str, dict[str, Any]]:
        """Image path per camera, relative to the steps' folder; omits cameras without the frame in their video."""
        found = {}
        for frame, age_s in frames:
            stamp_ns, name = self._written.get(frame.camera, (None, None))
            if stamp_ns != frame.stamp_ns:
                name = self._write(frame)
                self._written[frame.camera] = frame.stamp_ns, name
            if name is not None:
                found[frame.camera] = {"image": name, "age_s": round(age_s, 4), "frame_sequence": frame.sequence}
        return found

    def _write(self, frame: FrameRef) -> str | None:
        picture = picture_of(self._videos, frame.camera, frame.stamp_ns)
        if picture is None:
            return None
        self._folder.mkdir(exist_ok=True)
        path = self._folder / f"{camera_file_name(frame.camera)}-{len(self.paths) + 1:06d}.jpg"
        path.write_bytes(jpeg_of(picture.image_bgr, quality=_JPEG_QUALITY, most_px=PICTURE_WIDTH_PX))
        self.paths.append(path)
        return path.relative_to(self._out).as_posix()


class _EpisodeWriter:
    """Cuts steps into episodes, from the first that moves to the last, plus a short rest."""

    def __init__(self, session: Session, out: Path, pictures: _StepPictures) -> None:
        self._session = session
        self._whose = session_columns(session)
        self._pictures = pictures
        self._out = out
        self.index = out / "episodes.jsonl"
        self.paths: list[Path] = []
        self.steps = 0
        self._index_file = self.index.open("w", encoding="utf-8", errors="replace")
        self._file: IO[str] | None = None
        self._resting: list[dict[str, Any]] = []
        self._of_this: list[int] = []
        self._sources: Counter[str] = Counter()

    @property
    def is_open(self) -> bool:
        return self._file is not None

    def add(
        self, at_ns: int, state: dict[str, Any], action: dict[str, Any], frames: list[tuple[FrameRef, float]]
    ) -> None:
        moving = _moves(action)
        if not moving and self._file is None:
            return
        if self._file is None:
            path = self._out / f"episode-{len(self.paths) + 1:04d}.jsonl"
            self._file = path.open("w", encoding="utf-8", errors="replace")
            self.paths.append(path)
        row = {"at_ns": at_ns, "state": state, "action": action, "frames": frames}
        if not moving:
            self._resting.append(row)
            if len(self._resting) * STEP_NS >= PAUSE_NS:
                self._end()
            return
        self._sources[action["source"]] += 1
        for step in (*self._resting, row):
            self._write(step)
        self._resting.clear()

    def close(self) -> None:
        self._end()
        self._index_file.close()

    def _write(self, row: dict[str, Any]) -> None:
        if self._file is None:
            return
        at_ns = row["at_ns"]
        line = {
            **self._whose,
            "episode": len(self.paths),
            "step": len(self._of_this),
            "session_s": round(self._session.clock.session_s(at_ns), 4),
            "utc": self._session.clock.utc(at_ns),
            "state": {**row["state"], "pictures": self._pictures.names(row["frames"])},
            "action": row["action"],
        }
        self._file.write(_line(line))
        self._of_this.append(at_ns)
        self.steps += 1

    def _end(self) -> None:
        if self._file is None:
            return
        for step in self._resting[:_STEPS_AFTER]:
            self._write(step)
        self._file.close()
        first_ns, last_ns = self._of_this[0], self._of_this[-1]
        summary = {
            **self._whose,
            "episode": len(self.paths),
            "file": self.paths[-1].name,
            "steps": len(self._of_this),
            "start_s": round(self._session.clock.session_s(first_ns), 4),
            "end_s": round(self._session.clock.session_s(last_ns + STEP_NS), 4),
            "steps_by_source": dict(sorted(self._sources.items())),
        }
        self._index_file.write(_line(summary))
        self._file = None
        self._resting.clear()
        self._of_this.clear()
        self._sources.clear()


def write_dialogue(session: Session, out: Path) -> Written:
    """Write ``turns.jsonl``: one line per robot utterance. Raises OSError, SessionError."""
    out.mkdir()
    facts = read_facts(session)
    spoken = [utterance for utterance in facts.utterances if utterance.said]
    responses = {reply.utterance.utterance_id: reply.delay_s for reply in response_times(spoken, facts.pauses)}
    exchanges = questions_of(facts.of(LlmExchange))
    became = answer_uses(exchanges, facts.of(AnswerUsed), facts.utterances)
    reactions = {
        reply.utterance.utterance_id: reply.delay_s
        for reply in reaction_times(facts.utterances, exchanges, facts.pauses)
    }
    in_view, of_this = _counts_in_view(session), session_columns(session)
    path = out / "turns.jsonl"
    turns, before_ns = 0, -(2**62)
    with path.open("w", encoding="utf-8", errors="replace") as file:
        for utterance in facts.utterances:
            if utterance.speaker != "robot":
                continue
            at_ns = _decided_ns(utterance)
            if at_ns is None:
                continue
            known = [other for other in spoken if other is not utterance and _known_at(other, at_ns)]
            preceding = [exchange for exchange in exchanges if before_ns < exchange.stamp_ns <= at_ns]
            edited = _edited_answer(utterance.text, at_ns, facts.of(AnswerUsed))
            line = {
                **of_this,
                "turn": turns + 1,
                "utterance_id": utterance.utterance_id,
                "decided_s": _seconds(session, at_ns),
                "utc": session.clock.utc(at_ns),
                "context": {
                    "transcript": [_as_heard(session, other, at_ns) for other in known[-_TURNS_BEFORE:]],
                    "people_in_view": _count_at(in_view, at_ns),
                    "assistant": [_exchange(session, exchange, became[exchange.exchange_id]) for exchange in preceding],
                },
                "action": {
                    "text": utterance.text,
                    "origin": "edited" if edited else utterance.origin,
                    "voice": utterance.voice,
                    "started_s": _seconds(session, utterance.start_ns),
                    "ended_s": _seconds(session, utterance.end_ns),
                    "state": utterance.state,
                    "said": utterance.said,
                },
                "response_time_s": _rounded(responses.get(utterance.utterance_id)),
                "wizard_reaction_time_s": _rounded(reactions.get(utterance.utterance_id)),
            }
            file.write(_line(line))
            turns, before_ns = turns + 1, at_ns
    return Written((path,), turns, turns)


def _decided_ns(utterance: SpokenUtterance) -> int | None:
    return utterance.start_ns if utterance.requested_ns is None else utterance.requested_ns


def _known_at(utterance: SpokenUtterance, at_ns: int) -> bool:
    """True if the utterance had begun; transcripts of heard speech are known only after its end."""
    if utterance.start_ns is None or utterance.start_ns >= at_ns:
        return False
    return utterance.speaker == "robot" or (utterance.end_ns is not None and utterance.end_ns <= at_ns)


def _as_heard(session: Session, utterance: SpokenUtterance, at_ns: int) -> dict[str, Any]:
    ended = utterance.end_ns is not None and utterance.end_ns <= at_ns
    return {
        "speaker": utterance.speaker,
        "text": utterance.text,
        "origin": utterance.origin,
        "started_s": _seconds(session, utterance.start_ns),
        "ended_s": _seconds(session, utterance.end_ns) if ended else None,
    }


def _exchange(session: Session, exchange: LlmExchange, use: LlmUse) -> dict[str, Any]:
    return {
        "exchange_id": exchange.exchange_id,
        "provider": exchange.provider,
        "model": exchange.model,
        "model_version": exchange.model_version,
        "server": exchange.server,
        "seed": exchange.seed,
        "parameters": exchange.parameters,
        "messages": [{"role": message.role, "content": message.content} for message in exchange.messages],
        "answer": exchange.answer,
        "outcome": exchange.outcome,
        "cut": exchange.cut,
        "asked_s": _seconds(session, exchange.asked_ns),
        "answered_s": _seconds(session, exchange.stamp_ns),
        "use": use,
    }


def _edited_answer(text: str, at_ns: int, uses: tuple[AnswerUsed, ...]) -> bool:
    return any(
        use.use == "edited" and use.text.strip() == text.strip() and abs(use.stamp_ns - at_ns) <= _EDIT_WITHIN_NS
        for use in uses
    )


def _counts_in_view(session: Session) -> dict[str, tuple[list[int], list[int]]]:
    """Times and numbers of people per camera, at each change."""
    counts: dict[str, tuple[list[int], list[int]]] = {}
    for _, people in session.values("people"):
        moments, numbers = counts.setdefault(people.camera, ([], []))
        if not numbers or numbers[-1] != len(people.boxes):
            moments.append(people.stamp_ns)
            numbers.append(len(people.boxes))
    return counts


def _count_at(counts: dict[str, tuple[list[int], list[int]]], at_ns: int) -> dict[str, int]:
    found = {}
    for camera, (moments, numbers) in counts.items():
        index = bisect.bisect_right(moments, at_ns) - 1
        if index >= 0:
            found[camera] = numbers[index]
    return found


def _scan(scan: LaserScan) -> dict[str, Any]:
    ranges = np.asarray(scan.ranges_m, np.float64).round(4)
    return {
        "angle_min_rad": scan.angle_min_rad,
        "angle_increment_rad": scan.angle_increment_rad,
        "range_max_m": scan.range_max_m if math.isfinite(scan.range_max_m) else None,
        "robot_from_laser": None if scan.robot_from_laser is None else _pose(scan.robot_from_laser),
        "ranges_m": [value if math.isfinite(value) else None for value in ranges.tolist()],
    }


def _odometry(odometry: Odometry) -> dict[str, Any]:
    twist = odometry.twist
    return {
        "pose_in_odom": _pose(odometry.pose_in_odom),
        "forward_mps": twist.forward_mps,
        "left_mps": twist.left_mps,
        "turn_radps": twist.turn_radps,
    }


def _people_in_map(people: PeopleInMap) -> dict[str, Any]:
    return {
        "people": [
            {"person_id": person.person_id, "x_m": person.x_m, "y_m": person.y_m, "spread_m": person.spread_m}
            for person in people.people
        ]
    }


def _people_in_view(people: People) -> dict[str, Any]:
    return {
        "camera": people.camera,
        "frame_width_px": people.frame_width_px,
        "frame_height_px": people.frame_height_px,
        "boxes": [
            {
                "person_id": box.person_id,
                "left_px": box.left_px,
                "top_px": box.top_px,
                "width_px": box.width_px,
                "height_px": box.height_px,
                "confidence": box.confidence,
            }
            for box in people.boxes
        ],
    }


def _pose(pose: Pose2D) -> dict[str, Any]:
    return {"x_m": pose.x_m, "y_m": pose.y_m, "heading_rad": pose.heading_rad}


def _seconds(session: Session, stamp_ns: int | None) -> float | None:
    return None if stamp_ns is None else round(session.clock.session_s(stamp_ns), 4)


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 4)


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=_plain) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not JSON")
