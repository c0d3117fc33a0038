"""Audio messages (audio_common_msgs), of audio_common in ROS 1 and its ROS 2 branch."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value
from caris_desktop.ros.message_fields import Message, MessageError, blob, count, message_of, part, stamp_of, text

MAX_AUDIO_BYTES = 1_000_000
MOST_CHANNELS = 16
LEAST_RATE_HZ, MOST_RATE_HZ = 4_000, 192_000

Coding = Literal["wave", "mp3"]


class AudioPacket(Value):
    """Content of one message: raw samples, or a piece of an mp3 stream."""

    content: bytes
    robot_stamp_ns: int | None


class AudioForm(Value):
    """Audio format of a topic."""

    coding: Coding
    rate_hz: int
    channels: int


def decode_audio_data(message: Any) -> AudioPacket:
    """Decode audio_common_msgs/AudioData, or AudioDataStamped, whose stamp is that of its first sample."""
    audio = message_of(message, "AudioData")
    if "audio" in audio:
        data = part(audio, "audio", "AudioDataStamped")
        content = blob(data, "data", "AudioDataStamped.audio", most=MAX_AUDIO_BYTES)
        return AudioPacket(content, stamp_of(audio, "AudioDataStamped"))
    return AudioPacket(blob(audio, "data", "AudioData", most=MAX_AUDIO_BYTES), None)


def encode_audio_data(samples: NDArray[np.int16]) -> Message:
    """Encode audio_common_msgs/AudioData as wave; ``samples`` has the shape (samples, channels)."""
    return {"data": np.ascontiguousarray(samples, dtype="<i2").tobytes()}


def decode_audio_info(message: Any) -> AudioForm:
    """Decode audio_common_msgs/AudioInfo."""
    info = message_of(message, "AudioInfo")
    coding = text(info, "coding_format", "AudioInfo", most=40).lower()
    if coding not in ("wave", "mp3"):
        raise MessageError(f"audio encoded as '{coding}' is not supported; wave and mp3 are")
    sample_format = text(info, "sample_format", "AudioInfo", most=40)
    if coding == "wave" and sample_format.upper() != "S16LE":
        raise MessageError(f"samples in the format '{sample_format}' are not supported; S16LE is")
    rate_hz = count(info, "sample_rate", "AudioInfo", most=MOST_RATE_HZ)
    channels = count(info, "channels", "AudioInfo", most=MOST_CHANNELS)
    if rate_hz < LEAST_RATE_HZ or not channels:
        raise MessageError(f"audio with {rate_hz} samples per second and {channels} channels")
    return AudioForm("wave" if coding == "wave" else "mp3", rate_hz, channels)


def encode_audio_info(form: AudioForm, *, bitrate: int = 0) -> Message:
    """Encode audio_common_msgs/AudioInfo."""
    return {
        "channels": form.channels,
        "sample_rate": form.rate_hz,
        "sample_format": "S16LE",
        "bitrate": bitrate,
        "coding_format": form.coding,
    }


def samples_of(content: bytes, channels: int) -> NDArray[np.int16]:
    """S16LE as int16, shape (samples, channels). Raises MessageError for incomplete samples."""
    if len(content) % (2 * channels):
        raise MessageError(f"{len(content)} bytes of audio are not complete samples of {channels} channel(s)")
    return np.frombuffer(content, "<i2").astype(np.int16).reshape(-1, channels)
