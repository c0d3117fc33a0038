"""Marking of the selected person in every view."""

import numpy as np
from PySide6.QtCore import QRect
from PySide6.QtGui import QImage

from caris_desktop.domain import clock
from caris_desktop.domain.events import PeopleMerged, PersonForgotten, PersonIdentified, PersonRejected
from caris_desktop.domain.sensing import PeopleInMap, PersonPlace
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.video_panel import VideoPanel
from tests.ui import samples
from tests.ui.fake_console import FakeConsole


def changed(before: QImage, after: QImage, area: QRect) -> int:
    return sum(
        before.pixel(x, y) != after.pixel(x, y)
        for x in range(area.left(), area.right())
        for y in range(area.top(), area.bottom())
    )


def test_the_box_of_who_is_selected_is_marked_and_no_other(window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    frame = console.frames.add(np.zeros((480, 640, 3), np.uint8))
    console.state.add(frame)
    boxes = [(60.0, 100.0, 120.0, 300.0), (400.0, 100.0, 120.0, 300.0)]
    console.state.add(samples.people_for(frame.sequence, 640, 480, boxes))
    before = panel.view.grab().toImage()
    console.state.selected_person.set("p2")
    after = panel.view.grab().toImage()
    middle = round(panel.view.picture_rect().center().x())
    left, right = QRect(0, 0, middle, before.height()), QRect(middle, 0, before.width() - middle, before.height())
    assert changed(before, after, right) > 1000
    assert changed(before, after, left) == 0
    console.state.selected_person.set("")
    assert panel.view.grab().toImage() == before


def test_the_dot_of_who_is_selected_is_ringed_on_the_map(window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    places = (PersonPlace("p1", 3.0, 2.0, 0.1, "lidar"), PersonPlace("p2", 6.0, 2.0, 0.1, "lidar"))
    console.state.add(PeopleInMap(clock.now_ns(), places))
    before = panel.view.grab().toImage()
    console.state.selected_person.set("p2")
    after = panel.view.grab().toImage()

    def around(x_m: float) -> QRect:
        spot = panel.view.to_view(x_m, 2.0).toPoint()
        return QRect(spot.x() - 14, spot.y() - 14, 28, 28)

    assert changed(before, after, around(6.0)) > 30
    assert changed(before, after, around(3.0)) == 0


def test_the_wizard_means_who_stands_there_when_it_turns_out_who_that_is(console: FakeConsole) -> None:
    state = console.state
    state.selected_person.set("p-3")
    state.add(PersonIdentified(1, "p-3", "p-mara", "console", 0.97))
    assert state.selected_person.value == "p-mara"
    state.add(PersonIdentified(1, "p-7", "p-ana", "console", 0.97))
    assert state.selected_person.value == "p-mara", "that was about somebody else"
    state.add(PersonRejected(2, "p-3", "p-mara"))
    assert state.selected_person.value == "p-3"
    state.add(PeopleMerged(3, "p-3", "p-ana"))
    assert state.selected_person.value == "p-ana"
    state.add(PersonForgotten(4, "p-ana"))
    assert state.selected_person.value == ""
