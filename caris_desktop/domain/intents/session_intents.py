"""Intents of the session: recording, photos, scenario, layout."""

from pathlib import Path
from typing import Literal, get_args

from caris_desktop.domain.intents.base_intents import AsBefore, Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class StartRecording(Intent):
    """Begin a session. ``anyway``: the wizard was asked about what is not as it should be, and begins nevertheless.

    Without it a recording is refused while a required check is open, whoever asks.
    """

    details: TrialDetails
    anyway: bool = False


@dataclass(frozen=True, slots=True)
class StopRecording(Intent):
    """End the session."""


@dataclass(frozen=True, slots=True)
class PauseRecording(Intent):
    """Record nothing for a while, or go on."""

    paused: bool


@dataclass(frozen=True, slots=True)
class TakePhoto(Intent):
    """Keep the picture on show."""


@dataclass(frozen=True, slots=True)
class TagPhoto(Intent):
    """Give a photo these tags and no others. Photos go by their file names, as in PhotoTaken."""

    file_name: str
    tags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DeletePhoto(Intent):
    """Take a photo away. It can be brought back until the session ends."""

    file_name: str


@dataclass(frozen=True, slots=True)
class RestorePhoto(Intent):
    """Bring a photo back that was deleted."""

    file_name: str


@dataclass(frozen=True, slots=True)
class KeepLayout(Intent):
    """The wizard arranged the panels: for the record. ``layout`` is an arrangement as in scenario files, as JSON."""

    layout: str


SizeClass = Literal["compact", "usual", "large"]
"""For which screens an arrangement of the panels is."""


@dataclass(frozen=True, slots=True)
class SaveLayout(Intent):
    """The arrangement (as in KeepLayout) is the scenario's from now on, for screens of that size; with a ``title`` it
    is that of another scenario of this name, which is opened.
    """

    layout: str
    size_class: SizeClass = "usual"
    title: str = ""


@dataclass(frozen=True, slots=True)
class ResetLayout(Intent):
    """The scenario has its own arrangement again, where another one was saved in its place."""


@dataclass(frozen=True, slots=True)
class OpenScenario(Intent):
    """Switch the scenario; the link and a running recording stay."""

    path: Path


@dataclass(frozen=True, slots=True)
class SaveScenario(Intent):
    """Write a scenario file. If it is the one in force, or was ``edited`` from that, it is in force from then on; but a
    recording goes on with the one that it has where this one is kept beside it.

    ``replaces`` is the checksum of the file that may be replaced; empty where none may be there.
    """

    text: str
    path: Path
    edited: Path | None = None
    replaces: str = ""


@dataclass(frozen=True, slots=True)
class SameName:
    """What becomes of a part (``kind`` scenario, robot or face) whose ``name`` something else has already: it is kept
    as ``new_name`` beside that, or, where that is empty, takes its place. What it replaces is put aside, not deleted.
    """

    kind: str
    name: str
    new_name: str = ""


@dataclass(frozen=True, slots=True)
class ImportScenario(Intent):
    """Unpack a scenario that came as one file among the user's own, and open it. Where its names are taken by something
    else, that is asked first, and nothing is done until it comes again with everything ``decided``.
    """

    path: Path
    decided: tuple[SameName, ...] = ()


@dataclass(frozen=True, slots=True)
class ConfirmFile(Intent):
    """The user's answer to what a file names, which was asked: with a yes the file of this checksum may use it."""

    sha256: str
    accepted: bool


@dataclass(frozen=True, slots=True)
class ShareScenario(Intent):
    """Write the scenario in force, with what of the user's own it refers to, as one file."""

    path: Path


@dataclass(frozen=True, slots=True)
class DismissAlarm(Intent):
    """Somebody has seen to what is wrong, where nothing else would show that it is over."""

    alarm_id: str


@dataclass(frozen=True, slots=True)
class GoOnWithTrial(Intent):
    """Go on with the trial that an end nobody wanted has broken off."""


@dataclass(frozen=True, slots=True)
class LeaveTrial(Intent):
    """Do not go on with it."""


@dataclass(frozen=True, slots=True)
class ConfirmAsBefore(Intent):
    """It was looked at, and holds as before; with a ``person_id`` of ``people`` that this one is who the list says."""

    what: AsBefore
    person_id: str = ""


SESSION: IntentTable = {
    StartRecording: IntentSpec(QT_TR_NOOP("Starting a recording"), confirmed=get_args(AsBefore)),
    StopRecording: IntentSpec(QT_TR_NOOP("Ending the recording")),
    PauseRecording: IntentSpec(QT_TR_NOOP("Pausing the recording")),
    TakePhoto: IntentSpec(
        QT_TR_NOOP("Taking a photo"), "photos", proposable=True, confirmed=("permissions", "consent")
    ),
    TagPhoto: IntentSpec(QT_TR_NOOP("Tagging the photo"), "photos"),
    DeletePhoto: IntentSpec(QT_TR_NOOP("Deleting the photo"), "photos"),
    RestorePhoto: IntentSpec(QT_TR_NOOP("Restoring the photo"), "photos"),
    KeepLayout: IntentSpec(QT_TR_NOOP("Storing the panel layout"), quiet=True),
    SaveLayout: IntentSpec(QT_TR_NOOP("Saving the panel layout")),
    ResetLayout: IntentSpec(QT_TR_NOOP("Resetting the panel layout")),
    OpenScenario: IntentSpec(QT_TR_NOOP("Opening another scenario")),
    SaveScenario: IntentSpec(QT_TR_NOOP("Saving the scenario")),
    ImportScenario: IntentSpec(QT_TR_NOOP("Importing a scenario")),
    ConfirmFile: IntentSpec(QT_TR_NOOP("Confirming a file's references")),
    ShareScenario: IntentSpec(QT_TR_NOOP("Exporting the scenario as one file")),
    DismissAlarm: IntentSpec(QT_TR_NOOP("Dismissing an alarm")),
    GoOnWithTrial: IntentSpec(QT_TR_NOOP("Resuming the trial")),
    LeaveTrial: IntentSpec(QT_TR_NOOP("Ending the interrupted trial")),
    ConfirmAsBefore: IntentSpec(QT_TR_NOOP("Confirming unchanged conditions")),
}
