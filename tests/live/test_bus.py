"""Values queued for the GUI thread reach the panels, each at its rate."""

from collections.abc import Collection
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain.sensing import BatteryState, FrameRef
from caris_desktop.domain.streams import ShownAs
from caris_desktop.live.bus import Bus, Mailbox
from caris_desktop.live.state import LiveState

PICTURE = FrameRef(1, None, "front", "ring", 0, 1, 4, 3)


def test_panels_that_are_held_back_hold_no_picture_and_get_the_newest_in_the_end(qtbot: QtBot) -> None:
    state = LiveState()
    bus = Bus(state)
    bus.pass_at_most_every(panels_s=0.6, picture_s=0.0)
    bus.publish(BatteryState(1, 0.1))
    qtbot.waitUntil(lambda: state.battery.value is not None, timeout=5000)
    bus.publish(BatteryState(2, 0.2))
    bus.publish(PICTURE)
    qtbot.waitUntil(lambda: state.frame.value == PICTURE, timeout=5000)
    assert state.battery.value == BatteryState(1, 0.1), "the panels pay before the picture"
    bus.publish(BatteryState(3, 0.3))
    qtbot.waitUntil(lambda: state.battery.value == BatteryState(3, 0.3), timeout=5000)
    assert state.battery.arrivals == 2
    bus.end()
    state.close()


def test_values_that_arrive_while_others_are_processed_are_not_left(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = LiveState()
    bus = Bus(state)
    drain = Mailbox.drain

    def drain_late(mailbox: Mailbox, display_name: Collection[ShownAs]) -> tuple[list[Any], list[Any]]:
        if state.battery.value is None:
            mailbox.put(BatteryState(1, 0.1))
        return drain(mailbox, display_name)

    monkeypatch.setattr(Mailbox, "drain", drain_late)
    bus.publish(PICTURE)
    qtbot.waitUntil(lambda: state.battery.value == BatteryState(1, 0.1), timeout=5000)
    bus.end()
    state.close()
