"""The console as the window sees it, running or replayed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar

from PySide6.QtCore import SignalInstance

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.trial import TrialDetails
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.state import LiveState, LiveValue
from caris_desktop.scenario.model import Scenario

if TYPE_CHECKING:
    # The window stands before anything of a session is read.
    from caris_desktop.recording.annotation.model import AnnotationDocument
    from caris_desktop.recording.session.session_reader import Session
    from caris_desktop.recording.studies.query import SessionQuery

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RobotChoice:
    """One robot of the list. ``name`` is what UseRobot takes; ``problem`` says why its profile cannot be used."""

    name: str
    title: str
    address: str
    problem: str = ""


@dataclass(frozen=True, slots=True)
class BeforeRecording:
    """What the start dialog begins with, as far as it could be found out.

    ``suggested`` are the study's last answers, with the trial counted on; ``bytes_per_hour`` is what an hour of
    recording will take, from this study's sessions and what the scenario keeps; ``free_bytes`` where the study lies.
    """

    suggested: TrialDetails = field(default_factory=TrialDetails)
    bytes_per_hour: float | None = None
    free_bytes: int | None = None


class WizardConsole(Protocol):
    """What panels read, and the one way to ask for something. GUI thread only; every call returns at once.

    Results show up in ``state``; refusals arrive as ``Problem`` events, never as exceptions.
    """

    @property
    def state(self) -> LiveState: ...

    @property
    def scenario(self) -> Scenario: ...

    @property
    def frames(self) -> FrameReader: ...

    def do(self, intent: Intent) -> str:
        """Ask for something; gives why it was refused, empty when it is under way. The wizard is told by itself."""

    def read_aside(
        self, read: Callable[[], T], done: Callable[[T], None], failed: Callable[[ToldFailure], None] | None = None
    ) -> None:
        """Have files read in another thread: ``done`` gets later what ``read`` gave, ``failed`` what it raised, else
        the wizard is told. One after the other, in the order in which it is asked.
        """

    def robots(self) -> Sequence[RobotChoice]:
        """The robots that can be connected to: shipped profiles and the wizard's own. Waits on files, in any
        thread: it is for ``read_aside``.
        """

    def look_before_recording(self, told: Callable[[BeforeRecording], None]) -> None:
        """Find out what the start dialog begins with; ``told`` gets it later, whatever could be found out."""

    def microphones(self) -> Sequence[str]:
        """Names of the sound inputs of this computer; the empty name is the system's default."""

    @property
    def microphone(self) -> str | None: ...

    @property
    def wizard_microphone(self) -> str | None:
        """The input that hears the wizard; None for none."""


class ReplayControls(Protocol):
    """What the bar and the timeline of a replay ask for. GUI thread only; every call returns at once.

    ``playback`` holds a PlaybackStatus, ``overview`` a SessionOverview once it was made in the background (None until
    then), ``coding`` the annotations of every coder as an AnnotationDocument. ``live_robots`` holds a LiveRobotsStatus:
    whose robots ``stop`` and ``emergency_stop`` of the replay's console stop.
    """

    @property
    def live_robots(self) -> LiveValue: ...

    @property
    def playback(self) -> LiveValue: ...

    @property
    def overview(self) -> LiveValue: ...

    @property
    def coding(self) -> LiveValue: ...

    @property
    def thumbnail_made(self) -> SignalInstance:
        """(camera, at_ns, image_bgr): a thumbnail that was asked for; an empty array where there is no picture."""

    @property
    def noticed(self) -> SignalInstance:
        """(Problem): what the replay itself has to tell. Those of the session are history, and in its log."""

    @property
    def session(self) -> Session: ...

    def with_names(self, text: str) -> str:
        """What was said, as it is shown: with names where the record has ids."""

    def play(self) -> None: ...

    def pause(self) -> None: ...

    def set_rate(self, rate: float) -> None:
        """0.1 to 16 times the recorded speed."""

    def seek(self, at_ns: int) -> None:
        """Show that moment, on the session's own clock; bounded to the session."""

    def step(self, frames: int) -> None:
        """Pause and show the frame that lies so many frames further on, or back."""

    def jump(self, kind: Literal["mark", "utterance"], direction: Literal[-1, 1]) -> bool:
        """To the next mark or utterance in that direction; False where there is none."""

    def request_thumbnail(self, camera: str, at_ns: int) -> None:
        """A small picture of that moment; the newest request for a place counts. ``thumbnail_made`` brings it."""

    def edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument]) -> str:
        """Apply a function of ``recording.annotation.editing``; gives why it was refused, empty when done.

        ``coding`` has the result; it is saved in the background, one file for each coder.
        """

    def undo(self) -> bool: ...

    def redo(self) -> bool: ...

    def import_annotations(self, path: Path, coder: str, told: Callable[[str], None]) -> None:
        """Take over an .eaf or CSV file as ``coder``'s. Returns at once; ``told`` gets why it was refused, empty when
        done.
        """


class SessionLibrary(Protocol):
    """The sessions of a study, to find, replay and export. GUI thread only; every call returns at once.

    ``found`` holds a LibraryStatus, ``export`` an ExportStatus.
    """

    found: LiveValue
    export: LiveValue

    def find(self, query: SessionQuery) -> None:
        """Bring the index up to date and look; ``found`` changes when there is something to show."""

    def open_replay(self, folder: Path, *, at_ns: int | None = None) -> None:
        """Open the replay of a session in a window of its own."""

    def look_for_export_folder(
        self, sessions: Sequence[Path], told: Callable[[Path], None], *, chosen: Path | None = None
    ) -> None:
        """Find a folder for them that is not there yet; ``told`` gets it later. ``chosen`` is where the wizard wants
        them: that itself, where it holds nothing, else one of their own inside.
        """

    def start_export(
        self,
        sessions: Sequence[Path],
        formats: Sequence[str],
        out: Path,
        *,
        licence: str = "",
        with_names: bool = False,
    ) -> None:
        """Write each session in each of the formats (``recording.export.FORMATS``), in a process of its own.

        Pseudonyms stand for wizards, coders and the robot's address unless ``with_names``.
        """

    def cancel_export(self) -> None:
        """What is finished stays, what is half written goes."""
