"""Steps of the guided practice, and detection of their completion. With injected time, without Qt."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from caris_desktop.domain.events import (
    CommandSent,
    EmergencyStopChanged,
    LinkChanged,
    LlmExchange,
    Marked,
    PersonRenamed,
    PhotoTaken,
    SuggestionChanged,
    UtteranceChanged,
)
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value

_DRIVEN_M, _DRIVEN_AGAIN_M = 1.0, 0.3
_MOST_POINTS, _FEWEST_POINTS = 10.0, 5.0
_SLOW = 3.0
"""Factor of the usual time at which a step gets the fewest points."""


class PracticeStep(Value):
    """``how``: instruction, with ``{key}`` for the key of ``action_id`` in the action table. ``usual_s``: duration with
    experience.
    """

    id: str
    title: str
    how: str
    usual_s: float
    action_id: str = ""


STEPS = (
    PracticeStep(
        "drive", QT_TR_NOOP("Drive one metre"),
        QT_TR_NOOP("Hold {key} or the up arrow key: the robot drives while you hold it. The other arrow keys turn and "
            "reverse."),
        40.0, "drive_forward",
    ),
    PracticeStep(
        "type", QT_TR_NOOP("Type while driving"),
        QT_TR_NOOP("Press {key} and type something. Hold Alt and an arrow key so that the robot drives, then press "
            "Enter while driving."),
        60.0, "focus_speak",
    ),
    PracticeStep(
        "phrase", QT_TR_NOOP("Say a phrase"),
        QT_TR_NOOP("Press {key}, or click one of the phrases below the Speak field."), 20.0, "phrase_1",
    ),
    PracticeStep(
        "name", QT_TR_NOOP("Name a person"),
        QT_TR_NOOP(
            "Press {key}, or Name next to a person in People. Type a name and press "
            "Enter."), 40.0, "name_person",
    ),
    PracticeStep(
        "photo", QT_TR_NOOP("Take a photo"),
        QT_TR_NOOP("Press {key}, or Photo above the video."), 20.0, "photo",
    ),
    PracticeStep(
        "ask", QT_TR_NOOP("Ask the assistant"),
        QT_TR_NOOP(
            "Click Assistant, or press {key} and type its name. Type a question, press Enter, and wait for "
                "the answer."
        ),
        60.0, "find",
    ),
    PracticeStep(
        "suggestion", QT_TR_NOOP("Use a suggestion"),
        QT_TR_NOOP("A participant has asked a question. When Conversation shows suggested replies, press {key} to say "
            "one."),
        40.0, "suggestion_1",
    ),
    PracticeStep(
        "mark", QT_TR_NOOP("Mark a moment"),
        QT_TR_NOOP("Press {key}, or Mark at the top. The mark is recorded for later analysis."), 20.0, "mark",
    ),
    PracticeStep(
        "link", QT_TR_NOOP("Recover from a lost connection"),
        QT_TR_NOOP(
            "The connection was interrupted. Note how the window shows this. It reconnects automatically: "
                "then drive a little further."
        ),
        40.0,
    ),
    PracticeStep(
        "emergency", QT_TR_NOOP("Stop in an emergency"),
        QT_TR_NOOP(
            "Press Esc twice, or the red button. Then release the stop with the button in the red banner, or "
                "in Find anything."
        ),
        30.0,
        "emergency_stop",
    ),
)  # fmt: skip


class EndedStep(Value):
    """``took_s``: from the end of the previous step."""

    step: PracticeStep
    done: bool
    took_s: float

    @property
    def points(self) -> float:
        if not self.done:
            return 0.0
        late = (self.took_s / self.step.usual_s - 1.0) / (_SLOW - 1.0)
        return _MOST_POINTS - (_MOST_POINTS - _FEWEST_POINTS) * min(1.0, max(0.0, late))


class Practice:
    """One run of the practice; detects completed steps from events."""

    def __init__(self, now_s: float) -> None:
        self.began_s = now_s
        self.ended: list[EndedStep] = []
        self._since_s = now_s
        self._moving = self._moved = self._lost = self._latched = False
        self._driven_m = 0.0
        self._at: tuple[float, float] | None = None
        self._happened: Mapping[str, Callable[[Any], bool]] = {
            "drive": lambda _event: self._driven_m >= _DRIVEN_M,
            "type": self._typed_while_driving,
            "phrase": lambda event: _was_spoken(event, "phrase"),
            "name": lambda event: isinstance(event, PersonRenamed) and bool(event.actor),
            "photo": lambda event: isinstance(event, PhotoTaken),
            "ask": lambda event: (
                isinstance(event, LlmExchange) and (event.purpose, event.outcome) == ("question", "answered")
            ),
            "suggestion": lambda event: isinstance(event, SuggestionChanged) and event.state in ("taken", "edited"),
            "mark": lambda event: isinstance(event, Marked) and event.kind == "mark" and event.state != "withdrawn",
            "link": lambda _event: self._lost and self._driven_m >= _DRIVEN_AGAIN_M,
            "emergency": self._released,
        }

    @property
    def now(self) -> PracticeStep | None:
        """Current step; None after the last."""
        return STEPS[len(self.ended)] if len(self.ended) < len(STEPS) else None

    @property
    def since_s(self) -> float:
        return self._since_s

    @property
    def done(self) -> int:
        return sum(step.done for step in self.ended)

    @property
    def score(self) -> int:
        """Score of 100: ten for a step in its usual time, five at three times that, none if skipped."""
        return round(sum(step.points for step in self.ended))

    def minutes(self, now_s: float) -> float:
        return (now_s - self.began_s) / 60.0

    def add(self, value: Any, now_s: float) -> EndedStep | None:
        """Process an event or robot motion; returns the step that it completed."""
        if isinstance(value, CommandSent):
            self._moving = value.twist.moving
            self._moved = self._moved or self._moving
        elif isinstance(value, Odometry):
            self._drove(value)
        elif isinstance(value, LinkChanged) and value.link == "control":
            if value.state == "lost":
                self._lost, self._driven_m = True, 0.0
        elif isinstance(value, EmergencyStopChanged) and value.latched:
            self._latched = True
        step = self.now
        if step is None or not self._happened[step.id](value):
            return None
        return self._end(step, now_s, done=True)

    def skip(self, now_s: float) -> EndedStep | None:
        return None if self.now is None else self._end(self.now, now_s, done=False)

    def _end(self, step: PracticeStep, now_s: float, *, done: bool) -> EndedStep:
        ended = EndedStep(step, done, now_s - self._since_s)
        self.ended.append(ended)
        self._since_s = now_s
        self._lost = self._latched = False
        self._driven_m = 0.0
        return ended

    def _drove(self, odometry: Odometry) -> None:
        """Count manually driven distance only, not navigation or pushing. Odometry may arrive less often than commands:
        the last part arrives after the key was released.
        """
        pose = odometry.pose_in_odom
        before, self._at = self._at, (pose.x_m, pose.y_m)
        if before is not None and self._moved:
            self._driven_m += math.dist(before, self._at)
        self._moved = self._moving

    def _typed_while_driving(self, event: Any) -> bool:
        return self._moving and isinstance(event, UtteranceChanged) and event.origin == "typed"

    def _released(self, event: Any) -> bool:
        return self._latched and isinstance(event, EmergencyStopChanged) and not event.latched


def _was_spoken(event: Any, origin: str) -> bool:
    return isinstance(event, UtteranceChanged) and event.origin == origin and event.state in ("started", "finished")
