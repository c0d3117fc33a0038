"""Number of keys per command, counted with real key events in one window, while typing and while driving."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.domain import intents
from caris_desktop.scenario.protocol_steps import ProtocolSettings, ProtocolStep
from caris_desktop.ui.main_window import MainWindow
from tests.ui import samples
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

Key = Qt.Key
NONE, CTRL, SHIFT, ALT = (
    Qt.KeyboardModifier.NoModifier,
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.AltModifier,
)
NAME = "Maria"


@dataclass(frozen=True)
class Act:
    """``keys`` in order, with NAME for a typed name, which is not counted; ``asked`` is the request to the console."""

    keys: tuple[tuple[Qt.Key, Qt.KeyboardModifier] | str, ...]
    asked: tuple[str, Any]
    at_most: int

    @property
    def count(self) -> int:
        return sum(key != NAME for key in self.keys)


ACTS = {
    "phrase": Act(((Key.Key_F2, NONE),), ("say", ("Please follow me.", "phrase")), 1),
    "suggestion": Act(((Key.Key_1, CTRL),), ("say_suggestion", 1), 1),
    "named place, of the first nine": Act(((Key.Key_2, ALT),), ("go_to_place", samples.TOUR.places[1].name), 1),
    "named place, seen by its name": Act(
        ((Key.Key_G, CTRL | SHIFT), (Key.Key_2, NONE)), ("go_to_place", samples.TOUR.places[1].name), 2
    ),
    "photo": Act(((Key.Key_P, CTRL),), ("take_photo", None), 1),
    "name who is in front": Act(((Key.Key_I, CTRL), NAME, (Key.Key_Return, NONE)), ("rename_person", NAME), 2),
    "mark": Act(((Key.Key_M, CTRL),), ("mark", ("", "mark")), 1),
    "next step": Act(((Key.Key_PageDown, CTRL),), ("protocol", intents.NextStep()), 1),
    "emergency stop": Act(((Key.Key_Pause, NONE),), ("emergency_stop", None), 1),
    "switch scenario": Act(((Key.Key_O, CTRL), (Key.Key_2, NONE)), ("open_scenario", samples.MENTAL.path), 2),
}


TOUR = dataclasses.replace(
    samples.TOUR, protocol=ProtocolSettings((ProtocolStep("Greet"), ProtocolStep("Talk"), ProtocolStep("Close")))
)


@pytest.fixture
def console() -> FakeConsole:
    return FakeConsole(TOUR, {samples.MENTAL.path: samples.MENTAL, TOUR.path: TOUR})


def press(keys: tuple[tuple[Qt.Key, Qt.KeyboardModifier] | str, ...]) -> None:
    for key in keys:
        focused = QApplication.focusWidget()
        assert isinstance(focused, QWidget)
        if isinstance(key, str):
            QTest.keyClicks(focused, key)
        else:
            QTest.keyClick(focused, *key)


def asked_of(console: FakeConsole, name: str) -> list[Any]:
    """Arguments of the requests; without generated ids."""
    given = {"rename_person": lambda arguments: arguments[1], "say_suggestion": lambda arguments: arguments[0]}
    return [given.get(name, lambda arguments: arguments)(arguments) for arguments in console.named(name)]


@pytest.mark.long
def test_no_act_costs_more_keys_than_it_may(window: MainWindow, console: FakeConsole) -> None:
    for begun_in in ("speak_field", "video_view"):
        samples.suggest(console)
        field = find(window, "speak_field")
        for name, act in ACTS.items():
            find(window, begun_in).setFocus()
            console.calls.clear()
            press(act.keys)
            assert asked_of(console, act.asked[0]) == [act.asked[1]], f"{name}, begun in {begun_in}: {console.calls}"
            assert act.count <= act.at_most, name
            if name != "switch scenario":
                assert field.property("plainText") == "", f"{name}: no key of an act is typed"
            console.clear_emergency_stop()
        assert TOUR.path is not None
        console.do(intents.OpenScenario(TOUR.path))
        window.board.complete()
