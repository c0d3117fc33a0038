"""Robot speech: requested utterances by topic, action, service or web interface, and unprompted ones."""

import asyncio
import logging
import secrets
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from urllib.parse import quote

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import VALUE, fill_template
from caris_desktop.domain.events import UtteranceChanged, UtteranceState
from caris_desktop.domain.link_commands import Say
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.robot.action_client import FATE_UNKNOWN, FATE_WITHIN_S, make_action_client
from caris_desktop.robot.profile_model import SpeechAction, SpeechInterface, SpeechService, SpeechWeb
from caris_desktop.robot.speaking_time import LONGEST_UTTERANCE_S, estimated_duration_s
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.action_messages import Ending
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import decode_bool, decode_string, encode_string
from caris_desktop.ros.message_fields import Message

_log = logging.getLogger(__name__)

STARTS_WITHIN_S = 4.0
STARTED_UNTOLD_S = 1.0
SPEECH_ANSWERS_WITHIN_S = 5.0
_CONNECTS_WITHIN_S = 3.0
LONGEST_TEXT = 1000
_MAX_REQUESTS = 100
_PART_AT_LEAST = 8
_NOT_CONNECTED = QT_TR_NOOP("the robot is not connected")
_NOT_STARTED = QT_TR_NOOP("the robot did not report that it started speaking")
_NOT_FINISHED = QT_TR_NOOP("the robot did not report that it finished speaking")

Emit = Callable[[UtteranceChanged], None]


def robot_voice(ros: RosbridgeClient, speech: SpeechInterface | None, *, emit: Emit) -> "RobotVoice":
    """Speech by the profile's interface."""
    if speech is not None and speech.action is not None:
        return ActionVoice(ros, speech, speech.action, emit=emit)
    if speech is not None and speech.service is not None:
        backend: ServiceSpeaker | WebSpeaker = ServiceSpeaker(ros, speech.service)
        return RequestSpeech(ros, speech, backend, answers_at_end=speech.service.answers_at_end, emit=emit)
    if speech is not None and speech.web is not None:
        backend = WebSpeaker(speech.web)
        return RequestSpeech(ros, speech, backend, answers_at_end=speech.web.answers_at_end, emit=emit)
    return TopicVoice(ros, speech, emit=emit)


