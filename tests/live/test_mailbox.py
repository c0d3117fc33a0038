"""One-slot mailboxes: the newest state wins, events are never lost."""

import threading

import numpy as np
import pytest

from caris_desktop.domain.events import LinkChanged, LinkState, Marked, RobotChosen
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import AudioBlock, BatteryState, FrameRef, OccupancyGrid, People
from caris_desktop.live.bus import Mailbox


def _frame(sequence: int, camera: str = "front") -> FrameRef:
    return FrameRef(sequence, None, camera, "ring", sequence % 4, sequence, 4, 3)


def test_newest_state_wins_and_events_keep_their_order() -> None:
    wakes: list[int] = []
    mailbox = Mailbox(lambda: wakes.append(1))
    for number in range(5):
        mailbox.put(BatteryState(number, number / 10))
        mailbox.put(Marked(number, f"mark {number}"))
    events, latest = mailbox.drain()
    assert [event.label for event in events] == [f"mark {number}" for number in range(5)]
    assert latest == [BatteryState(4, 0.4)]
    assert len(wakes) == 1, "only empty to full wakes"
    assert mailbox.drain() == ([], [])


def test_events_can_be_taken_alone_while_the_picture_waits() -> None:
    wakes: list[int] = []
    mailbox = Mailbox(lambda: wakes.append(1))
    mailbox.put(_frame(1))
    mailbox.put(Marked(1, "first"))
    assert mailbox.drain(()) == ([Marked(1, "first")], [])
    mailbox.put(_frame(2))
    assert len(wakes) == 1, "whoever lets the picture wait comes for it"
    mailbox.put(Marked(2, "second"))
    assert len(wakes) == 2, "but an event is told at once"
    assert mailbox.drain() == ([Marked(2, "second")], [_frame(2)])


def test_the_picture_can_be_taken_alone_while_the_panels_wait() -> None:
    wakes: list[int] = []
    mailbox = Mailbox(lambda: wakes.append(1))
    mailbox.put(BatteryState(1, 0.5))
    mailbox.put(_frame(1))
    assert mailbox.drain(("picture",)) == ([], [_frame(1)])
    assert mailbox.waiting == {"panels"}
    wakes.clear()
    mailbox.put(BatteryState(2, 0.4))
    assert not wakes, "whoever lets the panels wait comes for it"
    mailbox.put(_frame(2))
    assert wakes, "but a picture is told at once"
    assert mailbox.drain() == ([], [BatteryState(2, 0.4), _frame(2)])


@pytest.mark.parametrize("state", ["lost", "closed"])
def test_values_of_a_lost_link_are_dropped_with_it(state: LinkState) -> None:
    mailbox = Mailbox(lambda: None)
    grid = OccupancyGrid(1, None, 0.05, Pose2D(0, 0, 0), np.zeros((2, 2), np.int8))
    lost = LinkChanged(2, "control", state, "ws://robot")
    for value in (BatteryState(1, 0.5), grid, lost):
        mailbox.put(value)
    assert mailbox.drain() == ([lost], [grid]), "the map came over the other link"
    mailbox.put(LinkChanged(2, "media", state, "ws://robot"))
    mailbox.put(grid)
    assert mailbox.drain()[1] == [grid], "what comes after it is of the next connection"
    trouble = LinkChanged(3, "control", "trouble", "ws://robot")
    mailbox.put(BatteryState(3, 0.5))
    mailbox.put(trouble)
    assert mailbox.drain() == ([trouble], [BatteryState(3, 0.5)])


def test_values_of_one_robot_are_not_shown_as_the_next_one_s() -> None:
    mailbox = Mailbox(lambda: None)
    chosen = RobotChosen(2, "Other", "other", "ws://other", "", "wizard")
    mailbox.put(BatteryState(1, 0.5))
    mailbox.put(chosen)
    assert mailbox.drain() == ([chosen], [])


def test_cameras_do_not_overwrite_one_another() -> None:
    mailbox = Mailbox(lambda: None)
    mailbox.put(_frame(1, "front"))
    mailbox.put(_frame(2, "rear"))
    mailbox.put(_frame(3, "front"))
    _, latest = mailbox.drain()
    assert {(ref.camera, ref.sequence) for ref in latest} == {("front", 3), ("rear", 2)}


def test_values_of_one_camera_or_microphone_replace_none_of_another() -> None:
    mailbox = Mailbox(lambda: None)
    for camera, sequence in (("front", 1), ("rear", 2), ("front", 3)):
        mailbox.put(People(sequence, camera, sequence, 4, 3, (), 1.0))
    for source in ("microphone", "robot voice"):
        mailbox.put(AudioBlock(1, source, "a.wav", 0, 10, 16_000))
    _, latest = mailbox.drain()
    people = {(value.camera, value.stamp_ns) for value in latest if isinstance(value, People)}
    assert people == {("front", 3), ("rear", 2)}
    assert {value.source for value in latest if isinstance(value, AudioBlock)} == {"microphone", "robot voice"}


def test_events_from_many_threads_all_arrive() -> None:
    mailbox = Mailbox(lambda: None)

    def put_many(thread: int) -> None:
        for number in range(500):
            mailbox.put(Marked(number, f"{thread}"))

    threads = [threading.Thread(target=put_many, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    events, _ = mailbox.drain()
    assert len(events) == 2000
