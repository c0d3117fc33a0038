"""In the trial language every text of the window has its marks, except texts of a study, a scenario or a robot."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import get_args

import pytest
from PySide6.QtWidgets import QApplication, QDialog, QLabel, QMenu, QWidget

from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.translation import tr
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.status import AssistantSetup, ContextPartStatus
from caris_desktop.people.presence import is_unnamed_label
from caris_desktop.robot.profile import load_profile, shipped_profiles
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import BuiltInPanel, Permissions, TabNode
from caris_desktop.ui import text_formatting
from caris_desktop.ui.dock_area import Dock, PanelTabs
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.observer_window import SEES_WORDS
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_appearance import ENGLISH, TRIAL, Language
from tests.support.trial_language_check import (
    StudyTexts,
    is_unmarked,
    is_unmarked_fragment,
    listed,
    merged,
    strings_of,
    unmarked_texts,
)
from tests.support.window_menus import menus_made, opened_menus
from tests.ui import samples, test_sessions
from tests.ui.conftest import freshen
from tests.ui.fake_console import FakeConsole, FakeLibrary
from tests.ui.fake_replay import FakeReplay, ReplayScene, sample_coding, sample_overview
from tests.ui.test_every_size import SCENARIOS
from tests.ui.test_robot_dialog import MemoryExplorer

SAID = ("samples.py", "fake_console.py", "people_samples.py")
"""Files with sample data, whose texts stand for those of a study."""

OF_OTHERS = ("CARIS Desktop", "Lab visit", "Kim", "P07", "Scroll Left", "Scroll Right")
"""The name of the program, participants, and texts of Qt, which have their own translation."""

WHAT_TO_DO = (
    "These are shown without going through tr: give them to it where they are made, or, in a table, where they are"
    " shown. What a study or a robot says has to stand in the samples of this test."
)
SAMPLES = Path(samples.__file__)
UI = Path(text_formatting.__file__).parent
OF_A_REPLAY = tuple((UI / "replay").rglob("*.py"))


class Spoken:
    """One window in the trial language, with everything that it opens."""

    def __init__(self, theme: Theme) -> None:
        self.language = Language()
        self.language.use(TRIAL)
        scenarios = [load_scenario(layouts_dir() / f"{name}.yaml") for name in SCENARIOS]
        self.console = FakeConsole(scenarios[0], {one.path: one for one in scenarios if one.path is not None})
        samples.fill_console(self.console)
        along = (
            ContextPartStatus("history", "Person history", 2, 12),
            ContextPartStatus("things", "Objects in view", 1, 3),
        )
        self.console.state.assistant_setup.set(AssistantSetup(parts=along))
        said = [text for name in SAID for text in strings_of(SAMPLES.with_name(name)) if not is_unnamed_label(text)]
        robots = [load_profile(name) for name in shipped_profiles()]
        sessions = (test_sessions.SESSIONS, test_sessions.HITS)
        cameras = [text_formatting.camera_name(name) for name in self.console.state.cameras.value]
        self.data = StudyTexts(said, scenarios, robots, sessions, shipped_profiles(), cameras, OF_OTHERS)
        self.scenarios = scenarios
        self._drawn: set[int] = set()
        self.gamepads = Gamepads(self.console.state, lambda _event: None)
        self.window = MainWindow(
            self.console,
            theme=theme,
            gamepads=self.gamepads,
            explorer=MemoryExplorer(),  # type: ignore[arg-type]
        )
        self.window.use_library(FakeLibrary(test_sessions.SESSIONS, test_sessions.HITS))
        self.window._top_bar.show_details(TrialDetails("Lab visit", "P07", "B", "2", "Kim"))
        self.window.resize(1920, 1080)
        self.window.show()
        self.console.state.close()

    def close(self) -> None:
        self.window.close()
        self.language.use(ENGLISH)
        for widget in QApplication.topLevelWidgets():
            if widget.parent() is None and not widget.isHidden():
                widget.close()
        self.window.deleteLater()

    def shown(self) -> dict[str, set[str]]:
        """Texts without marks in the window and its parts."""
        freshen(self.console)
        for _ in range(10):
            QApplication.processEvents()
        self.window.status_bar.refresh()
        windows = [
            widget for widget in QApplication.topLevelWidgets() if widget.parent() is None and widget.isVisible()
        ]
        return unmarked_texts({id(one): one for one in (self.window, *windows)}.values(), self.data, self._drawn)

    def of_every_scenario(self) -> dict[str, set[str]]:
        found = []
        for scenario in self.scenarios:
            self.console.scenario = scenario
            self.console.state.scenario.reset_value(scenario)
            for name in self.window.board.possible():
                self.window.open_panel(name)
            self._drawn.clear()
            found.append(self.shown())
        return merged(*found)

    def of_what_opens(self) -> dict[str, set[str]]:
        window, menus = self.window, self.window.menus
        found = []
        openers = (
            menus.open_scenario_menu, menus.open_window_menu, menus.open_robot_menu, window.show_command_palette,
            window.show_shortcuts, window._connection.open, window.show_preflight, window._alarms.show_alarms,
            window.sessions.open_start_dialog, window.sessions.open_sessions,
            lambda: window.sessions.open_export([test_sessions.SESSIONS[0].folder]), window.robots.open_dialog,
            window.gamepad.open, window.editor.open, *(partial(window.observers.open, sees) for sees in SEES_WORDS),
            window.show_set_up,
        )  # fmt: skip
        for opener in openers:
            opener()
            window.observers.complete()
            found.append(self.shown())
            window.hold.escape_pressed.emit()
        return merged(*found)

    def of_every_menu(self) -> tuple[dict[str, set[str]], set[str]]:
        """Texts without marks in the menus of panels, titles and bars, and the opened menus."""
        everything = Permissions(**dict.fromkeys((each.name for each in dataclasses.fields(Permissions)), True))
        tour = next(one for one in self.scenarios if one.path is not None and one.path.stem == "tour-guide")
        # More panels in one tab bar than fit.
        crowded = dataclasses.replace(tour, permissions=everything, layout=TabNode(get_args(BuiltInPanel)))
        self.console.scenario = crowded
        self.console.state.scenario.reset_value(crowded)
        self.console.state.places.set(crowded.places)
        self.console.do = lambda _intent: ""  # type: ignore[method-assign] # what is pressed changes nothing
        window = self.window
        window.resize(1366, 768)
        self.shown()
        found, opened = of_menus([window._top_bar, window.status_bar], self.data, window.menus.open_robot_menu)
        for name in window.board.possible():
            window.open_panel(name)
            QApplication.processEvents()
            of_panel, of_it = of_menus(window.findChildren(Dock, f"dock_{name}"), self.data)
            of_tabs, in_tabs = of_menus(window.findChildren(PanelTabs), self.data)
            found, opened = merged(found, of_panel, of_tabs), opened | of_it | in_tabs
            window.hold.escape_pressed.emit()
        return found, opened


def of_menus(
    widgets: Iterable[QWidget], data: StudyTexts, *openers: Callable[[], None]
) -> tuple[dict[str, set[str]], set[str]]:
    found, opened = [], set()
    for menu in opened_menus(widgets, *openers):
        found.append(unmarked_texts([menu], data))
        opened |= {one.objectName() for one in (menu, *menu.findChildren(QMenu))}
    return merged(*found), opened


@pytest.fixture
def spoken(theme: Theme) -> Iterator[Spoken]:
    spoken = Spoken(theme)
    yield spoken
    spoken.close()


@pytest.mark.long
def test_every_text_bears_the_marks_of_the_trial_language(spoken: Spoken) -> None:
    found = merged(spoken.of_every_scenario(), spoken.of_what_opens())
    assert listed(found) == [], WHAT_TO_DO


@pytest.mark.long
def test_the_lines_of_every_menu_bear_them_too(spoken: Spoken) -> None:
    found, opened = spoken.of_every_menu()
    assert listed(found) == [], WHAT_TO_DO
    made = menus_made(file for file in UI.rglob("*.py") if file not in OF_A_REPLAY)
    assert sorted(made - opened) == [], "These did not open, or have no name: what they say was not looked at."


def test_a_replay_and_its_dialogs_bear_them_too(theme: Theme) -> None:
    language = Language()
    language.use(TRIAL)
    replay = FakeReplay(overview=sample_overview(), coding=sample_coding(120_000))
    replay.at_ms(34_500)
    scene = ReplayScene(theme, replay)
    data = StudyTexts(
        [text for name in (*SAID, "fake_replay.py") for text in strings_of(SAMPLES.with_name(name))], OF_OTHERS
    )
    try:
        scene.show()
        found = []
        first = scene.timeline.acts.document.annotations[5]
        tier = scene.timeline.acts.document.tiers[0]
        dialogs = {"tier_dialog", "import_dialog", "agreement_dialog"}
        for opener in (
            lambda: None, lambda: scene.timeline.canvas.select(first.annotation_id),
            scene.timeline.acts.rename_selected,
            scene.timeline.open_tier_dialog, lambda: scene.timeline._open_tier_dialog(tier),
            scene.timeline.open_import, scene.timeline.open_agreement,
        ):  # fmt: skip
            opener()
            for _ in range(10):
                QApplication.processEvents()
            opened = [dialog for dialog in scene.findChildren(QDialog) if dialog.isVisible()]
            dialogs -= {dialog.objectName() for dialog in opened}
            found.append(unmarked_texts([scene, *opened], data))
            for dialog in opened:
                dialog.close()
        assert dialogs == set(), "These did not open."
        assert listed(merged(*found)) == [], WHAT_TO_DO
    finally:
        language.use(ENGLISH)
        scene.close()
        scene.deleteLater()


def test_the_lines_of_every_menu_of_a_replay_bear_them_too(theme: Theme) -> None:
    language = Language()
    language.use(TRIAL)
    replay = FakeReplay(overview=sample_overview(), coding=sample_coding(120_000))
    scene = ReplayScene(theme, replay)
    data = StudyTexts(
        [text for name in (*SAID, "fake_replay.py") for text in strings_of(SAMPLES.with_name(name))], OF_OTHERS
    )
    try:
        scene.resize(640, 620)  # too narrow for all codes of the selected row
        scene.show()
        first = scene.timeline.acts.document.annotations[5]
        scene.timeline.canvas.activate(f"tier {first.tier_id}")
        scene.timeline.canvas.select(first.annotation_id)
        QApplication.processEvents()
        buttons = [scene.findChild(QWidget, name) for name in ("rows_menu_button", "coding_more")]
        found, opened = of_menus([scene.timeline.canvas, *buttons], data)
        assert listed(found) == [], WHAT_TO_DO
        assert sorted(menus_made(OF_A_REPLAY) - opened) == [], "These did not open, or have no name."
    finally:
        language.use(ENGLISH)
        scene.close()
        scene.deleteLater()


def test_untranslated_text_is_visible(spoken: Spoken) -> None:
    holder = QWidget(spoken.window)
    said, told, named = QLabel("Left as it was", holder), QLabel(tr("Stop"), holder), QLabel("Lab visit · P07", holder)
    filled = QLabel(tr("Go to {place}").format(place="Lab visit"), holder)
    told.setToolTip("A tip for {name}".format(name=tr("Stop")))
    named.setAccessibleName("Named by nobody")
    found = unmarked_texts([holder], spoken.data)
    assert {text for texts in found.values() for text in texts} == {
        "Left as it was", f"A tip for {tr('Stop')}", "Named by nobody",
    }, (said, filled)  # fmt: skip
    holder.deleteLater()


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("[Ğö tö thé Štöp ēx] · P07", False),
        ("[Ğö tö [thé Štöp ēx]]", False),
        ("Go to [thé Štöp ēx]", True),
        ("[Ğö tö thé Š…", False),
        ("Ctrl+K", False),
        ("12.5 m/s · 3 GB", False),
        ("3 people", True),
        ("P07", False),
        ("ws://127.0.0.1:9090", False),
    ],
)
def test_text_that_counts_as_untranslated(text: str, plain: bool) -> None:
    assert is_unmarked(text, StudyTexts("P07")) is plain


def test_a_line_of_a_longer_text_is_recognised_by_its_accents() -> None:
    assert not is_unmarked_fragment("thé röböt îš öût öf réàçh", StudyTexts())
    assert is_unmarked_fragment("the robot is out of reach", StudyTexts())
