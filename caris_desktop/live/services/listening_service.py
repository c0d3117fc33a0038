"""Speech recognition service: runs the recogniser while a permitted microphone is open. GUI thread unless stated
otherwise.
"""

import pickle
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from caris_desktop.conversation.listening.recogniser_messages import (
    EndTurns,
    RecogniserAway,
    RecogniserFailed,
    RecogniserReady,
    SpokenBy,
    UseSilence,
)
from caris_desktop.domain import clock
from caris_desktop.domain.events import Gap, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, WIZARD_MICROPHONE, PlayedSound, PlayedSoundEnded
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.service import (
    ContextService,
    Follows,
    Restarts,
    ServiceContext,
    SupervisedProcess,
    localize_problem,
)
from caris_desktop.live.status import ListeningStatus, RecordingStatus, SoundStatus
from caris_desktop.scenario.scenario_model import Scenario

_GRACE_S = 1.0
_LOADS_AFTER_MS = 2000
"""Loading a recogniser occupies a processor for seconds: the window comes first, and a further scenario change is not
delayed.
"""


class ListeningService(ContextService):
    """``body`` returns the recogniser process of a scenario."""

    def __init__(self, context: ServiceContext, body: Callable[[Scenario], ProcessSpec]) -> None:
        super().__init__(context)
        self._body_of = body
        self._body: ProcessSpec | None = None
        self._feed: ListeningFeed | None = None
        self._to_recogniser: ListeningFeed | None = None
        """The same once it is ready; the taps read it in their threads."""
        self._to_dictate = True
        """Whether the wizard's voice is for the Speak field, and not heard from the robot anyway."""
        self._silence = UseSilence(0.3, 3.0)
        self._process = SupervisedProcess(
            self._children, ended=self._on_ended, on_message=self.on_heard, grace_s=_GRACE_S
        )
        self._started = self._stopped = False
        self._soon = new_timer(self, self._begin, _LOADS_AFTER_MS, single_shot=True)
        self._bus.tap(self._on_sound, (AudioChunk,))
        self._bus.tap(self._pass_on, (PlayedSound, PlayedSoundEnded))
        self._bus.tap(self._on_utterance, (UtteranceChanged,))
        for microphone in (self._state.microphone, self._state.wizard_microphone):
            microphone.changed.connect(self._on_microphone_changed)
        self._state.sound.changed.connect(self._on_sound_status_changed)
        self._records = False
        self._state.recording.changed.connect(self._on_recording_changed)

    def follows(self) -> Follows:
        return {UtteranceCorrected: self._on_corrected}

    def supervised(self) -> tuple[SupervisedProcess, ...]:
        return () if self._body is None else (self._process,)

    def use_scenario(self, scenario: Scenario) -> None:
        body = self._body_of(scenario) if scenario.permissions.transcription else None
        settings = scenario.listening
        self._silence = UseSilence(settings.silence_at_least_s, settings.silence_at_most_s)
        if body == self._body:
            self._report_silence()
            if self._soon.isActive():
                self._soon.start()
            return
        self._body = body
        # End the recogniser, for a scenario without it or with another one.
        feed, self._feed, self._to_recogniser = self._feed, None, None
        self._state.listening.set(ListeningStatus())
        if feed is not None:
            self._process.ask_to_end()
            feed.end()
            self._process.dismiss(feed.join)
        self._process.restarts = Restarts()
        if self._started:
            self._soon.start()

    def start(self) -> None:
        self._started = True
        self._begin()

    def stop(self) -> None:
        self._stopped = True
        self._soon.stop()
        self._to_recogniser = None
        self._process.ask_to_end()
        if self._feed is not None:
            self._feed.end()

    def end(self) -> None:
        self._process.end()
        if self._feed is not None:
            self._feed.join()

    def on_heard(self, message: Any) -> None:
        """Handle a status message of the recogniser."""
        match message:
            case RecogniserReady(model=model, language=language, detail=detail):
                self._to_recogniser = self._feed
                self._state.listening.set(ListeningStatus("ready", model, language, detail))
            case RecogniserAway(problem):
                status: ListeningStatus = self._state.listening.value
                self._state.listening.set(ListeningStatus("failed", status.model, status.language, problem.what))
                self._bus.publish(localize_problem(problem))
            case RecogniserFailed(problem):
                self._to_recogniser = None
                self._state.listening.set(ListeningStatus("failed", detail=problem.what))
                self._bus.publish(localize_problem(problem))

    def _on_microphone_changed(self, _status: object) -> None:
        self._begin()

    def _on_sound_status_changed(self, status: SoundStatus) -> None:
        self._to_dictate = status.talking != "robot"

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        records = status.state in ("starting", "recording")
        if self._records and not records:
            self._pass_on(EndTurns(), None)
        self._records = records

    def _begin(self) -> None:
        """Start the recogniser, once there is audio: it takes hundreds of megabytes."""
        if self._body is None or self._process.child is not None or not self._started or self._stopped:
            return
        if self._soon.isActive():
            return
        microphones = (self._state.microphone.value, self._state.wizard_microphone.value)
        if self._process.restarts.exhausted or all(each.state in ("off", "failed") for each in microphones):
            return
        self._state.listening.set(ListeningStatus("loading"))
        self._feed = ListeningFeed(self._process.start(self._body), self._bus.publish)
        self._report_silence()

    def _report_silence(self) -> None:
        if self._feed is not None:
            self._feed.put(pickle.dumps(self._silence, protocol=pickle.HIGHEST_PROTOCOL))

    def _on_ended(self) -> None:
        if self._feed is not None:
            self._feed.end()
        self._feed = self._to_recogniser = None
        self._process.restarts.after_end(self._report_ended, self._begin)

    def _report_ended(self, advice: str) -> None:
        self._bus.problem(
            "warning",
            tr("Transcription stopped unexpectedly."),
            tr("The current utterance is missing from the transcript; sound is still recorded."),
            advice,
            until="transcription",
        )
        self._state.listening.set(ListeningStatus("failed", detail=QT_TR_NOOP("It stopped unexpectedly.")))

    def _on_sound(self, chunk: AudioChunk, raw: bytes | None) -> None:  # any thread
        if chunk.source in PARTICIPANT_SOURCES or (chunk.source == WIZARD_MICROPHONE and self._to_dictate):
            self._pass_on(chunk, raw, sound=True)

    def _on_utterance(self, utterance: UtteranceChanged, raw: bytes | None) -> None:  # any thread
        if utterance.speaker == "robot":
            self._pass_on(utterance, raw)
        elif utterance.speaker == "participant" and utterance.person_id:
            self._pass_on(SpokenBy(utterance.utterance_id, utterance.person_id), None)

    def _on_corrected(self, correction: UtteranceCorrected) -> None:
        if correction.person_id:
            self._pass_on(SpokenBy(correction.utterance_id, correction.person_id), None)

    def _pass_on(self, value: Any, raw: bytes | None, *, sound: bool = False) -> None:  # any thread
        feed = self._to_recogniser
        if feed is not None:
            feed.put(pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL) if raw is None else raw, sound=sound)


