"""Interface of the console towards the window, live or replayed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar

from PySide6.QtCore import SignalInstance

from caris_desktop.domain.events import Problem, TrialDetails
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState, LiveValue
from caris_desktop.recording.csv_cells import SHOWN, CsvStyle
from caris_desktop.scenario.scenario_model import Scenario

if TYPE_CHECKING:
    # Imported late: the window is shown before session files are read.
    from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
    from caris_desktop.recording.session.session_reader import Session
    from caris_desktop.recording.studies.study_query import SessionQuery

T = TypeVar("T")


class RobotChoice(Value):
    """Robot in the list. ``name``: argument of UseRobot; ``problem``: why its profile is unusable."""

    name: str
    title: str
    address: str
    problem: str = ""


class BeforeRecording(Value):
    """Initial contents of the start dialog, as far as available.

    ``suggested``: the study's last details with the next trial number; ``bytes_per_hour``: expected usage, from this
    study's sessions and what the scenario records; ``free_bytes``: free space of the study's disk.
    """

    suggested: TrialDetails = field(default_factory=TrialDetails)
    bytes_per_hour: float | None = None
    free_bytes: int | None = None


class WizardConsole(Protocol):
    """State for panels, and the only entry point for intents. GUI thread only; every call returns at once.

    Results appear in ``state``; refusals arrive as ``Problem`` events, never as exceptions.
    """

    @property
    def state(self) -> LiveState: ...

    @property
    def scenario(self) -> Scenario: ...

    @property
    def frames(self) -> FrameReader: ...

    def do(self, intent: Intent) -> str:
        """Run an intent; returns the reason if refused, else empty. The wizard is notified automatically."""

    def run_in_background(
        self, read: Callable[[], T], done: Callable[[T], None], failed: Callable[[UserFacingError], None] | None = None
    ) -> None:
        """Read files in a background thread: ``done`` receives the result of ``read``, ``failed`` its exception, which
        is otherwise reported. In the order of calls.
        """

    def report(self, problem: Problem) -> None:
        """Report a problem to wizard and record."""

    def robots(self) -> Sequence[RobotChoice]:
        """Available robots: shipped profiles and the user's own. Reads files, in any thread: call with
        ``run_in_background``.
        """

    def check_before_recording(self, on_result: Callable[[BeforeRecording], None]) -> None:
        """Gather the initial contents of the start dialog; ``on_result`` receives them later."""

    def microphones(self) -> Sequence[str]:
        """Sound inputs of this computer; the empty name is the system's default."""

    @property
    def microphone(self) -> str | None: ...

    @property
    def wizard_microphone(self) -> str | None:
        """Wizard's microphone; None for none."""


class ReplayControls(Protocol):
    """Interface of replay bar and timeline. GUI thread only; every call returns at once.

    ``playback`` holds a PlaybackStatus, ``overview`` a SessionOverview once computed (None until then), ``coding`` the
    annotations of all coders as an AnnotationDocument. ``live_robots`` holds a LiveRobotsStatus of robots that ``stop``
    and ``emergency_stop`` of the replay's console affect.
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
        """(camera, at_ns, image_bgr): a requested thumbnail; an empty array if there is no image."""

    @property
    def noticed(self) -> SignalInstance:
        """(Problem): problems of the replay itself; those of the session are in its log."""

    @property
    def session(self) -> Session: ...

    def with_names(self, text: str) -> str:
        """Transcript text with names in place of recorded ids."""

    def play(self) -> None: ...

    def pause(self) -> None: ...

    def set_rate(self, rate: float) -> None:
        """Set the rate, 0.1 to 16."""

    def seek(self, at_ns: int) -> None:
        """Seek to a time of the session clock, clamped to the session."""

    def step(self, frames: int) -> None:
        """Pause and move by this many frames, backward if negative."""

    def jump(self, kind: Literal["mark", "utterance"], direction: Literal[-1, 1]) -> bool:
        """Go to the next mark or utterance in that direction; False if there is none."""

    def request_thumbnail(self, camera: str, at_ns: int) -> None:
        """Request a thumbnail at a time; the newest request per place counts. ``thumbnail_made`` delivers it."""

    def edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument]) -> str:
        """Apply a function of ``recording.annotation.editing``; returns the reason if refused, else empty.

        ``coding`` has the result; it is saved in the background, one file per coder.
        """

    def undo_steps(self) -> tuple[str, str]:
        """Names of the steps that ``undo`` and ``redo`` would change, in the wizard's language; empty for none."""

    def undo(self) -> bool: ...

    def redo(self) -> bool: ...

    def import_annotations(self, path: Path, coder: str, on_result: Callable[[str], None]) -> None:
        """Import an .eaf or CSV file as ``coder``'s. Returns at once; ``on_result`` receives the refusal, or ''."""


class SessionLibrary(Protocol):
    """Sessions of a study: search, replay, export. GUI thread only; every call returns at once.

    ``found`` holds a LibraryStatus, ``export`` an ExportStatus.
    """

    found: LiveValue
    export: LiveValue

    def find(self, query: SessionQuery) -> None:
        """Update the index and search; ``found`` changes with results."""

    def open_replay(self, folder: Path, *, at_ns: int | None = None) -> None:
        """Open the replay of a session in a separate window."""

    def choose_export_folder(
        self, sessions: Sequence[Path], on_folder: Callable[[Path], None], *, chosen: Path | None = None
    ) -> None:
        """Propose a new export folder; ``on_folder`` receives it later. ``chosen``: the wizard's folder, used itself if
        empty, else a new subfolder.
        """

    def start_export(
        self,
        sessions: Sequence[Path],
        formats: Sequence[str],
        out: Path,
        *,
        licence: str = "",
        with_names: bool = False,
        csv: CsvStyle = SHOWN,
    ) -> None:
        """Export each session in each format (``recording.export.FORMATS``) in a process.

        Wizards, coders and the robot's address are pseudonymised unless ``with_names``.
        """

    def cancel_export(self) -> None:
        """Cancel the export; complete files stay, partial ones are removed."""
