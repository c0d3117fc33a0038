"""Autonomy levels of the language model: display, and change up to the scenario's limit."""

from collections.abc import Callable

from PySide6.QtGui import QActionGroup

from caris_desktop.domain import intents
from caris_desktop.domain.events import AssistanceLevel, AssistedFunction
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import LevelsStatus
from caris_desktop.scenario.assistance import levels_up_to
from caris_desktop.ui.event_messages import FUNCTIONS, LEVELS
from caris_desktop.ui.panel import PanelContext
from caris_desktop.ui.top_bar import as_menu
from caris_desktop.ui.widgets.buttons import ActionButton


class LevelsButton(ActionButton):
    """Button with a menu section per function; amber while any function acts without confirmation."""

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context.theme, icon="sliders-horizontal", look="ghost", height_px=30)
        self.setObjectName("levels_button")
        self._context = context
        self._state = context.console.state
        self._menu = as_menu(context.theme, self, "levels_menu")
        self._menu.aboutToShow.connect(self.fill)
        self.clicked.connect(lambda: self._menu.popup(self.mapToGlobal(self.rect().bottomLeft())))
        self._state.levels.changed.connect(self._refresh)
        self._refresh()

    def _refresh(self, _levels: object = None) -> None:
        levels: LevelsStatus = self._state.levels.value
        acting = any(getattr(levels, function) == "act" for function in FUNCTIONS)
        self.set_label(tr("Automatic") if acting else "", look="amber" if acting else "ghost")
        lines = [f"{tr(FUNCTIONS[each])}: {tr(LEVELS[getattr(levels, each)])}" for each in self._assisted]
        self.setToolTip("\n".join((tr("Assistance levels"), *lines)))
        self.setAccessibleName(tr("Assistance levels"))
        self.setEnabled(self._state.present.live)

    @property
    def _assisted(self) -> tuple[AssistedFunction, ...]:
        return self._context.console.scenario.assisted

    def fill(self) -> None:
        """Fill the menu with the levels that the scenario permits."""
        self._menu.clear()
        for function in self._assisted:
            self._menu.addSection(tr(FUNCTIONS[function]))
            group = QActionGroup(self._menu)
            for level in levels_up_to(self._context.console.scenario.highest_level(function)):
                action = self._menu.addAction(tr(LEVELS[level]))
                action.setCheckable(True)
                action.setChecked(getattr(self._state.levels.value, function) == level)
                action.setActionGroup(group)
                action.triggered.connect(self._setter(function, level))

    def _setter(self, function: AssistedFunction, level: AssistanceLevel) -> Callable[[], None]:
        def set_level() -> None:
            self._context.console.do(intents.SetLevel(function, level))

        return set_level
