"""Dock area of a window: the displayed layout matches the model."""

import json
import random

import pytest
from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, Qt
from PySide6.QtGui import QEnterEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMenu, QPlainTextEdit, QScrollArea, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.scenario.scenario_model import PanelLeaf, PanelName, TabNode, panels_in
from caris_desktop.ui.dock_area import Dock
from caris_desktop.ui.dock_geometry import GroupPlace, place
from caris_desktop.ui.dock_host import RESIZE_PX, DockHost
from caris_desktop.ui.dock_layout import DockLayout, arrangement_data, arrangement_from, arrangement_of, float_panel
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui import samples
from tests.ui.layout.edits import KINDS, edited
from tests.ui.layout.lying import Placed, shown_in
from tests.ui.test_quit_guard import AskedByTheWindowManager

PLACE = QRect(60, 80, 420, 300)


@pytest.fixture
def host(window: MainWindow) -> DockHost:
    window.resize(1900, 1050)
    QApplication.processEvents()
    return window.dock_host


def arranged(host: DockHost) -> DockLayout:
    assert host.arrangement is not None
    return host.arrangement


def placed(group: GroupPlace) -> Placed:
    rect = group.rect
    node = TabNode(group.panels, group.current) if group.tabbed else PanelLeaf(group.current)
    return Placed(node, rect.left(), rect.top(), rect.right(), rect.bottom())


def check(host: DockHost) -> None:
    """Assert that docked and floating panels match the layout."""
    arrangement = arranged(host)
    room = QRect(0, 0, host.width(), host.height())
    said = place(arrangement.tree, room, arrangement.docked, lambda name: host.docks[name].least())
    # Compare rectangles, as two trees describe four panels that meet in one point.
    expected = [placed(group) for group in said.groups]
    assert shown_in(host) == sorted(expected, key=str)
    for window in arrangement.floating:
        for name in set(panels_in(window.tree)) - arrangement.hidden:
            assert host.docks[name].window() is not host.window()
    for name in arrangement.hidden:
        assert not host.docks[name].isVisible()


@pytest.mark.long
def test_random_edits_are_seen_undone_and_brought_back(
    window: MainWindow, host: DockHost, pytestconfig: pytest.Config
) -> None:
    """25 edits in the real window; 500 with --long."""
    made = random.Random(7)  # noqa: S311
    keeper = window.layout_keeper
    seen = [arranged(host)]
    count = 500 if pytestconfig.getoption("--long") else 25
    while len(seen) <= count:
        kind = made.choice([kind for kind in KINDS if kind not in ("select", "place", "add", "remove")])
        edit = (kind, made.randrange(100), made.randrange(100), made.randrange(5), made.randrange(-600, 1200))
        if host.edit(kind, edited(arranged(host), edit, [])):
            check(host)
            seen.append(arranged(host))
            if len(seen) % 5 == 0:
                loaded = arrangement_from(json.loads(json.dumps(arrangement_data(arranged(host)))))
                window.board.show(loaded)
                assert arranged(host) == seen[-1]
                check(host)
    steps = min(count, 200)  # limit of the undo history
    for expected in list(reversed(seen))[1 : steps + 1]:
        keeper.undo()
        assert arranged(host) == expected
    check(host)


def test_a_panel_keeps_what_it_has_wherever_it_goes(window: MainWindow, host: DockHost) -> None:
    panel = window.panels["speak"]
    field = panel.findChild(QPlainTextEdit, "speak_field")
    assert isinstance(field, QPlainTextEdit)
    field.setFocus()
    QTest.keyClicks(field, "half a sent")
    host.float_panel("speak", PLACE)
    host.move_panel("map", "speak", "tab")
    host.dock_panel("speak")
    host.move_panel("speak", "video", "left")
    assert window.panels["speak"] is panel
    assert field.toPlainText() == "half a sent"
    field.clear()


