"""Protocol run with times set by the tests."""

import pytest

from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.events import PlannedStep, ProtocolEnded, ProtocolOpened, StepEntered, StepTicked
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.services.protocol_service import ProtocolRun
from caris_desktop.scenario.protocol_steps import Branch, ProtocolStep

STEPS = (
    ProtocolStep("Greet", minutes=1.0, tick=("Consent", "Coat")),
    ProtocolStep("Ask", minutes=0.5, branches=(Branch("Cries", "Close"), Branch("Laughs", "greet"))),
    ProtocolStep("Show"),
    ProtocolStep("Close"),
)
OTHER = "wizard:b"


def at(seconds: float) -> int:
    return round(seconds * 1e9)


@pytest.fixture
def walk() -> ProtocolRun:
    walk = ProtocolRun(STEPS)
    walk.start(at(0), WIZARD)
    return walk


def test_before_the_first_step_the_next_one_is_the_first() -> None:
    walk = ProtocolRun(STEPS)
    status = walk.status()
    assert (status.step_id, status.number, status.steps, status.next_title, status.elapsed_s(at(9))) == (
        "", 0, 4, "Greet", 0.0,
    )  # fmt: skip
    assert walk.next(at(1), OTHER) == StepEntered(at(1), "greet", "Greet", 1, "started", actor=OTHER)


def test_from_step_to_step_to_the_end_and_back(walk: ProtocolRun) -> None:
    assert walk.next(at(10), WIZARD) == StepEntered(at(10), "ask", "Ask", 2, "next", "greet", actor=WIZARD)
    status = walk.status()
    assert (status.title, status.number, status.next_title, status.done) == ("Ask", 2, "Show", ("greet",))
    assert walk.skip(at(20), OTHER) == StepEntered(at(20), "show", "Show", 3, "skipped", "ask", actor=OTHER)
    assert walk.status().skipped == ("ask",)
    walk.next(at(30), WIZARD)
    assert walk.status().next_title == ""
    assert walk.next(at(40), WIZARD) == ProtocolEnded(at(40), "close", actor=WIZARD)
    status = walk.status()
    assert (status.ended, status.step_id) == (True, "")
    assert (status.done, status.skipped) == (("greet", "show", "close"), ("ask",))
    with pytest.raises(UserFacingError, match="The protocol has ended"):
        walk.next(at(41), WIZARD)
    assert walk.back(at(42), WIZARD) == StepEntered(at(42), "close", "Close", 4, "back", "", actor=WIZARD)
    assert not walk.status().ended
    assert walk.skip(at(43), WIZARD) == ProtocolEnded(at(43), "close", skipped=True, actor=WIZARD)


def test_it_is_late_once_it_takes_longer_than_expected(walk: ProtocolRun) -> None:
    status = walk.status()
    assert [(status.elapsed_s(at(s)), status.late_s(at(s))) for s in (0, 60, 140)] == [(0, 0), (60, 0), (140, 80)]
    walk.next(at(140), WIZARD)
    walk.next(at(150), WIZARD)
    assert walk.status().late_s(at(9999)) == 0.0, "nothing is expected of it"


def test_back_after_a_slip_continues_where_the_step_was(walk: ProtocolRun) -> None:
    walk.next(at(50), WIZARD)
    assert walk.back(at(55), WIZARD).how == "back"
    assert walk.status().elapsed_s(at(56)) == 51.0
    assert walk.status().done == ()
    assert walk.next(at(70), WIZARD).step_id == "ask"
    assert walk.status().elapsed_s(at(71)) == 1.0
    walk.back(at(72), WIZARD)
    with pytest.raises(UserFacingError, match="This is the first step"):
        walk.back(at(73), WIZARD)


def test_back_retraces_the_steps(walk: ProtocolRun) -> None:
    walk.choose("show", at(1), WIZARD)
    walk.choose("ask", at(2), WIZARD)
    assert walk.branch("Cries", at(3), WIZARD) == StepEntered(
        at(3), "close", "Close", 4, "branch", "ask", "Cries", WIZARD
    )
    assert [walk.back(at(4 + n), WIZARD).step_id for n in range(3)] == ["ask", "show", "greet"]


def test_a_step_that_is_begun_again_has_its_time_again_and_no_step_behind_it(walk: ProtocolRun) -> None:
    assert walk.choose("greet", at(30), WIZARD) == StepEntered(
        at(30), "greet", "Greet", 1, "chosen", "greet", "", WIZARD
    )
    assert walk.status().elapsed_s(at(31)) == 1.0
    with pytest.raises(UserFacingError, match="first step"):
        walk.back(at(32), WIZARD)