class RobotVoice(ABC):
    """Robot speech: a queue of requested utterances, of which the first is being spoken, and unprompted ones.

    ``emit`` gets an UtteranceChanged for each utterance at its start and end. Its request is reported by the requester.
    """

    def __init__(self, ros: RosbridgeClient, speech: SpeechInterface | None, *, emit: Emit) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = ros
        self._emit = emit
        self._waiting: deque[Say] = deque()
        self._started = False
        # The link was lost meanwhile.
        self._adrift = False
        self._silence_due: Actor | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._unprompted = UnpromptedSpeech(ros, speech.says if speech is not None else None, emit=emit)

    def say(self, command: Say) -> None:
        """Request speech now, or after the present utterance."""
        self._unprompted.note_requested(command.text)
        self._request(command)

    @abstractmethod
    def _request(self, command: Say) -> None:
        """Request speech."""

    @abstractmethod
    def silence(self, actor: Actor) -> bool:
        """Interrupt speech. False if the robot does not support it."""

    @abstractmethod
    def link_lost(self) -> None:
        """The robot continues to speak; the outcome is reported when known."""

    @abstractmethod
    def link_connected(self) -> None:
        """The robot reports again."""

    async def close(self) -> None:
        """End all requests and reports."""
        self._unprompted.finish()
        self._wait_no_more()

    def _fail(self, detail: str) -> None:
        """The present utterance failed; go on with the next one."""
        raise NotImplementedError

    def _end_all(self, state: UtteranceState, detail: str, actor: Actor | None = None) -> None:
        self._silence_due = None
        while self._waiting:
            self._end(state, detail, actor)

    def _end(
        self, state: UtteranceState, detail: str = "", actor: Actor | None = None, *, estimated: bool = False
    ) -> None:
        self._started = self._adrift = False
        self._wait_no_more()
        self._report(self._waiting.popleft(), state, detail, actor, estimated=estimated)

    def _report(
        self,
        command: Say,
        state: UtteranceState,
        detail: str = "",
        actor: Actor | None = None,
        *,
        estimated: bool = False,
    ) -> None:
        """Report an utterance's state. ``actor`` caused it; None: the requester."""
        self._emit(command.reported(now_ns(), state, "robot", detail=detail, actor=actor, estimated=estimated))

    def _wait(self, delay_s: float, then: Callable[[], None]) -> None:
        self._wait_no_more()
        self._timer = self._loop.call_later(delay_s, then)

    def _wait_no_more(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _await_start(self, within_s: float) -> None:
        self._wait(within_s, lambda: self._fail(_NOT_STARTED))

    def _await_end(self) -> None:
        self._wait(LONGEST_UTTERANCE_S, lambda: self._fail(_NOT_FINISHED))


class ActionVoice(RobotVoice):
    """Speech through an action, whose result is the end of the utterance.

    One goal at a time: typical action servers drop the present goal for a new one.
    """

    def __init__(self, ros: RosbridgeClient, speech: SpeechInterface, action: SpeechAction, *, emit: Emit) -> None:
        super().__init__(ros, speech, emit=emit)
        self._goal = action.goal
        self._wire_id: str | None = None
        self._client = make_action_client(ros, action.name, action.type, self)

    def _request(self, command: Say) -> None:
        if not self._ros.is_connected:
            self._report(command, "failed", _NOT_CONNECTED)
            return
        self._waiting.append(command)
        if len(self._waiting) == 1:
            self._send_next()

    def silence(self, actor: Actor) -> bool:
        if not self._ros.is_connected:
            self._silence_due = actor if self._wire_id is not None else None
            return False
        if self._wire_id is not None:
            self._client.cancel(self._wire_id)
        self._wire_id = None
        self._end_all("interrupted", "", actor)
        return True

    def link_lost(self) -> None:
        head, unsent = list(self._waiting)[:1], list(self._waiting)[1:]
        self._waiting = deque(head)
        if head:
            self._adrift = True
            self._wait(FATE_WITHIN_S, lambda: self._finish("failed", FATE_UNKNOWN))
        for command in unsent:
            self._report(command, "failed", QT_TR_NOOP("the connection to the robot was lost"))

    def link_connected(self) -> None:
        due, self._silence_due = self._silence_due, None
        if due is not None:
            self.silence(due)
        elif self._adrift:
            self._wait(FATE_WITHIN_S, lambda: self._fail(FATE_UNKNOWN))

    def goal_pending(self, wire_id: str) -> None:
        if wire_id == self._wire_id and not self._started:
            # The robot is saying something else first.
            self._await_start(LONGEST_UTTERANCE_S)

    def goal_active(self, wire_id: str, *, estimated: bool = False) -> None:
        if wire_id != self._wire_id:
            return
        if not self._started:
            self._started = True
            self._report(self._waiting[0], "started", estimated=estimated)
        elif not self._adrift:
            return
        self._adrift = False
        self._await_end()

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
        command = self._waiting[0]
        self._wire_id = self._client.send(command.utterance_id, fill_template(self._goal, command.text))
        if self._wire_id is None:
            self._end_all("failed", _NOT_CONNECTED)
        elif self._ros.dialect is Dialect.ROS1:
            self._await_start(STARTS_WITHIN_S)
        else:
            # rosbridge does not report acceptance of a goal, and answers when it was refused.
            wire_id = self._wire_id
            self._wait(STARTED_UNTOLD_S, lambda: self.goal_active(wire_id, estimated=True))

    def _fail(self, detail: str) -> None:
        if self._wire_id is not None:
            self._client.cancel(self._wire_id)
        self._finish("failed", detail)

    def _finish(self, state: UtteranceState, detail: str, actor: Actor | None = None) -> None:
        self._wire_id = self._silence_due = None
        self._end(state, detail, actor)
        if self._waiting:
            self._send_next()


class TopicVoice(RobotVoice):
    """Speech through a topic, tracked by the robot's ``speaking`` topic, or else by an estimate."""

    def __init__(self, ros: RosbridgeClient, speech: SpeechInterface | None, *, emit: Emit) -> None:
        super().__init__(ros, speech, emit=emit)
        self._say: RosbridgeTopic | None = None
        self._stop: RosbridgeTopic | None = None
        self._follows_topic = self._robot_speaks = self._in_one_breath = False
        if speech is None or speech.topic is None:
            return
        self._say = RosbridgeTopic(ros, speech.topic, "std_msgs/String")
        self._say.advertise()
        if speech.stop:
            self._stop = RosbridgeTopic(ros, speech.stop, "std_msgs/Empty")
            self._stop.advertise()
        if speech.speaking:
            self._follows_topic = True
            _follow(ros, speech.speaking, self._on_speaking)

    def _request(self, command: Say) -> None:
        if self._say is None:
            self._report(command, "failed", QT_TR_NOOP("this robot's profile does not define a voice"))
        elif not self._say.publish(encode_string(command.text)):
            self._report(command, "failed", _NOT_CONNECTED)
        else:
            self._waiting.append(command)
            if len(self._waiting) == 1:
                self._expect_start()

    def silence(self, actor: Actor) -> bool:
        if not self._ros.is_connected:
            self._silence_due = actor if self._waiting else None
            return False
        stopped = self._stop is not None and self._stop.publish({})
        if stopped:
            self._in_one_breath = False
            self._end_all("interrupted", "", actor)
        return stopped

    def link_lost(self) -> None:
        self._robot_speaks = False
        if self._waiting and self._follows_topic:
            self._adrift = True
            self._wait(FATE_WITHIN_S, self._lose_all)

    def link_connected(self) -> None:
        due, self._silence_due = self._silence_due, None
        if due is not None:
            self.silence(due)
        if self._adrift:
            # Many robots publish the state to new subscribers; others at the next change.
            self._wait(FATE_WITHIN_S, lambda: self._fail(FATE_UNKNOWN))

    def _lose_all(self) -> None:
        self._in_one_breath = False
        self._end_all("failed", FATE_UNKNOWN)

    def _on_speaking(self, message: Any) -> None:
        speaking = self._robot_speaks = decode_bool(message)
        if not self._waiting:
            return
        if speaking and self._adrift and self._started:
            self._adrift = False
            self._await_end()
        elif speaking and not self._started:
            self._start()
        elif speaking and self._in_one_breath:
            # The previous utterance ended, and this is the requested one.
            self._in_one_breath = False
            self._await_end()
        elif not speaking and self._in_one_breath:
            self._wait(STARTED_UNTOLD_S, self._finish)
        elif not speaking and self._started:
            self._finish()
        elif not speaking:
            # It was speaking when the link came back, which was not reported.
            self._expect_start()

    def _expect_start(self) -> None:
        if self._robot_speaks:
            # The requested text follows immediately, or after the present utterance.
            self._in_one_breath = True
            self._start()
        elif self._follows_topic:
            self._await_start(STARTS_WITHIN_S)
        else:
            self._start()
            command = self._waiting[0]
            self._wait(estimated_duration_s(command.text, command.language), self._finish)

    def _start(self) -> None:
        self._started = True
        self._report(self._waiting[0], "started", estimated=self._in_one_breath or not self._follows_topic)
        self._await_end()

    def _finish(self) -> None:
        self._go_on("finished", estimated=self._in_one_breath or not self._follows_topic)

    def _fail(self, detail: str) -> None:
        self._go_on("failed", detail)

    def _go_on(self, state: UtteranceState, detail: str = "", *, estimated: bool = False) -> None:
        self._end(state, detail, estimated=estimated)
        self._in_one_breath = False
        if self._waiting:
            self._expect_start()


def _follow(ros: RosbridgeClient, speaking: str, on_speaking: Callable[[Any], None]) -> None:
    """Subscribe to the topic on which the robot reports that it speaks."""
    RosbridgeTopic(ros, speaking, "std_msgs/Bool", queue_length=10, every_message=True).subscribe(on_speaking)


class SpeechRefusedError(Exception):
    """The robot refuses or fails to speak; the reason is for the wizard."""


class RequestSpeech(RobotVoice):
    """Speaks one utterance at a time: repeated requests might be spoken twice at once.

    The end is known from the robot's ``speaking`` topic if there is one, else from its answer, else estimated.
    """

    def __init__(
        self,
        ros: RosbridgeClient,
        speech: SpeechInterface,
        speaker: "ServiceSpeaker | WebSpeaker",
        *,
        answers_at_end: bool,
        emit: Emit,
    ) -> None:
        super().__init__(ros, speech, emit=emit)
        self._speaker = speaker
        self._answers_at_end = answers_at_end
        self._worker: asyncio.Task[None] | None = None
        self._others: set[asyncio.Task[None]] = set()
        self._speaking = asyncio.Event()
        self._quiet = asyncio.Event()
        self._quiet.set()
        self._start_due: asyncio.Timeout | None = None
        self._linked = self._stop_due = False
        self._follows = speech.speaking is not None
        if speech.speaking is not None:
            _follow(ros, speech.speaking, self._on_speaking)

    def _request(self, command: Say) -> None:
        self._waiting.append(command)
        self._begin()

    def silence(self, actor: Actor) -> bool:
        unheard = self._timer is not None or (not self._linked and (self._follows or self._speaker.needs_link))
        interrupted, self._waiting = list(self._waiting), deque()
        if interrupted and not unheard and not self._speaker.can_stop:
            self._waiting.append(interrupted.pop(0))
        elif interrupted:
            self._give_up()
            self._stop_due = True
            self._stop_if_due()
        if interrupted and unheard:
            self._report(interrupted.pop(0), "failed", FATE_UNKNOWN, actor)
        for command in interrupted:
            self._report(command, "interrupted", actor=actor)
        return not self._waiting

    def link_lost(self) -> None:
        """The robot continues to speak. Its reported end is awaited with the usual timeout."""
        self._linked = False
        self._speaking.clear()
        if self._follows and self._worker is not None:
            self._wait(FATE_WITHIN_S, self._on_fate_untold)

    def link_connected(self) -> None:
        """Nothing is requested twice."""
        self._linked = True
        self._stop_if_due()
        if self._timer is not None:
            self._wait(FATE_WITHIN_S, self._on_fate_untold)

    async def close(self) -> None:
        await super().close()
        self._give_up()
        for task in list(self._others):
            task.cancel()
        await self._speaker.close()

    def _begin(self) -> None:
        if self._worker is None and self._waiting:
            self._worker = self._loop.create_task(self._speak_all())

    def _give_up(self) -> None:
        self._wait_no_more()
        if self._worker is not None:
            self._worker.cancel()
            self._worker = None

    def _on_fate_untold(self) -> None:
        self._give_up()
        self._report(self._waiting.popleft(), "failed", FATE_UNKNOWN)
        self._begin()

    def _stop_if_due(self) -> None:
        if self._stop_due and (self._linked or not self._speaker.needs_link):
            self._stop_due = False
            stopping = self._loop.create_task(self._stop())
            self._others.add(stopping)
            stopping.add_done_callback(self._others.discard)

    async def _stop(self) -> None:
        try:
            await self._speaker.stop()
        except SpeechRefusedError as error:
            _log.warning("the robot's voice was not silenced: %s", error)

    async def _speak_all(self) -> None:
        while self._waiting:
            command = self._waiting[0]
            try:
                await self._speak_one(command)
            except SpeechRefusedError as error:
                self._report(command, "failed", str(error))
            except Exception as error:
                _log.exception("an utterance of the robot failed")
                self._report(command, "failed", str(error))
            self._wait_no_more()
            self._waiting.popleft()
        self._worker = None

    async def _speak_one(self, command: Say) -> None:
        within_s = LONGEST_UTTERANCE_S if self._answers_at_end else SPEECH_ANSWERS_WITHIN_S
        if self._follows and not (self._answers_at_end and self._speaking.is_set()):
            answer: asyncio.Future[Any] = asyncio.ensure_future(self._speaker.say(command.text, within_s=within_s))
            try:
                await self._followed(command, answer)
            finally:
                answer.cancel()
                # A failure during speech, as with the link, does not show what was audible.
                answer.add_done_callback(lambda done: done.cancelled() or done.exception())
        elif self._answers_at_end:
            self._report(command, "started", estimated=True)
            await self._speaker.say(command.text, within_s=within_s)
            self._report(command, "finished")
        else:
            await self._speaker.say(command.text, within_s=within_s)
            self._report(command, "started", estimated=True)
            await asyncio.sleep(estimated_duration_s(command.text, command.language))
            self._report(command, "finished", estimated=True)

    async def _followed(self, command: Say, answer: "asyncio.Future[Any]") -> None:
        # The robot is already speaking: the new text follows immediately, or after it.
        already = self._speaking.is_set()
        if already:
            await answer
        else:
            await self._begun(answer)
        self._report(command, "started", estimated=already)
        try:
            async with asyncio.timeout(LONGEST_UTTERANCE_S):
                await self._quiet.wait()
                if already and await self._speaks_again():
                    already = False
                    await self._quiet.wait()
        except TimeoutError:
            raise SpeechRefusedError(_NOT_FINISHED) from None
        self._report(command, "finished", estimated=already)

    async def _begun(self, answer: "asyncio.Future[Any]") -> None:
        started: asyncio.Future[Any] = asyncio.ensure_future(self._speaking.wait())
        try:
            async with asyncio.timeout(STARTS_WITHIN_S) as self._start_due:
                await asyncio.wait({started, answer}, return_when=asyncio.FIRST_COMPLETED)
                if answer.done():
                    # A refusal, or an answer before the robot reports that it speaks.
                    answer.result()
                await started
        except TimeoutError:
            raise SpeechRefusedError(_NOT_STARTED) from None
        finally:
            self._start_due = None
            started.cancel()

    async def _speaks_again(self) -> bool:
        try:
            async with asyncio.timeout(STARTED_UNTOLD_S):
                return await self._speaking.wait()
        except TimeoutError:
            return False

    def _on_speaking(self, message: Any) -> None:
        if decode_bool(message):
            self._quiet.clear()
            self._speaking.set()
            return
        self._speaking.clear()
        self._quiet.set()
        if self._start_due is not None and self._start_due.when() is not None:
            # It was speaking when the link came back, which was not reported.
            self._start_due.reschedule(self._loop.time() + STARTS_WITHIN_S)


class ServiceSpeaker:
    """Backend that calls a ROS service."""

    needs_link = True

    def __init__(self, ros: RosbridgeClient, service: SpeechService) -> None:
        self._ros = ros
        self._service_settings = service
        self.can_stop = service.stop is not None

    async def say(self, text: str, *, within_s: float) -> None:
        await self._ask(
            self._service_settings.name,
            self._service_settings.type,
            fill_template(self._service_settings.request, text),
            within_s,
        )

    async def stop(self) -> None:
        """Stop speaking. Raises SpeechRefusedError."""
        if self._service_settings.stop is not None:
            await self._ask(self._service_settings.stop, "std_srvs/Trigger", {}, SPEECH_ANSWERS_WITHIN_S)

    async def close(self) -> None:
        """The link closes."""

    async def _ask(self, name: str, kind: str, request: Any, within_s: float) -> None:
        try:
            answer = await self._ros.ask(name, kind, request, timeout_s=within_s)
        except ServiceCallError as error:
            raise SpeechRefusedError(str(error)) from error
        if answer.get("success", True) is False:
            message = answer.get("message")
            raise SpeechRefusedError(
                message[:200] if isinstance(message, str) and message else QT_TR_NOOP("the robot refused")
            )


class WebSpeaker:
    """Backend that calls a web interface, only at the profile's address, without redirects or proxies."""

    needs_link = False

    def __init__(self, web: SpeechWeb) -> None:
        self._web_settings = web
        self._client: Any = None
        self.can_stop = web.stop is not None

    async def say(self, text: str, *, within_s: float) -> None:
        url = self._web_settings.url.replace(VALUE, quote(text, safe=""))
        if self._web_settings.body is None:
            await self._ask("GET", url, within_s)
        else:
            await self._ask("POST", url, within_s, json=fill_template(self._web_settings.body, text))

    async def stop(self) -> None:
        if self._web_settings.stop is not None:
            await self._ask("POST", self._web_settings.stop, SPEECH_ANSWERS_WITHIN_S)

    async def close(self) -> None:
        if self._client is not None:
            await self._client.aclose()

    async def _ask(self, method: str, url: str, within_s: float, **content: Any) -> None:
        # Late import, as few robots need it, and it takes 0.1 s.
        import httpx

        if self._client is None:
            timeout = httpx.Timeout(within_s, connect=_CONNECTS_WITHIN_S)
            self._client = httpx.AsyncClient(timeout=timeout, follow_redirects=False, trust_env=False)
        try:
            async with (
                asyncio.timeout(within_s + _CONNECTS_WITHIN_S),
                # The response body is not read: it may be long.
                self._client.stream(method, url, timeout=within_s, **content) as response,
            ):
                if not response.is_success:
                    raise SpeechRefusedError(f"the robot's web interface responded with {response.status_code}")
        except (TimeoutError, httpx.TimeoutException):
            raise SpeechRefusedError("the robot's web interface does not respond") from None
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise SpeechRefusedError(f"the robot's web interface cannot be reached ({error})") from error


class UnpromptedSpeech:
    """Unprompted speech of the robot, reported on its own topic and recorded as the robot's utterances.

    Reports the robot's own sentences; requested ones are reported by its speech backend.

    The robot does not report their end, so both times are estimated.
    """

    def __init__(self, ros: RosbridgeClient, topic: str | None, *, emit: Emit) -> None:
        self._emit = emit
        self._requested: deque[tuple[int, str]] = deque(maxlen=_MAX_REQUESTS)
        self._now: UtteranceChanged | None = None
        self._timer: asyncio.TimerHandle | None = None
        if topic is not None:
            listening = RosbridgeTopic(ros, topic, "std_msgs/String", queue_length=10, every_message=True)
            listening.subscribe(self._on_message)

    def note_requested(self, text: str) -> None:
        """Note a requested text."""
        self._requested.append((now_ns(), _plain(text)))

    def _on_message(self, message: Any) -> None:
        text = " ".join(decode_string(message).split())[:LONGEST_TEXT]
        if not text or self._was_requested(text):
            return
        self.finish()
        self._now = UtteranceChanged(
            now_ns(), f"r-{secrets.token_hex(4)}", "robot", text, "heard", "started", voice="robot", estimated=True
        )
        self._emit(self._now)
        self._timer = asyncio.get_running_loop().call_later(estimated_duration_s(text), self.finish)

    def _was_requested(self, text: str) -> bool:
        since_ns = now_ns() - int(LONGEST_UTTERANCE_S * 1e9)
        plain = _plain(text)
        recent = [text for at_ns, text in self._requested if at_ns > since_ns]
        # Some robots report a long text in parts.
        return plain in recent or (len(plain) >= _PART_AT_LEAST and any(plain in text for text in recent))

    def finish(self) -> None:
        """End the present utterance."""
        if self._timer is not None:
            self._timer.cancel()
        ended, self._now, self._timer = self._now, None, None
        if ended is not None:
            self._emit(replace(ended, stamp_ns=now_ns(), state="finished"))


def _plain(text: str) -> str:
    return "".join(character for character in text.casefold() if character.isalnum())
