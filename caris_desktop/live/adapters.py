"""Adapters of a run, as chosen by ``app``."""

from collections.abc import Callable, Sequence
from pathlib import Path

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import Value
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services.assistant_service import AssistantAdapters
from caris_desktop.live.services.cameras_service import CameraSelection
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryAdapters
from caris_desktop.live.services.microphone_service import MicrophoneAdapters
from caris_desktop.live.services.people_service import PeopleAdapters
from caris_desktop.live.services.practice_service import PracticeAdapters
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.services.scenario_service import ScenarioAdapters
from caris_desktop.live.services.session_service import SessionAdapters
from caris_desktop.live.services.sound_service import SoundAdapters
from caris_desktop.live.wizard_console import RobotChoice
from caris_desktop.scenario.scenario_model import Scenario


class RobotAdapters(Value):
    """``choices`` and ``connect_to`` read files in a background thread; ``connect_to`` raises UserFacingError.
    ``simulated`` as in AnotherRobotService.
    """

    choices: Callable[[], Sequence[RobotChoice]]
    connect_to: Callable[[str], RobotConnection]
    simulated: Callable[[Actor], None]


class Adapters(Value):
    """Adapters of a run, chosen in ``app``, per service."""

    recorder: ProcessSpec
    speech: ProcessSpec
    speech_history: Path
    people: PeopleAdapters
    cameras: Callable[[Scenario], CameraSelection]
    assistant: AssistantAdapters
    scenario: ScenarioAdapters
    robots: RobotAdapters
    session: SessionAdapters
    going_on: CrashRecoveryAdapters
    practice: PracticeAdapters
    microphone: MicrophoneAdapters
    sound: SoundAdapters
    listening: Callable[[Scenario], ProcessSpec]
    forgetting: Callable[[str], ProcessSpec]
