"""No key, menu item, palette entry or button remains in the window for a switched-off permission.

Generated from the table of intents: one window gets all permissions except one in turn, and every control in it is
pressed. A new permission is tested without a change here.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any, get_args

import pytest
from PySide6.QtCore import QCoreApplication, QEvent, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QApplication, QLineEdit, QMenu, QPlainTextEdit, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import CallService, RobotControl
from caris_desktop.domain.events import AssistedFunction
from caris_desktop.domain.intents import INTENTS, Intent, Permission
from caris_desktop.scenario.phrases import Gesture, Phrase, PhraseGroup
from caris_desktop.scenario.protocol_steps import Branch, ProtocolSettings, ProtocolStep
from caris_desktop.scenario.scenario_model import (
    AssistanceSettings,
    PanelName,
    Permissions,
    Scenario,
    SoundSettings,
    TabNode,
)
from caris_desktop.ui.action_bindings import actions_for
from caris_desktop.ui.action_rows import ACTIONS
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.observer_window import SEES_WORDS
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.panels.conversation_panel import SuggestionCards
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.popups import FloatingCard
from caris_desktop.ui.window_menus import THEME_WORDS
from tests.ui import samples
from tests.ui.conftest import MemorySettings
from tests.ui.fake_console import FakeConsole

PERMISSIONS: tuple[Permission, ...] = get_args(Permission)
EVERYTHING = Permissions(**dict.fromkeys((each.name for each in fields(Permissions)), True))
FULL = replace(
    samples.TOUR,
    layout=TabNode(("speak", "conversation")),
    phrases=(
        Phrase("Hello!", gesture="wave"), Phrase("Follow me.", key="Ctrl+G"),
        PhraseGroup("On the way", ("Mind the step.",)),
    ),
    gestures=(Gesture("Wave", "wave"), Gesture("Nod", "nod")),
    protocol=ProtocolSettings((
        ProtocolStep("Greet", say="Hello!", go_to="Kitchen", tick=("Form",), branches=(Branch("Leaves", "Goodbye"),)),
        ProtocolStep("Goodbye", say="Follow me."),
    )),
    sound=SoundSettings(hear=True),
    assistance=AssistanceSettings("act", "act", "act"),
    permissions=EVERYTHING,
)  # fmt: skip
WAVE = RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {}))
WITHOUT_INTENT: frozenset[Permission] = frozenset({"video_recording", "audio_recording", "cloud_models"})
"""Permissions without an intent, which apply to a recording or a question; see ``tests/app/test_permissions.py``."""
WITH_LEVEL: dict[AssistedFunction, tuple[type[Intent], ...]] = {
    "replies": (intents.SaySuggestion,),
    "fillers": (),
    "actions": (intents.ConfirmProposal, intents.VetoProposal),
}
"""Intents requested only by an assisted function of that level."""
OF_THE_WINDOW_ALONE = ("Window", "Panel", "Theme", "Scenario", "Session", "Wizard")
"""Kinds of entries that open windows or change the appearance, without a permission."""
MENUS_OF_THE_WINDOW_ALONE = ("Panels", "Layout", "Appearance", "Size", "Wizard", "Who is the wizard?")
LINES_OF_THE_WINDOW_ALONE = {
    *THEME_WORDS.values(), *SEES_WORDS.values(), "Edit this scenario…", "Import a scenario…",
    "Export this scenario as one file…", "Practise on the simulated robot", "Set up…", "All shortcuts", "Gamepad…",
}  # fmt: skip
"""The same in the menus of the top bar."""


@dataclass
class Desk:
    """Window whose console only records requests."""

    window: MainWindow
    console: FakeConsole
    asked: list[Intent] = field(default_factory=list)

    def show(self, scenario: Scenario) -> None:
        self.console.scenario = scenario
        self.console.state.scenario.reset_value(scenario)

    def pressed(self) -> list[Intent]:
        """Requests after every control in the window is pressed."""
        self.pressed_outside_panels()
        for name in self.window.board.possible():
            self.window.open_panel(name)
            QApplication.processEvents()
            self._write_lines(self.window.panels[name])
            self._press_buttons(self.window.panels[name])
            for widget in self.window.panels[name].title_widgets():
                self._press_buttons(widget)
            self.window.close_panel(name)
        return list(self.asked)

    def pressed_outside_panels(self) -> list[Intent]:
        """The same of keys, palette, bars and menus."""
        self.asked.clear()
        table = self.window.actions_table
        for spec in table.specs:
            asked = table.intent_of(spec)
            if asked is not None:
                self.asked.append(asked)
            elif spec.kind == "talk":
                self.asked.append(intents.PushToTalk(on=True, to=spec.argument))
        of_the_window = {spec.text for spec in table.specs if spec.group == "Window"}
        for entry in self.window.palette_entries():
            if entry.kind not in OF_THE_WINDOW_ALONE and entry.text not in of_the_window:
                entry.do()
        for bar in ("top_bar", "protocol_strip", "status_bar"):
            part = self.window.findChild(QWidget, bar)
            assert part is not None and part.isVisible(), bar
            self._press_buttons(part)
        return list(self.asked)

    def _write_lines(self, panel: QWidget) -> None:
        fields = [*panel.findChildren(QLineEdit), *panel.findChildren(QPlainTextEdit)]
        for line in fields:
            if line.isVisible() and line.isEnabled() and not line.isReadOnly():
                QTest.keyClicks(line, "Hello")
                QTest.keyClick(line, Qt.Key.Key_Return)

    def _press_buttons(self, panel: QWidget) -> None:
        ours = [panel] if isinstance(panel, QAbstractButton) else []
        for button in (*ours, *panel.findChildren(QAbstractButton)):
            if button.isVisible() and button.isEnabled():
                button.click()
                self._press_menu()
                self._press_cards(button)

    def _press_menu(self) -> None:
        menu = QApplication.activePopupWidget()
        if isinstance(menu, QMenu):
            menu.close()
            for line in lines(menu):
                line()

    def _press_cards(self, opener: QAbstractButton) -> None:
        """Press the buttons of an opened card, and close it."""
        for card in (*self.window.findChildren(FloatingCard), *self.window.findChildren(Overlay)):
            if card.isVisible() and not card.isAncestorOf(opener):
                for button in card.findChildren(QAbstractButton):
                    if button.isVisible() and button.isEnabled():
                        button.click()
                        self._press_menu()
                card.hide()


def lines(menu: QMenu) -> Iterator[Callable[[], None]]:
    """Actions of the menu, except those that change the appearance or open another window."""
    for action in menu.actions():
        inner = action.menu()
        if isinstance(inner, QMenu):
            if not inner.title().startswith(MENUS_OF_THE_WINDOW_ALONE):
                yield from lines(inner)
        elif action.isEnabled() and not action.isSeparator() and action.text() not in LINES_OF_THE_WINDOW_ALONE:
            yield action.trigger


def needed(asked: Intent) -> tuple[Permission, ...]:
    return () if asked.reduces_motion else asked.needs_permissions or INTENTS[type(asked)].permissions


@pytest.fixture
def desk(qapp: QApplication, theme: Theme) -> Iterator[Desk]:
    console = FakeConsole(FULL)
    samples.fill_console(console)
    samples.converse(console)
    samples.suggest(console)
    console.protocol.begin_session("wizard")
    window = MainWindow(console, settings=MemorySettings(), scenarios=list, theme=theme)
    desk = Desk(window, console)
    window.resize(1366, 768)
    window.setUpdatesEnabled(False)  # not displayed
    window.show()
    console.state.close()
    console.state.controls.set((WAVE,))
    console.do = lambda intent: desk.asked.append(intent) or ""  # type: ignore[method-assign,func-returns-value]
    yield desk
    window.close()
    window.deleteLater()
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)


def without(off: Collection[Permission]) -> Scenario:
    return replace(FULL, permissions=replace(EVERYTHING, **dict.fromkeys(off, False)))


def check_keys(desk: Desk, off: Collection[Permission]) -> None:
    """Assert that each key has its row, and none belongs to a switched-off panel."""
    bound = {keys.toString() for action in desk.window.actions() for keys in action.shortcuts()}
    rows = desk.window.actions_table.all_specs
    assert bound <= {key for spec in rows for key in spec.keys}, f"{off}: a key without its row"
    assert {name for name, spec in PANELS.items() if spec.permission in off}.isdisjoint(desk.window.board.possible())


def forbidden(asked: Iterable[Intent], off: Collection[Permission]) -> list[str]:
    return [type(each).__name__ for each in asked if not set(off).isdisjoint(needed(each))]


@pytest.mark.long
def test_disabled_functions_cannot_be_pressed_anywhere(desk: Desk, request: pytest.FixtureRequest) -> None:
    """With --long each permission alone; otherwise a few at a time, as a window with all panels takes seconds."""
    desk.show(FULL)
    found = {permission for asked in desk.pressed() for permission in needed(asked)}
    assert found | WITHOUT_INTENT == set(PERMISSIONS), (
        "something is there to be pressed for each, where it is permitted"
    )
    at_once = len(PERMISSIONS) if request.config.getoption("--long") else 3
    for number in range(at_once):
        off = set(PERMISSIONS[number::at_once])
        desk.show(without(off))
        check_keys(desk, off)
        assert forbidden(desk.pressed(), off) == [], off


@pytest.mark.long
def test_a_disabled_function_is_on_no_key_bar_or_menu(desk: Desk) -> None:
    desk.show(FULL)
    desk.console.state.persons.set(())  # each has palette entries that open a card
    everything = desk.pressed_outside_panels()
    asked = {type(each) for each in everything}
    assert {intents.Say, intents.GoToPlace, intents.TickItem, intents.TakeBranch, intents.PauseRecording} <= asked
    assert {"say_step", "go_to_step_place"} <= {spec.id for spec in desk.window.actions_table.specs}
    for permission in PERMISSIONS:
        desk.show(without({permission}))
        check_keys(desk, {permission})
        assert forbidden(desk.pressed_outside_panels(), {permission}) == [], permission


@pytest.mark.long
def test_actions_never_proposed_have_no_row_level_or_card(desk: Desk) -> None:
    """With suggestions and a proposal still in the state."""
    two = replace(FULL, panels_off=tuple(set(PANELS) - {"speak", "conversation"}))
    desk.show(two)
    before = {type(asked) for asked in desk.pressed()}
    assert {*sum(WITH_LEVEL.values(), ()), intents.SetLevel, intents.DismissSuggestions} <= before
    for off in (*((function,) for function in WITH_LEVEL), tuple(WITH_LEVEL)):
        levels = AssistanceSettings(**{function: "off" if function in off else "act" for function in WITH_LEVEL})
        desk.show(replace(two, assistance=levels))
        asked = desk.pressed()
        gone = {intent for function in off for intent in WITH_LEVEL[function]}
        assert gone.isdisjoint({type(each) for each in asked}), off
        assert {each.function for each in asked if isinstance(each, intents.SetLevel)} == set(WITH_LEVEL) - set(off)
        rows = {spec.id for spec in desk.window.actions_table.all_specs}
        assert any("edit_suggestion" in row for row in rows) is ("replies" not in off)
    assert not any(isinstance(each, intents.DismissSuggestions) for each in asked)
    assert "no_suggestion" not in rows
    assert desk.window.panels["conversation"].findChildren(SuggestionCards) == []


def test_the_keys_that_answer_are_there_while_something_may_be_asked() -> None:
    def answers(**changes: Any) -> bool:
        unnamed = replace(EVERYTHING, naming_people=False)
        return "answer_yes" in {row.id for row in actions_for(replace(FULL, permissions=unnamed, **changes))}

    assert answers()
    assert not answers(assistance=AssistanceSettings(actions="off"))


def test_a_panel_that_is_not_offered_has_no_line_no_key_and_no_place(desk: Desk) -> None:
    everywhere = replace(FULL, layout=TabNode(tuple(PANELS)))
    rows = {spec.id for spec in actions_for(everywhere)}
    for name in PANELS:
        left = actions_for(replace(everywhere, panels_off=(name,)))
        assert rows - {spec.id for spec in left} == {spec.id for spec in ACTIONS if spec.panel == name} & rows
    off: tuple[PanelName, ...] = ("speak", "conversation", "motion", "diagnostics", "map")
    desk.show(replace(everywhere, panels_off=off))
    window = desk.window
    assert set(window.panels) == set(PANELS) - set(off)
    for name in off:
        window.open_panel(name)
    assert set(window.panels) == set(PANELS) - set(off)
    titles = {entry.text for entry in window.palette_entries() if entry.kind == "Panel"}
    assert titles.isdisjoint(PANELS[name].title for name in off)
