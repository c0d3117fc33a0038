"""Intents of the session: recording, photos, scenario, layout."""

from pathlib import Path
from typing import Literal, get_args

from caris_desktop.domain.intents.base_intents import AsBefore, Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class StartRecording(Intent):
    """Start a session. ``anyway``: the wizard was asked about open problems and starts nevertheless.

    Without it a recording is refused while a required check is open, for every actor.
    """

    details: TrialDetails
    anyway: bool = False


@dataclass(frozen=True, slots=True)
class StopRecording(Intent):
    """End the session."""


@dataclass(frozen=True, slots=True)
class PauseRecording(Intent):
    """Pause or resume the recording."""

    paused: bool


@dataclass(frozen=True, slots=True)
class TakePhoto(Intent):
    """Save the current frame."""


@dataclass(frozen=True, slots=True)
class TagPhoto(Intent):
    """Set a photo's tags, and no others. Photos are named by their file, as in PhotoTaken."""

    file_name: str
    tags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DeletePhoto(Intent):
    """Delete a photo. It can be restored until the session ends."""

    file_name: str


@dataclass(frozen=True, slots=True)
class RestorePhoto(Intent):
    """Restore a deleted photo."""

    file_name: str


@dataclass(frozen=True, slots=True)
class KeepLayout(Intent):
    """Record the panel layout that the wizard made. ``layout`` is a layout as in scenario files, as JSON."""

    layout: str


SizeClass = Literal["compact", "usual", "large"]
"""Screen size for which a panel layout is made."""


@dataclass(frozen=True, slots=True)
class SaveLayout(Intent):
    """Save the layout (as in KeepLayout) in the scenario, for screens of that size. With a ``title`` it is saved in
    another scenario of this name, which is opened.
    """

    layout: str
    size_class: SizeClass = "usual"
    title: str = ""


@dataclass(frozen=True, slots=True)
class ResetLayout(Intent):
    """Restore the scenario's own layout, where another one was saved in its place."""


@dataclass(frozen=True, slots=True)
class OpenScenario(Intent):
    """Open a scenario; the link and a running recording stay."""

    path: Path


@dataclass(frozen=True, slots=True)
class SaveScenario(Intent):
    """Write a scenario file. If it is the one in force, or was ``edited`` from that, it is in force from then on. A
    recording continues with its own scenario if this one is saved as a separate file.

    ``replaces`` is the checksum of the file that may be replaced; empty if none may exist.
    """

    text: str
    path: Path
    edited: Path | None = None
    replaces: str = ""


@dataclass(frozen=True, slots=True)
class SameName:
    """Decision about a part (``kind`` scenario, robot or face) whose ``name`` is taken: it is saved as ``new_name``. If
    that is empty, it replaces the other, which is moved aside, not deleted.
    """

    kind: str
    name: str
    new_name: str = ""


@dataclass(frozen=True, slots=True)
class ImportScenario(Intent):
    """Unpack a scenario from one file into the user's own, and open it. On name conflicts the user is asked first;
    nothing is done until the intent is sent again with everything ``decided``.
    """

    path: Path
    decided: tuple[SameName, ...] = ()


@dataclass(frozen=True, slots=True)
class ConfirmFile(Intent):
    """The user's answer about the references of a file: if accepted, the file of this checksum may use them."""

    sha256: str
    accepted: bool


@dataclass(frozen=True, slots=True)
class ShareScenario(Intent):
    """Write the scenario in force, with the user's files that it refers to, as one file."""

    path: Path


@dataclass(frozen=True, slots=True)
class DismissAlarm(Intent):
    """Mark a problem as resolved, where nothing else would show that it is over."""

    alarm_id: str


@dataclass(frozen=True, slots=True)
class GoOnWithTrial(Intent):
    """Resume the trial that an unexpected end interrupted."""


@dataclass(frozen=True, slots=True)
class LeaveTrial(Intent):
    """Do not resume the trial."""


@dataclass(frozen=True, slots=True)
class ConfirmAsBefore(Intent):
    """Confirm a condition as unchanged; with a ``person_id`` of ``people``, that this one is who the list says."""

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
