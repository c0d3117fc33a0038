"""What the console and a microphone's process tell each other."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class OpenMicrophone:
    """Listen to the input of this name, the system's default for an empty one; another one is closed."""

    name: str


@dataclass(frozen=True, slots=True)
class CloseMicrophone:
    """Listen no longer."""


@dataclass(frozen=True, slots=True)
class MicrophoneList:
    """The inputs that there are. Sent at the start and before each opening."""

    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MicrophoneOpened:
    """Sound comes from now on; sent with the first of it. ``name`` is the input that was really opened."""

    name: str
    sample_rate_hz: int


@dataclass(frozen=True, slots=True)
class MicrophoneLevel:
    """How loud it was lately: the largest sample, 0 to 1."""

    peak: float


@dataclass(frozen=True, slots=True)
class MicrophoneAlive:
    """The process has not got stuck in the sound library. Sent every second while it is to listen."""


@dataclass(frozen=True, slots=True)
class MicrophoneFailed:
    """No sound comes; it is tried again by itself until it is closed. No ``problem``: there is no microphone at all,
    and none was asked for by name.
    """

    problem: Problem | None
