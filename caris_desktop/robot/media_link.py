"""Media link: camera frames, maps, and audio."""

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock, link_commands
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import Problem
from caris_desktop.domain.link_commands import PlayOnRobot
from caris_desktop.domain.media_checks import PictureError, decode_compressed, fitted
from caris_desktop.domain.ports import FrameWriter
from caris_desktop.domain.sensing import AudioChunk, CameraLens, OccupancyGrid
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, SoundClock
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.bridge_wire import MEDIA_TIMINGS
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.link_process import GOODBYE_S, ConsoleSender
from caris_desktop.robot.profile_model import AudioInterface, CameraTopic, RobotProfile, TopicSource
from caris_desktop.robot.sensors import CLOCK
from caris_desktop.robot.transport import MEDIA_SIZES, LinkObserver, RosbridgeTopic
from caris_desktop.ros.message_conversion import (
    AudioForm,
    GridUpdate,
    decode_audio_data,
    decode_audio_info,
    decode_camera_info,
    decode_clock,
    decode_compressed_image,
    decode_image,
    decode_occupancy_grid,
    decode_occupancy_grid_update,
    encode_audio_data,
    republish_advice,
    samples_of,
)
from caris_desktop.ros.message_fields import MessageError

# It hardly ever changes, and rosbridge requires a throttle for a topic sent with every image.
LENS_EVERY_MS = 2000
_ADVISE_AFTER_NS = 5_000_000_000
_HEAVY_MB_PER_S = 1.0

# rosbridge's queue for slow clients; audio is never throttled.
_QUEUED = 100
_PACKAGE = "audio_common_msgs"


class RobotSound:
    """Forwards the microphone while requested, and plays audio. On the link's loop."""

    def __init__(self, link: LinkContext, interface: AudioInterface) -> None:
        self._ros = ros = link.ros
        self._interface = interface
        self._put = link.put
        self._problems = link.report.problems
        self._measurement = link.measurement
        self._form = AudioForm(interface.format, interface.rate_hz, interface.channels)
        self._clock = SoundClock()
        self._mp3: Mp3Stream | None = None
        self._ears: list[tuple[RosbridgeTopic, Callable[[Any], None]]] = []
        if interface.topic is not None:
            data_type = f"{_PACKAGE}/{interface.type}"
            topic = RosbridgeTopic(ros, interface.topic, data_type, queue_length=_QUEUED, every_message=True)
            self._ears.append((topic, self._on_sound))
            if interface.info is not None:
                info = RosbridgeTopic(ros, interface.info, f"{_PACKAGE}/AudioInfo")
                self._ears.append((info, self._on_info))
        self._speaker: RosbridgeTopic | None = None
        if interface.speaker is not None:
            self._speaker = RosbridgeTopic(ros, interface.speaker, f"{_PACKAGE}/AudioData")

    def listen(self, on: bool) -> None:
        """Start or stop the robot's microphone stream."""
        self._restart()
        for topic, take in self._ears:
            if on:
                topic.subscribe(take)
            else:
                topic.unsubscribe()

    def play(self, request: PlayOnRobot) -> None:
        """Send audio now, or not at all."""
        if self._speaker is not None:
            self._speaker.publish(encode_audio_data(request.samples))

    def link_lost(self) -> None:
        self._restart()

    def _restart(self) -> None:
        self._clock = SoundClock()
        self._mp3 = None

    def _on_info(self, message: Any) -> None:
        form = decode_audio_info(message)
        if form != self._form:
            logger.info("The robot's sound is %s", form)
            self._form = form
            self._restart()

    def _on_sound(self, message: Any) -> None:
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
        stamp_ns = self._measurement.measured_ns(packet.robot_stamp_ns, arrival_ns)[0] or stamp_ns
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
        except (av.FFmpegError, ValueError) as error:
            raise MessageError("it is not an mp3 stream") from error
        return (np.concatenate(parts), rate_hz) if parts else (np.zeros((0, 1), np.int16), 1)


logger = logging.getLogger(__name__)


