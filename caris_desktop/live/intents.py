"""What a wizard can ask of the running console. Panels call these and nothing else."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from PySide6.QtCore import SignalInstance

from caris_desktop.domain.controls import ControlValue
from caris_desktop.domain.events import CommandSource, MarkKind, UtteranceOrigin
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.ports import FrameReader
from caris_desktop.live.state import LiveState, LiveValue
from caris_desktop.recording.annotation.model import AnnotationDocument
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.studies.study_index import SessionQuery
from caris_desktop.scenario.model import LayoutNode, Scenario
from caris_desktop.study.trial import TrialDetails


@dataclass(frozen=True, slots=True)
class RobotChoice:
    """One robot of the list. ``name`` is what ``use_robot`` takes; ``problem`` says why its profile cannot be used."""

    name: str
    title: str
    address: str
    problem: str = ""


class WizardIntents(Protocol):
    """The console as panels see it. GUI thread only; every call returns at once.

    Results show up in ``state``; refusals arrive as ``Problem`` events, never as exceptions.
    """

    @property
    def state(self) -> LiveState: ...

    @property
    def scenario(self) -> Scenario: ...

    @property
    def frames(self) -> FrameReader: ...

    def drive(self, *, forward: float, left: float, turn: float, source: CommandSource) -> None:
        """Hold to drive: each argument -1..1 of the speed setting. All zero releases. Call on each change only."""

    def release_drive(self, reason: str = "") -> None:
        """Nothing is held any more: zero at once."""

    def set_speed_fraction(self, fraction: float) -> None:
        """Speed setting, 0.1..1 of the scenario's limits."""

    def stop(self) -> None:
        """Halt motion and cancel goals, always."""

    def emergency_stop(self) -> None:
        """Latch the emergency stop."""

    def clear_emergency_stop(self) -> None:
        """Release the latched emergency stop."""

    def set_guard(self, *, on: bool) -> None:
        """Switch the obstacle guard; off lasts until the link is lost, the scenario changes, or it is switched on."""

    def look_at(self, *, pan_rad: float, tilt_rad: float) -> None:
        """Turn the head there: pan left positive, tilt down positive."""

    def turn_head(self, *, pan: float, tilt: float) -> None:
        """Turn the head while something is held: each argument -1..1 of its speed, zero stops. On each change only."""

    def go_to_place(self, name: str) -> None:
        """Navigate to a place of the scenario."""

    def go_to(self, target_in_map: Pose2D) -> None:
        """Navigate to a point with a heading."""

    def cancel_goal(self) -> None: ...

    def set_initial_pose(self, pose_in_map: Pose2D) -> None:
        """Tell the localization where the robot is."""

    def save_place(self, name: str, pose_in_map: Pose2D) -> None:
        """Add a place, or move the one of that name, in the wizard's copy of the scenario."""

    def remove_place(self, name: str) -> None: ...

    def save_map(self, name: str) -> None: ...

    def load_map(self, name: str) -> None: ...

    def set_mapping(self, *, mapping: bool) -> None:
        """Build the map on (True), or only find the place in it (False)."""

    def use_control(self, control_id: str, value: ControlValue) -> None:
        """A control of the Robot panel; a button's value is True."""

    def robots(self) -> Sequence[RobotChoice]:
        """The robots that can be connected to: shipped profiles and the wizard's own."""

    def use_robot(self, name: str) -> bool:
        """Connect to another robot instead of the present one. False when its profile was refused."""

    def say(self, text: str, origin: UtteranceOrigin) -> None:
        """Speak after whatever is waiting."""

    def silence(self) -> None:
        """Interrupt speech at once and drop what is waiting."""

    def ask_assistant(self, question: str) -> None:
        """Ask the language model; the answer streams into ``state.assistant``."""

    def cancel_assistant(self) -> None: ...

    def say_answer(self, text: str) -> None:
        """Say the assistant's answer, possibly edited by the wizard."""

    def rename_person(self, person_id: str, name: str) -> None: ...

    def take_photo(self) -> None: ...

    def mark(self, label: str, kind: MarkKind = "mark", *, earlier_s: float = 0.0, note: str = "") -> str:
        """Mark this moment, or one ``earlier_s`` ago. Gives the mark's id; the newest is in ``state.marks``."""

    def begin_mark(self, label: str, kind: MarkKind = "mark", *, earlier_s: float = 0.0) -> str:
        """Mark a stretch that begins now, or ``earlier_s`` ago, and goes on until ``end_mark``."""

    def stretch_mark(self, mark_id: str) -> None:
        """The moment that was marked becomes a stretch, which goes on until ``end_mark``."""

    def end_mark(self, mark_id: str) -> None: ...

    def change_mark(
        self, mark_id: str, *, label: str | None = None, earlier_s: float = 0.0, note: str | None = None
    ) -> None:
        """Change a mark of this session: another label, a note, or an earlier beginning."""

    def withdraw_mark(self, mark_id: str) -> None:
        """The mark was a slip."""

    def suggested_details(self) -> TrialDetails:
        """What the start dialog begins with: the study's last answers, with the trial counted on."""

    def expected_bytes_per_hour(self) -> float | None:
        """What an hour of recording will take, from this study's sessions and what the scenario keeps."""

    def free_bytes(self) -> int | None:
        """What is free where the study lies."""

    def microphones(self) -> Sequence[str]:
        """Names of the sound inputs of this computer; the empty name is the system's default."""

    def use_microphone(self, name: str | None) -> None:
        """Record from this input, where the scenario permits; None: from none. Kept for the next time."""

    @property
    def microphone(self) -> str | None: ...

    def start_session(self, details: TrialDetails) -> None: ...

    def stop_session(self) -> None: ...

    def pause_session(self, *, paused: bool) -> None:
        """Record nothing for a while, or go on."""

    def keep_layout(self, layout: LayoutNode) -> None:
        """The wizard arranged the panels: for the record."""

    def open_scenario(self, path: Path) -> bool:
        """Switch the scenario; the link and a running recording stay. False when the file was refused."""


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

    def import_annotations(self, path: Path, coder: str) -> str:
        """Take over an .eaf or CSV file as ``coder``'s; gives why it was refused, empty when done."""


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

    def default_export_folder(self, sessions: Sequence[Path]) -> Path: ...

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
