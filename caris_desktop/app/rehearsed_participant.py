"""Somebody before the simulated robot, who says what a rehearsal wants them to say."""

from collections.abc import Callable, Sequence

from caris_desktop.app import simulator_calls
from caris_desktop.live.asyncio_thread import AsyncioThread


class RehearsedParticipant:
    """Speaks into the robot's microphone; ``address`` gives the robot's rosbridge, None while there is none."""

    def __init__(self, asyncio_thread: AsyncioThread, address: Callable[[], str | None]) -> None:
        self._asyncio = asyncio_thread
        self._address = address

    def prepare(self, texts: Sequence[str]) -> None:
        """What they will say, so that nobody waits for its sound then."""
        self._tell(simulator_calls.PREPARE, texts)

    def say(self, text: str) -> None:
        """Returns at once. That nothing is heard is for who listens to notice."""
        self._tell(simulator_calls.SAY, (text,))

    def _tell(self, service: str, texts: Sequence[str]) -> None:
        address = self._address()
        if address is not None:
            self._asyncio.submit(simulator_calls.call(address, service, [{"text": text} for text in texts]))
