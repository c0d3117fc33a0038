"""Root causes: one alarm per cause, consequences below it, removal at its end, and one report for a flapping cause."""

import pytest

from caris_desktop.domain.events import ANSWER, Problem, ProblemEnd, Severity
from caris_desktop.live.alarm_causes import AGAIN_NS, HOLD_NS, LAPSE_NS, AlarmBook, Condition
from caris_desktop.live.status import Alarm

S = 1_000_000_000
LOST = Condition("link", "error", "The link is lost.", "", "", until="connected", prevails=True)
NO_PICTURE = Condition("picture", "warning", "No picture comes.", "", "", after_s=5.0, until="picture")
LOW = Condition("battery", "warning", "The battery is low.", "", "")
WELL: frozenset[ProblemEnd] = frozenset(("connected", "picture", "people"))


class Desk:
    """Alarm book with a clock, and the present conditions."""

    def __init__(self) -> None:
        self.book = AlarmBook()
        self.now_ns = 1_000 * S
        self.ends: frozenset[ProblemEnd] = WELL
        self.conditions: tuple[Condition, ...] = ()
        self.raised: list[str] = []
        self.ended: list[str] = []
        self.look()

    def look(self) -> None:
        self.book.evaluate(self.conditions, self.ends, self.now_ns)
        for change in self.book.take_changes():
            (self.raised if change.state == "raised" else self.ended).append(change.what)

    def wait(self, seconds: float) -> None:
        """Evaluate the alarms at each due time, as the service does."""
        until_ns = self.now_ns + round(seconds * S)
        while (wait_s := self.book.wait_s(self.now_ns)) is not None and self.now_ns + wait_s * S < until_ns:
            self.now_ns += max(1, round(wait_s * S))
            self.look()
        self.now_ns = until_ns
        self.look()

    def told(self, what: str, *, severity: Severity = "warning", until: ProblemEnd = "", cause: str = "") -> None:
        self.book.add(Problem(self.now_ns, severity, what, "", "", until, cause), self.now_ns)
        self.look()

    def lose(self) -> None:
        self.ends -= {"connected", "picture"}
        self.conditions = (LOST,)
        self.look()

    def come_back(self) -> None:
        self.ends, self.conditions = WELL, ()
        self.look()

    @property
    def alarms(self) -> dict[str, Alarm]:
        return {alarm.what: alarm for alarm in self.book.alarms}


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.mark.parametrize("first", ["what follows", "the loss"])
def test_a_lost_link_is_one_alarm_with_all_that_follows_from_it(desk: Desk, first: str) -> None:
    if first == "the loss":
        desk.lose()
    desk.told("The pictures broke off.", until="picture")
    desk.wait(0.5)
    desk.lose()
    desk.told("The robot is unreachable.", severity="error", until="connected")
    desk.told("Saying is not possible.", until="connected", cause=ANSWER)
    desk.told("No photo was taken.", until="picture", cause=ANSWER)
    desk.wait(30)
    assert desk.raised == ["The link is lost."]
    (alarm,) = desk.book.alarms
    assert set(alarm.folded) == {"The pictures broke off.", "Saying is not possible.", "No photo was taken."}
    assert alarm.why == "The robot is unreachable.", "which does not come of it"
    desk.come_back()
    desk.wait(10)
    assert (desk.ended, desk.book.alarms) == (["The link is lost."], ())


def test_a_report_of_an_absent_robot_gets_the_better_text_of_the_state(desk: Desk) -> None:
    desk.ends -= {"connected"}
    desk.told("Nobody answers at that address.", severity="error", until="connected")
    desk.lose()
    assert list(desk.alarms) == ["The link is lost."]
    assert desk.alarms["The link is lost."].why == "Nobody answers at that address."
    assert desk.alarms["The link is lost."].folded == ()
    assert len(desk.raised) == 1


@pytest.mark.parametrize("period_s", [1, 4, 20])
def test_a_link_that_flaps_twenty_times_is_one_alarm_reported_a_few_times(desk: Desk, period_s: int) -> None:
    for _ in range(20):
        desk.lose()
        desk.wait(period_s / 2)
        desk.come_back()
        desk.wait(period_s / 2)
    assert 1 <= len(desk.raised) <= 4
    assert len({alarm.alarm_id for alarm in desk.book.alarms}) <= 1
    desk.wait(120)
    assert desk.book.alarms == ()
    assert len(desk.raised) == len(desk.ended)


def test_a_possible_consequence_of_a_loss_waits_before_it_is_an_alarm(desk: Desk) -> None:
    desk.ends -= {"picture"}
    desk.told("The camera stopped.", until="picture")
    desk.wait(HOLD_NS / S - 0.1)
    assert desk.raised == []
    desk.wait(0.2)
    assert desk.raised == ["The camera stopped."]
    desk.ends |= {"picture"}
    desk.look()
    assert desk.book.alarms == ()


