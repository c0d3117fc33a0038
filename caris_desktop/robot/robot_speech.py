"""Robot speech backends by topic and action, with reports on each utterance."""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import fill_template
from caris_desktop.domain.events import UtteranceChanged, UtteranceState
from caris_desktop.domain.link_commands import Say
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.action_client import FATE_UNKNOWN, FATE_WITHIN_S, make_action_client
from caris_desktop.robot.profile_model import SpeechAction, SpeechInterface
from caris_desktop.robot.speaking_time import LONGEST_UTTERANCE_S, estimated_duration_s
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.action_messages import Ending
from caris_desktop.ros.dialect import Dialect, type_name
from caris_desktop.ros.message_conversion import decode_bool, encode_string
from caris_desktop.ros.message_fields import Message

STARTS_WITHIN_S = 4.0
STARTED_UNTOLD_S = 1.0


class _Utterance(Value):
    command: Say
    started: bool = False


class RobotVoice(Protocol):
    """Robot speech backend."""

    def say(self, command: Say) -> None:
        """Request speech now, or after the present utterance."""

    def silence(self, actor: Actor) -> bool:
        """Interrupt speech. False if the robot does not support it."""

    def link_lost(self) -> None:
        """The robot continues to speak; the outcome is reported when known."""

    def link_connected(self) -> None:
        """The robot reports again."""

    async def close(self) -> None:
        """End all requests and reports."""