def test_a_layout_of_two_screens_opens_on_one_and_goes_back_to_both(
    window: MainWindow, host: DockHost, qtbot: QtBot
) -> None:
    left, right = QRect(0, 0, 1920, 1080), QRect(1920, 0, 2560, 1440)
    on_right = QRect(2500, 300, 900, 700)
    host.screens = lambda: (left, right)
    window.board.show(float_panel(arrangement_of(samples.TOUR_LAYOUT), "map", on_right))
    own = host.docks["map"].window()
    assert own.geometry().topLeft() == QPoint(2500, 300)
    host.screens = lambda: (left,)
    host.show_everything()
    place = own.geometry()
    assert place.right() < 1920 and place.bottom() < 1080 and place.size().width() == 900
    assert arranged(host).floating[0].place == on_right, "the second screen may be back tomorrow"
    host.screens = lambda: (left, right)
    host.show_everything()
    assert own.geometry().topLeft() == QPoint(2500, 300)


def test_closing_a_window_of_its_own_loses_no_panel(host: DockHost) -> None:
    before = arranged(host)
    host.float_panel("map", PLACE)
    host.move_panel("people", "map", "below")
    own = host.docks["map"].window()
    assert own is host.docks["people"].window()
    own.closeEvent(AskedByTheWindowManager())
    assert arranged(host).floating == ()
    assert set(arranged(host).docked) == set(before.docked)
    check(host)


def test_a_handle_shares_the_room_again(host: DockHost, qtbot: QtBot) -> None:
    video = host.docks["video"].width()
    handle = next(handle for handle in host.findChildren(QWidget, "split_handle") if handle.height() > handle.width())
    told: list[str] = []
    host.edited.connect(lambda what, _before: told.append(what))
    QTest.mousePress(handle, Qt.MouseButton.LeftButton, pos=QPoint(4, 50))
    at = handle.mapToGlobal(QPoint(4, 50))
    for step in (40, 90):  # the handle moves too
        QTest.mouseMove(handle, handle.mapFromGlobal(at + QPoint(step, 0)))
    QTest.mouseRelease(handle, Qt.MouseButton.LeftButton, pos=handle.mapFromGlobal(at + QPoint(90, 0)))
    assert host.docks["video"].width() == pytest.approx(video + 90, abs=3)
    assert told == ["Resize panels"], "once, not with every pixel"


def test_the_menu_of_a_title_moves_and_floats_by_keys_too(host: DockHost) -> None:
    menu = QMenu(host)
    host.fill_menu(menu, "map")
    texts = [action.text() for action in menu.actions()]
    assert texts[0] == "Open in a separate window"
    into = next(action for action in menu.actions() if action.text() == "As a tab with")
    video = next(action for action in into.menu().actions() if action.text() == "Video")  # type: ignore[union-attr]
    video.trigger()
    group = host.placing.group_of("map")
    assert group is not None and group.panels == ("video", "map")
    menu.actions()[0].trigger()
    assert "map" in arranged(host).afloat


def test_a_panel_gets_larger_and_smaller_by_keys(window: MainWindow, host: DockHost) -> None:
    def press(panel: PanelName, words: str) -> bool:
        menu = QMenu()
        host.fill_menu(menu, panel)
        action = next(action for action in menu.actions() if action.text() == words)
        possible = action.isEnabled()
        action.trigger()
        return possible

    before, map_px, video_px = arranged(host), host.docks["map"].height(), host.docks["video"].height()
    assert press("map", "Larger")
    assert host.docks["map"].height() == map_px + RESIZE_PX and host.docks["video"].height() == video_px
    # Its column is the nearest split; the outer one follows once the column reaches its limit.
    while press("people", "Smaller"):
        check(host)
    column: tuple[PanelName, ...] = ("map", "drive", "assistant", "session", "people")
    assert host.docks["people"].width() == max(host.docks[name].least()[0] for name in column)
    assert host.docks["people"].height() == host.docks["people"].least()[1]
    larger = {entry.text: entry for entry in window.palette_entries()}
    assert "People: smaller" not in larger, "there is no room for that"
    height_px = host.docks["people"].height()
    larger["People: larger"].do()
    assert host.docks["people"].height() == height_px + RESIZE_PX
    while arranged(host) != before:
        window.layout_keeper.undo()
    assert host.docks["map"].height() == map_px


