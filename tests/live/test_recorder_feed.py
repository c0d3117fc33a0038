"""Messages to the recorder's pipe: everything with its arrival time, nothing during a pause."""

import pickle
import threading
from typing import Any

from caris_desktop.domain import clock
from caris_desktop.domain.events import Marked, UtteranceChanged
from caris_desktop.domain.sensing import BatteryState, StatusShown
from caris_desktop.live.services.recording_service import ARRIVED, RecorderFeed
from tests.support.polling import wait_for


class Pipe:
    """Records the written data."""

    def __init__(self) -> None:
        self.raw: list[bytes] = []
        self.open = threading.Event()
        self.open.set()

    def send_raw_waiting(self, raw: bytes) -> bool:
        self.open.wait(10)
        self.raw.append(raw)
        return True

    @property
    def messages(self) -> list[Any]:
        return [pickle.loads(raw[9:]) for raw in self.raw]  # noqa: S301 - written by this test


def _fed(**options: int) -> tuple[RecorderFeed, Pipe]:
    pipe = Pipe()
    return RecorderFeed(pipe, **options), pipe  # type: ignore[arg-type]


def _start(feed: RecorderFeed, message: Any, *events: Any) -> None:
    feed.hold(*events)
    feed.begin(message)


def test_each_message_carries_its_arrival() -> None:
    feed, pipe = _fed()
    before_ns = clock.now_ns()
    _start(feed, "begin")
    feed.put(Marked(3, "a"))
    feed.close()
    assert pipe.messages == ["begin", Marked(3, "a")]
    for raw in pipe.raw:
        assert raw[:1] == ARRIVED
        assert before_ns <= int.from_bytes(raw[1:9], "little", signed=True) <= clock.now_ns()


def test_current_states_come_first_and_once_for_each_key() -> None:
    feed, pipe = _fed()
    for name, content in (("drive", 1), ("link", 1), ("drive", 2)):
        feed.put(StatusShown(1, name, content))
    feed.put(BatteryState(2, 0.5))
    feed.put(Marked(3, "before the recording"))
    _start(feed, "begin", "event")
    feed.close()
    assert pipe.messages == [
        "begin",
        StatusShown(1, "drive", 2),
        StatusShown(1, "link", 1),
        BatteryState(2, 0.5),
        "event",
    ]


def test_events_before_the_session_has_a_folder_are_in_it() -> None:
    feed, pipe = _fed()
    feed.put(BatteryState(1, 0.9))
    asked_ns = clock.now_ns()
    feed.hold("opened")
    feed.put(Marked(2, "meanwhile"))
    feed.request("photo")
    wait_for(lambda: pipe.messages == ["photo"], "what is no part of it does not wait for it")
    begun_ns = clock.now_ns()
    feed.begin("begin")
    feed.put(Marked(3, "afterwards"))
    feed.close()
    assert pipe.messages[1:] == [
        "begin",
        BatteryState(1, 0.9),
        "opened",
        Marked(2, "meanwhile"),
        Marked(3, "afterwards"),
    ]
    arrivals_ns = [int.from_bytes(raw[1:9], "little", signed=True) for raw in pipe.raw[1:]]
    assert arrivals_ns == sorted(arrivals_ns)
    assert asked_ns <= arrivals_ns[0] <= arrivals_ns[3] <= begun_ns, "it starts when it was asked for"


def test_a_session_that_ends_before_it_has_a_place_holds_what_came_until_then() -> None:
    feed, pipe = _fed()
    feed.hold()
    feed.put(Marked(1, "inside"))
    feed.stop("end")
    feed.put(Marked(2, "outside"))
    feed.begin("begin")
    feed.close()
    assert pipe.messages == ["begin", Marked(1, "inside"), "end"]


def test_nothing_of_a_session_that_is_abandoned_reaches_the_next() -> None:
    feed, pipe = _fed()
    feed.hold("opened")
    feed.put(Marked(1, "given up"))
    feed.drop()
    feed.put(Marked(2, "in between"))
    assert not feed.holds
    _start(feed, "begin")
    feed.close()
    assert pipe.messages == ["begin"]


def test_another_recorder_gets_the_session_that_has_not_begun() -> None:
    feed, _pipe = _fed()
    other = Pipe()
    feed.hold("opened")
    feed.use_recorder(other)  # type: ignore[arg-type]
    feed.put(Marked(1, "a"))
    feed.begin("begin")
    feed.close()
    assert other.messages == ["begin", "opened", Marked(1, "a")]


def test_a_pause_lets_nothing_through_and_ends_with_what_stands() -> None:
    feed, pipe = _fed()
    _start(feed, "begin")
    feed.put(BatteryState(1, 0.9))
    feed.pause("pause", paused=True)
    feed.put(Marked(2, "private"))
    feed.put(BatteryState(3, 0.8))
    feed.pause("go on", paused=False)
    feed.put(Marked(4, "public"))
    feed.stop("end")
    feed.close()
    assert pipe.messages == [
        "begin",
        BatteryState(1, 0.9),
        "pause",
        "go on",
        BatteryState(3, 0.8),
        Marked(4, "public"),
        "end",
    ]


