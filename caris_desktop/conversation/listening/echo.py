"""Echo cancellation: removes the robot's voice from a microphone, given the played samples.

Playback times are reported, but a busy machine or a robot's buffers may delay the sound by seconds, and starved
loudspeakers fall behind within a sentence. So the delay is estimated from the sound itself, repeatedly while the robot
is not found or no longer explains the sound.
"""

import itertools
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.resampling import Resampler, resampled
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import PlayedSound, PlayedSoundEnded
from caris_desktop.domain.value_class import Value, dataclass

# Room filter: transfer function from loudspeaker to microphone, learned during possible double talk.
#
# For each frequency the microphone's sound is a weighted sum of the last played frames (convolutive transfer
# function). The weights are the state of a Kalman filter with full covariance over the frames, whose observation
# noise is the unexplained sound: bins with another speaker are not learned from. It converges within a few frames,
# where an adaptive filter with a step size per bin needs seconds, and estimates its own uncertainty.

FRAME, HOP = 1024, 256
"""Samples of a frame at 16 kHz, and from one to the next; they overlap by three quarters, or else what is left of the
robot is four times as loud."""
TAPS = 19
"""Frames that a room holds: 0.3 s."""
BINS = FRAME // 2 + 1
_WINDOW = np.sqrt(np.hanning(FRAME + 1)[:FRAME]).astype(np.float32)
_SYNTHESIS = (_WINDOW / (_WINDOW**2).reshape(-1, HOP).sum(axis=0)[0]).astype(np.float32)
_EXPECTED = np.exp(-np.maximum(np.arange(TAPS) - 2.0, 0.0) / 3.75)
"""Decay of an echo's energy over the frames, assumed for any room: by two thirds in 60 ms."""
_EXPECTED /= _EXPECTED.sum()
_RETAINED = 0.5
"""Of what was learnt of a room, while it may be another."""
_CLOCKS_APART = 3.5e-4
"""Two sound devices do not count the seconds alike: by a ten-thousandth as a rule, always in one direction. That turns
high tones most from one frame to the next."""
_TURNED = ((2 * np.pi * np.arange(BINS) / FRAME * HOP * _CLOCKS_APART) ** 2).astype(np.float32)[:, np.newaxis]
_DIAGONAL = np.arange(TAPS)
_SMOOTHING = 0.5
_LEAST_NOISE = 1e-7 * FRAME
_SPREAD = np.array((0.25, 0.5, 0.25), np.float32)
_LEFT_OF_ROBOT = 0.02
"""Of the robot's energy stays what no such filter explains, as with loudspeakers that are overdriven."""
_LAST = 3
_TAIL_MARGIN = 2.0
_TAIL_LASTS = 0.85
"""Of what a room holds beyond the filter, from one frame to the next: 60 dB in 1.4 s at most."""


