"""Fixtures: a window with a fake console."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import shiboken6
from PySide6.QtCore import Qt
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.scenario.scenario_file import ScenarioChoice
from caris_desktop.scenario.scenario_model import Scenario, panels_in
from caris_desktop.ui.dock_layout import without
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.fake_console import FakeConsole


class MemorySettings:
    """In-memory double of QSettings."""

    def __init__(self) -> None:
        self.values: dict[str, object] = {}

    def value(self, key: str, defaultValue: object = None) -> object:  # noqa: N803
        return self.values.get(key, defaultValue)

    def setValue(self, key: str, value: object) -> None:
        self.values[key] = value


_shown_without_parent: list[QWidget] = []


def _watch_for_windows() -> None:
    """Record each widget that is shown as a window while it has no parent.

    The patched Python methods catch every such call; an event filter for the ten thousand events of a new window would
    take a fifth of its time.
    """

    def noting(shows: Callable[..., None]) -> Callable[..., None]:
        def show(widget: QWidget, *visible: bool) -> None:
            if visible != (False,) and widget.isWindow() and widget.parent() is None:
                _shown_without_parent.append(widget)
            shows(widget, *visible)

        return show

    for name in ("show", "setVisible", "showNormal", "showMaximized", "showFullScreen"):
        for of in (QWidget, *_all_kinds_of(QWidget)):
            if name in vars(of) and of.__module__.startswith("PySide6"):
                setattr(of, name, noting(vars(of)[name]))


def _all_kinds_of(base: type) -> Iterator[type]:
    for kind in base.__subclasses__():
        yield kind
        yield from _all_kinds_of(kind)


_watch_for_windows()


@pytest.fixture(autouse=True)
def no_part_is_shown_before_it_has_a_parent() -> Iterator[None]:
    """Fail if a part is shown before it has a parent: it is a window for a moment and takes the focus from driving."""
    _shown_without_parent.clear()
    yield
    assert take_parts_shown_early() == []


def take_parts_shown_early() -> list[str]:
    """Recorded widgets that have a parent by now."""
    parts = [widget for widget in _shown_without_parent if shiboken6.isValid(widget) and widget.parent() is not None]
    _shown_without_parent.clear()
    return list(dict.fromkeys(f"{type(widget).__name__} {widget.objectName()!r}" for widget in parts))


@pytest.fixture
def settings() -> MemorySettings:
    return MemorySettings()


@pytest.fixture
def console(request: pytest.FixtureRequest) -> FakeConsole:
    """Fake console with the tour scenario, limited to the panels of ``@pytest.mark.panels("map")``.

    Building the other panels takes twice as long as the window itself. A test that needs them all in a marked file has
    the mark without a name.
    """
    tour = with_marked_panels(request, samples.TOUR)
    return FakeConsole(tour, {samples.MENTAL.path: samples.MENTAL, tour.path: tour})


def with_marked_panels(request: pytest.FixtureRequest, scenario: Scenario) -> Scenario:
    """``scenario`` limited to the panels of the mark, also for the console of a single file."""
    mark = request.node.get_closest_marker("panels")
    return scenario if mark is None or not mark.args else with_panels(scenario, *mark.args)


def with_panels(scenario: Scenario, *names: str) -> Scenario:
    layout = without(scenario.layout, set(panels_in(scenario.layout)).difference(names))
    assert layout is not None, f"{scenario.title} has none of {names}"
    return dataclasses.replace(scenario, layout=layout)


@pytest.fixture(scope="session")
def theme(qapp: QApplication) -> Theme:
    """One theme for all tests: applying a style sheet takes a third of a second."""
    return Theme(qapp, "dark")


@pytest.fixture
def window(qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme) -> Iterator[MainWindow]:
    theme.set_choice("dark")
    yield open_window(qtbot, console, settings, theme)


@pytest.fixture
def screen_reader() -> Iterator[None]:
    """Active accessibility, so that texts for screen readers are kept up to date."""
    before = QAccessible.isActive()
    QAccessible.setActive(True)
    yield
    QAccessible.setActive(before)


def open_window(qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme) -> MainWindow:
    def choices() -> list[ScenarioChoice]:
        return [ScenarioChoice(scenario.title, scenario.path or Path()) for scenario in (samples.TOUR, samples.MENTAL)]

    samples.fill_console(console)
    # The tests expect panels where the samples place them, whatever the size of the window.
    settings.setValue("wizards/*/layout/adapts", "no")
    window = MainWindow(console, settings=settings, scenarios=choices, theme=theme)
    qtbot.addWidget(window)
    window.resize(1366, 768)
    window.show()
    window.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is window)
    # Freshness depends on the clock; the tests advance the time themselves.
    console.state.close()
    freshen(console)
    console.calls.clear()
    return window


def freshen(console: FakeConsole) -> None:
    """Send new values on every fast stream."""
    image_bgr, boxes = samples.first_frames()[0]
    samples.show_frame(console, image_bgr, boxes)
    samples.refresh_streams(console, Pose2D(6.6, 3.4, 0.55))


def find(window: QWidget, name: str) -> QWidget:
    """The visible widget with that object name."""
    found = [widget for widget in window.findChildren(QWidget, name) if widget.isVisible()]
    assert found, f"nothing visible is called {name}"
    return found[0]


def click(qtbot: QtBot, widget: QWidget) -> None:
    qtbot.mouseClick(widget, Qt.MouseButton.LeftButton)
