"""Messages between the console and a microphone process."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class OpenMicrophone:
    """Open the input of this name, empty: the system default; closes another one."""

    name: str


@dataclass(frozen=True, slots=True)
class CloseMicrophone:
    """Close the input."""


@dataclass(frozen=True, slots=True)
class MicrophoneList:
    """Available inputs. Sent at the start and before each opening."""

    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MicrophoneOpened:
    """Sound follows; sent with the first chunk. ``name`` is the opened input."""

    name: str
    sample_rate_hz: int


@dataclass(frozen=True, slots=True)
class MicrophoneLevel:
    """Recent peak level, 0 to 1."""

    peak: float


@dataclass(frozen=True, slots=True)
class MicrophoneAlive:
    """Heartbeat: the process is not stuck in the audio library. Sent every second while open."""


@dataclass(frozen=True, slots=True)
class MicrophoneFailed:
    """No sound; retried until it is closed. Without ``problem``: there is no microphone, and none was requested by
    name.
    """

    problem: Problem | None
