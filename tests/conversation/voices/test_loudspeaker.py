"""Streaming buffer for the sound card."""

import threading
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.voice_engine import _Playback
from caris_desktop.conversation.voices.utterance_sound import StreamingBuffer
from tests.support.polling import wait_for

RATE_HZ = 1000
FRAMES = 20
TIMES = SimpleNamespace(outputBufferDacTime=0.0, currentTime=0.0)


class Card:
    """Sound card that requests ``blocks`` when it starts, with a simulated clock."""

    def __init__(self) -> None:
        self.sound = StreamingBuffer(RATE_HZ, lambda: None)
        self.silenced = threading.Event()
        self.now_ns = 0
        self.playback = _Playback(self.sound, self.silenced, threading.Event(), now_ns=lambda: self.now_ns)
        self.taken: list[NDArray[np.int16]] = []
        self._thread = threading.Thread(target=lambda: None)

    def ask(self, blocks: int) -> None:
        def fill() -> None:
            for _ in range(blocks):
                out = bytearray(2 * FRAMES)
                self.playback.fill(memoryview(out), FRAMES, TIMES, None)
                self.taken.append(np.frombuffer(bytes(out), np.int16))

        self._thread = threading.Thread(target=fill)
        self._thread.start()

    def waits_behind(self, blocks: int) -> None:
        wait_for(lambda: len(self.taken) == blocks, "it takes what there is")
        assert self._thread.is_alive()

    def end(self) -> NDArray[np.int16]:
        self._thread.join(10.0)
        assert not self._thread.is_alive()
        return np.concatenate(self.taken)


def sounding(frames: int) -> NDArray[np.int16]:
    return np.full(frames, 7, np.int16)


def test_a_card_that_requests_more_than_is_made_hears_no_gap() -> None:
    card = Card()
    card.sound.append(sounding(150))
    card.ask(10)
    card.waits_behind(7)
    card.sound.append(sounding(50))
    assert (card.end() == 7).all()


def test_before_it_runs_dry_it_gets_silence() -> None:
    card = Card()
    card.sound.append(sounding(150))
    card.ask(8)
    card.waits_behind(7)
    card.now_ns = 100_000_000  # of the 140 ms that it has buffered
    assert list(card.end()[140:]) == [7] * 10 + [0] * 10
    assert card.sound.append(sounding(50)) == 160, "what comes late is heard whole"


def test_the_end_of_a_sound_is_not_waited_behind() -> None:
    card = Card()
    card.sound.append(sounding(150))
    card.sound.finish()
    card.ask(10)
    assert list(card.end()[140:160]) == [7] * 10 + [0] * 10


def test_a_silenced_sound_waits_for_nothing() -> None:
    card = Card()
    card.sound.append(sounding(150))
    card.ask(8)
    card.waits_behind(7)
    card.silenced.set()
    card.playback.leave()
    assert card.end().size == 160