def test_events_are_never_dropped_and_states_are_counted() -> None:
    feed, pipe = _fed(max_bytes=2000)
    _start(feed, "begin")
    wait_for(lambda: pipe.raw, "the beginning is written")
    pipe.open.clear()
    for number in range(50):
        feed.put(BatteryState(number, 0.5))
        feed.put(Marked(number, str(number)))
    pipe.open.set()
    feed.stop("end")
    feed.close()
    marks = [message for message in pipe.messages if isinstance(message, Marked)]
    assert [mark.label for mark in marks] == [str(number) for number in range(50)]
    batteries = [message for message in pipe.messages if isinstance(message, BatteryState)]
    (gap,) = [message for message in pipe.messages if type(message).__name__ == "Gap"]
    assert (gap.stream, gap.count) == ("battery", 50 - len(batteries)) and gap.count > 0


def test_an_event_is_reported_again_after_a_pause() -> None:
    feed, pipe = _fed()
    _start(feed, "begin", "scenario A")
    feed.pause("pause", paused=True)
    feed.pause("go on", "scenario B", paused=False)
    feed.close()
    assert pipe.messages == ["begin", "scenario A", "pause", "go on", "scenario B"]


def test_states_of_a_lost_robot_do_not_head_the_next_recording() -> None:
    feed, pipe = _fed()
    feed.put(BatteryState(2, 0.5))
    feed.put(StatusShown(1, "drive", 1))
    feed.forget_streams(("battery", "map"))
    _start(feed, "begin")
    feed.close()
    assert pipe.messages == ["begin", StatusShown(1, "drive", 1)]


def test_dropped_values_are_reported_before_the_end() -> None:
    feed, pipe = _fed(max_bytes=600)
    _start(feed, "begin")
    wait_for(lambda: pipe.raw, "the beginning is written")
    pipe.open.clear()
    for number in range(50):
        feed.put(BatteryState(number, 0.5))
    feed.stop("end")
    pipe.open.set()
    feed.close()
    kinds = [type(message).__name__ for message in pipe.messages]
    assert kinds.index("Gap") < pipe.messages.index("end") and kinds[-1] == "str"


def _turn(stamp_ns: int, turn_id: str, state: str, text: str = "") -> UtteranceChanged:
    return UtteranceChanged(stamp_ns, turn_id, "participant", text, "heard", state)  # type: ignore[arg-type] # one of them


def test_the_end_waits_for_what_becomes_of_the_turns_that_were_heard_before() -> None:
    feed, pipe = _fed()
    _start(feed, "begin")
    feed.put(_turn(1, "echo", "started"))
    feed.put(_turn(2, "question", "started"))
    before_ns = clock.now_ns()
    feed.stop("end")
    asked_ns = clock.now_ns()
    feed.put(Marked(9, "after the end"))
    feed.put(_turn(3, "later", "started"))
    feed.put(_turn(4, "echo", "failed"))
    feed.put(_turn(5, "later", "finished", "This is nobody's business."))
    spoken_on = clock.now_ns() + 10**12
    feed.put(_turn(spoken_on, "question", "finished", "Where is the lab?"))
    feed.put(_turn(7, "question", "finished", "Once more."))
    wait_for(lambda: "end" in pipe.messages, "the end")
    feed.close()
    assert pipe.messages[-3:-1][0] == _turn(4, "echo", "failed")
    finished = pipe.messages[-2]
    assert finished.text == "Where is the lab?"
    assert before_ns <= finished.stamp_ns <= asked_ns  # the end of the recording ends an open turn
    assert pipe.messages == ["begin", _turn(1, "echo", "started"), _turn(2, "question", "started"),
        _turn(4, "echo", "failed"), finished, "end"]  # fmt: skip
    # The session ends at the request, not with the last recognised word.
    assert before_ns <= int.from_bytes(pipe.raw[-1][1:9], "little", signed=True) <= asked_ns


def test_the_end_waits_no_longer_than_that() -> None:
    pipe = Pipe()
    feed = RecorderFeed(pipe, verdicts_within_s=0.0)  # type: ignore[arg-type] # as above
    _start(feed, "begin")
    feed.put(_turn(1, "open", "started"))
    feed.stop("end")
    wait_for(lambda: "end" in pipe.messages, "the end")
    feed.put(_turn(2, "open", "finished", "Too late."))
    feed.close()
    assert pipe.messages == ["begin", _turn(1, "open", "started"), "end"]


def test_the_next_session_and_the_end_of_the_program_do_not_wait_for_words() -> None:
    feed, pipe = _fed()
    _start(feed, "begin")
    feed.put(_turn(1, "open", "started"))
    feed.stop("end")
    _start(feed, "begin 2")
    feed.put(_turn(2, "open", "finished", "Of the session before."))
    feed.put(_turn(3, "still open", "started"))
    feed.stop("end 2")
    feed.close()
    kept = [each if isinstance(each, str) else each.utterance_id for each in pipe.messages]
    assert kept[:4] == ["begin", "open", "end", "begin 2"]
    assert kept[-2:] == ["still open", "end 2"]


def test_a_pause_lets_earlier_utterances_through() -> None:
    feed, pipe = _fed()
    _start(feed, "begin")
    feed.put(_turn(1, "before", "started"))
    feed.pause("pause", paused=True)
    feed.put(_turn(2, "within", "started"))
    feed.put(_turn(3, "before", "finished", "Where is the lab?"))
    feed.put(_turn(4, "within", "finished", "Secret."))
    feed.pause("go on", paused=False)
    feed.close()
    assert pipe.messages == ["begin", _turn(1, "before", "started"), "pause",
        _turn(3, "before", "finished", "Where is the lab?"), "go on"]  # fmt: skip
