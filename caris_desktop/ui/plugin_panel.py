"""Panels of plug-ins: widgets of others in this window, and what they may read and request."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Protocol, TypeVar

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import SCRIPT
from caris_desktop.domain.plugins import Plugin, PluginError, find, load, switched_off, watched
from caris_desktop.domain.streams import BY_TYPE, STATE_STREAMS, STREAMS
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.service import localize_problem
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts
from caris_desktop.ui.panel import Panel, PanelContext, card_margins
from caris_desktop.ui.widgets.labels import label

T = TypeVar("T")
MAX_CALL_S = 0.15
"""A longer call ends driving, since the window cannot renew the motion lease meanwhile."""
MAX_CREATION_S = 1.0
REQUESTS: tuple[type[intents.Intent], ...] = (
    intents.Say, intents.Silence, intents.ShowExpression, intents.ShowOnFace, intents.Mark, intents.AddNote,
    intents.TakePhoto, intents.Stop, intents.EmergencyStop, intents.CancelGoal,
)  # fmt: skip
"""What a panel of a plug-in may request: nothing that moves the robot, or changes scenario, robot or people."""


class PanelConsole(Protocol):
    """What a panel of a plug-in gets from the console. For the thread of the window only."""

    @property
    def scenario(self) -> Scenario:
        """The open scenario."""

    def follow(self, kind: type[T], show: Callable[[T], None]) -> None:
        """Call ``show`` with each value of this type: of a stream such as ``sensing.Odometry``, the newest one and
        those that follow, while the panel is visible; of an event such as ``events.UtteranceChanged``, each one.

        ``show`` has 0.15 s.
        """

    def request(self, intent: intents.Intent) -> str:
        """Run one of the intents in ``REQUESTS`` as a script; returns the reason if it is refused, else an empty
        text. The scenario must allow it, as for the wizard.
        """


class PanelPlugin(Protocol):
    """Contract of the group ``caris_desktop.panels``: a class, whose instance is the content of one panel.

    It is made in the thread of the window, when a scenario first shows the panel ``plugin:NAME``, and again after each
    change of the scenario. Import and construction have one second. It may be any QWidget; its size hints are those of
    the panel. An exception of the constructor or of a ``show`` function, a text on standard output, or a call that
    takes longer switches the panel off: the widget is removed. The widget's own event handlers run in the window: one
    that hangs stops the window, which ends driving within 0.15 s, while recording goes on.
    """

    caris_interface: int

    def __call__(self, console: PanelConsole) -> QWidget:
        """Make the widget."""


class PluginPanel(Panel):
    """Panel of a plug-in, and its console."""

    def __init__(self, name: str, context: PanelContext) -> None:
        super().__init__(context)
        self._rows = layouts.vbox(self, margins_px=0, spacing_px=0)
        card_margins(self._rows)
        self._content: QWidget | None = None
        self._plugin = Plugin(name, "panels", "", "", "")
        self._following: list[tuple[Any, Callable[[Any], None]]] = []
        self.state.event_happened.connect(self._pass_on)
        self.show_title(name.replace("_", " ").replace("-", " ").capitalize())
        with self._switched_off_if_it_fails(MAX_CREATION_S):
            self._plugin = find("panels", name)
            content = load(self._plugin)(self)
            if not isinstance(content, QWidget):
                raise PluginError(self._plugin, QT_TR_NOOP("it is not a widget"))
            self._content = content
            self._rows.addWidget(content, 1)
            self.update_view()

    @property
    def scenario(self) -> Scenario:
        return self._scenario

    def follow(self, kind: type[T], show: Callable[[T], None]) -> None:
        spec = BY_TYPE.get(kind)
        if spec not in STREAMS:
            raise ValueError(f"{kind.__name__} is no stream and no event")
        if spec in STATE_STREAMS and kind not in dict(self._following):
            self.state.stream(spec.name).changed.connect(self._on_value)
        self._following.append((kind, show))

    def request(self, intent: intents.Intent) -> str:
        if not isinstance(intent, REQUESTS):
            return tr("A panel of a plug-in cannot request this.")
        return self.console.do(replace(intent, actor=SCRIPT))

    def update_view(self) -> None:
        for kind, show in tuple(self._following):
            spec = BY_TYPE[kind]
            if spec in STATE_STREAMS and (value := self.state.stream(spec.name).value) is not None:
                self._show(kind, show, value)

    def focus_target(self) -> QWidget:
        return self._content or self

    # Bound slots, which Qt disconnects from a deleted panel; it does not know that of a function.
    def _on_value(self, value: object) -> None:
        if self.in_view:
            self._pass_on(value)

    def _pass_on(self, value: object) -> None:
        for kind, show in tuple(self._following):
            self._show(kind, show, value)

    def _show(self, kind: type[Any], show: Callable[[Any], None], value: object) -> None:
        if isinstance(value, kind) and self._content is not None:
            with self._switched_off_if_it_fails(MAX_CALL_S):
                show(value)

    @contextmanager
    def _switched_off_if_it_fails(self, within_s: float) -> Iterator[None]:
        began_s = time.perf_counter()
        try:
            with watched(self._plugin):
                yield
        except PluginError as error:
            self._switch_off(error.reason)
            return
        if (took_s := time.perf_counter() - began_s) > within_s:
            self._switch_off(localized(QT_TR_NOOP("it stopped the window for {seconds} s"), seconds=f"{took_s:.1f}"))

    def _switch_off(self, reason: str) -> None:
        self._following.clear()
        if self._content is not None:
            layouts.discard(self._content)
            self._content = None
        alarm = switched_off(clock.now_ns(), self._plugin.name, self._plugin.package, reason)
        alarm = replace(alarm, meaning=QT_TR_NOOP("Its panel is empty; everything else works."))
        self._rows.addWidget(label(tr(alarm.what), wraps=True), 1, Qt.AlignmentFlag.AlignTop)
        self.console.report(localize_problem(alarm))
