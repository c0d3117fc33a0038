"""Decides on every intent, before anything is done about it. A refusal is a sentence."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from caris_desktop.domain import intents
from caris_desktop.domain.actor import MODEL
from caris_desktop.domain.events import ProblemEnd, Severity
from caris_desktop.domain.intents import INTENTS, Intent, IntentSpec, Permission
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Permissions

_NOT_PERMITTED: dict[Permission, tuple[str, str]] = {
    "driving": ("This scenario does not drive.", "Nothing was sent to the robot."),
    "photos": ("This scenario takes no photos.", "No picture was kept."),
    "video_recording": ("This scenario records no video.", "No picture was kept."),
    "audio_recording": ("This scenario records no sound.", "Nothing was listened to."),
    "assistant": ("This scenario has no assistant.", "The language model was not asked."),
    "naming_people": ("In this scenario people get no names.", "Nothing about them was changed."),
    "robot_controls": ("This scenario does not use the robot's controls.", "Nothing was sent to the robot."),
    "transcription": ("This scenario turns no speech into text.", "Nothing was listened to."),
    "own_voice": ("In this scenario the wizard does not speak through the robot.", "Nothing was heard there."),
    "cloud_models": ("This scenario uses local models only.", "Nothing left this computer."),
    "face": ("In this scenario the robot has no face.", "Nothing was shown."),
    "speech": ("In this scenario the robot does not speak.", "Nothing was said."),
    "notes": ("This scenario keeps no notes.", "Nothing was written down."),
}


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why not, what that means, and what to do; ``until`` as in Problem. ``quiet``: nobody needs to be told."""

    what: str
    meaning: str
    advice: str
    until: ProblemEnd = ""
    severity: Severity = "warning"
    quiet: bool = False


class Gate:
    """Permission, bounds, emergency stop, link, replay. GUI thread."""

    def __init__(self, state: LiveState, permissions: Callable[[], Permissions], *, replay: bool = False) -> None:
        self._state = state
        self._permissions = permissions
        self._replay = replay

    def refusal(self, intent: Intent) -> Refusal | None:
        """Why this may not be done now; None where it may."""
        spec = INTENTS[type(intent)]
        if self._replay:
            return None if spec.in_replay else _replayed(intent)
        if intent.actor == MODEL:
            # What it suggests and proposes is asked for by the wizard's key, or by the console after its countdown.
            return Refusal(
                f"{spec.words} is not possible: a language model asks for nothing by itself.",
                "Nothing was done.", "Do it yourself if it is wanted.",
            )  # fmt: skip
        unfit = _unfit(intent, spec)
        if unfit:
            # Nobody types such values: a program that asks has made a mistake.
            return Refusal(f"{spec.words} is not possible: {unfit}.", "Nothing was done.", "Ask for another value.")
        if intent.lets_go:
            return None
        withheld = self._permissions().withheld(intent.needs_permissions or spec.permissions)
        if withheld is not None:
            what, meaning = _NOT_PERMITTED[withheld]
            return Refusal(what, meaning, "Open a scenario that does.", quiet=spec.quiet)
        words, moves = self._of_control(intent, spec)
        if moves and self._state.drive.value.emergency_stop:
            return Refusal(
                f"{words} is not possible: the emergency stop is on.",
                "Nothing was sent to the robot.",
                "Release the emergency stop first, when everybody is clear of the robot.",
                until="released",
                quiet=spec.quiet,
            )
        if spec.needs_link and self._state.link.value.state != "connected":
            return Refusal(
                f"{words} is not possible: the robot is not connected.",
                "Nothing was sent to it, and nothing is kept for later.",
                "Try again when the link is back.",
                until="connected",
                quiet=spec.quiet,
            )
        return None

    def _of_control(self, intent: Intent, spec: IntentSpec) -> tuple[str, bool]:
        """Words for it, and whether it may move the robot; of a control both are its own."""
        if not isinstance(intent, intents.UseControl):
            return spec.words, spec.moves
        control = next((one for one in self._state.controls.value if one.id == intent.control), None)
        return (spec.words, True) if control is None else (f"Using “{control.title}”", control.is_motion)


def _unfit(intent: Intent, spec: IntentSpec) -> str:
    for name, (least, greatest) in spec.bounds.items():
        value = getattr(intent, name)
        if not math.isfinite(value) or not least <= value <= greatest:
            return f"{name} cannot be {value:g}"
    return ""


# They follow from another one, which was refused.
_QUIET_IN_REPLAY = (intents.KeepLayout, intents.StretchMark, intents.EndMark)


def _replayed(intent: Intent) -> Refusal:
    return Refusal(
        "This is a replay.",
        "Nothing is sent to a robot, and the recording stays as it is.",
        "Use the bar below to move through the session.",
        severity="info",
        quiet=intent.lets_go or isinstance(intent, _QUIET_IN_REPLAY),
    )
