"""Synthetic sound: room impulse responses and speech-like noise."""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import AudioChunk

RATE_HZ = 16_000


def speech_like(seconds: float, seed: int, rate_hz: int = RATE_HZ) -> NDArray[np.float64]:
    """Syllables of coloured noise with pauses, about four per second; RMS level 0.1 within a syllable."""
    rng = np.random.default_rng(seed)
    sound = np.zeros(round(seconds * rate_hz))
    at = 0
    while at < len(sound):
        length = round(rng.uniform(0.08, 0.3) * rate_hz)
        spectrum = np.fft.rfft(rng.standard_normal(length))
        frequency_hz = np.fft.rfftfreq(length, 1.0 / rate_hz)
        colour = sum(np.exp(-(((frequency_hz - rng.uniform(200, 4_000)) / rng.uniform(100, 500)) ** 2)) for _ in "abc")
        syllable = np.fft.irfft(spectrum * colour, length) * np.hanning(length)
        syllable *= 0.1 / np.sqrt((syllable**2).mean())
        part = sound[at : at + length]
        part += syllable[: len(part)]
        at += length + round(rng.choice([0.0, 0.02, 0.15]) * rate_hz)
    return sound


def room_impulse_response(
    rng: np.random.Generator, *, delay_s: float | None = None, rt60_s: float | None = None
) -> NDArray[np.float64]:
    """Random impulse response from a loudspeaker to a microphone at 16 kHz, with energy 1: 5 to 60 ms delay, early
    reflections and an RT60 of 0.2 to 0.7 s.
    """
    delay = round((rng.uniform(0.005, 0.060) if delay_s is None else delay_s) * RATE_HZ)
    length = round((rng.uniform(0.2, 0.7) if rt60_s is None else rt60_s) * RATE_HZ)
    tail = rng.standard_normal(length) * 10.0 ** (-3.0 * np.arange(length) / length)
    tail[:32] = 0
    tail *= 10.0 ** (-rng.uniform(-3.0, 6.0) / 20.0) / np.sqrt((tail**2).sum())
    response = np.zeros(delay + length)
    response[delay] = 1.0
    for _ in range(rng.integers(2, 6)):
        response[delay + round(rng.uniform(0.001, 0.02) * RATE_HZ)] += rng.uniform(-0.6, 0.6)
    response[delay:] += tail
    return response / np.sqrt((response**2).sum())


def convolved(response: NDArray[np.float64], sound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sound convolved with an impulse response, cut to the length of the sound."""
    size = 1 << (len(response) + len(sound)).bit_length()
    return np.fft.irfft(np.fft.rfft(response, size) * np.fft.rfft(sound, size), size)[: len(sound)]


def int16(sound: NDArray[np.float64]) -> NDArray[np.int16]:
    """One channel of 16-bit samples, as of a sound device; clipped at full scale."""
    return (np.clip(sound, -1.0, 0.9999) * 32_768).astype(np.int16)[:, np.newaxis]


def chunks_of(
    sound: NDArray[np.float64], start_ns: int, source: str, *, rate_hz: int = RATE_HZ, block_s: float = 0.02
) -> list[AudioChunk]:
    """Audio chunks as of a microphone."""
    samples, block = int16(sound), round(block_s * rate_hz)
    return [
        AudioChunk(start_ns + at * 1_000_000_000 // rate_hz, source, rate_hz, samples[at : at + block])
        for at in range(0, len(samples), block)
    ]