TRANSCRIPTION_STREAM = "transcription"
_PIECES_AT_MOST = 20
"""Two seconds of audio: later words would be useless."""


class ListeningFeed:
    """Feed of heard and played audio to the speech recogniser: never blocks, and never delivers late.

    Queue with one writer thread. If the recogniser is too slow, audio is dropped and counted in a ``Gap``; other
    messages wait.
    """

    def __init__(self, recogniser: ChildProcess, report_gap: Callable[[Gap], None]) -> None:
        self._recogniser = recogniser
        self._report_gap = report_gap
        self._queue: deque[tuple[bytes, bool]] = deque()
        self._pieces = self._left_out = 0
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._write, name="listening-feed", daemon=True)
        self._thread.start()

    def put(self, raw: bytes, *, sound: bool = False) -> None:
        """Queue a pickled message; ``sound`` may be dropped. Any thread."""
        with self._changed:
            if sound and self._pieces >= _PIECES_AT_MOST:
                self._left_out += 1
                return
            self._pieces += sound
            self._queue.append((raw, sound))
            self._changed.notify()

    def end(self) -> None:
        """Stop writing. The recogniser was asked to end before, so that nothing blocks."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def join(self) -> None:
        """Wait for the thread, which ends with the recogniser."""
        self._thread.join(2.0)

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._queue and not self._ended:
                    self._changed.wait()
                if self._ended:
                    return
                raw, sound = self._queue.popleft()
                self._pieces -= sound
                left_out = self._left_out if self._pieces <= _PIECES_AT_MOST // 2 else 0
                self._left_out -= left_out
            if left_out:
                self._report_gap(
                    Gap(
                        clock.now_ns(),
                        TRANSCRIPTION_STREAM,
                        left_out,
                        QT_TR_NOOP("speech recognition could not keep up"),
                    )
                )
            if not self._recogniser.send_raw_waiting(raw):
                return
