"""Menus with file lists: the cached list at once, and the new one when the disk has been read."""

from pathlib import Path

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QMenu

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.scenario.scenario_file import ScenarioChoice
from caris_desktop.ui.background_reading import Remembered
from caris_desktop.ui.main_window import MainWindow
from tests.ui import samples
from tests.ui.fake_console import FakeConsole


def test_the_last_reading_is_there_at_once_and_is_read_again() -> None:
    console, on_disk, told = FakeConsole(samples.TOUR), ["one"], list[bool]()
    owner = QObject()
    remembered = Remembered(console, lambda: tuple(on_disk), owner)
    remembered.changed.connect(lambda: told.append(True))
    console.disk_is_slow = True
    assert remembered.now() == ()
    assert remembered.now() == ()
    console.answer_of_disk()
    assert (remembered.now(), told) == (("one",), [True])
    on_disk.append("two")
    console.answer_of_disk()
    assert (remembered.now(), told) == (("one", "two"), [True, True])
    console.answer_of_disk()
    assert told == [True, True], "nothing else is there"


def test_a_failed_reading_leaves_the_last_one() -> None:
    console, owner = FakeConsole(samples.TOUR), QObject()
    answers = [("one",), UserFacingError("The disk is gone.", "", ""), ("two",)]

    def read() -> tuple[str, ...]:
        answer = answers.pop(0)
        if isinstance(answer, UserFacingError):
            raise answer
        return answer

    remembered = Remembered(console, read, owner)
    assert [remembered.now() for _ in range(3)] == [("one",), ("one",), ("two",)]


def test_an_open_menu_has_a_scenario_as_soon_as_the_disk_responds(window: MainWindow, console: FakeConsole) -> None:
    def titles() -> list[str]:
        menu = window.findChild(QMenu, "scenario_menu")
        assert menu is not None and menu.isVisible()
        return [action.text() for action in menu.actions()]

    console.disk_is_slow = True
    window._scenarios._read = lambda: [ScenarioChoice("Third", Path("third.yaml"))]
    window.menus.open_scenario_menu()
    assert "Third" not in titles()
    console.answer_of_disk()
    assert "Third" in titles()
    window.findChild(QMenu, "scenario_menu").close()  # type: ignore[union-attr]


def test_the_keys_for_scenarios_work_as_soon_as_the_disk_responds(window: MainWindow, console: FakeConsole) -> None:
    console.disk_is_slow = True
    window._scenarios._known = ()
    window.actions_table.run("choose_scenario")
    palette = window._palette_overlay
    assert palette.list.entries == ()
    console.answer_of_disk()
    assert palette.list.entries[0].text == f"Open scenario {samples.TOUR.title}"
    palette.close_overlay()
