"""Switch of the robot: the last request wins, and no state of the previous robot remains."""

from collections import deque
from collections.abc import Callable
from typing import Any

import pytest

from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.services.robot_service import AnotherRobotService
from tests.support.service_context import context_of


class Told:
    """Records the calls of all collaborators in one list."""

    def __init__(self, name: str, calls: list[str]) -> None:
        self._name, self._calls = name, calls

    def __getattr__(self, method: str) -> Callable[..., Any]:
        def called(*arguments: object, **_words: object) -> Callable[[], str]:
            first = arguments[0] if arguments and isinstance(arguments[0], str) else ""
            self._calls.append(f"{self._name}.{method} {first}".strip())
            return lambda: "left"

        return called


class LaterWork:
    """Background work, executed in order on request of the test."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[Callable[[], Any], Callable[[Any], None], Callable[[UserFacingError], None]]] = (
            deque()
        )

    def do(
        self, work: Callable[[], Any], done: Callable[[Any], None], failed: Callable[[UserFacingError], None]
    ) -> None:
        self.waiting.append((work, done, failed))

    def run(self, number: int = 1) -> None:
        for _ in range(number):
            work, done, failed = self.waiting.popleft()
            try:
                found = work()
            except UserFacingError as failure:
                failed(failure)
            else:
                done(found)


@pytest.fixture
def calls() -> list[str]:
    return []


@pytest.fixture
def work() -> LaterWork:
    return LaterWork()


@pytest.fixture
def service(calls: list[str], work: LaterWork) -> AnotherRobotService:
    bus, robot, drive, recording, people = (
        Told(name, calls) for name in ("bus", "robot", "drive", "recording", "people")
    )
    made: Any = AnotherRobotService
    service: AnotherRobotService = made(
        context_of(None, bus, None, slow_work=work),
        by_name=None,
        simulated=calls.append,
        robot=robot,
        drive=drive,
        recording=recording,
        people=people,
    )
    return service


def test_driving_ends_at_once_and_what_was_of_the_robot_before_goes_before_the_next_is_connected(
    service: AnotherRobotService, calls: list[str], work: LaterWork
) -> None:
    made: Any = "tiago"
    service.connect_to(made)
    assert calls == ["drive.release Another robot is connected", "robot.leave_for tiago"]
    work.run()
    assert calls[2:] == [
        "bus.take_in", "recording.forget_robot", "people.forget_robot", "robot.connect_robot tiago",
    ]  # fmt: skip


def test_the_simulated_robot_is_requested_by_several_users(service: AnotherRobotService, calls: list[str]) -> None:
    service.handlers()[intents.UseSimulatedRobot](intents.UseSimulatedRobot(actor="wizard:b"))
    assert calls[-1] == "wizard:b"
    assert "robot.leave_for_one_that_starts" in calls[0], "who does not answer is no alarm while another one starts"


def test_of_two_that_are_looked_for_the_last_counts(
    service: AnotherRobotService, calls: list[str], work: LaterWork
) -> None:
    first: Any = "tiago"
    second: Any = "pepper"
    service.use(lambda: first, WIZARD)
    service.use(lambda: second, WIZARD)
    work.run(2)
    service.connect_to(first)  # requested while the switch to the second one is in progress
    work.run(2)
    assert [call for call in calls if call.startswith("robot.connect_robot")] == ["robot.connect_robot tiago"]


def test_one_that_cannot_be_found_is_reported_and_leaves_the_present_one(
    service: AnotherRobotService, calls: list[str], work: LaterWork
) -> None:
    def find() -> Any:
        raise UserFacingError("No robot of this name.", "", "")

    service.use(find)
    work.run()
    assert calls == ["bus.answer"]


def test_a_program_that_ends_connects_no_more(service: AnotherRobotService, calls: list[str], work: LaterWork) -> None:
    made: Any = "tiago"
    service.connect_to(made)
    service.stop()
    work.run()
    service.connect_to(made)
    assert not work.waiting and "robot.connect_robot tiago" not in calls
