"""Echo cancellation of robot speech in synthetic rooms, with and without a participant's speech."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.conversation.listening.echo import EchoCanceller
from caris_desktop.domain.sound_values import PlayedSound, PlayedSoundEnded
from tests.support.sounds import RATE_HZ, chunks_of, convolved, int16, room_impulse_response, speech_like

_START_NS = 5_000_000_000_000
_BEFORE_S = 0.5
_ROBOT = speech_like(2.5, 1)
_SOMEBODY = speech_like(1.0, 2)


def _moment(seconds: float) -> int:
    return _START_NS + round(seconds * 1e9)


@dataclass
class _Heard:
    canceller: EchoCanceller
    samples: NDArray[np.float64]
    first_ns: int
    shares: list[tuple[int, float]]

    def between(self, start_s: float, end_s: float) -> NDArray[np.float64]:
        first = round((_moment(start_s) - self.first_ns) * RATE_HZ / 1e9)
        return self.samples[first : first + round((end_s - start_s) * RATE_HZ)]

    def share(self, start_s: float, end_s: float) -> float | None:
        return self.canceller.share_between(_moment(start_s), _moment(end_s))


def _padded(sound: NDArray[np.float64], before_s: float, whole_s: float) -> NDArray[np.float64]:
    padded = np.zeros(round(whole_s * RATE_HZ))
    first = round(before_s * RATE_HZ)
    padded[first : first + len(sound)] = sound
    return padded


def _echo(robot: NDArray[np.float64] = _ROBOT, seed: int = 0, loudness_db: float = 0.0, **of_room: float):
    """The robot as a microphone records it, from 0.5 s on."""
    response = room_impulse_response(np.random.default_rng(seed), **of_room)
    return convolved(response, _padded(robot, _BEFORE_S, 3.6)) * 10 ** (loudness_db / 20)


def _noise(count: int) -> NDArray[np.float64]:
    return np.random.default_rng(9).standard_normal(count) * 0.001


def _hear(
    sound: NDArray[np.float64],
    *plays: PlayedSound | PlayedSoundEnded,
    canceller: EchoCanceller | None = None,
    late_s: float = 0.0,
    rate_hz: int = RATE_HZ,
) -> _Heard:
    canceller = canceller or EchoCanceller()
    to_tell = sorted(plays, key=lambda each: each.stamp_ns)
    pieces, shares, first_ns = [], [], 0
    for chunk in chunks_of(sound + _noise(len(sound)), _START_NS, "robot microphone", rate_hz=rate_hz):
        while to_tell and to_tell[0].stamp_ns + late_s * 1e9 <= chunk.stamp_ns:
            told = to_tell.pop(0)
            canceller.play(told) if isinstance(told, PlayedSound) else canceller.play_ended(told)
        clean = canceller.process(chunk)
        if not pieces:
            first_ns = clean.stamp_ns
        assert abs(clean.stamp_ns - first_ns - sum(map(len, pieces)) * 1e9 / RATE_HZ) < 2e6
        pieces.append(clean.samples)
        shares.append((clean.stamp_ns, clean.echo_share))
    return _Heard(canceller, np.concatenate(pieces), first_ns, shares)


def _played(robot: NDArray[np.float64] = _ROBOT, rate_hz: int = RATE_HZ, at_s: float = _BEFORE_S) -> PlayedSound:
    return PlayedSound(_moment(at_s), "u-1", "speech as text", rate_hz, int16(robot))


def _less_db(before: NDArray[np.float64], after: NDArray[np.float64]) -> float:
    return float(10 * np.log10((before[: len(after)] ** 2).sum() / (after**2).sum()))


def _part(sound: NDArray[np.float64], start_s: float, end_s: float) -> NDArray[np.float64]:
    return sound[round(start_s * RATE_HZ) : round(end_s * RATE_HZ)]


@pytest.mark.parametrize(("seed", "loudness_db"), [(1, -6.0), (2, 0.0), (3, 6.0)])
def test_of_the_robot_alone_nothing_is_left_from_its_first_syllable_on(seed: int, loudness_db: float) -> None:
    echo = _echo(seed=seed, loudness_db=loudness_db)
    heard = _hear(echo, _played())
    assert _less_db(_part(echo, 0.55, 0.8), heard.between(0.55, 0.8)) > 10
    assert _less_db(_part(echo, 0.8, 3.1), heard.between(0.8, 3.1)) > 15
    assert (heard.share(0.55, 3.1) or 0) > 0.96


def test_speech_over_the_robot_is_unchanged() -> None:
    somebody = _padded(_SOMEBODY, 1.5, 3.6)
    heard = _hear(_echo() + somebody, _played())
    wanted = _part(somebody, 1.5, 2.5)
    assert _less_db(wanted, heard.between(1.5, 2.5) - wanted) > 12
    assert 0.2 < (heard.share(1.5, 2.5) or 0) < 0.8
    assert (heard.share(0.55, 1.4) or 0) > 0.96


@pytest.mark.parametrize("late_s", [0.0, 0.4, 1.8])
@pytest.mark.long
def test_it_knows_until_when_the_robot_is_heard_however_late(late_s: float) -> None:
    sound = convolved(room_impulse_response(np.random.default_rng(3)), _padded(_ROBOT, _BEFORE_S + late_s, 5.6))
    heard = _hear(sound, _played())
    heard.share(0.55 + late_s, 3.0 + late_s)
    moments_s = (0.7, 1.5, 2.9, 3.5, 4.5)
    plays = [heard.canceller.plays_at(_moment(late_s + each)) for each in moments_s]
    assert plays == [True, True, True, False, False]


def test_the_share_is_reported_while_it_is_heard() -> None:
    somebody = _padded(_SOMEBODY, 2.0, 3.6)
    shares = np.array(_hear(_echo() + somebody, _played()).shares)
    seconds = (shares[:, 0] - _START_NS) / 1e9
    assert np.median(shares[(seconds > 0.8) & (seconds < 1.9), 1]) > 0.96
    # Only the robot between their syllables.
    assert np.quantile(shares[(seconds > 2.1) & (seconds < 2.9), 1], 0.3) < 0.8
    assert shares[seconds < 0.4, 1].max() == 0.0


def test_an_echo_reported_100_ms_late_is_removed_and_known_in_hindsight() -> None:
    echo = _echo()
    heard = _hear(echo, _played(), late_s=0.1)
    assert _less_db(_part(echo, 0.9, 3.1), heard.between(0.9, 3.1)) > 15
    assert (heard.share(0.55, 0.7) or 0) > 0.9


@pytest.mark.parametrize("delay_s", [0.3, 0.5])
def test_a_robot_that_plays_late_is_found(delay_s: float) -> None:
    echo = _echo(delay_s=delay_s, rt60_s=0.4)
    heard = _hear(echo, _played())
    assert _less_db(_part(echo, 1.5, 3.1), heard.between(1.5, 3.1)) > 15


def test_a_moment_that_is_reported_too_late_is_found() -> None:
    echo = _echo(delay_s=0.01)
    heard = _hear(echo, _played(at_s=_BEFORE_S + 0.08))
    assert _less_db(_part(echo, 1.2, 3.1), heard.between(1.2, 3.1)) > 15


@pytest.mark.parametrize("delay_s", [1.2, 2.7])
@pytest.mark.long
def test_an_echo_seconds_later_than_reported_is_known_in_hindsight(
    delay_s: float,
) -> None:
    first, second = _echo(delay_s=0.02), _echo(seed=1, delay_s=0.02)
    late = np.zeros(round(delay_s * RATE_HZ))
    sound = np.concatenate((late, first, np.zeros(round(2.0 * RATE_HZ)), second, np.zeros(RATE_HZ)))
    heard = _hear(sound, _played(), _played(at_s=5.6 + _BEFORE_S))
    assert (heard.share(delay_s + 0.55, delay_s + 3.0) or 0) > 0.9
    at_s = 5.6 + delay_s
    assert _less_db(_part(sound, at_s + 0.8, at_s + 3.1), heard.between(at_s + 0.8, at_s + 3.1)) > 13
    assert (heard.share(at_s + 0.55, at_s + 3.0) or 0) > 0.9


def test_sound_before_the_robot_was_found_is_given_once_more_without_it() -> None:
    canceller = EchoCanceller()
    canceller.play(_played())
    first, by_now = np.zeros(0, np.float32), np.zeros(0, np.float32)
    late = np.pad(_echo(seed=3), (round(1.2 * RATE_HZ), 0))
    for chunk in chunks_of(late + _noise(len(late)), _START_NS, "robot microphone"):
        clean = canceller.process(chunk)
        assert len(clean.again) <= len(first)
        first = np.concatenate((first, clean.samples))
        by_now = np.concatenate((by_now[: len(by_now) - len(clean.again)], clean.again, clean.samples))
    began = slice(round(1.75 * RATE_HZ), round(2.15 * RATE_HZ))
    assert (by_now[began] ** 2).sum() < 0.1 * (first[began] ** 2).sum()


@pytest.mark.long
def test_a_loudspeaker_that_falls_behind_in_mid_sentence_is_found_again() -> None:
    """A busy machine pauses the playback: all later sound is heard later than announced."""
    robot = speech_like(6.0, 3)
    cut = round(2.0 * RATE_HZ)
    fallen_behind = np.concatenate((robot[:cut], np.zeros(round(0.4 * RATE_HZ)), robot[cut:]))
    echo = convolved(room_impulse_response(np.random.default_rng(0)), _padded(fallen_behind, _BEFORE_S, 7.4))
    heard = _hear(echo, _played(robot))
    assert _less_db(_part(echo, 4.2, 6.8), heard.between(4.2, 6.8)) > 13
    assert (heard.share(2.9, 6.8) or 0) > 0.9


@pytest.mark.parametrize("lost_s", [0.1, 0.5])
def test_the_learnt_echo_survives_lost_sound(lost_s: float) -> None:
    echo, canceller = _echo(), EchoCanceller()
    canceller.play(_played())
    chunks = chunks_of(echo + _noise(len(echo)), _START_NS, "robot microphone")
    lost = range(round(1.5 / 0.02), round((1.5 + lost_s) / 0.02))
    for number, chunk in enumerate(chunks):
        if number not in lost:
            canceller.process(chunk)
    assert (canceller.share_between(_moment(0.55), _moment(1.4)) or 0) > 0.95
    assert (canceller.share_between(_moment(0.55), _moment(3.1)) or 0) > 0.9


@pytest.mark.long
def test_a_person_alone_is_never_taken_for_a_robot_that_is_not_heard() -> None:
    somebody = np.concatenate([speech_like(2.5, seed) for seed in (11, 12, 13)])
    heard = _hear(somebody, *(_played(at_s=at_s) for at_s in (0.5, 3.2, 5.8)))
    assert _less_db(somebody[RATE_HZ:], somebody[RATE_HZ:][: 6 * RATE_HZ] - heard.between(1.0, 7.0)) > 10
    assert (heard.share(1.0, 7.0) or 0) < 0.2


def test_clocks_may_drift_apart() -> None:
    echo = _echo()
    drifted = np.interp(np.arange(len(echo)) * (1 + 1e-4), np.arange(len(echo)), echo)
    heard = _hear(drifted, _played())
    assert _less_db(_part(drifted, 2.0, 3.1), heard.between(2.0, 3.1)) > 12


def test_another_rate_on_either_side_changes_nothing() -> None:
    played = speech_like(2.5, 5, 48_000)
    echo = convolved(
        room_impulse_response(np.random.default_rng(4)), np.concatenate((np.zeros(24_000), played, np.zeros(30_000)))
    )
    third = PlayedSound(_moment(_BEFORE_S), "u-1", "", 24_000, int16(played[::2]))
    heard = _hear(echo, third, rate_hz=48_000)
    at_16_khz = echo[::3]
    assert _less_db(_part(at_16_khz, 0.8, 3.1), heard.between(0.8, 3.1)) > 15


def test_an_overdriven_loudspeaker_is_still_the_robot() -> None:
    heard = _hear(_echo(np.tanh(_ROBOT * 4.0) / 4.0), _played())
    assert (heard.share(0.55, 3.1) or 0) > 0.93


def test_after_a_cut_nothing_is_taken_away() -> None:
    echo = _echo()
    cut = round(1.5 * RATE_HZ)
    echo[cut:] = 0
    somebody = _padded(_SOMEBODY, 2.0, 3.6)
    heard = _hear(echo + somebody, _played(), PlayedSoundEnded(_moment(1.5), "u-1"))
    wanted = _part(somebody, 2.0, 3.1)
    assert _less_db(wanted, heard.between(2.0, 3.1) - wanted) > 25
    assert heard.share(2.5, 3.0) is None


def test_sound_without_playback_comes_back_at_once() -> None:
    canceller = EchoCanceller()
    sound = speech_like(1.0, 3)
    for chunk in chunks_of(sound, _START_NS, "robot microphone"):
        clean = canceller.process(chunk)
        assert clean.stamp_ns == chunk.stamp_ns
        np.testing.assert_allclose(clean.samples, chunk.samples[:, 0] / 32_768, atol=1e-6)
    assert canceller.share_between(_START_NS, _moment(0.9)) is None


def test_a_robot_in_another_room_is_taken_out_as_well() -> None:
    first, second = _echo(seed=1), _echo(seed=7, loudness_db=6.0)
    sound = np.concatenate((first, second))
    heard = _hear(sound, _played(), _played(at_s=3.6 + _BEFORE_S))
    assert _less_db(_part(second, 0.55, 3.1), heard.between(4.15, 6.7)) > 14
    assert (heard.share(4.15, 6.7) or 0) > 0.96


def test_pieces_of_one_utterance_are_one_sound() -> None:
    echo = _echo()
    pieces = [
        PlayedSound(_moment(_BEFORE_S + at) + 3_000_000 * (number % 2), "u-1", "", RATE_HZ, int16(part))
        for number, (at, part) in enumerate((at, _part(_ROBOT, at, at + 0.5)) for at in np.arange(0, 2.5, 0.5))
    ]
    heard = _hear(echo, *pieces)
    assert _less_db(_part(echo, 0.8, 3.1), heard.between(0.8, 3.1)) > 15


def test_a_hole_in_the_sound_is_a_hole_in_what_comes_back() -> None:
    canceller = EchoCanceller()
    chunks = chunks_of(speech_like(1.0, 3), _START_NS, "robot microphone")
    stamps = [canceller.process(chunk).stamp_ns for chunk in chunks[:10] + chunks[30:]]
    assert stamps == [chunk.stamp_ns for chunk in chunks[:10] + chunks[30:]]


@pytest.mark.parametrize("late_s", [0.1, 1.4, 2.6])
@pytest.mark.long
def test_the_robot_is_found_in_the_very_sound_of_a_turn_and_who_speaks_over_it_is_beyond(late_s: float) -> None:
    whole_s = 6.5
    robot = convolved(room_impulse_response(np.random.default_rng(5)), _padded(_ROBOT, _BEFORE_S + late_s, whole_s))
    at = _moment(_BEFORE_S + late_s + 0.6), _moment(_BEFORE_S + late_s + 2.2)
    alone = _hear(robot, _played()).canceller.heard_in(*at)
    assert alone is not None and alone.late_s == pytest.approx(late_s, abs=0.06) and alone.beyond < 0.1
    somebody = _padded(_SOMEBODY, _BEFORE_S + late_s + 0.8, whole_s)
    both = _hear(robot + somebody, _played()).canceller.heard_in(*at)
    assert both is None or both.beyond > 0.12
    assert _hear(somebody, _played()).canceller.heard_in(*at) is None


def test_a_robot_that_is_not_heard_where_it_is_expected_leaves_no_ghost_of_its_voice() -> None:
    canceller = EchoCanceller()
    _hear(_echo(), _played(), canceller=canceller)
    later = 4.0
    silence = np.zeros(round(2.5 * RATE_HZ))
    quiet = [
        canceller.process(chunk).samples
        for chunk in _later(canceller, silence + _noise(len(silence)), _played(at_s=later), later)
    ]
    assert float((np.concatenate(quiet) ** 2).mean()) < 1.5 * 0.001**2


def _later(canceller: EchoCanceller, sound: NDArray[np.float64], played: PlayedSound, start_s: float):
    canceller.play(played)
    return chunks_of(sound, _moment(start_s), "robot microphone")
