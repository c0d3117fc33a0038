"""The robot's own voice: what was asked to be said, and what became of it."""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import UtteranceChanged, UtteranceState
from caris_desktop.robot.profile import SpeechInterface
from caris_desktop.robot.transport import SafeRos, SafeTopic
from caris_desktop.ros.dialect import Dialect, type_name
from caris_desktop.ros.messages import decode_bool, encode_string

STARTS_WITHIN_S = 4.0
LONGEST_UTTERANCE_S = 120.0


@dataclass(frozen=True, slots=True)
class _Utterance:
    utterance_id: str
    text: str
    started: bool = False


def estimated_duration_s(text: str) -> float:
    """How long a usual synthetic voice (about 15 characters a second) takes."""
    return 0.4 + 0.066 * len(text)


class RobotVoice:
    """Speaks through a topic, and follows along: by the robot's ``speaking`` topic, or else by an estimate.

    ``emit`` gets an UtteranceChanged for each utterance when it starts and when it ends, however it ends. Who asked
    for the utterance has reported it as requested.
    """

    def __init__(
        self,
        ros: SafeRos,
        dialect: Dialect,
        speech: SpeechInterface | None,
        *,
        emit: Callable[[UtteranceChanged], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._emit = emit
        self._waiting: deque[_Utterance] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._say: SafeTopic | None = None
        self._stop: SafeTopic | None = None
        self._follows_topic = False
        if speech is None or speech.topic is None:
            return
        self._say = SafeTopic(ros, speech.topic, type_name(dialect, "std_msgs", "String"))
        self._say.advertise()
        if speech.stop:
            self._stop = SafeTopic(ros, speech.stop, type_name(dialect, "std_msgs", "Empty"))
            self._stop.advertise()
        if speech.speaking:
            self._follows_topic = True
            bool_type = type_name(dialect, "std_msgs", "Bool")
            speaking = SafeTopic(ros, speech.speaking, bool_type, queue_length=10, every_message=True)
            speaking.subscribe(self._take_speaking)

    def say(self, utterance_id: str, text: str) -> None:
        """Ask the robot to say it now, or behind what it is saying."""
        utterance = _Utterance(utterance_id, text)
        if self._say is None:
            self._tell(utterance, "failed", "this robot's profile names no voice")
        elif not self._say.publish(encode_string(text)):
            self._tell(utterance, "failed", "the robot is not connected")
        else:
            self._waiting.append(utterance)
            if len(self._waiting) == 1:
                self._expect_start()

    def silence(self) -> bool:
        """Interrupt, where the robot can be interrupted. False where it cannot."""
        stopped = self._stop is not None and self._stop.publish({})
        if stopped:
            self._end_all("interrupted", "")
        return stopped

    def link_lost(self) -> None:
        self._end_all("failed", "the link to the robot was lost")

    def _take_speaking(self, message: Any) -> None:
        speaking = decode_bool(message)
        if not self._waiting:
            return
        if speaking and not self._waiting[0].started:
            self._start(LONGEST_UTTERANCE_S, "the robot did not report that it finished")
        elif not speaking and self._waiting[0].started:
            self._finish()

    def _expect_start(self) -> None:
        if self._follows_topic:
            self._wait(STARTS_WITHIN_S, lambda: self._fail("the robot did not report that it speaks"))
        else:
            self._start(0.0, "")
            self._wait(estimated_duration_s(self._waiting[0].text), self._finish)

    def _start(self, at_most_s: float, detail: str) -> None:
        head = self._waiting.popleft()
        self._waiting.appendleft(_Utterance(head.utterance_id, head.text, started=True))
        self._tell(head, "started", "" if self._follows_topic else "estimated")
        self._wait(at_most_s, lambda: self._fail(detail))

    def _finish(self) -> None:
        self._tell(self._waiting.popleft(), "finished", "" if self._follows_topic else "estimated")
        self._next()

    def _fail(self, detail: str) -> None:
        self._tell(self._waiting.popleft(), "failed", detail)
        self._next()

    def _next(self) -> None:
        self._wait(None, None)
        if self._waiting:
            self._expect_start()

    def _end_all(self, state: UtteranceState, detail: str) -> None:
        self._wait(None, None)
        while self._waiting:
            self._tell(self._waiting.popleft(), state, detail)

    def _wait(self, delay_s: float | None, then: Callable[[], None] | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(delay_s, then) if delay_s is not None and then is not None else None

    def _tell(self, utterance: _Utterance, state: UtteranceState, detail: str) -> None:
        self._emit(
            UtteranceChanged(
                now_ns(),
                utterance.utterance_id,
                "robot",
                utterance.text,
                # Who asked for it knows the origin; to the robot everything is typed.
                "typed",
                state,
                voice="robot",
                detail=detail,
            )
        )
