"""Recogniser process: sound in, turns and transcripts out."""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from caris_desktop.conversation.listening.echo import EchoCanceller
from caris_desktop.conversation.listening.endpointing import (
    NoVoiceActivity,
    SilenceOfPeople,
    TurnModel,
    TurnTaking,
    VoiceActivity,
)
from caris_desktop.conversation.listening.engines import (
    Engine,
    EngineUnavailableError,
    LocalEngine,
    NoEngineError,
    PluginEngine,
    Recognised,
)
from caris_desktop.conversation.listening.recogniser_messages import (
    EndTurns,
    RecogniserAway,
    RecogniserFailed,
    RecogniserReady,
    RecogniserSettings,
    SpokenBy,
    UseSilence,
)
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.conversation.listening.speech_segmenter import SpeechSegmenter, TurnInterval
from caris_desktop.conversation.speech_plugins import PLUGIN
from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.model_files import GET_WEIGHTS_ANEW, WrongChecksum
from caris_desktop.domain.plugins import PluginError, switched_off
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, PlayedSound, PlayedSoundEnded
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
_END_WITHIN_S = 0.2
WORDS_THREAD = "words"


class Recognition(Value):
    """Result of an interval; ``text`` is None on failure, with ``away`` if the engine is unavailable."""

    stretch: TurnInterval
    text: Recognised | None
    took_s: float
    away: EngineUnavailableError | None = None


class WordsThread:
    """One interval at a time. ``news`` has RecogniserReady, or a final NoEngineError, and a Recognition per request.

    A plug-in that fails is replaced by the usual engine: ``news`` has its PluginError, and another RecogniserReady.
    ``every_s`` is the minimum interval between requests during continuous speech, for the engine that is ready.
    """

    every_s = 0.5

    def __init__(self, settings: RecogniserSettings) -> None:
        self.news: queue.SimpleQueue[RecogniserReady | NoEngineError | PluginError | Recognition] = queue.SimpleQueue()
        self._requests: queue.SimpleQueue[TurnInterval | None] = queue.SimpleQueue()
        self._settings = settings
        self._thread = threading.Thread(target=self._run, name=WORDS_THREAD, daemon=True)

    def start(self) -> None:
        """Load the engine."""
        self._thread.start()

    def ask(self, stretch: TurnInterval) -> None:
        """Transcribe an interval."""
        self._requests.put(stretch)

    def end(self) -> None:
        """End the thread, without waiting long for a running load or transcription."""
        self._requests.put(None)
        self._thread.join(_END_WITHIN_S)

    def _run(self) -> None:
        try:
            try:
                self._work(self._settings)
            except PluginError as error:
                self.news.put(error)
                self._work(replace(self._settings, engine="local", model="", sha256=""))
        except NoEngineError as error:
            self.news.put(error)

    def _work(self, settings: RecogniserSettings) -> None:
        began_s = time.monotonic()
        engine = open_engine(settings)
        self.every_s = engine.every_s
        self.news.put(RecogniserReady(engine.model, engine.language, time.monotonic() - began_s))
        with contextlib.closing(engine):
            while (stretch := self._requests.get()) is not None:
                began_s, text, away = time.monotonic(), None, None
                try:
                    sound, careful = stretch.sound, stretch.at_pause
                    text = engine.transcribe(sound, stretch.before, careful=careful, voice_s=stretch.voice_s)
                except EngineUnavailableError as error:
                    away = error
                except PluginError:
                    self.news.put(Recognition(stretch, None, time.monotonic() - began_s))
                    raise
                except Exception:
                    _log.exception("%.1f s of sound could not be transcribed", len(stretch.sound) / 16_000)
                self.news.put(Recognition(stretch, text, time.monotonic() - began_s, away))


def open_engine(settings: RecogniserSettings) -> Engine:
    """Open the engine; takes seconds, with a download minutes. Raises NoEngineError, PluginError."""
    if settings.model.startswith(PLUGIN):
        return PluginEngine(settings.model, settings.language)
    if settings.engine == "server":
        from caris_desktop.conversation.listening.server_engine import ServerEngine

        return ServerEngine(settings)
    return LocalEngine(settings)


