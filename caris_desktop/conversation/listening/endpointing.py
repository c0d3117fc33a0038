"""Voice activity, and turn-taking: start, pauses and end of turns, from voice probabilities per 32 ms.

No clock: all times are those of the sound.
"""

import math
from collections import OrderedDict, deque
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.recogniser_messages import UseSilence
from caris_desktop.domain.model_files import onnx_options, packaged_file, read_checked

# Adaptive endpointing delay: pause lengths within turns, learned per person.

LEAST_S, MOST_S = 0.5, 3.0
_USUAL_S = (0.25, 0.3, 0.4, 0.5, 0.75)
"""Pauses of people in conversation, for as long as little is known of this one."""
_MAX_PAUSES = 40
_SHARE = 0.9
_BEYOND = 1.15
_PEOPLE_AT_MOST, _TURNS_AT_MOST = 50, 30


class EndpointDelayModel:
    """Delay of one person: a high quantile of their pauses, robust against single long ones, with typical pauses as a
    prior.
    """

    def __init__(self) -> None:
        self._pauses_s: deque[float] = deque(maxlen=_MAX_PAUSES)

    def learn(self, pause_s: float) -> None:
        """Add a pause after which they continued."""
        if pause_s <= MOST_S:
            self._pauses_s.append(pause_s)

    def unlearn(self, pause_s: float) -> None:
        """Remove a pause that belonged to another person."""
        if pause_s in self._pauses_s:
            self._pauses_s.remove(pause_s)

    @property
    def seconds(self) -> float:
        """Silence after which this person has usually finished."""
        known = sorted((*_USUAL_S, *self._pauses_s))
        at = _SHARE * (len(known) - 1)
        low, rest = math.floor(at), at - math.floor(at)
        quantile = known[low] + rest * (known[min(low + 1, len(known) - 1)] - known[low])
        return min(MOST_S, max(LEAST_S, _BEYOND * quantile))


class SilenceOfPeople:
    """Delays of all speakers at a microphone. The speaker of a turn is known only later; until then the last speaker is
    assumed.
    """

    def __init__(self) -> None:
        self._people: OrderedDict[str, EndpointDelayModel] = OrderedDict()
        self._turns: OrderedDict[str, list[float]] = OrderedDict()
        self._speaker_of: OrderedDict[str, str] = OrderedDict()
        self.speaker = ""
        """Whose turn it is taken to be: a person's id, empty for somebody."""

    def learn(self, turn: str, pause_s: float) -> None:
        """Add a pause within that turn."""
        self._turns.setdefault(turn, []).append(pause_s)
        while len(self._turns) > _TURNS_AT_MOST:
            self._turns.popitem(last=False)
        self._of(self._speaker_of.get(turn, self.speaker)).learn(pause_s)

    def spoken_by(self, turn: str, person_id: str) -> None:
        """Assign the turn to its speaker."""
        taken_for = self._speaker_of.get(turn, self.speaker)
        self._speaker_of[turn] = self.speaker = person_id
        while len(self._speaker_of) > _TURNS_AT_MOST:
            self._speaker_of.popitem(last=False)
        if taken_for != person_id:
            for pause_s in self._turns.get(turn, ()):
                self._of(taken_for).unlearn(pause_s)
                self._of(person_id).learn(pause_s)

    @property
    def seconds(self) -> float:
        """Delay for the present speaker."""
        return self._of(self.speaker).seconds

    def _of(self, person_id: str) -> EndpointDelayModel:
        silence = self._people.setdefault(person_id, EndpointDelayModel())
        self._people.move_to_end(person_id)
        while len(self._people) > _PEOPLE_AT_MOST:
            self._people.popitem(last=False)
        return silence


VOICE_FROM, VOICE_UNTIL = 0.5, 0.35
"""What is like a voice as much as this begins one; less than that ends it."""
BEGINS_AFTER_NS = 190_000_000
"""A click or a cough is no turn."""
_LATE_NS = 32_000_000
"""For so long the network still takes a silence for a voice."""
PAUSE_NS = 200_000_000 + _LATE_NS
"""A silence of this length may be the end of the turn."""
_FORGET_NS = 600_000_000
_SPOKE_ON_WITHIN_NS = 3_000_000_000
_SURE, _UNSURE = 0.4, 0.3

Change = Literal["began", "paused", "spoke on", "over"]


def silence_to_wait_s(turn_over: float | None, learnt_s: float, bounds: UseSilence) -> float:
    """Silence that ends the turn, by the probability that it is over (None: unknown).

    If it is likely over, the minimum; if not, as long as this person's pauses take.
    """
    unsure = 1.0 if turn_over is None else min(1.0, max(0.0, (_SURE - turn_over) / (_SURE - _UNSURE)))
    wait_s = bounds.at_least_s + unsure * (learnt_s - bounds.at_least_s)
    return min(bounds.at_most_s, max(bounds.at_least_s, wait_s))


