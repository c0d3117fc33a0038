"""Robot speech: requested utterances by the profile's backend, and unprompted ones."""

import asyncio
import logging
import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol
from urllib.parse import quote

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import VALUE, fill_template
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.link_commands import Say
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.robot.action_client import FATE_UNKNOWN, FATE_WITHIN_S
from caris_desktop.robot.profile_model import SpeechInterface, SpeechService, SpeechWeb
from caris_desktop.robot.robot_speech import (
    STARTED_UNTOLD_S,
    STARTS_WITHIN_S,
    ActionVoice,
    RobotVoice,
    TopicVoice,
    report_utterance,
)
from caris_desktop.robot.speaking_time import LONGEST_UTTERANCE_S, estimated_duration_s
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect, plain_name, service_type_name, type_name
from caris_desktop.ros.message_conversion import decode_bool, decode_string


class RobotSpeech:
    """Robot speech. ``emit`` gets the reports of all utterances."""

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        speech: SpeechInterface | None,
        *,
        emit: Callable[[UtteranceChanged], None],
    ) -> None:
        self._voice = _voice_of(ros, dialect, speech, emit)
        self._unprompted = UnpromptedSpeech(ros, dialect, speech.says if speech is not None else None, emit=emit)

    def say(self, command: Say) -> None:
        """Request speech now, or after the present utterance."""
        self._unprompted.note_requested(command.text)
        self._voice.say(command)

    def silence(self, actor: Actor) -> bool:
        """Interrupt speech. False if the robot does not support it."""
        return self._voice.silence(actor)

    def link_lost(self) -> None:
        self._voice.link_lost()

    def link_connected(self) -> None:
        self._voice.link_connected()

    async def close(self) -> None:
        self._unprompted.close()
        await self._voice.close()


def _voice_of(
    ros: RosbridgeClient, dialect: Dialect, speech: SpeechInterface | None, emit: Callable[[UtteranceChanged], None]
) -> RobotVoice:
    if speech is not None and speech.action is not None:
        return ActionVoice(ros, dialect, speech.action, emit=emit)
    speaker: SpeechBackend
    if speech is not None and speech.service is not None:
        speaker, at_end = ServiceSpeaker(ros, dialect, speech.service), speech.service.answers_at_end
        return RequestSpeech(ros, dialect, speech, speaker, answers_at_end=at_end, emit=emit)
    if speech is not None and speech.web is not None:
        speaker, at_end = WebSpeaker(speech.web), speech.web.answers_at_end
        return RequestSpeech(ros, dialect, speech, speaker, answers_at_end=at_end, emit=emit)
    return TopicVoice(ros, dialect, speech, emit=emit)


LONGEST_TEXT = 1000
_MAX_REQUESTS = 100
_PART_AT_LEAST = 8


