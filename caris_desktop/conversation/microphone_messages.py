"""Messages between the console and a microphone process."""

from caris_desktop.domain.events import Problem
from caris_desktop.domain.value_class import Value


class OpenMicrophone(Value):
    """Open the input of this name, empty: the system default; closes another one."""

    name: str


class CloseMicrophone(Value):
    """Close the input."""


class MicrophoneList(Value):
    """Available inputs. Sent at the start and before each opening."""

    names: tuple[str, ...]


class MicrophoneOpened(Value):
    """Sound follows; sent with the first chunk. ``name`` is the opened input."""

    name: str
    sample_rate_hz: int


class MicrophoneLevel(Value):
    """Recent peak level, 0 to 1."""

    peak: float


class MicrophoneAlive(Value):
    """Heartbeat: the process is not stuck in the audio library. Sent every second while open."""


class MicrophoneFailed(Value):
    """No sound; retried until it is closed. Without ``problem``: there is no microphone, and none was requested by
    name.
    """

    problem: Problem | None
