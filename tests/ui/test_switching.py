"""Switch of the scenario during operation: forbidden controls disappear at once, panels are built one at a time."""

import dataclasses
import itertools
import json
import os
from pathlib import Path

import pytest
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QShortcut
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import AssistantSetup
from caris_desktop.scenario.phrases import PhraseGroup
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import PanelLeaf, PanelName, SplitNode, TabNode, panels_in
from caris_desktop.ui import panel_manager
from caris_desktop.ui.dock_layout import DockLayout
from caris_desktop.ui.event_messages import CATEGORIES
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.panels.assistant_panel import AssistantPanel
from caris_desktop.ui.panels.conversation_panel import ConversationPanel
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.people_panel import PeoplePanel
from caris_desktop.ui.panels.speak_panel import SpeakPanel
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import MemorySettings, open_window
from tests.ui.fake_console import FakeConsole

STRICT = dataclasses.replace(
    samples.TOUR,
    permissions=dataclasses.replace(samples.MENTAL.permissions, driving=False, assistant=False, speech=False),
    path=Path("/layouts/strict.yaml"),
)


ALONE = dataclasses.replace(samples.TOUR, layout=PanelLeaf("map"), path=Path("/layouts/alone.yaml"))
"""Scenario that shares hardly any panel with the others."""


NAMING: tuple[PanelName, ...] = ("video", "map", "conversation", "people")
NAMED = dataclasses.replace(
    samples.TOUR,
    layout=SplitNode("horizontal", tuple(PanelLeaf(name) for name in NAMING), (1.0, 1.0, 1.0, 1.0)),
    path=Path("/layouts/named.yaml"),
)
UNNAMED = dataclasses.replace(
    NAMED,
    permissions=dataclasses.replace(NAMED.permissions, naming_people=False),
    path=Path("/layouts/unnamed.yaml"),
)


GROUPED = dataclasses.replace(
    samples.TOUR,
    phrases=("One.", PhraseGroup("More", ("Two.", "Three."))),
    recording=dataclasses.replace(samples.TOUR.recording, labels=("Laughs", "Leaves")),
    filler="",
    path=Path("/layouts/grouped.yaml"),
)