class MediaLink(LinkObserver):
    """Bulk data on a separate socket and process, where decoding delays nothing else."""

    def __init__(self, profile: RobotProfile, address: str, outbox: ConsoleSender, frames: FrameWriter) -> None:
        self._put = outbox.put
        self._frames = frames
        self._closing = False
        streams = {camera.topic: "frame" for camera in profile.cameras}
        self._link = LinkContext(
            "media", profile, address, outbox, self, streams=streams, timings=MEDIA_TIMINGS, sizes=MEDIA_SIZES
        )
        self._report, self._ros, self._measurement = self._link.report, self._link.ros, self._link.measurement
        self._watched = self._link.watched
        self._takes_updates = profile.map_updates is not None
        self._lenses: dict[str, CameraModel] = {}
        self._raw_bytes: dict[str, tuple[int, int]] = {}
        self._advised: set[str] = set()
        listen = self._link.listen
        for camera in profile.cameras:
            images = TopicSource(camera.topic, camera.throttle_ms)
            listen(images, f"sensor_msgs/{camera.type}", partial(self._on_image, camera=camera))
            if camera.info is not None:
                info = TopicSource(camera.info, LENS_EVERY_MS)
                listen(info, "sensor_msgs/CameraInfo", partial(self._on_lens, camera=camera))
        self._sound: RobotSound | None = None
        if profile.audio is not None:
            self._sound = RobotSound(self._link, profile.audio)
        self._merger = MapMerger()
        self._map_due: asyncio.TimerHandle | None = None
        listen(profile.map, "nav_msgs/OccupancyGrid", self._on_map)
        # Even if it is latched, resubscribing would lose messages.
        updates = None if profile.map_updates is None else replace(profile.map_updates, latched=False)
        listen(updates, "map_msgs/OccupancyGridUpdate", self._on_map_update, queue_length=50, watched=False)
        if profile.simulation_time:
            add_time = self._measurement.add_simulation_time
            listen(CLOCK, "rosgraph_msgs/Clock", lambda message: add_time(decode_clock(message)), watched=False)

    def start(self) -> None:
        self._link.start()

    def process_commands(self, received: list[link_commands.RobotCommand]) -> None:
        for command in received:
            match command:
                case link_commands.ListenToRobot(on=on):
                    if self._sound is not None:
                        self._sound.listen(on)
                case link_commands.PlayOnRobot():
                    if self._sound is not None:
                        self._sound.play(command)
                case _:
                    logger.warning("The media link moves nothing; ignored: %s", type(command).__name__)

    async def finish(self) -> None:
        self._closing = True
        self._watched.link_lost()
        self._link.cancel()
        await self._ros.aclose(GOODBYE_S)
        self._report.changed("closed")

    def link_connected(self) -> None:
        self._report.changed("connected")
        self._watched.link_connected()

    def link_silent(self) -> None:
        self._report.changed("trouble", QT_TR_NOOP("No video or map for a moment"))

    def link_recovered(self) -> None:
        self._report.changed("connected")

    def link_lost(self, reason: str) -> None:
        self._watched.link_lost()
        self._merger.forget()
        self._lenses.clear()
        if self._sound is not None:
            self._sound.link_lost()
        if not self._closing:
            lost = localized(QT_TR_NOOP("The link for video and map was lost: {reason}"), reason=reason)
            self._report.changed("lost", lost)

    def link_unreachable(self, what: str, advice: str) -> None:
        self._report.unreachable(what, advice)

    def link_round_trip(self, round_trip_s: float) -> None:
        self._measurement.add_round_trip(round_trip_s)

    def link_refused(self, detail: str) -> None:
        self._report.refused(detail)

    def _on_image(self, message: Any, camera: CameraTopic) -> None:
        try:
            if camera.type == "CompressedImage":
                compressed = decode_compressed_image(message)
                image_bgr, robot_stamp_ns = decode_compressed(compressed.content), compressed.robot_stamp_ns
            else:
                raw = decode_image(message)
                image_bgr, robot_stamp_ns = fitted(raw.image_bgr), raw.robot_stamp_ns
            arrival_ns = self._ros.arrival_ns
            ref = self._frames.write(image_bgr, stamp_ns=arrival_ns, robot_stamp_ns=robot_stamp_ns, camera=camera.name)
        except MessageError as error:
            problem = localized(QT_TR_NOOP("the data cannot be read as an image: {why}"), why=error)
        except PictureError as error:
            problem = localized(QT_TR_NOOP("the last one {why}"), why=error)
        else:
            taken_ns, uncertainty_ns = self._measurement.measured_ns(ref.robot_stamp_ns, ref.stamp_ns)
            if taken_ns is not None:
                ref = replace(ref, taken_ns=taken_ns, taken_uncertainty_ns=uncertainty_ns)
            self._put(ref)
            if camera.type == "Image":
                self._advise(camera, image_bgr)
            return
        self._report.problems.count(
            f"image {camera.name}",
            severity="warning",
            what=localized(
                QT_TR_NOOP("{count} frame(s) from the camera {name} were dropped: {problem}."),
                name=camera.name,
                problem=problem,
            ),
            meaning=QT_TR_NOOP("The video freezes or stutters."),
            advice=localized(QT_TR_NOOP("Check what the robot publishes on {topic}."), topic=camera.topic),
        )

    def _advise(self, camera: CameraTopic, image_bgr: NDArray[np.uint8]) -> None:
        """Recommend compression once the load is known: uncompressed images are avoidable."""
        at_ns = self._ros.arrival_ns
        began_ns, total = self._raw_bytes.get(camera.name, (at_ns, 0))
        self._raw_bytes[camera.name] = began_ns, total + image_bgr.nbytes
        if camera.name in self._advised or at_ns - began_ns < _ADVISE_AFTER_NS:
            return
        self._advised.add(camera.name)
        mb_per_s = total / (at_ns - began_ns) * 1e3
        if mb_per_s < _HEAVY_MB_PER_S:
            return
        self._put(
            Problem(
                clock.now_ns(),
                "info",
                localized(
                    QT_TR_NOOP("The camera {name} sends uncompressed images, about {mb_per_s} MB per second."),
                    name=camera.name,
                    mb_per_s=f"{mb_per_s:.0f}",
                ),
                QT_TR_NOOP("Over a wireless link, the video may stutter and delay everything else."),
                localized(
                    QT_TR_NOOP("Compress them on the robot: {republish_advice}."),
                    republish_advice=republish_advice(camera.topic),
                ),
            )
        )

    def _on_lens(self, message: Any, camera: CameraTopic) -> None:
        decoded = decode_camera_info(message)
        if decoded is None:
            return
        model, robot_stamp_ns = decoded
        if camera.model is not None:  # its mounting is known only from the profile
            model = replace(
                camera.model, width_px=model.width_px, height_px=model.height_px,
                fx_px=model.fx_px, fy_px=model.fy_px, cx_px=model.cx_px, cy_px=model.cy_px,
            )  # fmt: skip
        if self._lenses.get(camera.name) != model:
            self._lenses[camera.name] = model
            self._put(CameraLens(self._ros.arrival_ns, robot_stamp_ns, camera.name, model))

    def _on_map(self, message: Any) -> None:
        grid = decode_occupancy_grid(message, stamp_ns=self._ros.arrival_ns)
        if self._takes_updates:
            self._merger.replace(grid)
        self._put(grid)

    def _on_map_update(self, message: Any) -> None:
        update = decode_occupancy_grid_update(message)
        try:
            merged = self._merger.update(update, stamp_ns=self._ros.arrival_ns)
        except MessageError as error:
            self._report.problems.count(
                "map update",
                severity="warning",
                what=localized(QT_TR_NOOP("{count} update(s) of the robot's map were rejected: {error}."), error=error),
                meaning=QT_TR_NOOP("Parts of the map may be out of date."),
                advice=QT_TR_NOOP("The next complete map corrects it. Check that both topics belong to the same map."),
            )
            return
        if merged and self._map_due is None:
            self._map_due = asyncio.get_running_loop().call_later(self._merger.period_s, self._put_merged_map)

    def _put_merged_map(self) -> None:
        self._map_due = None
        grid = self._merger.snapshot()
        if grid is not None:
            self._put(grid)


