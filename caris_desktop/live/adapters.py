"""Adapters of a run, as chosen by ``app``."""

from collections.abc import Callable, Sequence
from pathlib import Path

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services.assistant_service import AssistantParts
from caris_desktop.live.services.cameras_service import WantedCameras
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryAdapters
from caris_desktop.live.services.microphone_service import MicrophoneParts
from caris_desktop.live.services.people_service import PeopleParts
from caris_desktop.live.services.practice_service import PracticeParts
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.services.scenario_service import ScenarioParts
from caris_desktop.live.services.session_service import SessionParts
from caris_desktop.live.services.sound_service import SoundParts
from caris_desktop.live.wizard_console import RobotChoice
from caris_desktop.scenario.scenario_model import Scenario


@dataclass(frozen=True, slots=True)
class RobotParts:
    """``choices`` and ``connect_to`` read files in a background thread; ``connect_to`` raises UserFacingError.
    ``simulated`` as in AnotherRobotService.
    """

    choices: Callable[[], Sequence[RobotChoice]]
    connect_to: Callable[[str], RobotConnection]
    simulated: Callable[[Actor], None]


@dataclass(frozen=True, slots=True)
class Adapters:
    """Adapters of a run, chosen in ``app``, per service."""

    recorder: ProcessSpec
    speech: ProcessSpec
    said_before: Path
    people: PeopleParts
    cameras: Callable[[Scenario], WantedCameras]
    assistant: AssistantParts
    scenario: ScenarioParts
    robots: RobotParts
    session: SessionParts
    going_on: CrashRecoveryAdapters
    practice: PracticeParts
    microphone: MicrophoneParts
    sound: SoundParts
    listening: Callable[[Scenario], ProcessSpec]
    forgetting: Callable[[str], ProcessSpec]