@pytest.fixture
def alone(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> tuple[MainWindow, FakeConsole]:
    """Window in which hardly any panel has been built yet."""
    console = FakeConsole(ALONE)
    return open_window(qtbot, console, settings, theme), console


def switch(console: FakeConsole, scenario: samples.Scenario) -> None:
    console.scenario = scenario
    console.state.scenario.reset_value(scenario)


def test_forbidden_panels_are_gone_before_the_first_of_the_next_scenario(
    window: MainWindow, console: FakeConsole
) -> None:
    switch(console, STRICT)
    assert {"video", "drive", "speak", "assistant", "conversation"}.isdisjoint(window.board._panels), "nothing of them"
    rows = {spec.id for spec in window.actions_table.all_specs}
    assert rows.isdisjoint({"drive_forward", "phrase_1", "photo", "focus_speak", "suggestion_1"})
    assert {"stop", "emergency_stop"} <= rows, "what stops the robot works all the while"
    assert "Speak" not in {entry.text for entry in window.palette_entries()}


@pytest.mark.parametrize(("turn_s", "fewest"), [(0.0, 12), (60.0, 2)], ids=["slow", "quick"])
@pytest.mark.long
def test_other_things_have_their_turn_between_two_panels_that_are_not_quickly_made(
    alone: tuple[MainWindow, FakeConsole], qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, turn_s: float, fewest: int
) -> None:
    window, console = alone
    monkeypatch.setattr(panel_manager, "TURN_S", turn_s)
    others, made_at = QTimer(interval=1), []
    ticks, turns = itertools.count(), []
    others.timeout.connect(lambda: next(ticks))
    make, before = window.board._make, dict(window.panels)
    build_for_a_turn = window.board._build_for_a_turn

    def noting(name: PanelName) -> Panel:
        made_at.append(next(ticks))
        return make(name)

    def noting_turn() -> None:
        turns.append(next(ticks))
        build_for_a_turn()

    monkeypatch.setattr(window.board, "_make", noting)
    window.board._turn.timeout.disconnect()
    window.board._turn.timeout.connect(noting_turn)
    others.start()
    switch(console, samples.MENTAL)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    others.stop()
    made = [name for name, panel in window.panels.items() if panel is not before.get(name)]
    assert len(made_at) == len(made) >= 3
    # The layout of all panels gets a separate pass, however fast the panels are.
    assert len(turns) >= fewest if turn_s == 0.0 else len(turns) == fewest
    assert all(after - before >= 2 for before, after in itertools.pairwise(turns)), "between any two"


@pytest.mark.long
def test_visible_panels_come_before_hidden_tabs(alone: tuple[MainWindow, FakeConsole], qtbot: QtBot) -> None:
    window, console = alone
    tabs_of = TabNode(("people", "assistant", "session"), "people")
    tabbed = dataclasses.replace(samples.MENTAL, layout=SplitNode("horizontal", (PanelLeaf("video"), tabs_of), (1, 1)))
    every, seen = set(panels_in(tabbed.layout)), {"video", "people"}
    docks, behind = window.dock_host, "assistant"
    arranged: list[tuple[set[str], set[str]]] = []

    def on_arranged() -> None:
        tabs = {name for bar in docks.bars for name in bar.panels}
        arranged.append((set(window.board._panels), tabs))
        if len(arranged) == 1:
            docks.show_panel(behind)

    docks.layout_changed.connect(on_arranged)
    switch(console, tabbed)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    made, tabs = arranged[0]
    assert (seen <= made, behind in made, tabs) == (True, False, set(tabs_of.tabs)), "all tabs, and what is in front"
    assert {type(panel) for panel in window.panels.values()} == {PANELS[name].load() for name in every}
    assert window.panels[behind].isVisible() and window.panels[behind].in_view
    assert {name for name in every if window.panels[name].in_view} == {"video", behind}


@pytest.mark.parametrize("chosen", [samples.TOUR, STRICT], ids=["goes on", "goes"])
@pytest.mark.long
def test_a_panel_that_has_no_room_yet_when_another_scenario_is_chosen_continues_or_goes(
    alone: tuple[MainWindow, FakeConsole], qtbot: QtBot, chosen: samples.Scenario
) -> None:
    window, console = alone
    switch(console, samples.MENTAL)
    window.board._build_next()
    begun = window.board._without_room
    assert begun is not None
    switch(console, chosen)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    shown = {name for name, panel in window.panels.items() if panel.isVisible()}
    assert (begun in window.panels) is (begun in panels_in(chosen.layout))
    assert "map" in shown
    assert {name for name, dock in window.dock_host.docks.items() if dock.isVisible()} == shown
    assert all(window.dock_host.docks[name].panel is panel for name, panel in window.panels.items())


@pytest.mark.long
def test_the_window_may_be_resized_and_tabs_pressed_meanwhile(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    docks = window.dock_host
    for scenario in (STRICT, samples.TOUR, samples.MENTAL):
        switch(console, scenario)
        assert {name for bar in docks.bars for name in bar.panels} <= set(docks.docks), "no tab of what is gone"
        window.resize(window.width() - 40, window.height() - 20)
        docks.retitle()
        qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
        assert set(docks.docks) == {*window.panels, *window.board._aside}


@pytest.mark.long
def test_nothing_turns_any_more_once_all_stand(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    for scenario in (ALONE, samples.MENTAL):
        switch(console, scenario)
        qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
        assert not window.board._turn.isActive()


@pytest.mark.long
def test_hidden_tabs_get_their_room_when_they_are_opened(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    tabs = TabNode(("people", "drive"), "people")
    tabbed = dataclasses.replace(
        ALONE, layout=SplitNode("vertical", (PanelLeaf("map"), tabs), (0.8, 0.2)), path=Path("/layouts/low.yaml")
    )
    console = FakeConsole(ALONE)
    window = open_window(qtbot, console, settings, theme)
    for scenario in (tabbed, ALONE, tabbed):
        switch(console, scenario)
        qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
        docks = window.dock_host
        assert scenario is ALONE or docks.docks["people"].height() >= docks.docks["drive"].least()[1]
        there = {name: dock.geometry() for name, dock in docks.docks.items()}
        docks.lay_out()
        assert there == {name: dock.geometry() for name, dock in docks.docks.items()}


@pytest.mark.long
def test_a_panel_requested_meanwhile_opens(window: MainWindow, console: FakeConsole) -> None:
    switch(console, samples.MENTAL)
    window.open_panel("diagnostics")
    assert window.board.is_open("diagnostics")
    assert set(window.panels) == {*panels_in(samples.MENTAL.layout), "diagnostics"}


def test_the_one_that_was_chosen_last_counts(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    switch(console, samples.MENTAL)
    qtbot.waitUntil(lambda: bool(window.board._panels))
    switch(console, STRICT)
    allowed = {name for name in panels_in(STRICT.layout) if name not in ("drive", "assistant", "speak")}
    qtbot.waitUntil(lambda: window.dock_host.tree is not None, timeout=60_000)
    assert set(window.panels) == allowed
    assert {type(panel) for panel in window.panels.values()} == {PANELS[name].load() for name in allowed}


@pytest.mark.long
def test_a_panel_without_a_place_is_not_seen_and_comes_back_as_a_new_one_would(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    before, drives = dict(window.panels), window.panels["drive"]
    switch(console, ALONE)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    assert set(window.panels) == {"map"}
    assert [name for name, dock in window.dock_host.docks.items() if dock.isVisible()] == ["map"]
    assert not any(panel.in_view for name, panel in before.items() if name != "map")
    assert drives not in window.hold._driving_panels
    window.open_panel("speak")
    assert window.panels["speak"] is before["speak"] and before["speak"].isVisible()
    switch(console, dataclasses.replace(GROUPED, layout=PanelLeaf("speak")))
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    switch(console, GROUPED)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    assert {name: panel for name, panel in before.items() if name in window.panels} == dict(window.panels)
    chips = {chip.text() for chip in window.panels["speak"].findChildren(QAbstractButton) if chip.isVisible()}
    assert "One." in chips and not chips & set(samples.TOUR.phrases)
    window.open_panel("session")
    labels = [chip for chip in window.panels["session"].findChildren(QAbstractButton) if "_label_" in chip.objectName()]
    assert sorted(chip.text() for chip in labels if not chip.isHidden()) == ["Laughs", "Leaves"]


def test_forbidden_panels_are_not_put_aside(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    switch(console, ALONE)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    assert {"speak", "drive"} <= set(window.board._aside)
    switch(console, STRICT)
    assert {"speak", "drive", "assistant"}.isdisjoint({*window.board._panels, *window.board._aside})
    assert {"speak", "drive", "assistant"}.isdisjoint(window.dock_host.docks)


def test_a_window_of_its_own_goes_with_a_panel_that_is_put_aside(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    window.dock_host.float_panel("people")
    floating = window.panels["people"].window()
    assert floating is not window
    assert floating.isVisible()
    switch(console, ALONE)
    qtbot.waitUntil(lambda: window.board.whole, timeout=60_000)
    assert window.dock_host._windows == []
    window.open_panel("people")
    assert window.panels["people"].window() is window and window.panels["people"].isVisible()


@pytest.mark.long
def test_a_panel_that_continues_says_what_a_new_one_would(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    scenarios = [load_scenario(path) for path in sorted(layouts_dir().glob("*.yaml"))]
    console = FakeConsole(scenarios[-1])
    window = open_window(qtbot, console, settings, theme)
    went_on: set[str] = set()
    back = (*reversed(scenarios[:-1]), *scenarios[::2]) if os.environ.get("CARIS_TEST_LONG") else ()
    for scenario in (*scenarios, *back):
        before = dict(window.panels)
        switch(console, scenario)
        kept = {name: panel for name, panel in window.panels.items() if panel is before.get(name)}
        texts = {name: _said(window, name) for name in kept}
        window.show_scenario(scenario)
        anew = {name: _said(window, name) for name in kept}
        assert not any(window.panels[name] is panel for name, panel in kept.items()), "all of them are built anew"
        differ = {name: set(texts[name]) ^ set(anew[name]) for name in kept if texts[name] != anew[name]}
        assert differ == {}, scenario.title
        went_on |= set(kept)
    assert went_on >= {"video", "map", "people", "drive", "conversation", "speak", "assistant", "session", "notes"}


def test_names_disappear_at_once_where_nobody_is_named(window: MainWindow, console: FakeConsole) -> None:
    samples.fill_console(console)
    samples.converse(console)
    samples.refresh_people_in_map(console)

    def named() -> dict[str, bool]:
        window.board.complete()
        video, map_, conversation, people = (window.panels[name] for name in NAMING)
        assert isinstance(video, VideoPanel)
        assert isinstance(map_, MapPanel)
        assert isinstance(conversation, ConversationPanel)
        assert isinstance(people, PeoplePanel)
        views = (
            video.view.visible_detections(),
            map_.view.map_state.people,
            conversation.view.rows,
            people.model.persons,
        )
        return {name: "Luis" in str(words) for name, words in zip(NAMING, views, strict=True)}

    switch(console, NAMED)
    assert named() == dict.fromkeys(NAMING, True)
    before = {name: window.panels[name] for name in NAMING}
    switch(console, UNNAMED)
    assert named() == dict.fromkeys(NAMING, False)
    assert {name: window.panels[name] for name in NAMING} == before, "they go on"
    people = before["people"]
    assert isinstance(people, PeoplePanel)
    assert not people.title_widgets()
    assert not any(people.list.buttons(row) for row in range(3))
    assert not any(shortcut.key().toString() for shortcut in people.findChildren(QShortcut))
    switch(console, NAMED)
    assert named() == dict.fromkeys(NAMING, True)
    assert all(people.list.buttons(row) for row in range(3))
    assert sum(bool(shortcut.key().toString()) for shortcut in people.findChildren(QShortcut)) == 2


def test_phrases_and_labels_do_what_they_say_after_another_scenario(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    for scenario in (GROUPED, samples.TOUR, GROUPED):
        before = {name: window.panels[name] for name in ("speak", "session")}
        switch(console, scenario)
        assert {name: window.panels[name] for name in before} == before
        QTest.qWait(0)
        speak, session = before["speak"], before["session"]
        chips = {chip.objectName(): chip for chip in speak.findChildren(QAbstractButton) if chip.isVisible()}
        chosen = [name for name in chips if name.startswith("phrase_") and "group" not in name]
        of_group = ["One."] if scenario is GROUPED else list(samples.TOUR.phrases)
        assert [chips[f"phrase_{number}"].text() for number in range(1, len(chosen) + 1)] == of_group[:10]
        assert ("filler" in chips) is bool(scenario.filler)
        console.calls.clear()
        chips["phrase_1"].click()
        assert console.named("say_phrase") or console.named("say"), console.calls
        window.open_panel("session")
        labels = [button for button in session.findChildren(QAbstractButton) if "_label_" in button.objectName()]
        there = sorted(button.text() for button in labels if not button.isHidden())
        assert there == sorted(scenario.recording.labels)


def test_words_for_the_model_that_were_being_changed_never_go_into_another_scenario(
    window: MainWindow, console: FakeConsole
) -> None:
    setup = AssistantSetup(system_prompt="You are a guide.")
    console.state.assistant_setup.set(setup)
    panel = window.panels["assistant"]
    assert isinstance(panel, AssistantPanel)
    panel.field.setText("And wh")
    panel.setup_bar.words.click()
    panel._words.field.setPlainText("You are a guide who jokes.")
    console.state.assistant_setup.set(dataclasses.replace(setup, system_prompt="You are a nurse."))
    switch(console, samples.MENTAL)
    window.board.complete()
    assert window.panels["assistant"] is panel and panel.field.isVisible(), "back from the words"
    assert panel.field.text() == "And wh"
    panel.setup_bar.words.click()
    assert panel._words.field.toPlainText() == "You are a nurse." and not panel._words.save.isEnabled()


def test_a_suggestion_that_was_being_changed_is_a_line_like_others_afterwards(
    window: MainWindow, console: FakeConsole
) -> None:
    edited: list[str] = []
    window.panels["speak"].edit_first("It stops.", lambda text: not edited.append(text))
    switch(console, samples.MENTAL)
    window.focus_speak()
    panel = window.panels["speak"]
    assert isinstance(panel, SpeakPanel)
    QTest.keyClick(panel.field, Qt.Key.Key_Return)
    assert (edited, console.named("say")) == ([], [("It stops.", "typed")])


def _said(window: MainWindow, name: PanelName) -> list[tuple[str, ...]]:
    """Readable, audible and clickable content of the panel and its title bar, in front."""
    window.open_panel(name)
    QTest.qWait(0)
    dock = window.dock_host.docks[name]
    found = []
    for part in dock.findChildren(QWidget):
        if part.isVisibleTo(dock) and part.objectName() != "panel_fact":  # contains the time
            text = part.text() if isinstance(part, QAbstractButton | QLabel) else ""
            found.append((type(part).__name__, part.objectName(), text, part.accessibleName(), part.toolTip()))
    return sorted(found)


TOUR_NAME = samples.TOUR.path.stem if samples.TOUR.path else ""


@pytest.fixture
def at_the_start(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> tuple[MainWindow, FakeConsole]:
    """Window that was not shown yet, without its hidden panels."""
    settings.setValue("wizards/*/layout/adapts", "no")
    settings.setValue(f"wizards/*/choices/{TOUR_NAME}/panels/session", json.dumps({"category": CATEGORIES[0]}))
    console = FakeConsole(samples.TOUR)
    window = MainWindow(console, settings=settings, theme=theme, all_panels=False)
    window.preferences.begin()
    qtbot.addWidget(window)
    console.state.close()
    return window, console


def behind_in(window: MainWindow) -> set[PanelName]:
    return set(panels_in(samples.TOUR.layout)) - set(window.board.made_so_far)


def test_the_first_window_waits_only_for_the_panels_that_it_shows(
    at_the_start: tuple[MainWindow, FakeConsole], qtbot: QtBot
) -> None:
    window, _console = at_the_start
    seen = {name for name in window.board.made_so_far if window.dock_host.is_open(name)}
    assert seen and behind_in(window)
    assert all(window.board.made_so_far[name].parent() is not None for name in seen)
    window.show()
    assert behind_in(window), "those behind them come once it was painted"
    qtbot.waitUntil(lambda: window.board.whole)
    assert behind_in(window) == set()
    assert window.panels["session"].choices() == {"category": CATEGORIES[0]}, "as the wizard had it last time"


def test_another_layout_before_all_are_made_leaves_out_what_lies_behind_in_it_too(
    at_the_start: tuple[MainWindow, FakeConsole], qtbot: QtBot
) -> None:
    window, _console = at_the_start
    behind = behind_in(window)
    arrangement = window.dock_host.arrangement
    assert arrangement is not None
    window.board.show(arrangement)
    assert behind_in(window) == behind
    front = next(iter(behind))
    window.board.show(DockLayout(PanelLeaf(front)))
    assert front in window.board.made_so_far
    assert window.board.whole
    window.board.show(arrangement)
    assert behind_in(window) == set(), "what is asked for now is made now"


def test_a_panel_requested_early_opens_as_it_was_left(
    at_the_start: tuple[MainWindow, FakeConsole],
) -> None:
    window, _console = at_the_start
    behind = next(iter(behind_in(window)))
    window.open_panel(behind)
    assert behind_in(window) == set()
    assert window.board.panels[behind].isVisibleTo(window)
    assert window.board.panels["session"].choices() == {"category": CATEGORIES[0]}
