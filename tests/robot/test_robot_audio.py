"""Robot microphone and loudspeaker over the media link: both encodings, gaps, stamps, mp3 and invalid data."""

import base64
from typing import Any

import av
import numpy as np
import pytest

from caris_desktop.domain import clock, link_commands
from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.robot.link_process import ConsoleSender
from caris_desktop.robot.profile_model import AudioInterface, RobotProfile
from tests.robot.loop_bench import Bridge, LoopBench, with_link

TONE = (np.sin(np.arange(1600) / 10) * 8000).astype(np.int16)
EAR = AudioInterface("/audio", speaker="/speaker")
ROBOT = RobotProfile("test", "Test", audio=EAR)


async def listening(bench: LoopBench) -> dict[str, Any]:
    assert bench.bridge.operations("subscribe", "/audio") == [], "nobody has asked for it"
    bench.link.process_commands([link_commands.ListenToRobot(1, on=True)])
    [subscribed] = await bench.until(lambda: bench.bridge.operations("subscribe", "/audio"), "the subscription")
    return subscribed


def test_robot_sound_arrives_in_either_encoding_while_it_is_subscribed() -> None:
    async def test(bench: LoopBench) -> None:
        subscribed = await listening(bench)
        assert subscribed["type"] == "audio_common_msgs/AudioData"
        assert subscribed["compression"] == "cbor"
        assert subscribed.get("throttle_rate", 0) == 0, "every piece of it counts"
        await bench.bridge.publish("/audio", {"data": TONE.tobytes()}, cbor=True)
        await bench.bridge.publish("/audio", {"data": base64.b64encode(TONE.tobytes()).decode()})
        first, second = await bench.until(
            lambda: bench.of(AudioChunk) if len(bench.of(AudioChunk)) == 2 else None, "two pieces of sound"
        )
        for chunk in (first, second):
            assert (chunk.source, chunk.sample_rate_hz, chunk.samples.shape) == ("robot microphone", 16000, (1600, 1))
            assert np.array_equal(chunk.samples[:, 0], TONE)
        assert second.stamp_ns - first.stamp_ns == pytest.approx(100_000_000, abs=2_000_000), "one follows the other"
        bench.link.process_commands([link_commands.ListenToRobot(2, on=False)])
        await bench.until(lambda: bench.bridge.operations("unsubscribe", "/audio"), "the end of the subscription")

    with_link(ROBOT, test, media=True)


def test_it_is_listened_to_again_when_the_connection_is_back() -> None:
    async def test(bench: LoopBench) -> None:
        await listening(bench)
        await bench.bridge.drop()
        await bench.until(lambda: len(bench.bridge.operations("subscribe", "/audio")) == 2, "subscribed again")

    with_link(ROBOT, test, media=True)


def test_broken_pieces_are_one_problem_and_the_next_good_one_is_heard() -> None:
    async def test(bench: LoopBench) -> None:
        await listening(bench)
        for content in (b"odd", 7, "§", None):
            await bench.bridge.publish("/audio", {"data": content}, cbor=True)
        await bench.bridge.publish("/audio", {"data": TONE.tobytes()}, cbor=True)
        await bench.until(lambda: bench.of(AudioChunk), "the good one")
        [problem] = bench.of(Problem)
        assert "1 chunk(s) of the robot's audio were dropped" in problem.what
        assert "/audio" in problem.advice

    with_link(ROBOT, test, media=True)


def test_the_form_that_the_robot_reports_replaces_that_of_the_profile() -> None:
    async def test(bench: LoopBench) -> None:
        await listening(bench)
        form = {"channels": 2, "sample_rate": 44100, "sample_format": "S16LE", "bitrate": 0, "coding_format": "wave"}
        await bench.bridge.publish("/info", form)
        await bench.bridge.publish("/audio", {"data": TONE.tobytes()}, cbor=True)
        [chunk] = await bench.until(lambda: bench.of(AudioChunk), "sound")
        assert (chunk.sample_rate_hz, chunk.samples.shape) == (44100, (800, 2))

    with_link(RobotProfile("test", "Test", audio=AudioInterface("/audio", info="/info")), test, media=True)


