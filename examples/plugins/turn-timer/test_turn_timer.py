"""The panel keeps the contract of the program."""

from caris_turn_timer import TurnTimer

from caris_desktop.app.plugin_contracts import check_panel
from caris_desktop.domain.events import UtteranceChanged


def test_it_keeps_the_contract(qtbot):
    started = UtteranceChanged(0, "1", "robot", "Hello.", "typed", "started")
    check_panel(TurnTimer, started, UtteranceChanged(1, "1", "robot", "Hello.", "typed", "finished"))
