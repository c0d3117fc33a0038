"""Elements hidden in narrow spaces: their order, and access to their content."""

import itertools

import pytest
from PySide6.QtWidgets import QApplication

from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel
from tests.support.window_check import painted_by
from tests.ui.conftest import find


def _wide(window: MainWindow, width_px: int) -> None:
    window.status_bar.setFixedWidth(width_px)
    for _ in range(5):
        QApplication.processEvents()
    window.status_bar.refresh()


def test_items_left_out_of_the_status_bar_are_in_its_tip(window: MainWindow) -> None:
    items = window.status_bar.items
    _wide(window, 1366)
    disk, recording = items["disk"].text, items["recording"].text
    assert disk and not items["disk"].isHidden() and disk not in window.status_bar.toolTip()
    _wide(window, 480)
    assert items["disk"].isHidden() and disk in window.status_bar.toolTip()
    assert disk in window.status_bar.accessibleDescription()
    assert items["recording"].text == recording and items["recording"].width() == items["recording"].full_px
    shown = sorted((item for item in items.values() if item.isVisible()), key=lambda item: item.x())
    assert all(one.geometry().right() < other.x() for one, other in itertools.pairwise(shown))


@pytest.mark.panels("video")
def test_a_button_loses_its_words_before_the_title_is_cut(window: MainWindow) -> None:
    bar = window.dock_host.docks["video"].titleBarWidget()
    photo, title = find(window, "photo_button"), bar.findChild(ElidedLabel)
    assert isinstance(photo, ActionButton) and title is not None
    for width_px, words, whole in ((600, True, True), (260, False, True), (150, False, False)):
        bar.setFixedWidth(width_px)
        for _ in range(5):
            QApplication.processEvents()
        assert (photo.width() >= photo.sizeHint().width()) is words, width_px
        painted = [text.text for text in painted_by(title)]
        assert (painted == [title.text()]) is whole, (width_px, painted)
        assert (title.text() in bar.toolTip()) is not whole
    assert photo.toolTip() and photo.accessibleName()