def mp3_of(samples: np.ndarray, rate_hz: int) -> bytes:
    codec: Any = av.CodecContext.create("libmp3lame", "w")
    codec.sample_rate, codec.layout, codec.format = rate_hz, "mono", "s16p"
    frame = av.AudioFrame.from_ndarray(samples[None, :], format="s16p", layout="mono")
    frame.sample_rate = rate_hz
    return b"".join(bytes(packet) for packet in [*codec.encode(frame), *codec.encode(None)])


def test_an_mp3_stream_is_heard_however_it_is_cut() -> None:
    tone = (np.sin(np.arange(32000) * 2 * np.pi * 440 / 16000) * 8000).astype(np.int16)
    content = mp3_of(tone, 16000)

    async def test(bench: LoopBench) -> None:
        await listening(bench)
        for begin in range(0, len(content), 500):
            await bench.bridge.publish("/audio", {"data": content[begin : begin + 500]}, cbor=True)
        await bench.until(lambda: sum(len(each.samples) for each in bench.of(AudioChunk)) > 28000, "most of it")
        samples = np.concatenate([each.samples[:, 0] for each in bench.of(AudioChunk)]).astype(float)
        spectrum = np.abs(np.fft.rfft(samples[4000:20000]))
        assert np.argmax(spectrum) == pytest.approx(440, abs=2)
        assert {each.sample_rate_hz for each in bench.of(AudioChunk)} == {16000}

    with_link(RobotProfile("test", "Test", audio=AudioInterface("/audio", format="mp3")), test, media=True)


def test_a_stamp_of_the_robot_is_the_moment_of_the_first_sample() -> None:
    ahead_ns = 1_700_000_000 * 1_000_000_000

    def told_time(_request: object) -> dict[str, object]:
        seconds, nanoseconds = divmod(clock.now_ns() + ahead_ns, 1_000_000_000)
        return {"time": {"secs": seconds, "nsecs": nanoseconds}}

    async def test(bench: LoopBench) -> None:
        await listening(bench)
        await bench.until(lambda: bench.link._measurement.offset_at(clock.now_ns()), "the robot's clock is known")
        begun_ns = clock.now_ns() - 250_000_000
        seconds, nanoseconds = divmod(begun_ns + ahead_ns, 1_000_000_000)
        header = {"stamp": {"secs": seconds, "nsecs": nanoseconds}, "frame_id": ""}
        await bench.bridge.publish("/audio", {"header": header, "audio": {"data": TONE.tobytes()}}, cbor=True)
        [chunk] = await bench.until(lambda: bench.of(AudioChunk), "sound")
        assert chunk.stamp_ns == pytest.approx(begun_ns, abs=20_000_000)

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/rosapi/get_time"] = told_time

    robot = RobotProfile("test", "Test", audio=AudioInterface("/audio", "AudioDataStamped"))
    with_link(robot, test, media=True, prepare=prepare)


def test_the_wizards_voice_goes_to_the_robots_loudspeaker_now_or_never() -> None:
    async def test(bench: LoopBench) -> None:
        bench.link.process_commands([link_commands.PlayOnRobot(1, TONE[:, None])])
        [message] = await bench.until(lambda: bench.bridge.published("/speaker"), "the sound")
        assert base64.b64decode(message["data"]) == TONE.tobytes()
        [told] = bench.bridge.operations("advertise", "/speaker")
        assert told["type"] == "audio_common_msgs/AudioData"

    with_link(ROBOT, test, media=True)


def test_a_console_that_sleeps_misses_no_sound_of_some_seconds() -> None:
    class Pipe:
        def __init__(self) -> None:
            self.sent: list[object] = []

        def send(self, value: object) -> None:
            self.sent.append(value)

    pipe = Pipe()
    outbox = ConsoleSender(pipe)  # type: ignore[arg-type]
    with outbox._changed:  # blocks the writer, as a full pipe does
        for number in range(100):
            outbox.put(AudioChunk(number, "robot microphone", 16000, TONE[:, None]))
    outbox.close(5.0)
    assert [value.stamp_ns for value in pipe.sent if isinstance(value, AudioChunk)] == list(range(100))