def test_a_locked_panel_keeps_its_size(window: MainWindow, host: DockHost) -> None:
    refused, before = list[str](), arranged(host)
    host.refused.connect(refused.append)
    window.layout_keeper.set_locked(True)
    menu = QMenu()
    host.fill_menu(menu, "map")
    assert not [action for action in menu.actions() if action.text() in ("Larger", "Smaller") and action.isEnabled()]
    assert not [entry.text for entry in window.palette_entries() if entry.text == "Map: larger"]
    host.resize_panel("map", RESIZE_PX)
    assert arranged(host) == before and len(refused) == 1


def test_what_a_panel_that_is_too_small_cuts_off_can_be_scrolled_to(window: MainWindow, host: DockHost) -> None:
    window.resize(1000, 420)
    QApplication.processEvents()
    cut = 0
    for name, dock in host.docks.items():
        panel, scroll = window.panels[name], dock.findChild(QScrollArea, "panel_scroll")
        if not dock.isVisible() or scroll.viewport().rect().contains(panel.geometry()):
            continue
        cut += 1
        assert panel.height() >= panel.minimumSizeHint().height(), "it keeps the room that it needs"
        corner = panel.rect().bottomRight()
        scroll.ensureVisible(corner.x(), corner.y(), 1, 1)
        assert scroll.viewport().rect().contains(panel.mapToParent(corner)), name
        assert scroll.focusPolicy() is Qt.FocusPolicy.NoFocus
    assert cut, "so little room is not enough for all"


def test_tab_scrolls_to_what_it_reaches(window: MainWindow, host: DockHost) -> None:
    window.resize(1000, 420)
    QApplication.processEvents()
    panel, reached = window.panels["speak"], 0
    panel.focus_target().setFocus()
    for _ in range(20):
        focused = QApplication.focusWidget()
        assert focused is not None
        if panel.isAncestorOf(focused):
            reached += 1
            assert not focused.visibleRegion().isEmpty(), focused.objectName()
        QTest.keyClick(focused, Qt.Key.Key_Tab)
    assert reached > 2


def test_every_panel_has_its_button_to_float(host: DockHost) -> None:
    for name, dock in host.docks.items():
        button = dock.findChild(QWidget, "float_button")
        assert button is not None
        assert button.accessibleName().endswith("Open in a separate window"), name
    assert isinstance(host.docks["map"], Dock)
    assert set(PANELS) >= set(host.docks)


def test_a_locked_window_of_its_own_goes_back_to_its_place(window: MainWindow, host: DockHost) -> None:
    host.float_panel("map", PLACE)
    own = host.docks["map"].window()
    window.layout_keeper.set_locked(True)
    told: list[str] = []
    host.refused.connect(told.append)
    own.setGeometry(300, 200, PLACE.width(), PLACE.height())
    own._notify()  # type: ignore[attr-defined]
    assert own.geometry().topLeft() == PLACE.topLeft()
    assert len(told) == 1
    window.layout_keeper.set_locked(False)
    own.setGeometry(300, 200, PLACE.width(), PLACE.height())
    own._notify()  # type: ignore[attr-defined]
    assert arranged(host).floating[0].place == QRect(300, 200, PLACE.width(), PLACE.height())


