"""Elements hidden in narrow spaces: their order, and access to their content."""

import itertools

import pytest
from PySide6.QtCore import QEvent, QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.status_bar import StatusBar
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel
from tests.support.window_check import painted_by
from tests.ui.conftest import find


def _wide(window: MainWindow, width_px: int) -> None:
    window.status_bar.setFixedWidth(width_px)
    for _ in range(5):
        QApplication.processEvents()
    window.status_bar.refresh()


def test_items_left_out_of_the_status_bar_are_in_its_tip(window: MainWindow) -> None:
    bar, items = window.status_bar, window.status_bar.items
    _wide(window, 1366)
    shown = {name for name, item in items.items() if item.isVisible()}
    assert shown <= {"link", "battery", "microphone"}, "what is as it should be takes no room"
    for name in ("disk", "recording", "video", "lidar", "round_trip", "models"):
        assert items[name].text and items[name].text in bar.toolTip()
        assert items[name].text in bar.accessibleDescription()
    battery = items["battery"].text
    assert battery and battery not in bar.toolTip()
    _wide(window, 400)
    assert items["battery"].isHidden() and battery in bar.toolTip()
    visible = sorted((item for item in items.values() if item.isVisible()), key=lambda item: item.x())
    assert all(one.geometry().right() < other.x() for one, other in itertools.pairwise(visible))


@pytest.mark.panels("speak")
def test_the_battery_without_room_is_not_shown_for_a_moment(window: MainWindow) -> None:
    bar = find(window, "status_bar")
    assert isinstance(bar, StatusBar)
    battery = bar.items["battery"]
    _wide(window, 640)
    assert battery.isHidden()
    shown: list[QEvent.Type] = []

    class Watch(QObject):
        def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
            shown.append(event.type())
            return False

    watch = Watch()
    battery.installEventFilter(watch)
    bar.refresh()
    QApplication.processEvents()
    assert QEvent.Type.Show not in shown


def test_a_button_loses_its_words_before_the_title_is_cut(window: MainWindow) -> None:
    bar = window.dock_host.docks["speak"].title_bar
    button, title = find(window, "silence_button"), bar.findChild(ElidedLabel)
    assert isinstance(button, ActionButton) and title is not None
    for width_px, words, whole in ((600, True, True), (260, False, True), (150, False, False)):
        bar.setFixedWidth(width_px)
        for _ in range(5):
            QApplication.processEvents()
        assert (button.width() >= button.sizeHint().width()) is words, width_px
        painted = [text.text for text in painted_by(title)]
        assert (painted == [title.text()]) is whole, (width_px, painted)
        assert (title.text() in bar.toolTip()) is not whole
    assert button.toolTip() and button.accessibleName()
