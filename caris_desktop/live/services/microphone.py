"""The microphone of this computer: which one is used, and when it is listened to. GUI thread."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from PySide6.QtCore import QObject, QTimer

from caris_desktop.conversation.microphone_messages import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneLevel,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
)
from caris_desktop.domain import clock, intents
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessBody
from caris_desktop.live.children import Children
from caris_desktop.live.service import Handlers, Restarts, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import IN_SESSION, MicrophoneStatus
from caris_desktop.scenario.model import Scenario

_OPENS_WITHIN_MS = 4000


@dataclass(frozen=True, slots=True)
class MicrophoneParts:
    """``chosen`` gives what was chosen last time (None: no microphone, empty: the system's), ``keep`` remembers it."""

    body: ProcessBody
    chosen: Callable[[], str | None]
    keep: Callable[[str | None], None]


class MicrophoneService(Service):
    """Runs the microphone's process from the first time that a scenario permits sound."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: Children,
        parts: MicrophoneParts,
        *,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._children = children
        self._parts = parts
        self._problem = bus.problem
        self._child: ChildProcess | None = None
        self._names: tuple[str, ...] = ()
        self._looked = False
        self._chosen = parts.chosen()
        self._listens_to: str | None = None
        self._open = False
        self._restarts = Restarts()
        self._permitted = self._started = False
        self._then: Callable[[], None] | None = None
        self._missing_since_ns: int | None = None
        self._patience = QTimer(self, singleShot=True, interval=_OPENS_WITHIN_MS)
        self._patience.timeout.connect(self._on_patience_over)

    @property
    def names(self) -> tuple[str, ...]:
        return self._names

    @property
    def chosen(self) -> str | None:
        """None for no microphone, also where the computer has none at all."""
        return None if self._looked and not self._names else self._chosen

    def handlers(self) -> Handlers:
        return {intents.UseMicrophone: lambda asked: self.use(asked.microphone)}

    def processes(self) -> dict[str, ChildProcess]:
        return {} if self._child is None else {self._parts.body.name: self._child}

    def use_scenario(self, scenario: Scenario) -> None:
        """While nothing is recorded it is only found out which there are."""
        self._permitted = scenario.permissions.audio_recording
        if not self._permitted:
            self.wait_no_longer()
            self.close()
        elif self._state.recording.value.state not in IN_SESSION:
            if self._started:
                self.get_ready()
        else:
            self.open()

    def start(self) -> None:
        self._started = True
        if self._permitted:
            self.get_ready()

    def get_ready(self) -> None:
        """Find out which inputs there are."""
        if self._child is None and not self._restarts.exhausted:
            self._child = self._children.start(self._parts.body, ended=self._on_ended, heard=self.on_message)

    def use(self, name: str | None) -> None:
        if name != self._chosen:
            self._chosen = name
            self._parts.keep(name)
            if self._open:
                self.open()

    def open_and_then(self, then: Callable[[], None]) -> None:
        """Listen, and do ``then`` once its sound comes, none will come, or it has kept everybody waiting long enough.

        Whoever closes it meanwhile has changed their mind, and nothing is done.
        """
        self.open()
        self._then = then
        if self._state.microphone.value.state == "starting":
            self._patience.start()
        else:
            self.wait_no_longer()

    def wait_no_longer(self) -> None:
        """Do at once what waits for the sound, if anything does."""
        then, self._then = self._then, None
        self._patience.stop()
        if then is not None:
            then()

    def _on_patience_over(self) -> None:
        self._missing_since_ns = clock.now_ns()
        self.wait_no_longer()

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
        self._then = self._missing_since_ns = None
        self._patience.stop()
        self._tell_closed()

    def _tell_closed(self) -> None:
        if self._child is not None:
            self._child.send(CloseMicrophone())
        self._state.microphone.set(MicrophoneStatus())

    def on_message(self, message: Any) -> None:
        """What the process said."""
        name = self._state.microphone.value.name
        match message:
            case MicrophoneList(names):
                self._names, self._looked = names, True
            case MicrophoneOpened(opened) if self._open:
                self._state.microphone.set(MicrophoneStatus("on", opened))
                self._tell_missing()
                self.wait_no_longer()
            case MicrophoneLevel(peak) if self._open:
                self._state.microphone.set(MicrophoneStatus("on", name, round(peak, 3)))
            case MicrophoneFailed(problem) if self._open:
                detail = "No microphone is plugged in." if problem is None else problem.what
                self._state.microphone.set(MicrophoneStatus("failed", name, detail=detail))
                self.wait_no_longer()
                if problem is not None:
                    self._bus.publish(problem)

    def _tell_missing(self) -> None:
        if self._missing_since_ns is None:
            return
        missing_s = (clock.now_ns() - self._missing_since_ns) / 1e9
        self._missing_since_ns = None
        self._problem(
            "info",
            f"The microphone was heard {missing_s:.1f} s after the recording had begun.",
            "Its sound is missing from the recording until then.",
            "",
        )

    def _on_ended(self, child: ChildProcess) -> None:
        """It is started again if it is needed."""
        if child is not self._child:
            return
        self._child = None
        again = self._restarts.another()
        if self._open:
            self._problem(
                "warning",
                "Listening to the microphone stopped unexpectedly.",
                "Its sound is missing from the recording from now on."
                if not again
                else "A moment of its sound is missing from the recording.",
                self._restarts.advice,
            )
            self._open = False
            self.open()

    def stop(self) -> None:
        if self._child is not None:
            self._child.ask_to_end()

    def end(self) -> None:
        if self._child is not None:
            self._child.stop(grace_s=1.0)
