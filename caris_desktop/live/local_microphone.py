"""Local microphone: its process, selected input and state. GUI thread."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject, QTimer

from caris_desktop.conversation.sound_devices import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneLevel,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
)
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.service import ProcessManager, Restarts, localize_problem
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import MicrophoneStatus

# The audio library may hang its process, which therefore sends a sign of life each second.
_STUCK_AFTER_MS, _STARTS_WITHIN_MS = 6000, 30_000
# After working this long, the restart limit is reset.
_WELL_AFTER_MS = 60_000


class MicrophoneChoice(Value):
    """``chosen`` returns the saved selection (None: no microphone, empty: the system's), ``keep`` saves it."""

    body: ProcessSpec
    chosen: Callable[[], str | None]
    keep: Callable[[str | None], None]


class LocalMicrophone(QObject):
    """Maintains ``status``, a MicrophoneStatus, and reports problems. Its audio goes to the bus while it ``sends``."""

    def __init__(
        self,
        status: LiveValue,
        source: str,
        bus: Bus,
        children: ProcessManager,
        choice: MicrophoneChoice,
        *,
        settled: Callable[[], None],
        parent: QObject,
    ) -> None:
        """``settled`` is called when audio arrives, or when none can be expected for now."""
        super().__init__(parent)
        self._status = status
        self._off = MicrophoneStatus(role=status.value.role)
        self._source = source
        self._bus = bus
        self._children = children
        self._choice = choice
        self._settled = settled
        self.child: ChildProcess | None = None
        self.sends = True
        self.names: tuple[str, ...] = ()
        self._looked = False
        self._begun = False
        """Whether the process that runs now has said anything yet."""
        self._chosen = choice.chosen()
        self._listens_to: str | None = None
        self._open = False
        self.restarts = Restarts()
        self._stuck = QTimer(self, singleShot=True, interval=_STUCK_AFTER_MS)
        self._stuck.timeout.connect(self._on_stuck)
        self._well = QTimer(self, singleShot=True, interval=_WELL_AFTER_MS)
        self._well.timeout.connect(self._on_well)

    @property
    def chosen(self) -> str | None:
        """Selected microphone; None for none, also if the computer has none."""
        return None if self._looked and not self.names else self._chosen

    @property
    def process_name(self) -> str:
        return self._choice.body.name

    def get_ready(self) -> None:
        """List the available inputs."""
        if self.child is None and not self.restarts.exhausted:
            self._begun = False
            self.child = self._children.start(
                self._choice.body, ended=self._on_ended, on_message=self.on_message, reads=self._read
            )  # fmt: skip

    def use(self, name: str | None) -> None:
        if name != self._chosen:
            self._chosen = name
            self._choice.keep(name)
            if self._open:
                self.open()

    def open(self) -> None:
        """Start listening, if a microphone is selected."""
        status: MicrophoneStatus = self._status.value
        if self._open and self._listens_to == self._chosen and status.state in ("starting", "on"):
            return
        self._open = True
        self._listens_to = self._chosen
        if self._chosen is None:
            self._report_closed()
            self._settled()
            return
        self.get_ready()
        if self.child is None:
            self._show("failed", self._chosen, detail=QT_TR_NOOP("It failed too often."))
            self._settled()
        else:
            self._show("starting", self._chosen)
            self._stuck.start(_STUCK_AFTER_MS if self._begun else _STARTS_WITHIN_MS)
            self.child.send(OpenMicrophone(self._chosen))

    def close(self) -> None:
        if self._open:
            self._open = False
            self._report_closed()

    def dismiss(self) -> None:
        """End the process: this scenario does not use it."""
        self.close()
        child, self.child = self.child, None
        if child is not None:
            self._children.dismiss(child, grace_s=1.0)

    def ask_to_end(self) -> None:
        self._stuck.stop()
        self._well.stop()
        if self.child is not None:
            self.child.ask_to_end()

    def end(self) -> None:
        if self.child is not None:
            self.child.stop(grace_s=1.0)

    def _report_closed(self) -> None:
        self._stuck.stop()
        self._well.stop()
        if self.child is not None:
            self.child.send(CloseMicrophone())
        self._status.set(self._off)

    def _show(self, state: Any, name: str, *, level: float = 0.0, detail: str = "") -> None:
        self._status.set(replace(self._off, state=state, name=name, level=level, detail=detail, source=self._source))

    def _read(self, value: Any, raw: bytes) -> None:  # reader thread
        if self.sends or not isinstance(value, AudioChunk):
            self._children.pass_on(self.on_message, value, raw)

    def on_message(self, message: Any) -> None:
        """Handle a message of the process."""
        self._begun = True
        if self._stuck.isActive():
            self._stuck.start(_STUCK_AFTER_MS)
        name = self._status.value.name
        match message:
            case MicrophoneList(names):
                self.names, self._looked = names, True
            case MicrophoneOpened(opened) if self._open:
                self._show("on", opened)
                self._well.start()
                self._settled()
            case MicrophoneLevel(peak) if self._open:
                self._show("on", name, level=round(peak, 3))
            case MicrophoneFailed(problem) if self._open:
                detail = QT_TR_NOOP("No microphone is plugged in.") if problem is None else problem.what
                self._show("failed", name, detail=detail)
                self._settled()
                if problem is not None:
                    self._bus.publish(localize_problem(problem))

    def _on_stuck(self) -> None:
        if self.child is not None:
            self.child.kill()

    def _on_well(self) -> None:
        self.restarts = Restarts()

    def _on_ended(self, child: ChildProcess) -> None:
        """Restart the process if it is needed."""
        if child is not self.child:
            return
        self.child = None
        if not self._open:
            self.restarts.another()
            return
        self._open = False
        self.restarts.after_end(self._report_ended, self.open)
        if self.restarts.exhausted:
            self.open()  # shows the failure

    def _report_ended(self, advice: str) -> None:
        is_wizards = self._source == WIZARD_MICROPHONE
        self._bus.problem(
            "warning",
            tr("Your microphone stopped unexpectedly.") if is_wizards else tr("The microphone stopped unexpectedly."),
            tr("Its sound is missing from now on.")
            if self.restarts.exhausted
            else tr("A short part of its sound is missing."),
            advice,
            until="own_microphone" if is_wizards else "microphone",
        )
