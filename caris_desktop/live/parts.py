"""Adapters of a run, as chosen by ``app``."""

from collections.abc import Callable, Sequence
from pathlib import Path

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services.assistant import AssistantParts
from caris_desktop.live.services.cameras import WantedCameras
from caris_desktop.live.services.going_on import CrashRecoveryAdapters
from caris_desktop.live.services.microphone import MicrophoneParts
from caris_desktop.live.services.people import PeopleParts
from caris_desktop.live.services.practice import PracticeParts
from caris_desktop.live.services.robot import RobotConnection
from caris_desktop.live.services.scenario import ScenarioParts
from caris_desktop.live.services.session import SessionParts
from caris_desktop.live.services.sound import SoundParts
from caris_desktop.live.wizard_console import RobotChoice
from caris_desktop.scenario.model import Scenario


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