def test_a_ticked_item_stays_with_its_step(walk: ProtocolRun) -> None:
    assert walk.tick("Coat", True, at(1), OTHER) == StepTicked(at(1), "greet", "Coat", True, OTHER)
    assert walk.tick("Coat", True, at(2), WIZARD) is None
    walk.tick("Consent", True, at(3), WIZARD)
    assert walk.status().ticked == ("Consent", "Coat")
    walk.next(at(4), WIZARD)
    assert walk.status().ticked == ()
    with pytest.raises(UserFacingError, match="The current step has no item “Coat”"):
        walk.tick("Coat", False, at(5), WIZARD)
    walk.back(at(6), WIZARD)
    assert walk.tick("Consent", False, at(7), WIZARD) == StepTicked(at(7), "greet", "Consent", False, WIZARD)
    assert walk.status().ticked == ("Coat",)


def test_a_pause_takes_no_time_of_any_step(walk: ProtocolRun) -> None:
    walk.pause(True, at(10))
    walk.pause(True, at(20))
    assert walk.status().elapsed_s(at(500)) == 10.0
    walk.next(at(500), WIZARD)
    assert walk.status().elapsed_s(at(600)) == 0.0
    walk.pause(False, at(1000))
    assert walk.status().elapsed_s(at(1003)) == 3.0
    walk.back(at(1004), WIZARD)
    assert walk.status().elapsed_s(at(1004)) == 10.0


def test_an_edited_protocol_leaves_the_wizard_in_their_step(walk: ProtocolRun) -> None:
    walk.tick("Coat", True, at(1), WIZARD)
    walk.next(at(2), WIZARD)
    before = ProtocolStep("Prepare")
    walk.follow((before, ProtocolStep("Greeting", id="greet", tick=("Coat",)), *STEPS[1:]))
    status = walk.status()
    assert (status.step_id, status.number, status.steps, status.since_ns) == ("ask", 3, 5, at(2))
    walk.back(at(3), WIZARD)
    assert (walk.status().title, walk.status().ticked) == ("Greeting", ("Coat",))
    walk.follow(STEPS[1:])
    assert (walk.status().step_id, walk.status().ended) == ("", False)


def test_an_impossible_step_is_reported() -> None:
    empty, fresh = ProtocolRun(), ProtocolRun(STEPS)
    for move in (lambda: empty.next(0, WIZARD), lambda: empty.skip(0, WIZARD), lambda: empty.back(0, WIZARD)):
        with pytest.raises(UserFacingError, match="This scenario has no protocol"):
            move()
    for move in (lambda: fresh.skip(0, WIZARD), lambda: fresh.back(0, WIZARD), lambda: fresh.branch("x", 0, WIZARD)):
        with pytest.raises(UserFacingError, match="No step is active"):
            move()
    with pytest.raises(UserFacingError, match="no step “nowhere”"):
        fresh.choose("nowhere", 0, WIZARD)
    assert fresh.choose("show", at(1), WIZARD).how == "chosen"
    with pytest.raises(UserFacingError, match="no branch “Cries”"):
        fresh.branch("Cries", at(2), WIZARD)


def test_the_plan_is_reported_with_what_is_expected(walk: ProtocolRun) -> None:
    assert walk.opened(at(5)) == ProtocolOpened(
        at(5),
        (
            PlannedStep("greet", "Greet", 60.0, ("Consent", "Coat")),
            PlannedStep("ask", "Ask", 30.0),
            PlannedStep("show", "Show"),
            PlannedStep("close", "Close"),
        ),
    )


def test_the_next_step_may_be_another_or_the_end() -> None:
    walk = ProtocolRun(
        (
            ProtocolStep("Wait"),
            ProtocolStep("Serve", then="wait"),
            ProtocolStep("Close", then="end"),
            ProtocolStep("Help"),
        )
    )
    walk.choose("serve", at(0), WIZARD)
    assert walk.status().next_title == "Wait"
    assert walk.next(at(1), WIZARD).step_id == "wait"
    walk.choose("close", at(2), WIZARD)
    assert walk.status().next_title == ""
    assert walk.next(at(3), WIZARD) == ProtocolEnded(at(3), "close", actor=WIZARD)
