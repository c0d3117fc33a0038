"""What a wizard can ask of the running console. Panels call these and nothing else."""

from pathlib import Path
from typing import Literal, Protocol

from caris_desktop.domain.events import CommandSource, UtteranceOrigin
from caris_desktop.domain.ports import FrameReader
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.model import Scenario
from caris_desktop.study.trial import TrialDetails


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

    def go_to_place(self, name: str) -> None:
        """Navigate to a place of the scenario."""

    def cancel_goal(self) -> None: ...

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