class TurnTaking:
    """Turns at one microphone. ``turn`` names the present one for the learned pauses."""

    def __init__(self, silence: SilenceOfPeople, bounds: UseSilence) -> None:
        self._silence = silence
        self.bounds = bounds
        self._voiced_ns = self._audio_end_ns = 0
        self._turn_over: float | None = None
        self._last_turn, self._last_ended_ns = "", 0
        self.turn = ""
        self.under_way = False
        self.speaking = False
        self.voiced = False
        """Whether there is voice at this very moment."""
        self.started_ns = 0
        """Where the voice of the turn began."""
        self.voice_ended_ns = 0
        """Where there was voice last."""

    @property
    def beginning_ns(self) -> int:
        """Duration of voice that is not a turn yet, including short silences."""
        return self._audio_end_ns - self.started_ns if self._voiced_ns and not self.under_way else 0

    def process(self, stamp_ns: int, length_ns: int, voice: float) -> Change | None:
        """Process the next window with its voice probability."""
        end_ns = self._audio_end_ns = stamp_ns + length_ns
        self.voiced = voice >= (VOICE_UNTIL if self.voiced else VOICE_FROM)
        if self.voiced:
            return self._process_voice(stamp_ns, end_ns)
        return self._process_silence(end_ns)

    def judge(self, turn_over: float) -> None:
        """Set the probability that the turn is over at this pause. Before, the person's learned delay applies."""
        self._turn_over = turn_over

    def end(self) -> None:
        """End the present turn, without learning from its pauses."""
        self.under_way = self.speaking = self.voiced = False
        self._voiced_ns = 0
        self._last_turn = ""

    def another_spoke(self) -> None:
        """The robot answered: silence after the last turn was not a pause in it."""
        self._last_turn = ""

    def _process_voice(self, stamp_ns: int, end_ns: int) -> Change | None:
        change: Change | None = None
        if not self.under_way:
            if self._voiced_ns == 0:
                self.started_ns = stamp_ns
            self._voiced_ns += end_ns - stamp_ns
            if self._voiced_ns >= BEGINS_AFTER_NS:
                change = "began"
                self.under_way = self.speaking = True
                self._learn_from_cut()
        elif not self.speaking:
            change = "spoke on"
            self.speaking = True
            self._silence.learn(self.turn, (stamp_ns - self.voice_ended_ns) / 1e9)
        self.voice_ended_ns = max(self.started_ns, end_ns - _LATE_NS)
        return change

    def _process_silence(self, end_ns: int) -> Change | None:
        silent_ns = end_ns - self.voice_ended_ns
        if not self.under_way:
            if silent_ns > _FORGET_NS:
                self._voiced_ns = 0
            return None
        if self.speaking:
            if silent_ns < PAUSE_NS:
                return None
            self.speaking = False
            self._turn_over = None
            return "paused"
        if silent_ns < silence_to_wait_s(self._turn_over, self._silence.seconds, self.bounds) * 1e9:
            return None
        self.under_way = False
        self._voiced_ns = 0
        self._last_turn, self._last_ended_ns = self.turn, self.voice_ended_ns
        return "over"

    def _learn_from_cut(self) -> None:
        """Learn from a turn that was cut: a speaker who continues soon, with nobody in between, had not finished."""
        pause_ns = self.started_ns - self._last_ended_ns
        if self._last_turn and pause_ns <= _SPOKE_ON_WITHIN_NS:
            self._silence.learn(self._last_turn, pause_ns / 1e9)
        self._last_turn = ""


# Voice activity detection by the Silero network, window by window.

if TYPE_CHECKING:
    import onnxruntime


RATE_HZ = 16_000
WINDOW = 512
"""Samples of one window: 32 ms."""
_CONTEXT = 64
_STATE = 128
# Non-voice sound such as music or long silence degrades the network's state; resetting it in clear silence restores it.
_CLEAR_BELOW, _CLEAR_AFTER, _CLEAR_EVERY = 0.1, 5, 62


class NoVoiceActivity(Exception):  # noqa: N818 - says what is missing
    """The network for voice activity is not installed."""


