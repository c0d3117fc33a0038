"""Simulated participant of a rehearsal, who speaks to the simulated robot."""

from collections.abc import Callable, Sequence

from caris_desktop.app import simulator_calls
from caris_desktop.live.asyncio_thread import AsyncioThread


class RehearsedParticipant:
    """Speaks into the robot's microphone; ``address`` returns the robot's rosbridge, None while there is none."""

    def __init__(self, asyncio_thread: AsyncioThread, address: Callable[[], str | None]) -> None:
        self._asyncio = asyncio_thread
        self._address = address

    def prepare(self, texts: Sequence[str]) -> None:
        """Synthesise these texts in advance, so that speech starts without delay."""
        self._notify(simulator_calls.PREPARE, texts)

    def say(self, text: str) -> None:
        """Say a text. Returns at once; a failure shows only in that nothing is heard."""
        self._notify(simulator_calls.SAY, (text,))

    def _notify(self, service: str, texts: Sequence[str]) -> None:
        address = self._address()
        if address is not None:
            self._asyncio.submit(simulator_calls.call(address, service, [{"text": text} for text in texts]))
