"""Flow layout: sizes are cached until an item changes."""

import pytest
from PySide6.QtCore import QRect, QSize
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.ui.widgets.containers import FlowLayout, FlowRow


class Item(QWidget):
    """Item of variable size."""

    def __init__(self, width_px: int) -> None:
        super().__init__()
        self.size_px = QSize(width_px, 20)

    def sizeHint(self) -> QSize:
        return self.size_px

    def grow_to(self, width_px: int) -> None:
        self.size_px = QSize(width_px, 20)
        self.updateGeometry()


def test_the_height_follows_every_change_and_is_worked_out_once_for_each_width(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrange, arranged = FlowLayout._arrange, []

    def noting(layout: FlowLayout, rect: QRect, *, move: bool) -> int:
        arranged.append(rect.width())
        return arrange(layout, rect, move=move)

    monkeypatch.setattr(FlowLayout, "_arrange", noting)
    row = FlowRow(gap_px=10)
    qtbot.addWidget(row)
    items = [Item(100), Item(100), Item(100)]
    for item in items:
        row.add(item)
    row.show()
    assert (row.heightForWidth(320), row.heightForWidth(220), row.heightForWidth(100)) == (20, 50, 80)
    arranged.clear()
    for _ in range(50):
        assert (row.heightForWidth(320), row.heightForWidth(220)) == (20, 50)
    assert arranged == []
    items[0].grow_to(200)
    assert row.heightForWidth(320) == 50
    items[1].hide()
    assert row.heightForWidth(320) == 20
    items[1].show()
    assert row.heightForWidth(320) == 50
    row.set_gap(30)
    assert row.heightForWidth(320) == 70
    row.remove(items[0])
    assert row.heightForWidth(320) == 20
    row.add(Item(100))
    qtbot.waitUntil(lambda: row.heightForWidth(320) == 70)
    items[1].setMinimumWidth(150)
    assert row.minimumSizeHint().width() == 150
