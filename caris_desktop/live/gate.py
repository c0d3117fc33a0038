"""Gate: decides whether an intent may run. A refusal is a sentence."""

import math
from collections.abc import Callable

from caris_desktop.domain import intents
from caris_desktop.domain.actor import MODEL, WIZARD, in_words
from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.events import ProblemEnd, Severity
from caris_desktop.domain.intents import INTENTS, AsBefore, Intent, IntentSpec, Moves, Permission
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_model import Permissions

_NOT_PERMITTED: dict[Permission, tuple[str, str]] = {
    "driving": (QT_TR_NOOP("This scenario does not allow driving."), QT_TR_NOOP("Nothing was sent to the robot.")),
    "photos": (QT_TR_NOOP("This scenario does not allow photos."), QT_TR_NOOP("No picture was saved.")),
    "video_recording": (
        QT_TR_NOOP("This scenario does not allow video recording."),
        QT_TR_NOOP("No picture was saved."),
    ),
    "audio_recording": (
        QT_TR_NOOP("This scenario does not allow sound recording."),
        QT_TR_NOOP("The microphone was not used."),
    ),
    "assistant": (
        QT_TR_NOOP("This scenario does not allow the assistant."),
        QT_TR_NOOP("The language model was not asked."),
    ),
    "naming_people": (
        QT_TR_NOOP("This scenario does not allow naming people."),
        QT_TR_NOOP("Nothing about them was changed."),
    ),
    "robot_controls": (
        QT_TR_NOOP("This scenario does not allow the robot's controls."),
        QT_TR_NOOP("Nothing was sent to the robot."),
    ),
    "transcription": (
        QT_TR_NOOP("This scenario does not allow transcription."),
        QT_TR_NOOP("The microphone was not used."),
    ),
    "own_voice": (
        QT_TR_NOOP("This scenario does not allow the wizard to speak through the robot."),
        QT_TR_NOOP("Nothing was played through the robot."),
    ),
    "cloud_models": (
        QT_TR_NOOP("This scenario does not allow cloud models."),
        QT_TR_NOOP("Nothing left this computer."),
    ),
    "face": (QT_TR_NOOP("This scenario does not allow the robot's face."), QT_TR_NOOP("Nothing was shown.")),
    "speech": (QT_TR_NOOP("This scenario does not allow robot speech."), QT_TR_NOOP("Nothing was said.")),
    "notes": (QT_TR_NOOP("This scenario does not allow notes."), QT_TR_NOOP("No note was saved.")),
}
_UNCONFIRMED: dict[AsBefore, str] = {
    "map": QT_TR_NOOP("the robot's position"),
    "people": QT_TR_NOOP("the people present"),
    "permissions": QT_TR_NOOP("what is recorded"),
    "consent": QT_TR_NOOP("the participant's consent"),
}


class Refusal(Value):
    """Reason, meaning and advice; ``until`` as in Problem. ``quiet``: no notification."""

    what: str
    meaning: str
    advice: str
    until: ProblemEnd = ""
    severity: Severity = "warning"
    quiet: bool = False


