"""Recognition thread, so that voice activity detection continues during transcription."""

import contextlib
import logging
import queue
import threading
import time
from dataclasses import replace

from caris_desktop.conversation.listening.engine import Engine, EngineUnavailableError, NoEngineError, Recognised
from caris_desktop.conversation.listening.heard_turn import TurnInterval
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.speech_plugins import PLUGIN
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
_END_WITHIN_S = 0.2
WORDS_THREAD = "words"


class WordsReady(Value):
    """The engine is loaded. ``every_s`` is the minimum interval between requests during continuous speech."""

    model: str
    language: str
    every_s: float
    load_s: float


class Recognition(Value):
    """Result of an interval; ``text`` is None on failure, with ``away`` if the engine is unavailable."""

    stretch: TurnInterval
    text: Recognised | None
    took_s: float
    away: EngineUnavailableError | None = None


class WordsThread:
    """One interval at a time. ``news`` has WordsReady, or a final NoEngineError, and a Recognition per request.

    A plug-in that fails is replaced by the usual engine: ``news`` has its PluginError, and another WordsReady.
    """

    def __init__(self, settings: RecogniserSettings) -> None:
        self.news: queue.SimpleQueue[WordsReady | NoEngineError | PluginError | Recognition] = queue.SimpleQueue()
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
        self.news.put(WordsReady(engine.model, engine.language, engine.every_s, time.monotonic() - began_s))
        with contextlib.closing(engine):
            while (stretch := self._requests.get()) is not None:
                self._make_out(engine, stretch)

    def _make_out(self, engine: Engine, stretch: TurnInterval) -> None:
        began_s, text, away = time.monotonic(), None, None
        try:
            text = engine.transcribe(stretch.sound, stretch.before, careful=stretch.at_pause, voice_s=stretch.voice_s)
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
        from caris_desktop.conversation.listening.plugin_engine import PluginEngine

        return PluginEngine(settings.model, settings.language)
    if settings.engine == "server":
        from caris_desktop.conversation.listening.server_engine import ServerEngine

        return ServerEngine(settings)
    from caris_desktop.conversation.listening.local_engine import LocalEngine

    return LocalEngine(settings)
