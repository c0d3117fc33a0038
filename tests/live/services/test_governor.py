"""Who pays when the machine is busy: in steps, with patience on the way back."""

from caris_desktop.live.services.governor import LOOK_EVERY_MS, STEPS, LoadSteps

SECOND_NS = 1_000_000_000


class Machine:
    """Looks at the steps ten times a second of a clock of its own."""

    def __init__(self) -> None:
        self.steps = LoadSteps()
        self.now_ns = 100 * SECOND_NS

    def run(self, seconds: float, *, late_ms: float, once_in: int = 1) -> int:
        for number in range(round(seconds * 1000 / LOOK_EVERY_MS)):
            self.now_ns += LOOK_EVERY_MS * 1_000_000
            self.steps.look(late_ms if number % once_in == 0 else 0.0, self.now_ns)
        return self.steps.step


def test_a_machine_that_keeps_up_gives_nothing_up() -> None:
    machine = Machine()
    assert machine.run(60.0, late_ms=8.0) == 0
    assert machine.run(60.0, late_ms=200.0, once_in=100) == 0, "one stall is no load"


def test_a_busy_machine_gives_up_one_step_after_another_and_no_more_than_there_are() -> None:
    machine = Machine()
    assert machine.run(2.5, late_ms=60.0) == 1
    assert machine.run(2.5, late_ms=60.0) == 2
    assert machine.run(60.0, late_ms=60.0) == len(STEPS) - 1


def test_what_was_given_up_comes_back_slowly_and_only_where_there_is_room() -> None:
    machine = Machine()
    machine.run(60.0, late_ms=60.0)
    assert machine.run(60.0, late_ms=18.0) == 3, "neither late nor in time: stay"
    assert machine.run(9.0, late_ms=2.0) == 2
    assert machine.run(9.0, late_ms=2.0) == 1
    assert machine.run(9.0, late_ms=2.0) == 0


def test_people_pay_first_and_the_picture_last() -> None:
    looks, passes = [step[0] for step in STEPS], [step[1] for step in STEPS]
    assert looks == sorted(looks) and passes == sorted(passes)
    assert passes[1] == 0.0 and looks[1] > 0.0
    assert all(bool(step[2]) == (number > 0) for number, step in enumerate(STEPS))
