"""Rate of panel updates."""

import time

from PySide6.QtCore import QTimer
from pytestqt.qtbot import QtBot

from caris_desktop.live.bus import MOST_REST_S, UNHURRIED_S, UiThrottle, rest_after


def test_only_a_slow_pass_is_followed_by_a_rest() -> None:
    assert rest_after(UNHURRIED_S) == 0.0
    assert rest_after(0.05) == 0.1
    assert rest_after(3.0) == MOST_REST_S


def test_waiting_values_come_last_and_timers_run_meanwhile(qtbot: QtBot) -> None:
    pace, order = UiThrottle(), []
    pace.due.connect(lambda: order.append("due"))
    assert pace.may_begin()
    time.sleep(0.06)  # a slow pass
    assert not pace.may_begin()
    QTimer.singleShot(40, lambda: order.append("timer"))
    qtbot.waitUntil(lambda: "due" in order, timeout=5000)
    assert order == ["timer", "due"]
    assert pace.may_begin()


def test_passes_can_be_held_to_a_rate_and_let_go_again(qtbot: QtBot) -> None:
    pace, due = UiThrottle(), []
    pace.due.connect(lambda: due.append(time.monotonic()) if pace.may_begin() else None)
    pace.at_most_every(panels_s=0.15, picture_s=0.15)
    begun_s = time.monotonic()
    assert pace.may_begin()
    assert not pace.may_begin()
    qtbot.waitUntil(lambda: bool(due), timeout=5000)
    assert due[0] - begun_s >= 0.14, "a timer may be late, never as early as without"
    pace.at_most_every(panels_s=0.0, picture_s=0.0)
    qtbot.waitUntil(lambda: bool(pace.may_begin()), timeout=5000)


def test_the_panels_are_held_back_before_the_picture(qtbot: QtBot) -> None:
    pace, passed = UiThrottle(), []
    pace.due.connect(lambda: passed.append(pace.may_begin(("panels",))))
    pace.at_most_every(panels_s=0.15, picture_s=0.0)
    assert pace.may_begin() == {"panels", "picture"}
    begun_s = time.monotonic()
    qtbot.waitUntil(lambda: pace.may_begin() == {"picture"}, timeout=5000)
    qtbot.waitUntil(lambda: {"panels"} in passed, timeout=5000)
    assert time.monotonic() - begun_s >= 0.14


def test_both_are_held_back_for_a_time_and_come_then(qtbot: QtBot) -> None:
    pace, due = UiThrottle(), []
    pace.due.connect(lambda: due.append(time.monotonic()) if pace.may_begin() else None)
    pace.at_most_every(panels_s=0.05, picture_s=0.0)
    began_s = time.monotonic()
    pace.hold_back(0.15)
    assert not pace.may_begin()
    qtbot.waitUntil(lambda: bool(due), timeout=5000)
    assert due[0] - began_s >= 0.15


def test_no_pass_begins_once_it_has_ended(qtbot: QtBot) -> None:
    pace, due = UiThrottle(), []
    pace.due.connect(lambda: due.append("due"))
    pace.at_most_every(panels_s=0.01, picture_s=0.01)
    assert pace.may_begin()
    assert not pace.may_begin()
    pace.end()
    qtbot.wait(30)
    assert not due
    assert not pace.may_begin()
