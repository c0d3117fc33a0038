"""The microphone of this computer: which one is used, and when it is listened to. GUI thread."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.conversation.microphone import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneLevel,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
)
from caris_desktop.domain.events import Problem, Severity
from caris_desktop.live.child_process import ChildProcess, ProcessBody
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MicrophoneStatus

MicrophoneMessage = MicrophoneList | MicrophoneOpened | MicrophoneLevel | MicrophoneFailed
_RESTARTS_AT_MOST = 3


@dataclass(frozen=True, slots=True)
class MicrophoneParts:
    """``chosen`` gives what was chosen last time (None: no microphone, empty: the system's), ``keep`` remembers it."""

    body: ProcessBody
    chosen: Callable[[], str | None]
    keep: Callable[[str | None], None]


class MicrophoneDirector(QObject):
    """Runs the microphone's process from the first time that a scenario permits sound."""

    def __init__(
        self,
        state: LiveState,
        parts: MicrophoneParts,
        *,
        start_child: Callable[[ProcessBody], ChildProcess],
        problem: Callable[[Severity, str, str, str], None],
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._parts = parts
        self._start_child = start_child
        self._problem = problem
        self._child: ChildProcess | None = None
        self._names: tuple[str, ...] = ()
        self._looked = False
        self._chosen = parts.chosen()
        self._listens_to: str | None = None
        self._open = False
        self._restarts = 0

    @property
    def names(self) -> tuple[str, ...]:
        return self._names

    @property
    def chosen(self) -> str | None:
        """None for no microphone, also where the computer has none at all."""
        return None if self._looked and not self._names else self._chosen

    def get_ready(self) -> None:
        """Find out which inputs there are."""
        if self._child is None and self._restarts <= _RESTARTS_AT_MOST:
            self._child = self._start_child(self._parts.body)

    def use(self, name: str | None) -> None:
        if name != self._chosen:
            self._chosen = name
            self._parts.keep(name)
            if self._open:
                self.open()

    def open(self) -> None:
        """Listen from now on, if a microphone is chosen."""
        status: MicrophoneStatus = self._state.microphone.value
        if self._open and self._listens_to == self._chosen and status.state in ("starting", "on"):
            return
        self._open = True
        self._listens_to = self._chosen
        if self._chosen is None:
            self._tell_closed()
            return
        self.get_ready()
        self._state.microphone.set(MicrophoneStatus("starting", self._chosen))
        if self._child is None:
            self._state.microphone.set(MicrophoneStatus("failed", self._chosen, detail="It failed too often."))
        else:
            self._child.send(OpenMicrophone(self._chosen))

    def close(self) -> None:
        self._open = False
        self._tell_closed()

    def _tell_closed(self) -> None:
        if self._child is not None:
            self._child.send(CloseMicrophone())
        self._state.microphone.set(MicrophoneStatus())

    def on_message(self, message: Any) -> Problem | None:
        """What the process said; a problem that the wizard shall hear of, if it is one."""
        name = self._state.microphone.value.name
        match message:
            case MicrophoneList(names):
                self._names, self._looked = names, True
            case MicrophoneOpened(opened) if self._open:
                self._state.microphone.set(MicrophoneStatus("on", opened))
            case MicrophoneLevel(peak) if self._open:
                self._state.microphone.set(MicrophoneStatus("on", name, round(peak, 3)))
            case MicrophoneFailed(problem) if self._open:
                detail = "No microphone is plugged in." if problem is None else problem.what
                self._state.microphone.set(MicrophoneStatus("failed", name, detail=detail))
                return problem
        return None

    def on_ended(self, child: ChildProcess) -> bool:
        """True when it was the microphone's process, which is started again if it is needed."""
        if child is not self._child:
            return False
        self._child = None
        self._restarts += 1
        if self._open:
            again = self._restarts <= _RESTARTS_AT_MOST
            self._problem(
                "warning",
                "Listening to the microphone stopped unexpectedly.",
                "Its sound is missing from the recording from now on."
                if not again
                else "A moment of its sound is missing from the recording.",
                "It is being started again." if again else "It failed too often: restart the program.",
            )
            self._open = False
            self.open()
        return True

    def shutdown(self) -> None:
        if self._child is not None:
            self._child.stop(grace_s=1.0)
            self._child = None
