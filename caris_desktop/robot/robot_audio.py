"""Robot microphone and streaming loudspeaker (``audio`` in the profile)."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.link_commands import PlayOnRobot
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_clock import SoundClock
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.clock_offset import OffsetEstimate
from caris_desktop.robot.console_sender import ProblemReporter
from caris_desktop.robot.profile import AudioInterface
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.audio_messages import (
    AudioForm,
    decode_audio_data,
    decode_audio_info,
    encode_audio_data,
    samples_of,
)
from caris_desktop.ros.dialect import Dialect, type_name
from caris_desktop.ros.message_fields import MessageError

# rosbridge's queue for slow clients; audio is never throttled.
_QUEUED = 100
_PACKAGE = "audio_common_msgs"

logger = logging.getLogger(__name__)


class RobotSound:
    """Forwards the microphone while requested, and plays audio. On the link's loop."""

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        interface: AudioInterface,
        *,
        put: Callable[[AudioChunk], None],
        problems: ProblemReporter,
        offset_at: Callable[[int], OffsetEstimate | None],
    ) -> None:
        self._ros = ros
        self._interface = interface
        self._put = put
        self._problems = problems
        self._offset_at = offset_at
        self._form = AudioForm(interface.format, interface.rate_hz, interface.channels)
        self._clock = SoundClock()
        self._mp3: Mp3Stream | None = None
        self._ears: list[tuple[RosbridgeTopic, Callable[[Any], None]]] = []
        if interface.topic is not None:
            data_type = type_name(dialect, _PACKAGE, interface.type)
            topic = RosbridgeTopic(ros, interface.topic, data_type, queue_length=_QUEUED, every_message=True)
            self._ears.append((topic, self._take))
            if interface.info is not None:
                info = RosbridgeTopic(ros, interface.info, type_name(dialect, _PACKAGE, "AudioInfo"))
                self._ears.append((info, self._take_info))
        self._speaker: RosbridgeTopic | None = None
        if interface.speaker is not None:
            self._speaker = RosbridgeTopic(ros, interface.speaker, type_name(dialect, _PACKAGE, "AudioData"))

    def listen(self, on: bool) -> None:
        """Start or stop the robot's microphone stream."""
        self._restart()
        for topic, take in self._ears:
            if on:
                topic.subscribe(take)
            else:
                topic.unsubscribe()

    def play(self, asked: PlayOnRobot) -> None:
        """Send audio now, or not at all."""
        if self._speaker is not None:
            self._speaker.publish(encode_audio_data(asked.samples))

    def link_lost(self) -> None:
        self._restart()

    def _restart(self) -> None:
        self._clock = SoundClock()
        self._mp3 = None

    def _take_info(self, message: Any) -> None:
        form = decode_audio_info(message)
        if form != self._form:
            logger.info("The robot's sound is %s", form)
            self._form = form
            self._restart()

    def _take(self, message: Any) -> None:
        arrival_ns = self._ros.arrival_ns
        try:
            packet = decode_audio_data(message)
            samples, rate_hz = self._samples(packet.content)
        except MessageError as error:
            self._problems.count(
                "sound",
                severity="warning",
                what=localized(QT_TR_NOOP("{count} chunk(s) of the robot's audio were dropped: {error}."), error=error),
                meaning=QT_TR_NOOP("Speech during this time is neither heard nor recorded."),
                advice=localized(
                    QT_TR_NOOP("Compare 'audio' in the robot profile with what the robot publishes on {topic}."),
                    topic=self._interface.topic,
                ),
            )
            return
        if not len(samples):
            return
        length_ns = len(samples) * 1_000_000_000 // rate_hz
        stamp_ns, missing_ns = self._clock.stamp(arrival_ns=arrival_ns, length_ns=length_ns)
        stamp_ns = self._by_robot(packet.robot_stamp_ns, arrival_ns) or stamp_ns
        if missing_ns:
            self._problems.count(
                "missing sound",
                severity="info",
                what=localized(
                    QT_TR_NOOP("The robot's audio was interrupted for {missing_ns} s ({count} time(s) recently)."),
                    missing_ns=f"{missing_ns / 1000000000.0:.1f}",
                ),
                meaning=QT_TR_NOOP("Speech during this time is neither heard nor recorded."),
                advice=QT_TR_NOOP("If this happens often, check the robot's network."),
            )
        self._put(AudioChunk(stamp_ns, ROBOT_MICROPHONE, rate_hz, samples))

    def _by_robot(self, robot_stamp_ns: int | None, arrival_ns: int) -> int | None:
        offset = self._offset_at(arrival_ns)
        if offset is None:
            return None
        return clock.measured_ns(
            robot_stamp_ns,
            arrival_ns=arrival_ns,
            offset_ns=offset.offset_ns,
            uncertainty_ns=offset.uncertainty_ns,
        )

    def _samples(self, content: bytes) -> tuple[NDArray[np.int16], int]:
        if self._form.coding == "wave":
            return samples_of(content, self._form.channels), self._form.rate_hz
        if self._mp3 is None:
            self._mp3 = Mp3Stream()
        return self._mp3.decode(content)


class Mp3Stream:
    """Decoder of an mp3 stream in arbitrary pieces."""

    def __init__(self) -> None:
        import av

        self._codec: Any = av.CodecContext.create("mp3", "r")
        self._resampler: Any = None
        self._error: type[Exception] = av.FFmpegError

    def decode(self, content: bytes) -> tuple[NDArray[np.int16], int]:
        """Samples completed by this piece, shape (samples, channels), and the sample rate.

        Raises MessageError.
        """
        import av

        parts: list[NDArray[np.int16]] = []
        rate_hz = 0
        try:
            for packet in self._codec.parse(content):
                for frame in self._codec.decode(packet):
                    rate_hz = int(frame.sample_rate)
                    if self._resampler is None:
                        self._resampler = av.AudioResampler("s16", frame.layout, rate_hz)
                    channels = frame.layout.nb_channels
                    for plain in self._resampler.resample(frame):
                        parts.append(plain.to_ndarray().reshape(-1, channels))
        except (self._error, ValueError) as error:
            raise MessageError("it is not an mp3 stream") from error
        return (np.concatenate(parts), rate_hz) if parts else (np.zeros((0, 1), np.int16), 1)