def spectrum(samples: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Spectrum of one frame, shape (BINS,)."""
    return np.fft.rfft(samples * _WINDOW).astype(np.complex64)


def energy_of(samples: NDArray[np.float32]) -> float:
    """Energy of one frame, scaled as in its spectrum."""
    return float(((samples * _WINDOW) ** 2).sum()) * FRAME / 2


def part_of_sound(frame: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Contribution of a frame to the sound, shape (FRAME,)."""
    sound: NDArray[np.float32] = np.fft.irfft(frame).astype(np.float32) * _SYNTHESIS
    return sound


class Split(Value, eq=False):
    """Separated frame. ``robot`` is to be subtracted; ``others_energy`` of ``microphone_energy`` is certainly not the
    robot's.
    """

    robot: NDArray[np.complex64]
    microphone_energy: float
    others_energy: float


class RoomFilter:
    """Filter of one room. Process each frame once, in order."""

    def __init__(self) -> None:
        self._weights = np.zeros((BINS, TAPS), np.complex64)
        self._covariance = np.zeros((BINS, TAPS, TAPS), np.complex64)
        self._noise = np.full(BINS, _LEAST_NOISE, np.float32)
        self._tail = np.zeros(BINS, np.float32)

    @property
    def weights(self) -> NDArray[np.complex64]:
        """Present weights, for ``reduce_step_size``."""
        return self._weights.copy()

    @property
    def loudness(self) -> float:
        """Energy of the robot at the microphone relative to the playback; 0 if unknown."""
        return float((np.abs(self._weights) ** 2).sum(axis=1).mean())

    def reduce_step_size(self, loudness: float, known: NDArray[np.complex64]) -> None:
        """Restart from the ``known`` room with large uncertainty; ``loudness`` is the expected relative energy."""
        self._weights = known * np.complex64(_RETAINED)
        self._covariance[:] = 0
        self._covariance[:, _DIAGONAL, _DIAGONAL] = loudness * _EXPECTED
        self._noise[:] = _LEAST_NOISE

    def process(self, microphone: NDArray[np.complex64], played: NDArray[np.complex64]) -> Split:
        """Process a frame; ``played`` has the last played frames, newest first, shape (BINS, TAPS)."""
        seen = np.matmul(self._covariance, np.conj(played)[:, :, np.newaxis])[:, :, 0]
        unsure = np.maximum(np.real((played * seen).sum(axis=1)), 0.0)
        error = microphone - (played * self._weights).sum(axis=1)
        others = np.convolve(np.maximum(np.abs(error) ** 2 - unsure, 0.0), _SPREAD, "same").astype(np.float32)
        self._noise = _SMOOTHING * self._noise + (1.0 - _SMOOTHING) * others
        noise = np.maximum(np.maximum(self._noise, others), _LEAST_NOISE)
        step = seen / (unsure + noise)[:, np.newaxis]
        self._weights += step * error[:, np.newaxis]
        self._covariance -= step[:, :, np.newaxis] * np.conj(seen)[:, np.newaxis, :]
        self._covariance[:, _DIAGONAL, _DIAGONAL] += _TURNED * np.abs(self._weights) ** 2
        echo = (played * self._weights).sum(axis=1)
        # An estimate that makes the sound louder is of a robot that is not heard: a ghost of its voice.
        rest = microphone - echo
        rest = np.where(np.abs(rest) > np.abs(microphone), microphone, rest)
        rest2 = np.abs(rest) ** 2
        left = unsure * noise / (unsure + noise) + _LEFT_OF_ROBOT * np.abs(echo) ** 2 + self._beyond(played)
        mine = np.maximum(rest2 - left, 0.0)
        microphone_energy = float((np.abs(microphone) ** 2).sum())
        # The residual echo is removed by magnitude: spectral subtraction (Boll 1979).
        share = np.convolve(mine, _SPREAD, "same") / np.maximum(np.convolve(rest2, _SPREAD, "same"), 1e-12)
        return Split(microphone - np.sqrt(share) * rest, microphone_energy, float(mine.sum()))

    def _beyond(self, played: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Energy of reverberation beyond the filter's length."""
        last = np.abs(self._weights[:, -_LAST:] * played[:, -_LAST:]) ** 2
        self._tail = _TAIL_LASTS * (self._tail + last.mean(axis=1, dtype=np.float32))
        return _TAIL_MARGIN * self._tail


_HOLE_NS = 60_000_000
_SHORT_HOLE_NS = 1_000_000_000
"""While the robot may be heard so much lost sound is taken for silence, so that what came before is still looked at."""
SAMPLE_RATE_HZ = 16_000
_CONTINUES_WITHIN_NS = 30_000_000


def samples_in(duration_ns: int) -> int:
    return round(duration_ns * SAMPLE_RATE_HZ / 1_000_000_000)


def ns_of(samples: int) -> int:
    return samples * 1_000_000_000 // SAMPLE_RATE_HZ


@dataclass(slots=True, eq=False)
class _Piece:
    utterance_id: str
    start_ns: int
    samples: NDArray[np.float32]

    @property
    def end_ns(self) -> int:
        return self.start_ns + ns_of(len(self.samples))


class PlaybackReference:
    """Playback reference: past and scheduled loudspeaker sound at 16 kHz in session time.

    Accumulates reported sounds; simultaneous ones are mixed.
    """

    def __init__(self) -> None:
        self._pieces: list[_Piece] = []

    def add(self, sound: PlayedSound) -> int:
        """Add a sound; return its start: chunks of one utterance are joined without gaps."""
        mono = sound.samples.mean(axis=1, dtype=np.float32) / np.float32(32768.0)
        start_ns = sound.stamp_ns
        for piece in self._pieces:
            if piece.utterance_id == sound.utterance_id and abs(start_ns - piece.end_ns) < _CONTINUES_WITHIN_NS:
                start_ns = piece.end_ns
        self._pieces.append(_Piece(sound.utterance_id, start_ns, resampled(mono, sound.sample_rate_hz, SAMPLE_RATE_HZ)))
        return start_ns

    def end(self, ended: PlayedSoundEnded) -> None:
        """Truncate an utterance."""
        for piece in self._pieces:
            if piece.utterance_id == ended.utterance_id:
                piece.samples = piece.samples[: max(0, samples_in(ended.stamp_ns - piece.start_ns))]

    def sound(self, start_ns: int, count: int) -> NDArray[np.float32]:
        """Sound from that time on, shape (count,); zeros where nothing was played."""
        sound = np.zeros(count, np.float32)
        for piece in self._pieces:
            first = samples_in(start_ns - piece.start_ns)
            start, end = max(0, first), min(len(piece.samples), first + count)
            if start < end:
                sound[start - first : end - first] += piece.samples[start:end]
        return sound

    def anything(self, start_ns: int, end_ns: int) -> bool:
        """True if any sound was played in that interval."""
        return any(piece.start_ns < end_ns and piece.end_ns > start_ns for piece in self._pieces)

    def began_ns(self, moment_ns: int) -> int | None:
        """Start of the utterance played at that time, or last before it; None if there was none."""
        before = [piece for piece in self._pieces if piece.start_ns <= moment_ns]
        if not before:
            return None
        last = max(before, key=lambda piece: piece.start_ns)
        if not last.utterance_id:
            return last.start_ns
        return min(piece.start_ns for piece in before if piece.utterance_id == last.utterance_id)

    def forget_before(self, moment_ns: int) -> None:
        self._pieces = [piece for piece in self._pieces if piece.end_ns >= moment_ns]


_HISTORY = 6 * SAMPLE_RATE_HZ
_HINDSIGHT = 30 * SAMPLE_RATE_HZ
_EARLY = 256
"""Samples by which the reported time of a sound may be late: 16 ms."""
_USUALLY_LATEST, _LATEST = 9_600, 48_000
"""Samples by which a robot may play sound late after receiving it: 0.6 s, on a busy machine 3 s."""
_WELL_PLACED = range(1_600)
"""Room filter positions at which robot sound may start."""
_MEASURED_AFTER_FRAMES = (10, 16, 24, 34, 46, 60)
_AHEAD = 3_200
"""Samples by which it may be early: 0.2 s."""
_SURE_PEAK = 16.0
"""Before the robot is heard peaks of chance go up to 15; its own are 20 and more."""
_SURE_PEAK_ELSEWHERE = 20.0
"""Where it is not expected."""
_SEARCH_EVERY = 30
"""Frames: 0.5 s."""
_SEARCHED, _SEARCHED_AGAIN = 38_400, 24_000
"""In the last 2.4 s it is looked for, and in the last 1.5 s once it was found."""
_NEW_PLACE = 40
"""The same place is found again within so many samples."""
_ALIKE_AGAIN = 0.3
_RELEARN, _RELEARN_FROM = 2, 48 * HOP
"""Times, and samples back, that the room is relearned where the robot was found but is not explained."""
_EXPLAINED, _EXPLAINED_FRAMES = 0.5, 8
"""Where the robot speaks alone it explains more of what is heard than this."""
_RESOUNDS_FRAMES = 16
"""Frames for which a room resounds beyond the room filter: 0.26 s."""
_CATCHES_UP_EVERY = 8 * HOP
"""Push-to-talk sound is played in pieces of some milliseconds, each of which may be reported late."""
_PIECE, _LEAD = 24_000, 8_000
"""1.5 s; what was played 0.5 s before still resounds in it."""
_BANDS = np.unique(np.geomspace(5, 225, 25).astype(int))
_CONTINUES, _LOUDER = 0.58, 4.0
"""Energy of a room from one frame to the next (60 dB in 0.4 s); so much louder than usual is somebody else."""
_BREATH_NS = 150_000_000
"""Between two words of one sentence."""
_SAME_ROOM_FOR = SAMPLE_RATE_HZ // 2
"""Longest silence after which the robot has not moved; samples."""
_USUAL_LOUDNESS = 1.0
_MARGIN = 4.0
"""Who expects too little of the robot takes it for somebody else."""

_EMPTY = np.zeros(0, np.float32)


class CleanSound(Value, eq=False):
    """Microphone sound after cancellation, float32 from -1 to 1, mono, at 16 kHz; may be empty or longer than the
    input: during robot speech it is delayed by some 80 ms.

    ``stamp_ns`` is the time of the first sample. ``echo_share`` is the robot's share of the original energy: 1 is the
    robot alone, 0 none of it. ``again`` replaces the samples right before, where the robot was found in them only
    later; usually empty.
    """

    stamp_ns: int
    samples: NDArray[np.float32] = field(metadata={"shape": (-1,)})
    echo_share: float
    again: NDArray[np.float32] = field(default_factory=lambda: _EMPTY, metadata={"shape": (-1,)})


class EchoCanceller:
    """Canceller for one microphone. ``play`` may come late or early; ``process`` takes chunks in order."""

    def __init__(self) -> None:
        self._played = PlaybackReference()
        self._room = RoomFilter()
        self._known_before = self._room.weights
        self._loudness = _USUAL_LOUDNESS
        """As energy, of the robot at the microphone over what is played."""
        self._late = -_EARLY
        """Delay from reported to heard robot sound, without what the room filter covers; samples."""
        self._resampler: Resampler | None = None
        self._rate_hz = 0
        # Sample positions count from ``_base_ns``.
        self._base_ns = 0
        self._microphone = np.zeros(0, np.float32)
        self._robot = np.zeros(0, np.float32)
        """What of ``_microphone`` is the robot."""
        self._microphone_from = self._given_until = self._next_frame = 0
        self._frames = np.zeros((BINS, TAPS), np.complex64)
        """What was played, newest frame first."""
        self._silent_frames = 0
        """Since the last of them with sound in it."""
        self._began: int | None = None
        """The first frame of the robot since it was silent."""
        self._last_played = 0
        self._may_sound_from: int | None = None
        """The first frame in which what was played may be heard, however late; None while nothing may."""
        self._found: int | None = None
        """Delay from reported to found robot sound since then; samples."""
        self._searched_at = -_HINDSIGHT
        self._relearning = 0
        self._lost: list[tuple[int, int]] = []
        """What of the sound is missing, from one place to another."""
        self._reported_late_from: int | None = None
        self._caught_up_at = -_CATCHES_UP_EVERY
        self._redo_from: int | None = None
        """From where on what was given is known better by now."""
        self._energies: dict[int, _Energies] = {}

    def play(self, sound: PlayedSound) -> None:
        """Add sound that a loudspeaker plays."""
        start_ns = self._played.add(sound)
        first = self._place_of(start_ns) + self._late - FRAME
        first = max(self._microphone_from, self._next_frame - max(0, self._next_frame - first) // HOP * HOP)
        if first < self._next_frame:
            self._reported_late_from = (
                first if self._reported_late_from is None else min(first, self._reported_late_from)
            )

    def play_ended(self, ended: PlayedSoundEnded) -> None:
        """Truncate sound that was cut off."""
        self._played.end(ended)
        self._recompute_from(self._next_frame - HOP)

    def process(self, chunk: AudioChunk) -> CleanSound:
        """Remove the robot from a chunk."""
        resampler, lost = self._placed(chunk)
        new = resampler.process(chunk.samples.mean(axis=1, dtype=np.float32) / np.float32(32768.0))
        if lost:
            until = self._microphone_from + len(self._microphone)
            self._lost = [each for each in self._lost if each[1] > self._microphone_from] + [(until, until + lost)]
            new = np.concatenate((np.zeros(lost, np.float32), new))
        self._microphone = np.concatenate((self._microphone, new))
        self._robot = np.concatenate((self._robot, np.zeros_like(new)))
        microphone_until = self._microphone_from + len(self._microphone)
        if self._next_frame - self._caught_up_at >= _CATCHES_UP_EVERY:
            self._recompute()
        while self._next_frame + FRAME <= microphone_until:
            self._take_frame(self._next_frame)
            self._next_frame += HOP
            self._search_echo(self._next_frame - HOP)
        waits = self._resounds or self._reference(self._next_frame, microphone_until - self._next_frame).any()
        return self._give(self._next_frame if waits else microphone_until)

    def share_between(self, started_ns: int, ended_ns: int) -> float | None:
        """The robot's share of the energy in an interval, estimated with later knowledge of the room. None if nothing
        was played then; call within 30 s.
        """
        self._recompute()
        last = self._next_frame - HOP
        if self._may_sound_from is not None and last - self._searched_at >= _SEARCH_EVERY // 2 * HOP:
            self._find_robot(last)
        return self._share(self._place_of(started_ns), self._place_of(ended_ns))

    def plays_at(self, moment_ns: int) -> bool:
        """Whether what was played is heard then, or was a breath before, as late as the robot was found to be."""
        breath = samples_in(_BREATH_NS)
        return bool(self._reference(self._place_of(moment_ns) - breath, breath + HOP).any())

    def heard_in(self, started_ns: int, ended_ns: int) -> "RobotEcho | None":
        """The robot as it is heard in the very sound of a turn, wherever it was found before; None where it is not.

        In pieces, as it may have been given nothing for a moment in between.
        """
        start = max(self._place_of(started_ns), self._microphone_from)
        end = min(self._place_of(ended_ns), self._next_frame)
        if end - start < FRAME + HOP:
            return None
        late: list[int] = []
        total = beyond = 0.0
        pieces = max(1, round((end - start) / _PIECE))
        for first, last in itertools.pairwise(start + (end - start) * each // pieces for each in range(pieces + 1)):
            lag, peak, _loudness = self._find(first, last - FRAME)
            microphone = _spectral_energies(self._microphone_at(first, last - first))
            energy = float(microphone.sum())
            total += energy
            if peak < _SURE_PEAK_ELSEWHERE:
                beyond += energy
                continue
            late.append(lag)
            played = self._played.sound(self._base_ns + ns_of(first - lag - _LEAD), last - first + _LEAD)
            beyond += _beyond_robot(microphone, _resounding(_spectral_energies(played))[-len(microphone) :])
        return RobotEcho(late[0] / SAMPLE_RATE_HZ, beyond / max(total, 1e-12)) if late else None

    def _recompute(self) -> None:
        """Recompute frames processed before their playback was reported."""
        first, self._reported_late_from = self._reported_late_from, None
        if first is None:
            return
        self._caught_up_at = self._next_frame
        first = max(first, self._microphone_from)
        if self._began is None:
            self._begin(first)
        self._learn_again(first, self._next_frame)

    def _place_of(self, moment_ns: int) -> int:
        return samples_in(moment_ns - self._base_ns)

    def _placed(self, chunk: AudioChunk) -> tuple[Resampler, int]:
        """Position of a chunk, and the number of lost samples before it to replace by silence. Sample counts take
        precedence over jittering stamps, except at gaps, and slightly where nothing is played.
        """
        off_ns = chunk.stamp_ns - self._base_ns - ns_of(self._microphone_from + len(self._microphone))
        if self._resampler is not None and chunk.sample_rate_hz == self._rate_hz and abs(off_ns) > _HOLE_NS:
            self._resampler = Resampler(chunk.sample_rate_hz, SAMPLE_RATE_HZ)
            if self._may_sound_from is not None and 0 < off_ns <= _SHORT_HOLE_NS:
                return self._resampler, samples_in(off_ns)
            self._go_on_at(chunk.stamp_ns)
        elif self._resampler is None or chunk.sample_rate_hz != self._rate_hz:
            self._resampler, self._rate_hz = Resampler(chunk.sample_rate_hz, SAMPLE_RATE_HZ), chunk.sample_rate_hz
            self._base_ns = chunk.stamp_ns
            self._microphone = self._robot = np.zeros(0, np.float32)
            self._microphone_from = self._given_until = self._next_frame = 0
            self._frames[:] = 0
            self._began = self._reported_late_from = self._may_sound_from = self._found = self._redo_from = None
            self._searched_at = -_HINDSIGHT
            self._lost = []
            self._caught_up_at = -_CATCHES_UP_EVERY
            self._energies = {}
        elif self._began is None:
            self._base_ns += off_ns // 16
        return self._resampler, 0

    def _go_on_at(self, stamp_ns: int) -> None:
        """Continue after missing sound, retaining what is known of the time before."""
        later = -(-samples_in(stamp_ns - self._base_ns) // HOP) * HOP
        self._base_ns = stamp_ns
        self._microphone = self._robot = np.zeros(0, np.float32)
        self._microphone_from = self._given_until = self._next_frame = 0
        self._lost = []
        self._reported_late_from, self._redo_from, self._caught_up_at = None, None, -_CATCHES_UP_EVERY
        self._energies = {at - later: energies for at, energies in self._energies.items() if at < later}
        self._last_played -= later
        self._searched_at -= later
        if self._may_sound_from is not None:
            self._may_sound_from -= later
        if self._began is not None:
            self._began = None if -self._last_played > _SAME_ROOM_FOR else self._began - later
        self._recompute_from(-HOP)

    def _reference(self, at: int, count: int) -> NDArray[np.float32]:
        """Played sound as heard from that position."""
        return self._played.sound(self._base_ns + ns_of(at - self._late), count)

    @property
    def _resounds(self) -> bool:
        """True while played sound may still be audible."""
        return self._began is not None and self._silent_frames < _RESOUNDS_FRAMES

    def _microphone_at(self, at: int, count: int) -> NDArray[np.float32]:
        return self._microphone[at - self._microphone_from : at - self._microphone_from + count]

    def _take_frame(self, at: int) -> None:
        microphone = self._microphone_at(at, FRAME)
        reference = self._reference(at, FRAME)
        if not self._resounds and not reference.any():
            energy = energy_of(microphone)
            self._note(at, _Energies(energy, energy, played=False))
            if self._began is not None and at - self._last_played > _SAME_ROOM_FOR:
                self._began = None
            return
        if self._began is None:
            self._begin(at)
        self._last_played = at
        self._learn(at, reference)

    def _search_echo(self, at: int) -> None:
        """Search for the robot when due: soon after it begins, and while it does not explain the sound."""
        start_ns = self._base_ns + ns_of(at)
        if not self._played.anything(start_ns - ns_of(_LATEST), start_ns + ns_of(FRAME + _AHEAD)):
            self._may_sound_from = self._found = None
            self._relearning = 0
            return
        if self._may_sound_from is None:
            self._may_sound_from = at
        if self._began is not None and (at - self._began) // HOP in _MEASURED_AFTER_FRAMES:
            self._measure(at)
        elif (at - self._may_sound_from) // HOP % _SEARCH_EVERY == _SEARCH_EVERY - 1:
            self._find_robot(at)

    def _begin(self, at: int) -> None:
        """Start of robot speech, possibly in another room than before."""
        self._began = self._last_played = at
        self._known_before = self._room.weights
        self._loudness = _MARGIN * (self._room.loudness or _USUAL_LOUDNESS)
        self._room.reduce_step_size(self._loudness, self._known_before)

    def _learn(self, at: int, reference: NDArray[np.float32]) -> None:
        self._frames[:, 1:] = self._frames[:, :-1]
        self._frames[:, 0] = spectrum(reference)
        self._silent_frames = 0 if self._frames.any() else self._silent_frames + 1
        if any(first < at + FRAME and at < end for first, end in self._lost):
            # Inserted silence would distort the room estimate.
            return
        split = self._room.process(spectrum(self._microphone_at(at, FRAME)), self._frames)
        self._robot[at - self._microphone_from :][:FRAME] += part_of_sound(split.robot)
        self._note(at, _Energies(split.microphone_energy, split.others_energy, played=True))

    def _note(self, at: int, energies: "_Energies") -> None:
        self._energies[at] = energies
        self._energies.pop(at - _HINDSIGHT, None)

    def _measure(self, at: int) -> None:
        """Measure delay and loudness of the robot; on a deviation, relearn the room."""
        start = max(self._began or 0, self._microphone_from, at + FRAME - _SEARCHED)
        lag, peak, loudness = self._find(start, at)
        if peak < (_SURE_PEAK if lag <= _USUALLY_LATEST else _SURE_PEAK_ELSEWHERE):
            return
        self._found = lag
        if lag - self._late not in _WELL_PLACED:
            self._late = lag - _EARLY
            start = self._first_audible(at)
        elif loudness * 1.5 < self._loudness < loudness * 24.0:
            return
        self._loudness = _MARGIN * loudness
        self._room.reduce_step_size(self._loudness, self._known_before)
        self._learn_again(start, at + HOP)

    def _find_robot(self, at: int) -> None:
        """Search for another delay, if the robot is not heard where expected."""
        self._searched_at = at
        bad_from = self._unexplained_from(at)
        if self._found is not None and bad_from is None:
            return
        through = _SEARCHED if self._found is None else _SEARCHED_AGAIN
        start = max(self._may_sound_from or 0, self._microphone_from, at + FRAME - through)
        if at + FRAME - start < _SEARCH_EVERY * HOP:
            return
        lag, peak, loudness = self._find(start, at)
        if peak < _SURE_PEAK_ELSEWHERE:
            return
        before, self._found = self._found, lag
        same = before is not None and abs(lag - before) <= _NEW_PLACE
        if (same and not self._relearning) or (before is None and lag - self._late in _WELL_PLACED):
            return
        self._relearning = self._relearning - 1 if same else _RELEARN if before is not None else 0
        self._late = lag - _EARLY if not same else self._late
        first = max(self._first_audible(at), at - _RELEARN_FROM if same else 0)
        if before is not None and bad_from is not None:
            first = max(first, bad_from)
        start = first if before is None else self._again_from(first, at, loudness)
        self._began = self._last_played = start
        self._loudness = _MARGIN * loudness
        self._room.reduce_step_size(self._loudness, self._known_before)
        self._learn_again(start, at + HOP)
        # And once more with the final room estimate, also for frames that were not learned from, as the robot may have
        # been silent there.
        self._learn_again(first, at + HOP)

    def _find(self, start: int, at: int) -> tuple[int, float, float]:
        """Delay of the robot between ``start`` and the end of frame ``at``, the clarity of the peak, and loudness as
        energy ratio.
        """
        microphone = self._microphone_at(start, at + FRAME - start)
        played = self._played.sound(self._base_ns + ns_of(start - _LATEST), len(microphone) + _LATEST + _AHEAD)
        lag, peak = _lag(microphone, played)
        part = played[_LATEST - lag :][: len(microphone)]
        return lag, peak, float((microphone**2).sum()) / max(float((part**2).sum()), 1e-9)

    def _first_audible(self, at: int) -> int:
        """First frame in which the utterance of frame ``at``, or the last before it, is heard."""
        began_ns = self._played.began_ns(self._base_ns + ns_of(at + FRAME - self._late))
        first = at if began_ns is None else self._place_of(began_ns) + self._late - FRAME + HOP
        return min(-(-max(first, self._microphone_from) // HOP) * HOP, at)

    def _again_from(self, start: int, at: int, loudness: float) -> int:
        """Frame at which the robot is heard again after a gap in its playback; before it nothing of it is heard."""
        for end in range(at + HOP, start, -_EXPLAINED_FRAMES * HOP):
            frames = range(max(start, end - _EXPLAINED_FRAMES * HOP), end, HOP)
            expected = loudness * sum(energy_of(self._reference(each, FRAME)) for each in frames)
            if sum(energy_of(self._microphone_at(each, FRAME)) for each in frames) < _ALIKE_AGAIN * expected:
                return min(end, at)
        return start

    def _unexplained_from(self, at: int) -> int | None:
        """Start of the sound that the robot's playback does not explain; None if it does."""
        since = None
        for end in range(at + HOP, max(self._may_sound_from or 0, self._microphone_from), -_EXPLAINED_FRAMES * HOP):
            first = end - _EXPLAINED_FRAMES * HOP
            there = [self._energies[each] for each in range(first, end, HOP) if each in self._energies]
            total = sum(energies.total for energies in there)
            if sum(energies.others for energies in there) < (1.0 - _EXPLAINED) * total:
                break
            since = max(first, -(-self._microphone_from // HOP) * HOP)
        return since

    def _learn_again(self, start: int, until: int) -> None:
        """Relearn the frames from ``start`` up to ``until`` (exclusive)."""
        if start < self._given_until:
            self._redo_from = start if self._redo_from is None else min(start, self._redo_from)
        self._robot[start - self._microphone_from :] = 0
        self._recompute_from(start - HOP)
        for at in range(start, until, HOP):
            self._learn(at, self._reference(at, FRAME))

    def _recompute_from(self, at: int) -> None:
        """Recompute the reference spectra after a change of the playback data."""
        for tap in range(TAPS):
            reference = self._reference(at - tap * HOP, FRAME)
            self._frames[:, tap] = spectrum(reference) if reference.any() else 0

    def _give(self, until: int) -> CleanSound:
        start, until = self._given_until, max(until, self._given_until)
        again = _EMPTY if self._redo_from is None else self._clean(max(self._redo_from, self._microphone_from), start)
        clean = self._clean(start, until)
        sound = CleanSound(self._base_ns + ns_of(start), clean, self._share(start, until) or 0.0, again)
        self._given_until, self._redo_from = until, None
        old = (min(until, self._next_frame) - self._microphone_from - _HISTORY) // HOP * HOP
        if old > SAMPLE_RATE_HZ:
            self._microphone, self._robot = self._microphone[old:], self._robot[old:]
            self._microphone_from += old
            self._played.forget_before(self._base_ns + ns_of(self._microphone_from - _LATEST - TAPS * HOP))
        return sound

    def _clean(self, start: int, until: int) -> NDArray[np.float32]:
        return self._microphone_at(start, until - start) - self._robot[start - self._microphone_from :][: until - start]

    def _share(self, start: int, until: int) -> float | None:
        first = -(-(start - (FRAME + HOP) // 2) // HOP) * HOP
        there = [self._energies[at] for at in range(first, until - (FRAME - HOP) // 2, HOP) if at in self._energies]
        if not any(energies.played for energies in there):
            return None
        total = sum(energies.total for energies in there)
        return min(1.0, max(0.0, 1.0 - sum(energies.others for energies in there) / max(total, 1e-12)))


class RobotEcho(Value):
    """Robot sound in a turn. ``late_s``: delay from its reported time. ``beyond``: share of the energy that its
    loudness in time and pitch does not explain, even before the room is learnt; 0 is the robot alone.
    """

    late_s: float
    beyond: float


def _spectral_energies(sound: NDArray[np.float32]) -> NDArray[np.float32]:
    """Energies, shape (frames, bands), at the pitch resolution of an ear."""
    frames = np.lib.stride_tricks.sliding_window_view(sound, FRAME // 2)[::HOP]
    energies = np.abs(np.fft.rfft(frames * np.hanning(FRAME // 2).astype(np.float32))) ** 2
    return np.add.reduceat(energies, _BANDS, axis=1).astype(np.float32)


def _resounding(energies: NDArray[np.float32]) -> NDArray[np.float32]:
    """Add the decay of a usual room."""
    sounding = energies.copy()
    for at in range(1, len(sounding)):
        sounding[at] += _CONTINUES * sounding[at - 1]
    return sounding


def _beyond_robot(microphone: NDArray[np.float32], robot: NDArray[np.float32]) -> float:
    """The energy that is louder than the robot is as a rule in that band."""
    robot = robot + np.float32(1e-4) * robot.max() + np.float32(1e-12)
    loud = robot > 0.05 * robot.max(axis=0)
    gains = np.nanmedian(np.where(loud, microphone / robot, np.nan), axis=0)
    return float(np.maximum(microphone - _LOUDER * gains * robot, 0.0).sum())


class _Energies(Value):
    """Energy of one frame: total, and the part that is certainly not the robot."""

    total: float
    others: float
    played: bool


def _lag(microphone: NDArray[np.float32], played: NDArray[np.float32]) -> tuple[int, float]:
    """Delay in samples of ``microphone`` relative to ``played``, which begins ``_LATEST`` earlier, and the clarity of
    the peak: phase correlation (GCC-PHAT, Knapp and Carter 1976).
    """
    size = 1 << (len(microphone) + len(played) - 1).bit_length()
    cross = np.fft.rfft(microphone, size) * np.conj(np.fft.rfft(played, size))
    strength = np.abs(cross)
    whitened = np.where(strength > 1e-4 * strength.max(), cross / np.maximum(strength, 1e-12), 0)
    correlation = np.fft.irfft(whitened, size)
    # microphone[n] corresponds to played[n + _LATEST - lag]: the shift is lag - _LATEST.
    shifts = np.arange(-_LATEST - _AHEAD, 1)
    around = np.abs(correlation[shifts])
    best = int(around.argmax())
    return int(shifts[best]) + _LATEST, float(around[best] / max(float(around.std()), 1e-12))
