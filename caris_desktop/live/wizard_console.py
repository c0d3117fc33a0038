"""Interface of the console towards the window, live or replayed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Protocol, TypeVar

from caris_desktop.domain.events import Problem, TrialDetails
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.robot.profile import ListedProfile
from caris_desktop.scenario.scenario_model import Scenario

T = TypeVar("T")


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

    def robots(self) -> Sequence[ListedProfile]:
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
