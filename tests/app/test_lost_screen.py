"""Messages of Qt in the log, with an adjusted level."""

import logging

import pytest
from PySide6.QtCore import QMessageLogContext, QtMsgType

from caris_desktop.app.qt_application import _on_message


@pytest.mark.parametrize(
    ("message", "level"),
    [
        ('Could not find accessible on path: "/org/a11y/atspi/accessible/2147483981"', logging.DEBUG),
        ("Received text event for invalid interface.", logging.DEBUG),
        ('QSpiApplication::keyEventError  "org.freedesktop.DBus.Error.NoReply"', logging.DEBUG),
        ("QObject::startTimer: Timers cannot be started from another thread", logging.INFO),
    ],
)
def test_qt_warnings_of_a_screen_reader_do_not_fill_the_log(
    caplog: pytest.LogCaptureFixture, message: str, level: int
) -> None:
    kind = QtMsgType.QtInfoMsg if level == logging.INFO else QtMsgType.QtWarningMsg
    with caplog.at_level(logging.DEBUG, logger="qt"):
        _on_message(kind, QMessageLogContext(), message)
    assert [(record.levelno, record.getMessage()) for record in caplog.records] == [(level, message)]
