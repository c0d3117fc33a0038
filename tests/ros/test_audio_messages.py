"""audio_common_msgs in both encodings of rosbridge, and refused messages."""

import base64
from typing import Any

import numpy as np
import pytest

from caris_desktop.ros.definitions import cbor_carries
from caris_desktop.ros.message_conversion import (
    AudioForm,
    decode_audio_data,
    decode_audio_info,
    encode_audio_data,
    samples_of,
)
from caris_desktop.ros.message_fields import MessageError
from caris_desktop.ros.rosbridge import decode_cbor, decode_json, encode_cbor, encode_json

INFO = {"channels": 2, "sample_rate": 44100, "sample_format": "S16LE", "bitrate": 0, "coding_format": "mp3"}
STEREO = np.array([[1, -2], [300, -32768]], np.int16)


def test_samples_come_through_either_encoding() -> None:
    for encode, decode in ((encode_json, decode_json), (encode_cbor, decode_cbor)):
        operation = {"op": "publish", "topic": "/audio", "msg": encode_audio_data(STEREO)}
        packet = decode_audio_data(decode(encode(operation))["msg"])
        assert packet.robot_stamp_ns is None
        assert samples_of(packet.content, 2).tolist() == STEREO.tolist()


def test_a_stamped_message_reports_its_moment_in_both_versions_of_ros() -> None:
    data = base64.b64encode(STEREO.tobytes()).decode()
    for stamp in ({"secs": 3, "nsecs": 4}, {"sec": 3, "nanosec": 4}):
        packet = decode_audio_data({"header": {"stamp": stamp, "frame_id": ""}, "audio": {"data": data}})
        assert packet.robot_stamp_ns == 3_000_000_004
        assert packet.content == STEREO.tobytes()


@pytest.mark.parametrize("kind", ["audio_common_msgs/AudioData", "audio_common_msgs/msg/AudioDataStamped"])
def test_it_is_requested_in_the_compact_form(kind: str) -> None:
    assert cbor_carries(kind)


def test_the_form_is_reported() -> None:
    assert decode_audio_info(INFO) == AudioForm("mp3", 44100, 2)


@pytest.mark.parametrize(
    "message",
    [
        None,
        {"data": "§"},
        {"data": "A" * 2_000_000},
        {"audio": [1, 2]},
        {"header": {"stamp": "now"}, "audio": {"data": ""}},
    ],
)
def test_a_message_without_sound_is_refused(message: Any) -> None:
    with pytest.raises(MessageError):
        decode_audio_data(message)


@pytest.mark.parametrize(
    "wrong", [{"coding_format": "opus"}, {"sample_format": "F32LE"}, {"sample_rate": 10}, {"channels": 0}]
)
def test_a_form_that_is_not_read_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(MessageError):
        decode_audio_info(INFO | {"coding_format": "wave"} | wrong)


def test_half_a_sample_is_refused() -> None:
    with pytest.raises(MessageError, match="3 bytes"):
        samples_of(b"abc", 1)