def test_a_condition_that_ends_early_is_no_alarm(desk: Desk) -> None:
    desk.ends -= {"picture"}
    desk.told("The camera stopped.", until="picture")
    desk.ends |= {"picture"}
    desk.wait(5)
    assert desk.raised == []


def test_missing_data_of_a_robot_that_is_still_searched_is_no_alarm(desk: Desk) -> None:
    desk.ends -= {"connected", "microphone"}
    desk.told("The robot's microphone cannot be heard.", until="microphone", cause="robot_sound")
    desk.wait(20)
    assert desk.raised == []
    desk.ends |= {"connected"}
    desk.look()
    desk.ends |= {"microphone"}
    desk.wait(5)
    assert desk.raised == []


def test_a_condition_counts_once_it_has_lasted(desk: Desk) -> None:
    desk.conditions = (NO_PICTURE,)
    desk.ends -= {"picture"}
    desk.look()
    desk.wait(4)
    desk.conditions = ()
    desk.look()
    desk.conditions = (NO_PICTURE,)
    desk.look()
    desk.wait(4)
    assert desk.raised == []
    desk.wait(2)
    assert desk.raised == ["No picture comes."]
    desk.lose()
    assert list(desk.alarms) == ["The link is lost."], "and goes below what it follows from"
    assert desk.alarms["The link is lost."].folded == ("No picture comes.",)


def test_a_condition_without_an_end_of_its_own_ends_with_itself(desk: Desk) -> None:
    desk.conditions = (LOW,)
    desk.look()
    assert list(desk.alarms) == ["The battery is low."]
    desk.conditions = ()
    desk.look()
    assert desk.book.alarms == ()


def test_notes_and_answers_are_no_alarms(desk: Desk) -> None:
    desk.told("The map was saved.", severity="info")
    desk.told("This scenario does not allow photos.", cause=ANSWER)
    assert desk.raised == []


def test_a_repeated_problem_is_one_alarm_that_lapses(desk: Desk) -> None:
    for number in (1, 12, 15):
        desk.told(f"{number} pictures were dropped.", until="quiet", cause="image front")
        desk.wait(10)
    assert desk.raised == ["1 pictures were dropped."]
    assert list(desk.alarms) == ["15 pictures were dropped."]
    desk.wait(LAPSE_NS / S)
    assert desk.book.alarms == ()


def test_of_one_cause_the_gravest_words_stand(desk: Desk) -> None:
    desk.told("The disk is filling up.", until="recording", cause="disk")
    desk.told("The disk is full.", severity="error", until="recording", cause="disk")
    desk.told("The disk is slow.", until="recording", cause="disk")
    assert desk.alarms["The disk is full."].folded == ("The disk is filling up.", "The disk is slow.")
    assert len(desk.raised) == len(desk.alarms) == 1
    desk.wait(1)
    desk.told("Broken.", severity="error")
    assert list(desk.alarms) == ["Broken.", "The disk is full."], "the newest first"


def test_a_person_sees_to_what_does_not_end_automatically(desk: Desk) -> None:
    desk.told("Classes unknown to the detector: cake.", until="")
    desk.told("People are not found.", until="people")
    unknown, lost = desk.alarms["Classes unknown to the detector: cake."], desk.alarms["People are not found."]
    assert not desk.book.dismiss(lost.alarm_id, "wizard", desk.now_ns)
    assert desk.book.dismiss(unknown.alarm_id, "wizard", desk.now_ns)
    assert not desk.book.dismiss(unknown.alarm_id, "wizard", desk.now_ns)
    assert list(desk.alarms) == ["People are not found."]
    (change,) = desk.book.take_changes()
    assert (change.state, change.actor) == ("ended", "wizard")


def test_long_afterwards_it_is_another_alarm(desk: Desk) -> None:
    desk.lose()
    first = desk.book.alarms[0].alarm_id
    desk.come_back()
    desk.wait(AGAIN_NS / S + 10)
    desk.lose()
    assert desk.book.alarms[0].alarm_id != first
    assert desk.book.alarms[0].times == 1


def test_nothing_is_looked_at_again_while_nothing_is_due(desk: Desk) -> None:
    assert desk.book.wait_s(desk.now_ns) is None
    desk.lose()
    assert desk.book.wait_s(desk.now_ns) is None
    desk.come_back()
    wait_s = desk.book.wait_s(desk.now_ns)
    assert wait_s is not None and 1.0 < wait_s <= 2.0