class ActionVoice:
    """Speech through an action, whose result is the end of the utterance.

    One goal at a time: typical action servers drop the present goal for a new one. ``emit`` as in :class:`TopicVoice`.
    """

    def __init__(
        self, ros: RosbridgeClient, dialect: Dialect, action: SpeechAction, *, emit: Callable[[UtteranceChanged], None]
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = ros
        self._dialect = dialect
        self._goal = action.goal
        self._emit = emit
        self._waiting: deque[_Utterance] = deque()
        self._wire_id: str | None = None
        self._adrift = False
        self._reckoned = False
        self._silence_due: Actor | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._client = make_action_client(ros, dialect, action.name, action.type, self)

    def say(self, command: Say) -> None:
        utterance = _Utterance(command)
        if not self._ros.is_connected:
            report_utterance(self._emit, utterance.command, "failed", QT_TR_NOOP("the robot is not connected"))
            return
        self._waiting.append(utterance)
        if len(self._waiting) == 1:
            self._send_next()

    def silence(self, actor: Actor) -> bool:
        if not self._ros.is_connected:
            self._silence_due = actor if self._wire_id is not None else None
            return False
        if self._wire_id is not None:
            self._client.cancel(self._wire_id)
        self._end_all("interrupted", "", actor)
        return True

    def link_lost(self) -> None:
        head, unsent = list(self._waiting)[:1], list(self._waiting)[1:]
        self._waiting = deque(head)
        if head:
            self._adrift = True
            self._wait(FATE_WITHIN_S, lambda: self._finish("failed", FATE_UNKNOWN))
        for utterance in unsent:
            report_utterance(
                self._emit, utterance.command, "failed", QT_TR_NOOP("the connection to the robot was lost")
            )

    def link_connected(self) -> None:
        due, self._silence_due = self._silence_due, None
        if due is not None:
            self.silence(due)
        elif self._adrift:
            self._wait(FATE_WITHIN_S, lambda: self._give_up(FATE_UNKNOWN))

    async def close(self) -> None:
        self._wait(None, None)

    def goal_pending(self, wire_id: str) -> None:
        if wire_id == self._wire_id and not self._waiting[0].started:
            # The robot is saying something else first.
            self._wait(
                LONGEST_UTTERANCE_S,
                lambda: self._give_up(QT_TR_NOOP("the robot did not report that it started speaking")),
            )

    def goal_active(self, wire_id: str) -> None:
        if wire_id != self._wire_id:
            return
        if not self._waiting[0].started:
            self._waiting[0] = replace(self._waiting[0], started=True)
            report_utterance(self._emit, self._waiting[0].command, "started", estimated=self._reckoned)
        elif not self._adrift:
            return
        self._adrift = False
        self._wait(
            LONGEST_UTTERANCE_S, lambda: self._give_up(QT_TR_NOOP("the robot did not report that it finished speaking"))
        )

    def _reckon_active(self, wire_id: str) -> None:
        self._reckoned = True
        self.goal_active(wire_id)
        self._reckoned = False

    def goal_feedback(self, wire_id: str, _: Message) -> None:
        self.goal_active(wire_id)

    def goal_ended(self, wire_id: str, ending: Ending, detail: str) -> None:
        if wire_id != self._wire_id:
            return
        if ending == "reached":
            # A short word may end before its start was reported.
            self.goal_active(wire_id)
        states: dict[Ending, UtteranceState] = {"reached": "finished", "cancelled": "interrupted", "failed": "failed"}
        # Silenced utterances were removed before: the robot itself cancelled this one.
        self._finish(states[ending], detail, "" if ending == "cancelled" else None)

    def _send_next(self) -> None:
        command = self._waiting[0].command
        self._wire_id = self._client.send(command.utterance_id, fill_template(self._goal, command.text))
        if self._wire_id is None:
            self._end_all("failed", QT_TR_NOOP("the robot is not connected"))
        elif self._dialect is Dialect.ROS1:
            self._wait(
                STARTS_WITHIN_S, lambda: self._give_up(QT_TR_NOOP("the robot did not report that it started speaking"))
            )
        else:
            # rosbridge does not report acceptance of a goal, and answers when it was refused.
            wire_id = self._wire_id
            self._wait(STARTED_UNTOLD_S, lambda: self._reckon_active(wire_id))

    def _give_up(self, detail: str) -> None:
        if self._wire_id is not None:
            self._client.cancel(self._wire_id)
        self._finish("failed", detail)

    def _finish(self, state: UtteranceState, detail: str, actor: Actor | None = None) -> None:
        self._wire_id = None
        self._adrift, self._silence_due = False, None
        self._wait(None, None)
        report_utterance(self._emit, self._waiting.popleft().command, state, detail, actor)
        if self._waiting:
            self._send_next()

    def _end_all(self, state: UtteranceState, detail: str, actor: Actor | None = None) -> None:
        self._wire_id = None
        self._adrift, self._silence_due = False, None
        self._wait(None, None)
        while self._waiting:
            report_utterance(self._emit, self._waiting.popleft().command, state, detail, actor)

    def _wait(self, delay_s: float | None, then: Callable[[], None] | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(delay_s, then) if delay_s is not None and then is not None else None


class TopicVoice:
    """Speech through a topic, tracked by the robot's ``speaking`` topic, or else by an estimate.

    ``emit`` gets an UtteranceChanged for each utterance at its start and end. Its request is reported by the requester.
    """

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        speech: SpeechInterface | None,
        *,
        emit: Callable[[UtteranceChanged], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = ros
        self._emit = emit
        self._adrift = False
        self._silence_due: Actor | None = None
        self._waiting: deque[_Utterance] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._say: RosbridgeTopic | None = None
        self._stop: RosbridgeTopic | None = None
        self._follows_topic = self._robot_speaks = self._in_one_breath = False
        if speech is None or speech.topic is None:
            return
        self._say = RosbridgeTopic(ros, speech.topic, type_name(dialect, "std_msgs", "String"))
        self._say.advertise()
        if speech.stop:
            self._stop = RosbridgeTopic(ros, speech.stop, type_name(dialect, "std_msgs", "Empty"))
            self._stop.advertise()
        if speech.speaking:
            self._follows_topic = True
            bool_type = type_name(dialect, "std_msgs", "Bool")
            speaking = RosbridgeTopic(ros, speech.speaking, bool_type, queue_length=10, every_message=True)
            speaking.subscribe(self._on_speaking)

    def say(self, command: Say) -> None:
        """Request speech now, or after the present utterance."""
        utterance = _Utterance(command)
        if self._say is None:
            self._notify(utterance, "failed", QT_TR_NOOP("this robot's profile does not define a voice"))
        elif not self._say.publish(encode_string(command.text)):
            self._notify(utterance, "failed", QT_TR_NOOP("the robot is not connected"))
        else:
            self._waiting.append(utterance)
            if len(self._waiting) == 1:
                self._expect_start()

    def silence(self, actor: Actor) -> bool:
        """Interrupt speech. False if the robot does not support it."""
        if not self._ros.is_connected:
            self._silence_due = actor if self._waiting else None
            return False
        stopped = self._stop is not None and self._stop.publish({})
        if stopped:
            self._end_all("interrupted", "", actor)
        return stopped

    def link_lost(self) -> None:
        self._robot_speaks = False
        if self._waiting and self._follows_topic:
            self._adrift = True
            self._wait(FATE_WITHIN_S, lambda: self._end_all("failed", FATE_UNKNOWN))

    def link_connected(self) -> None:
        due, self._silence_due = self._silence_due, None
        if due is not None:
            self.silence(due)
        if self._adrift:
            # Many robots publish the state to new subscribers; others at the next change.
            self._wait(FATE_WITHIN_S, lambda: self._fail(FATE_UNKNOWN))

    async def close(self) -> None:
        self._wait(None, None)

    def _on_speaking(self, message: Any) -> None:
        speaking = self._robot_speaks = decode_bool(message)
        if not self._waiting:
            return
        if speaking and self._adrift and self._waiting[0].started:
            self._adrift = False
            self._wait(
                LONGEST_UTTERANCE_S,
                lambda: self._fail(QT_TR_NOOP("the robot did not report that it finished speaking")),
            )
        elif speaking and not self._waiting[0].started:
            self._start(LONGEST_UTTERANCE_S, QT_TR_NOOP("the robot did not report that it finished speaking"))
        elif speaking and self._in_one_breath:
            # The previous utterance ended, and this is the requested one.
            self._in_one_breath = False
            self._wait(
                LONGEST_UTTERANCE_S,
                lambda: self._fail(QT_TR_NOOP("the robot did not report that it finished speaking")),
            )
        elif not speaking and self._in_one_breath:
            self._wait(STARTED_UNTOLD_S, self._finish)
        elif not speaking and self._waiting[0].started:
            self._finish()
        elif not speaking:
            # It was speaking when the link came back, which was not reported.
            self._expect_start()

    def _expect_start(self) -> None:
        if self._robot_speaks:
            # The requested text follows immediately, or after the present utterance.
            self._in_one_breath = True
            self._start(LONGEST_UTTERANCE_S, QT_TR_NOOP("the robot did not report that it finished speaking"))
        elif self._follows_topic:
            self._wait(
                STARTS_WITHIN_S, lambda: self._fail(QT_TR_NOOP("the robot did not report that it started speaking"))
            )
        else:
            self._start(0.0, "")
            command = self._waiting[0].command
            self._wait(estimated_duration_s(command.text, command.language), self._finish)

    def _start(self, at_most_s: float, detail: str) -> None:
        head = self._waiting.popleft()
        self._waiting.appendleft(replace(head, started=True))
        report_utterance(self._emit, head.command, "started", "", estimated=self._estimates)
        self._wait(at_most_s, lambda: self._fail(detail))

    def _finish(self) -> None:
        report_utterance(self._emit, self._waiting.popleft().command, "finished", "", estimated=self._estimates)
        self._next()

    def _fail(self, detail: str) -> None:
        self._notify(self._waiting.popleft(), "failed", detail)
        self._next()

    @property
    def _estimates(self) -> bool:
        return self._in_one_breath or not self._follows_topic

    def _next(self) -> None:
        self._adrift = self._in_one_breath = False
        self._wait(None, None)
        if self._waiting:
            self._expect_start()

    def _end_all(self, state: UtteranceState, detail: str, actor: Actor | None = None) -> None:
        self._adrift, self._silence_due, self._in_one_breath = False, None, False
        self._wait(None, None)
        while self._waiting:
            report_utterance(self._emit, self._waiting.popleft().command, state, detail, actor)

    def _wait(self, delay_s: float | None, then: Callable[[], None] | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(delay_s, then) if delay_s is not None and then is not None else None

    def _notify(self, utterance: _Utterance, state: UtteranceState, detail: str) -> None:
        report_utterance(self._emit, utterance.command, state, detail)


def report_utterance(
    emit: Callable[[UtteranceChanged], None],
    command: Say,
    state: UtteranceState,
    detail: str = "",
    actor: Actor | None = None,
    *,
    estimated: bool = False,
) -> None:
    """Report an utterance's state. ``actor`` caused it; None: the requester."""
    emit(
        UtteranceChanged(
            now_ns(),
            command.utterance_id,
            "robot",
            command.recorded or command.text,
            command.origin,
            state,
            voice="robot",
            detail=detail,
            actor=command.actor if actor is None else actor,
            person_id=command.person_id,
            estimated=estimated,
        )
    )
