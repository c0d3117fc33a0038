"""Detection of parts that are windows for a moment."""

from collections.abc import Callable

import pytest
from PySide6.QtWidgets import QComboBox, QDialog, QLabel, QWidget
from pytestqt.qtbot import QtBot

from tests.ui.conftest import take_parts_shown_early


class _Own(QDialog):
    def setVisible(self, visible: bool) -> None:
        super().setVisible(visible)


@pytest.mark.parametrize("kind", [QWidget, QLabel, QComboBox, QDialog, _Own])
@pytest.mark.parametrize("show", [lambda part: part.show(), lambda part: part.setVisible(True)])
def test_a_part_that_is_shown_before_it_has_a_parent_is_found(
    qtbot: QtBot, kind: type[QWidget], show: Callable[[QWidget], None]
) -> None:
    window, part = QWidget(), kind()
    qtbot.addWidget(window)
    part.setObjectName("early")
    show(part)
    part.setParent(window)
    assert take_parts_shown_early() == [f"{kind.__name__} 'early'"]


def test_nothing_else_is_found(qtbot: QtBot) -> None:
    window, hidden, late = QWidget(), QLabel(), QLabel()
    qtbot.addWidget(window)
    hidden.setVisible(False)
    hidden.setParent(window)
    late.setParent(window)
    window.show()
    late.show()
    hidden.show()
    assert hidden.isVisible() and late.isVisible()
    assert take_parts_shown_early() == []