class VoiceActivity:
    """Detector of one microphone, with state."""

    def __init__(self) -> None:
        """Raises NoVoiceActivity, and WrongChecksum."""
        path = packaged_file("faster_whisper/assets/silero_vad_v6.onnx")
        if path is None:
            raise NoVoiceActivity(
                "The Python package faster-whisper, which distinguishes speech from other sound, is not installed"
            )
        self._session = open_network(path)
        self._context = np.zeros(_CONTEXT, np.float32)
        self._clear()
        self._quiet = self._since_clear = 0

    def _clear(self) -> None:
        self._h = np.zeros((1, 1, _STATE), np.float32)
        self._c = np.zeros((1, 1, _STATE), np.float32)
        self._since_clear = 0

    def probability(self, window: NDArray[np.float32]) -> float:
        """Voice probability of the next ``WINDOW`` samples at 16 kHz."""
        sound = np.concatenate((self._context, window))[np.newaxis]
        output, self._h, self._c = self._session.run(None, {"input": sound, "h": self._h, "c": self._c})
        self._context = window[-_CONTEXT:]
        probability = float(np.asarray(output).reshape(-1)[0])
        self._since_clear += 1
        self._quiet = self._quiet + 1 if probability < _CLEAR_BELOW else 0
        if self._quiet >= _CLEAR_AFTER and self._since_clear >= _CLEAR_EVERY:
            self._clear()
        return probability


def open_network(path: Path) -> "onnxruntime.InferenceSession":
    """Session on one thread. Raises WrongChecksum."""
    import onnxruntime

    options = onnx_options(1)
    options.enable_cpu_mem_arena = False
    return onnxruntime.InferenceSession(read_checked(path)[0], sess_options=options, providers=["CPUExecutionProvider"])


# End-of-turn detection by sound: the SmartTurn network (Daily, BSD-2; version 3.2).
#
# It was trained on Whisper's log-mel spectrogram (Radford et al. 2022) over the last 8 s of a turn, zero-padded in
# front, and returns the probability that the turn is complete.

SECONDS = 8
_SAMPLES = RATE_HZ * SECONDS
_WINDOW, _HOP, _BANDS = 400, 160, 80
_VARIANCE_FLOOR, _POWER_FLOOR, _RANGE = 1e-7, 1e-10, 8.0


class TurnModel:
    """``TurnModel.find()`` returns None if the network is not installed, and raises WrongChecksum."""

    @classmethod
    def find(cls) -> "TurnModel | None":
        path = packaged_file("pipecat/audio/turn/smart_turn/data/smart-turn-v3.2-cpu.onnx")
        return None if path is None else cls(open_network(path))

    def __init__(self, session: object) -> None:
        self._session = session
        # Mel filter bank, Slaney's scale with equal areas; shape (bands, frequencies of the spectrum).
        mel = np.linspace(_mel(0.0), _mel(RATE_HZ / 2), _BANDS + 2)
        edges = np.where(mel < _KNEE_MEL, mel * 200 / 3, _LINEAR_HZ * np.exp(_PER_MEL * (mel - _KNEE_MEL)))
        frequencies = np.linspace(0, RATE_HZ / 2, _WINDOW // 2 + 1)
        widths = np.diff(edges)
        slopes = edges[:, np.newaxis] - frequencies
        bands = np.maximum(0.0, np.minimum(-slopes[:-2] / widths[:-1, np.newaxis], slopes[2:] / widths[1:, np.newaxis]))
        self._bands = np.asarray(bands * (2.0 / (edges[2:] - edges[:-2]))[:, np.newaxis])
        self._window = np.hanning(_WINDOW + 1)[:-1]

    def turn_over(self, turn: NDArray[np.float32]) -> float:
        """Probability that a turn is complete. ``turn`` is its sound at 16 kHz, including the following silence."""
        features = self.features(turn)[np.newaxis]
        (output,) = self._session.run(None, {"input_features": features})  # type: ignore[attr-defined]
        return float(np.asarray(output).reshape(-1)[0])

    def features(self, turn: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log-mel spectrogram of the last 8 s, shape (80, 800)."""
        sound = np.zeros(_SAMPLES, np.float32)
        last = turn[-_SAMPLES:]
        sound[_SAMPLES - len(last) :] = last
        sound = (sound - sound.mean()) / np.sqrt(sound.var() + _VARIANCE_FLOOR)
        padded = np.pad(sound.astype(np.float64), _WINDOW // 2, mode="reflect")
        frames = np.lib.stride_tricks.sliding_window_view(padded, _WINDOW)[::_HOP][:-1]
        power = np.abs(np.fft.rfft(frames * self._window, axis=-1)) ** 2
        log = np.log10(np.maximum(_POWER_FLOOR, self._bands @ power.T))
        log = np.maximum(log, log.max() - _RANGE)
        return np.asarray((log + 4.0) / 4.0, np.float32)


# Slaney's scale: linear up to 1 kHz, logarithmic above.
_LINEAR_HZ, _KNEE_MEL, _PER_MEL = 1000.0, 15.0, np.log(6.4) / 27.0


def _mel(hz: float) -> float:
    return hz * 3 / 200 if hz < _LINEAR_HZ else _KNEE_MEL + float(np.log(hz / _LINEAR_HZ)) / _PER_MEL