def test_tabs_that_do_not_fit_stand_in_a_list(window: MainWindow, host: DockHost, qtbot: QtBot) -> None:
    for name in ("map", "drive", "people", "session", "speak"):
        host.move_panel(name, "assistant", "tab")
    host.move_panel("video", "assistant", "left")
    window.resize(800, 700)
    QApplication.processEvents()
    (bar,) = host.bars
    seen = [index for index in range(bar.count()) if bar.isTabVisible(index)]
    assert bar.currentIndex() in seen and len(seen) < bar.count()
    more = bar.findChild(QWidget, "more_tabs")
    assert more is not None and more.isVisible()
    assert [bar.tabRect(index) for index in seen if bar.tabRect(index).right() > more.x()] == [], "whole tabs only"
    for index in set(range(bar.count())) - set(seen):
        assert bar.tabText(index) in more.accessibleName()
    listed = next(index for index in range(bar.count()) if index not in seen)
    panel = bar.panels[listed]
    qtbot.mouseClick(more, Qt.MouseButton.LeftButton)
    menu = bar.findChild(QMenu, "more_tabs_menu")
    assert isinstance(menu, QMenu)
    menu.actions()[0].trigger()
    menu.close()
    assert host.docks[panel].isVisible()
    assert host.bars[0].isTabVisible(listed), "what is chosen has its tab"


def _hover(dock: Dock, *, over: bool) -> None:
    at = QPointF(5, 5)
    QApplication.sendEvent(dock, QEnterEvent(at, at, at) if over else QEvent(QEvent.Type.Leave))


def test_buttons_to_arrange_a_panel_appear_under_the_pointer_and_when_tab_reaches_them(
    window: MainWindow, host: DockHost
) -> None:
    for name in ("video", "speak"):
        dock = host.docks[name]
        button = dock.findChild(ActionButton, "float_button")
        assert button is not None and not button.is_seen
        place = button.geometry()
        blank = button.grab().toImage()
        _hover(dock, over=True)
        assert button.is_seen and button.grab().toImage() != blank
        _hover(dock, over=False)
        assert not button.is_seen
        button.setFocus(Qt.FocusReason.TabFocusReason)
        assert button.is_seen and button.geometry() == place, "nothing moves for it"
        window.setFocus()
        assert not button.is_seen


def test_the_picture_has_no_title_bar_and_is_moved_floated_and_closed_by_its_handle(
    qtbot: QtBot, window: MainWindow, host: DockHost
) -> None:
    dock = host.docks["video"]
    handle, view = dock.findChild(ActionButton, "panel_handle"), window.panels["video"].focus_target()
    assert handle is not None and view.mapTo(dock, QPoint()) == QPoint(), "the picture reaches the upper edge"
    for keys in (True, False):
        if keys:
            handle.setFocus(Qt.FocusReason.TabFocusReason)
            QTest.keyClick(handle, Qt.Key.Key_Space)
        else:
            qtbot.mouseClick(handle, Qt.MouseButton.LeftButton)
        menu = host.findChild(QMenu, "panel_menu")
        assert menu is not None and menu.isVisible()
        texts = [action.text() for action in menu.actions()]
        assert {"Open in a separate window", "Close this panel", "Left of"} <= set(texts)
        menu.close()
        QApplication.sendPostedEvents(menu, QEvent.Type.DeferredDelete)
        QApplication.processEvents()
    assert not dock.floating
    middle, target = handle.rect().center(), host.docks["speak"]
    QTest.mousePress(handle, Qt.MouseButton.LeftButton, pos=middle)
    below = handle.mapFromGlobal(target.mapToGlobal(QPoint(target.width() // 2, target.height() - 4)))
    QTest.mouseMove(handle, middle + QPoint(40, 40))
    QTest.mouseRelease(handle, Qt.MouseButton.LeftButton, pos=below)
    assert dock.y() > target.y(), "dragged below Speak"
    host.float_panel("video", PLACE)
    assert dock.floating and view.mapTo(dock, QPoint()) == QPoint()
    host.dock_panel("video")
    host.close_panel("video")
    assert not dock.isVisible()
