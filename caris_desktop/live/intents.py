"""What a wizard can ask of the running console. Panels call these and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from caris_desktop.domain.controls import ControlValue
from caris_desktop.domain.events import CommandSource, UtteranceOrigin
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.ports import FrameReader
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Scenario
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

    def mark(self, label: str, kind: Literal["mark", "wizard_error"] = "mark") -> None: ...

    def suggested_details(self) -> TrialDetails:
        """What the start dialog begins with: the study's last answers, with the trial counted on."""

    def start_session(self, details: TrialDetails) -> None: ...

    def stop_session(self) -> None: ...

    def export_session(self) -> None:
        """Write the last session as tables beside its files; an info ``Problem`` says where."""

    def open_scenario(self, path: Path) -> bool:
        """Switch the scenario; the link and a running recording stay. False when the file was refused."""