_POLL_EVERY_S = 0.02
_NO_SOUND_NS = 700_000_000
"""A microphone from which nothing has come for so long is closed, and the turn at it is over."""
_IN_PROGRESS_NS = 300_000_000
"""By so much sound may be late."""
_ROOM = 1.5
"""From one pass to the next it takes so many times as long as a pass does: others want the processor too."""
_PLAYED_AT_MOST = 8


def run_recogniser(connection: Connection, settings: RecogniserSettings) -> None:
    """Process entry point. Sends RecogniserReady or RecogniserFailed first; returns when the connection closes."""
    step_back(settings.niceness)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        _Recogniser(connection, settings).run()


class _Recogniser:
    def __init__(self, connection: Connection, settings: RecogniserSettings) -> None:
        self._connection = connection
        self._bounds = UseSilence()
        self._robot_speech = RobotSpeechFilter()
        self._silence = SilenceOfPeople()
        self._signal = SignalWatch()
        self._turn_model: TurnModel | None = None
        self._words = WordsThread(settings)
        self._segmenters: dict[str, SpeechSegmenter] = {}
        self._turns: list[TurnTaking] = []
        self._played: deque[PlayedSound] = deque(maxlen=_PLAYED_AT_MOST)
        self._ready: RecogniserReady | None = None
        self._transcribing: SpeechSegmenter | None = None
        self._not_before_s = 0.0
        self._away = ""

    def run(self) -> None:
        """Run until the console ends."""
        self._words.start()
        no_text = QT_TR_NOOP("Speech is not transcribed.")
        try:
            VoiceActivity()
            self._turn_model = TurnModel.find()
        except NoVoiceActivity as error:
            self._fail(
                NoEngineError(
                    localized(QT_TR_NOOP("{error}."), error=error), no_text, QT_TR_NOOP("Install it with pip.")
                )
            )
        except WrongChecksum as error:
            self._fail(NoEngineError(str(error), no_text, GET_WEIGHTS_ANEW))
        try:
            while True:
                while self._connection.poll(_POLL_EVERY_S):
                    self._process(self._connection.recv())
                    self._process_news()
                self._process_news()
                # Treat missing sound as silence, so that the last words before a microphone was closed are reported.
                now_ns = clock.now_ns()
                for segmenter in self._segmenters.values():
                    if segmenter.busy and now_ns - segmenter.heard_until_ns > _NO_SOUND_NS:
                        self._signal.closed(segmenter.source)
                        segmenter.add_silence(now_ns - _IN_PROGRESS_NS)
                self._ask()
        finally:
            self._words.end()

    def _process(self, message: Any) -> None:
        match message:
            case AudioChunk():
                self._process_sound(message)
            case PlayedSound():
                self._played.append(message)
                for segmenter in self._segmenters.values():
                    segmenter.canceller.play(message)
            case PlayedSoundEnded():
                for segmenter in self._segmenters.values():
                    segmenter.canceller.play_ended(message)
            case UtteranceChanged():
                self._robot_speech.robot_says(message)
                for segmenter in self._segmenters.values():
                    if message.state == "started":
                        segmenter.another_spoke()
                    elif message.state != "requested":
                        segmenter.another_ended(message.stamp_ns)
                    segmenter.reassign_robot_turns()
            case SpokenBy(utterance_id, person_id):
                self._silence.spoken_by(utterance_id, person_id)
            case EndTurns():
                for source, segmenter in self._segmenters.items():
                    if source != WIZARD_MICROPHONE:
                        segmenter.end_turn()
            case UseSilence() as bounds:
                self._bounds = bounds
                for turns in self._turns:
                    turns.bounds = self._bounds
            case other:
                _log.error("unknown message %r", other)

    def _process_sound(self, chunk: AudioChunk) -> None:
        if self._ready is None:
            return
        segmenter = self._segmenters.get(chunk.source)
        if segmenter is None:
            canceller = EchoCanceller()
            for sound in self._played:
                canceller.play(sound)
            # The wizard's pauses must not affect the participants' delay.
            turns = TurnTaking(SilenceOfPeople() if chunk.source == WIZARD_MICROPHONE else self._silence, self._bounds)
            self._turns.append(turns)
            segmenter = self._segmenters[chunk.source] = SpeechSegmenter(
                chunk.source,
                turns,
                VoiceActivity(),
                canceller=canceller,
                robot_speech=self._robot_speech,
                turn_over=None if self._turn_model is None else self._turn_model.turn_over,
                report=self._connection.send,
            )
        if chunk.source != WIZARD_MICROPHONE:
            peak = int(np.abs(chunk.samples.astype(np.int32)).max(initial=0)) / 32768
            if self._signal.process(chunk.source, chunk.stamp_ns, peak):
                self._connection.send(
                    Problem(
                        clock.now_ns(),
                        "warning",
                        localized(QT_TR_NOOP("No sound is received from the {source}."), source=chunk.source),
                        QT_TR_NOOP("The participant's speech there is neither heard nor transcribed."),
                        QT_TR_NOOP("Check whether it is muted or turned off, or choose another one."),
                        until="quiet",
                    )
                )
        segmenter.process(chunk)
        self._ask()
        segmenter.judge()

    def _ask(self) -> None:
        if self._transcribing is not None or self._ready is None:
            return
        every_s = self._words.every_s if time.monotonic() >= self._not_before_s else float("inf")
        for segmenter in self._segmenters.values():
            stretch = segmenter.next_interval(every_s)
            if stretch is not None:
                self._transcribing = segmenter
                self._words.ask(stretch)
                return

    def _process_news(self) -> None:
        while not self._words.news.empty():
            match self._words.news.get():
                case RecogniserReady() as ready:
                    if self._turn_model is None:
                        detail = QT_TR_NOOP("No endpointing model is available: only silence ends a turn.")
                        ready = replace(ready, detail=detail)
                    self._ready = ready
                    self._connection.send(ready)
                case NoEngineError() as failure:
                    self._fail(failure)
                case PluginError(plugin=plugin, reason=reason):
                    self._connection.send(switched_off(clock.now_ns(), plugin.name, plugin.package, reason))
                case Recognition() as result:
                    segmenter, self._transcribing = self._transcribing, None
                    self._not_before_s = time.monotonic() + (_ROOM - 1) * result.took_s
                    if result.away is not None and not self._away:
                        self._away = result.away.what
                        self._connection.send(RecogniserAway(_problem(result.away)))
                    elif result.away is None and self._away and self._ready is not None:
                        self._away = ""
                        self._connection.send(self._ready)
                    if segmenter is not None:
                        segmenter.add_result(result.stretch, result.text)
                    self._ask()

    def _fail(self, failure: UserFacingError) -> None:
        self._connection.send(RecogniserFailed(_problem(failure)))
        # A restart would fail again; the console closes the connection.
        while True:
            self._connection.recv()


def _problem(failure: UserFacingError) -> Problem:
    return Problem(clock.now_ns(), "warning", failure.what, failure.meaning, failure.advice, until="transcription")


_SILENT = 0.0008
"""A peak, of 1: the noise of a microphone that is on is louder even in a quiet room."""
_REPORT_AFTER_NS = 45_000_000_000


class SignalWatch:
    """Detector for microphones without signal: muted, unplugged at the other end, or the wrong one.

    Reports each microphone once, and again only after a signal.
    """

    def __init__(self) -> None:
        self._received_ns: dict[str, int] = {}
        self._reported: set[str] = set()

    def process(self, source: str, stamp_ns: int, peak: float) -> bool:
        """Add the peak level. True when a missing signal is to be reported."""
        if peak > _SILENT:
            self._received_ns[source] = stamp_ns
            self._reported.discard(source)
            return False
        since_ns = self._received_ns.setdefault(source, stamp_ns)
        if source in self._reported or stamp_ns - since_ns < _REPORT_AFTER_NS:
            return False
        self._reported.add(source)
        return True

    def closed(self, source: str) -> None:
        """Expect no sound from this microphone for now."""
        self._received_ns.pop(source, None)