class Gate:
    """Checks permission, bounds, emergency stop, current driver, link and replay. GUI thread."""

    def __init__(self, state: LiveState, permissions: Callable[[], Permissions], *, replay: bool = False) -> None:
        self._state = state
        self._permissions = permissions
        self._replay = replay

    def refusal(self, intent: Intent) -> Refusal | None:
        """Reason why the intent may not run now; None if it may."""
        spec = INTENTS[type(intent)]
        if self._replay:
            return None if spec.in_replay else _replayed(intent)
        if intent.actor == MODEL:
            # Model suggestions and proposals run by the wizard's key, or by the console after its countdown.
            return Refusal(
                tr("{act} is not possible: a language model cannot do this directly.").format(act=tr(spec.words)),
                tr("Nothing was done."), tr("Do it yourself if needed."),
            )  # fmt: skip
        unfit = _unfit(intent, spec)
        if unfit is not None:
            # No user enters such values: a calling program is faulty.
            what = tr("{act} is not possible: {value} is out of range for {field}.")
            what = what.format(act=tr(spec.words), field=unfit[0], value=f"{unfit[1]:g}")
            return Refusal(what, tr("Nothing was done."), tr("Use another value."))
        if intent.reduces_motion:
            return None
        withheld = self._permissions().withheld(intent.needs_permissions or spec.permissions)
        if withheld is not None:
            what, meaning = _NOT_PERMITTED[withheld]
            return Refusal(tr(what), tr(meaning), tr("Open a scenario that does."), quiet=spec.quiet)
        to_confirm = self._state.going_on.value.unconfirmed
        unconfirmed = [
            tr(words) for what, words in _UNCONFIRMED.items() if what in spec.confirmed and what in to_confirm
        ]
        if unconfirmed:
            return Refusal(
                tr("{act} is not possible before this is confirmed again: {what}.").format(
                    act=tr(spec.words), what=", ".join(unconfirmed)
                ),
                tr("The program closed unexpectedly during this trial. Nothing is recorded before the confirmation."),
                tr("Check it and tick it on the card above the panels, or choose Do not resume there."),
            )
        words, moves, held = self._of_control(intent, spec)
        if self._releases_stop(intent):
            return Refusal(
                tr("{act} is not possible: it would release the emergency stop.").format(act=words),
                tr("Nothing was sent to the robot. A control defined in a file must not release a stop."),
                tr("Use Release emergency stop when everybody is clear of the robot."),
                quiet=spec.quiet,
            )
        if held and self._state.drive.value.emergency_stop:
            return Refusal(
                tr("{act} is not possible: the emergency stop is active.").format(act=words),
                tr("Nothing was sent to the robot."),
                tr("Release the emergency stop when everybody is clear of the robot."),
                until="released",
                quiet=spec.quiet,
            )
        driver = self._state.drive.value.driver
        if moves == "base" and driver and intent.actor not in (driver, WIZARD):
            # The wizard at this computer is responsible for the robot and overrides other drivers.
            who = in_words(driver)
            return Refusal(
                tr("{act} is not possible: {who} is driving manually.").format(act=words, who=tr(who)),
                tr("Nothing was sent to the robot."),
                tr("Try again when the manual driving has ended."),
                severity="info",
                quiet=spec.quiet,
            )
        if spec.needs_link and self._state.link.value.state != "connected":
            return Refusal(
                tr("{act} is not possible: the robot is not connected.").format(act=words),
                tr("Nothing was sent to the robot, and nothing is queued."),
                tr("Try again when the robot is connected again."),
                until="connected",
                quiet=spec.quiet,
            )
        return None

    def _of_control(self, intent: Intent, spec: IntentSpec) -> tuple[str, Moves | None, bool]:
        """Name, moved part of the robot, and whether the emergency stop blocks it; for a control its own."""
        if not isinstance(intent, intents.UseControl):
            return tr(spec.words), spec.moves, spec.moves is not None
        control = self._control(intent)
        if control is None:
            return tr(spec.words), "base", True
        words = tr("Using “{control}”").format(control=control.title)
        return words, "base" if control.is_motion else None, control.is_held_by_stop

    def _releases_stop(self, intent: Intent) -> bool:
        control = self._control(intent) if isinstance(intent, intents.UseControl) else None
        return control is not None and control.releases_stop

    def _control(self, intent: intents.UseControl) -> RobotControl | None:
        return next((one for one in self._state.controls.value if one.id == intent.control), None)


def _unfit(intent: Intent, spec: IntentSpec) -> tuple[str, float] | None:
    """First argument that is out of bounds, with its value."""
    for name, (least, greatest) in spec.bounds.items():
        value = getattr(intent, name)
        if not math.isfinite(value) or not least <= value <= greatest:
            return name, value
    return None


# They follow from another intent, which was refused.
_QUIET_IN_REPLAY = (intents.KeepLayout, intents.StretchMark, intents.EndMark)


def _replayed(intent: Intent) -> Refusal:
    return Refusal(
        tr("This is a replay."),
        tr("Nothing is sent to a robot, and the recording is not changed."),
        tr("Use the bar below to move through the session."),
        severity="info",
        quiet=intent.reduces_motion or isinstance(intent, _QUIET_IN_REPLAY),
    )
