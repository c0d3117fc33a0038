"""Sound of an utterance: trimmed as a whole, independent of its chunks, and bounded."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from caris_desktop.conversation.voices.utterance_sound import Samples, SoundCache, Stop, StreamingBuffer, trimmed

RATE_HZ = 1000
KEPT = 5


def some(*values: int) -> Samples:
    return np.array(values, np.int16)


sounds = arrays.arrays(np.int16, st.integers(1, 80), elements=st.sampled_from([0, 3, -3, 200, -32768]))


@given(sound=sounds, cuts=st.lists(st.integers(0, 80), max_size=6))
def test_silence_is_left_out_before_and_behind_but_not_within(sound: Samples, cuts: list[int]) -> None:
    parts = [part for part in np.split(sound, sorted(cuts)) if part.size]
    trimmed_sound = np.concatenate([some(), *trimmed(iter(parts), RATE_HZ, least=100)])
    loud = np.flatnonzero(np.abs(sound.astype(int)) >= 100)
    if loud.size == 0:
        assert trimmed_sound.size == 0
        return
    wanted = sound[loud[0] : loud[-1] + 1]
    at = int(np.flatnonzero(np.abs(trimmed_sound.astype(int)) >= 100)[0])
    assert 0 <= at <= KEPT
    assert np.array_equal(trimmed_sound[at : at + len(wanted)], wanted)
    assert len(trimmed_sound) - at - len(wanted) <= KEPT


def test_of_a_whole_sound_the_loudest_sample_says_what_silence_is() -> None:
    noise = [40] * 50
    (sound,) = trimmed(iter([some(*noise, 20000, *noise)]), RATE_HZ, None)
    assert len(sound) == 2 * KEPT + 1


@given(lengths=st.lists(st.integers(1, 30), min_size=1, max_size=8), frames=st.integers(1, 40))
def test_appended_sound_is_read_once_and_in_order(lengths: list[int], frames: int) -> None:
    sound = StreamingBuffer(RATE_HZ, lambda: None)
    values = np.arange(1, sum(lengths) + 1, dtype=np.int16)
    places = []
    taken: list[Samples] = []
    for number, part in enumerate(np.split(values, np.cumsum(lengths)[:-1])):
        places.append((sound.append(part), part))
        if number % 2:
            taken.append(sound.read(frames))
    sound.finish()
    while not sound.over:
        taken.append(sound.read(frames))
    everything = np.concatenate(taken)
    assert np.array_equal(everything[everything != 0], values), "all of it, nothing twice"
    assert all(np.array_equal(everything[at : at + len(part)], part) for at, part in places), "where it was told"


def test_a_sound_of_which_nothing_was_heard_is_played_from_its_beginning() -> None:
    sound = StreamingBuffer(RATE_HZ, lambda: None)
    sound.append(some(1, 2, 3))
    sound.read(2)
    sound.rewind()
    assert sound.read(4).tolist() == [1, 2, 3, 0]
    sound.finish("broken")
    assert (sound.over, sound.trouble) == (True, "broken")


def test_the_cache_is_bounded_and_requested_texts_stay() -> None:
    kept = SoundCache(at_most_bytes=8)
    kept.want(["phrase"])
    assert kept.put("phrase", some(1, 2))
    assert kept.put("said", some(3, 4))
    assert kept.put("said later", some(5)), "what was said first makes room"
    assert kept.get("said") is None
    assert kept.get("phrase") is not None
    assert not kept.put("long", some(1, 2, 3)), "no room beside what is wanted"
    assert kept.bytes <= 8


def test_a_stop_reaches_who_asks_late() -> None:
    stop, reached = Stop(), []
    stop.set()
    stop.at_once(lambda: reached.append(True))
    assert reached == [True]