class UnpromptedSpeech:
    """Unprompted speech of the robot, reported on its own topic and recorded as the robot's utterances.

    Reports the robot's own sentences; requested ones are reported by its speech backend.

    The robot does not report their end, so both times are estimated.
    """

    def __init__(
        self, ros: RosbridgeClient, dialect: Dialect, topic: str | None, *, emit: Callable[[UtteranceChanged], None]
    ) -> None:
        self._emit = emit
        self._requested: deque[tuple[int, str]] = deque(maxlen=_MAX_REQUESTS)
        self._now: UtteranceChanged | None = None
        self._timer: asyncio.TimerHandle | None = None
        if topic is not None:
            listening = RosbridgeTopic(
                ros, topic, type_name(dialect, "std_msgs", "String"), queue_length=10, every_message=True
            )
            listening.subscribe(self._on_message)

    def note_requested(self, text: str) -> None:
        """Note a requested text."""
        self._requested.append((now_ns(), _plain(text)))

    def close(self) -> None:
        self._finish()

    def _on_message(self, message: Any) -> None:
        text = " ".join(decode_string(message).split())[:LONGEST_TEXT]
        if not text or self._was_requested(text):
            return
        self._finish()
        self._now = UtteranceChanged(
            now_ns(), f"r-{secrets.token_hex(4)}", "robot", text, "heard", "started", voice="robot", estimated=True
        )
        self._emit(self._now)
        self._timer = asyncio.get_running_loop().call_later(estimated_duration_s(text), self._finish)

    def _was_requested(self, text: str) -> bool:
        since_ns = now_ns() - int(LONGEST_UTTERANCE_S * 1e9)
        plain = _plain(text)
        recent = [text for at_ns, text in self._requested if at_ns > since_ns]
        # Some robots report a long text in parts.
        return plain in recent or (len(plain) >= _PART_AT_LEAST and any(plain in text for text in recent))

    def _finish(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        ended, self._now, self._timer = self._now, None, None
        if ended is not None:
            self._emit(replace(ended, stamp_ns=now_ns(), state="finished"))


def _plain(text: str) -> str:
    return "".join(character for character in text.casefold() if character.isalnum())


_log = logging.getLogger(__name__)

SPEECH_ANSWERS_WITHIN_S = 5.0
_CONNECTS_WITHIN_S = 3.0


class SpeechRefusedError(Exception):
    """The robot refuses or fails to speak; the reason is for the wizard."""


class SpeechBackend(Protocol):
    """Speech backend of the robot."""

    can_stop: bool
    needs_link: bool

    async def say(self, text: str, *, within_s: float) -> None:
        """Speak; returns when the robot answers. Raises SpeechRefusedError."""

    async def stop(self) -> None:
        """Stop speaking. Raises SpeechRefusedError."""

    async def close(self) -> None:
        """Close the backend."""


class RequestSpeech:
    """Speaks one utterance at a time: repeated requests might be spoken twice at once. ``emit`` as of other voices.

    The end is known from the robot's ``speaking`` topic if there is one, else from its answer, else estimated.
    """

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        speech: SpeechInterface,
        speaker: SpeechBackend,
        *,
        answers_at_end: bool,
        emit: Callable[[UtteranceChanged], None],
    ) -> None:
        self._speaker = speaker
        self._answers_at_end = answers_at_end
        self._emit = emit
        self._waiting: deque[Say] = deque()
        self._worker: asyncio.Task[None] | None = None
        self._others: set[asyncio.Task[None]] = set()
        self._speaking = asyncio.Event()
        self._quiet = asyncio.Event()
        self._quiet.set()
        self._start_due: asyncio.Timeout | None = None
        self._linked = self._stop_due = False
        self._fate: asyncio.TimerHandle | None = None
        self._follows = speech.speaking is not None
        if speech.speaking is not None:
            kind = type_name(dialect, "std_msgs", "Bool")
            topic = RosbridgeTopic(ros, speech.speaking, kind, queue_length=10, every_message=True)
            topic.subscribe(self._on_speaking)

    def say(self, command: Say) -> None:
        self._waiting.append(command)
        self._begin()

    def silence(self, actor: Actor) -> bool:
        unheard = self._fate is not None or (not self._linked and (self._follows or self._speaker.needs_link))
        interrupted, self._waiting = list(self._waiting), deque()
        if interrupted and not unheard and not self._speaker.can_stop:
            self._waiting.append(interrupted.pop(0))
        elif interrupted:
            self._give_up()
            self._stop_due = True
            self._stop_if_due()
        if interrupted and unheard:
            report_utterance(self._emit, interrupted.pop(0), "failed", FATE_UNKNOWN, actor)
        for command in interrupted:
            report_utterance(self._emit, command, "interrupted", actor=actor)
        return not self._waiting

    def link_lost(self) -> None:
        """The robot continues to speak. Its reported end is awaited with the usual timeout."""
        self._linked = False
        self._speaking.clear()
        if self._follows and self._worker is not None:
            self._wait_for_fate()

    def link_connected(self) -> None:
        """Nothing is requested twice."""
        self._linked = True
        self._stop_if_due()
        if self._fate is not None:
            self._wait_for_fate()

    async def close(self) -> None:
        self._give_up()
        for task in list(self._others):
            task.cancel()
        await self._speaker.close()

    def _begin(self) -> None:
        if self._worker is None and self._waiting:
            self._worker = asyncio.get_running_loop().create_task(self._speak_all())

    def _give_up(self) -> None:
        self._forget_fate()
        if self._worker is not None:
            self._worker.cancel()
            self._worker = None

    def _wait_for_fate(self) -> None:
        self._forget_fate()
        self._fate = asyncio.get_running_loop().call_later(FATE_WITHIN_S, self._on_fate_untold)

    def _forget_fate(self) -> None:
        if self._fate is not None:
            self._fate.cancel()
            self._fate = None

    def _on_fate_untold(self) -> None:
        self._give_up()
        report_utterance(self._emit, self._waiting.popleft(), "failed", FATE_UNKNOWN)
        self._begin()

    def _stop_if_due(self) -> None:
        if self._stop_due and (self._linked or not self._speaker.needs_link):
            self._stop_due = False
            stopping = asyncio.get_running_loop().create_task(self._stop())
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
                report_utterance(self._emit, command, "failed", str(error))
            except Exception as error:
                _log.exception("an utterance of the robot failed")
                report_utterance(self._emit, command, "failed", str(error))
            self._forget_fate()
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
            report_utterance(self._emit, command, "started", estimated=True)
            await self._speaker.say(command.text, within_s=within_s)
            report_utterance(self._emit, command, "finished")
        else:
            await self._speaker.say(command.text, within_s=within_s)
            report_utterance(self._emit, command, "started", estimated=True)
            await asyncio.sleep(estimated_duration_s(command.text, command.language))
            report_utterance(self._emit, command, "finished", estimated=True)

    async def _followed(self, command: Say, answer: "asyncio.Future[Any]") -> None:
        # The robot is already speaking: the new text follows immediately, or after it.
        already = self._speaking.is_set()
        if already:
            await answer
        else:
            await self._begun(answer)
        report_utterance(self._emit, command, "started", estimated=already)
        try:
            async with asyncio.timeout(LONGEST_UTTERANCE_S):
                await self._quiet.wait()
                if already and await self._speaks_again():
                    already = False
                    await self._quiet.wait()
        except TimeoutError:
            raise SpeechRefusedError("the robot did not report that it finished speaking") from None
        report_utterance(self._emit, command, "finished", estimated=already)

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
            raise SpeechRefusedError("the robot did not report that it started speaking") from None
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
            self._start_due.reschedule(asyncio.get_running_loop().time() + STARTS_WITHIN_S)


class ServiceSpeaker:
    """Backend that calls a ROS service."""

    needs_link = True

    def __init__(self, ros: RosbridgeClient, dialect: Dialect, service: SpeechService) -> None:
        self._ros = ros
        self._service_settings = service
        package, _, name = plain_name(service.type).partition("/")
        self._kind = service_type_name(dialect, package, name)
        self._stop_kind = service_type_name(dialect, "std_srvs", "Trigger")
        self.can_stop = service.stop is not None

    async def say(self, text: str, *, within_s: float) -> None:
        await self._ask(
            self._service_settings.name, self._kind, fill_template(self._service_settings.request, text), within_s
        )

    async def stop(self) -> None:
        if self._service_settings.stop is not None:
            await self._ask(self._service_settings.stop, self._stop_kind, {}, SPEECH_ANSWERS_WITHIN_S)

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