# A map of 4000 x 4000 cells goes to the window at most a few times a minute, a small one five times a second.
_LEAST_PERIOD_S = 0.2
_CELLS_PER_S = 8_000_000


class MapMerger:
    """Map assembly from whole maps and partial updates.

    Holds the newest whole map and applies updates.
    """

    def __init__(self) -> None:
        self._grid: OccupancyGrid | None = None

    @property
    def period_s(self) -> float:
        """Minimum interval for passing on the whole map during updates."""
        cells = 0 if self._grid is None else self._grid.cells.size
        return max(_LEAST_PERIOD_S, cells / _CELLS_PER_S)

    def replace(self, grid: OccupancyGrid) -> None:
        """Set a whole map."""
        self._grid = replace(grid, cells=grid.cells.copy())

    def forget(self) -> None:
        self._grid = None

    def update(self, update: GridUpdate, *, stamp_ns: int) -> bool:
        """Apply a partial update. False if there is no map.

        Raises
        ------
        MessageError
            When the part does not lie within the map.
        """
        grid = self._grid
        if grid is None:
            return False
        height, width = update.cells.shape
        rows, columns = grid.cells.shape
        if update.x + width > columns or update.y + height > rows:
            raise MessageError(
                f"an update of {width} x {height} cells at ({update.x}, {update.y}) is outside the map of "
                f"{columns} x {rows}"
            )
        grid.cells[update.y : update.y + height, update.x : update.x + width] = update.cells
        self._grid = replace(grid, stamp_ns=stamp_ns, robot_stamp_ns=update.robot_stamp_ns)
        return True

    def snapshot(self) -> OccupancyGrid | None:
        """Copy of the present map; later updates do not change it."""
        return None if self._grid is None else replace(self._grid, cells=np.array(self._grid.cells))
