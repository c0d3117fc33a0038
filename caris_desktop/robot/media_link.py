"""Media link: camera frames, maps, and audio."""

import asyncio
import logging
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock, link_commands
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import Problem
from caris_desktop.domain.picture_checks import PictureError, decode_compressed, fitted
from caris_desktop.domain.ports import FrameWriter
from caris_desktop.domain.sensing import CameraLens, FrameRef
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.bridge_wire import MEDIA_TIMINGS
from caris_desktop.robot.console_sender import ConsoleSender
from caris_desktop.robot.link_measurement import LinkMeasurement
from caris_desktop.robot.link_process import GOODBYE_S, LinkReporter
from caris_desktop.robot.map_merger import MapMerger
from caris_desktop.robot.profile import CameraTopic, RobotProfile
from caris_desktop.robot.robot_audio import RobotSound
from caris_desktop.robot.sensors import CLOCK
from caris_desktop.robot.subscription_watchdog import SubscriptionWatchdog
from caris_desktop.robot.traffic import TrafficMeter
from caris_desktop.robot.transport import MEDIA_SIZES, RosbridgeClient, RosbridgeTopic
from caris_desktop.ros.dialect import Dialect, type_name
from caris_desktop.ros.message_conversion import decode_camera_info, decode_compressed_image, decode_occupancy_grid
from caris_desktop.ros.message_fields import MessageError
from caris_desktop.ros.navigation_messages import decode_clock, decode_occupancy_grid_update
from caris_desktop.ros.raw_image import decode_image, republish_advice

# It hardly ever changes, and rosbridge requires a throttle for a topic sent with every image.
LENS_EVERY_MS = 2000
_ADVISE_AFTER_NS = 5_000_000_000
_HEAVY_MB_PER_S = 1.0

logger = logging.getLogger(__name__)


class MediaLink:
    """Bulk data on a separate socket and process, where decoding delays nothing else."""

    def __init__(self, profile: RobotProfile, address: str, outbox: ConsoleSender, frames: FrameWriter) -> None:
        dialect = Dialect(profile.ros)
        self._put = outbox.put
        self._frames = frames
        self._closing = False
        self._report = LinkReporter("media", address, outbox)
        traffic = TrafficMeter("media")
        self._ros = RosbridgeClient(
            address, self, timings=MEDIA_TIMINGS, sizes=MEDIA_SIZES, security=profile.security, traffic=traffic
        )
        self._measurement = LinkMeasurement(
            self._ros, traffic, self._put,
            link="media",
            streams={camera.topic: "frame" for camera in profile.cameras},
            simulation_time=profile.simulation_time,
        )  # fmt: skip
        self._takes_updates = profile.map_updates is not None
        self._measuring: asyncio.Task[None] | None = None
        self._lenses: dict[str, CameraModel] = {}
        self._watched = SubscriptionWatchdog(self._ros, dialect, tell=self._put)
        self._raw_bytes: dict[str, tuple[int, int]] = {}
        self._advised: set[str] = set()
        for camera in profile.cameras:
            images = RosbridgeTopic(
                self._ros,
                camera.topic,
                type_name(dialect, "sensor_msgs", camera.type),
                throttle_rate=camera.throttle_ms,
            )
            self._watched.subscribe(images, partial(self._take_image, camera=camera))
            if camera.info is not None:
                info_type = type_name(dialect, "sensor_msgs", "CameraInfo")
                info = RosbridgeTopic(self._ros, camera.info, info_type, throttle_rate=LENS_EVERY_MS)
                self._watched.subscribe(info, partial(self._take_lens, camera=camera))
        self._sound: RobotSound | None = None
        if profile.audio is not None:
            self._sound = RobotSound(
                self._ros, dialect, profile.audio,
                put=self._put, problems=self._report.problems, offset_at=self._measurement.offset_at,
            )  # fmt: skip
        self._merger = MapMerger()
        self._map_due: asyncio.TimerHandle | None = None
        if profile.map is not None:
            grid_type = type_name(dialect, "nav_msgs", "OccupancyGrid")
            topic = RosbridgeTopic(self._ros, profile.map.topic, grid_type, throttle_rate=profile.map.throttle_ms)
            self._watched.subscribe(topic, self._take_map)
        if profile.map_updates is not None:
            RosbridgeTopic(
                self._ros,
                profile.map_updates.topic,
                type_name(dialect, "map_msgs", "OccupancyGridUpdate"),
                throttle_rate=profile.map_updates.throttle_ms,
                queue_length=50,
                every_message=True,
            ).subscribe(self._take_map_update)
        if profile.simulation_time:
            clock = RosbridgeTopic(
                self._ros, CLOCK.topic, type_name(dialect, "rosgraph_msgs", "Clock"), throttle_rate=CLOCK.throttle_ms
            )
            clock.subscribe(lambda message: self._measurement.take_simulation_time(decode_clock(message)))

    def start(self) -> None:
        self._report.changed("connecting")
        self._ros.connect()
        self._measuring = asyncio.get_running_loop().create_task(self._measurement.run())

    def take_commands(self, received: list[link_commands.RobotCommand]) -> None:
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
        if self._measuring is not None:
            self._measuring.cancel()
        await self._ros.aclose(GOODBYE_S)
        self._report.changed("closed")

    def link_connected(self) -> None:
        self._report.changed("connected")
        self._watched.link_connected()

    def link_silent(self) -> None:
        self._report.changed("trouble", QT_TR_NOOP("No video or map for a moment"))

    def link_heard(self) -> None:
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
        self._measurement.take_round_trip(round_trip_s)

    def link_refused(self, detail: str) -> None:
        self._report.refused(detail)

    def _take_image(self, message: Any, camera: CameraTopic) -> None:
        try:
            image_bgr, robot_stamp_ns = _unfolded(message) if camera.type == "CompressedImage" else _raw(message)
            ref = self._frames.write(
                image_bgr, stamp_ns=self._ros.arrival_ns, robot_stamp_ns=robot_stamp_ns, camera=camera.name
            )
        except MessageError as error:
            problem = localized(QT_TR_NOOP("the data cannot be read as an image: {why}"), why=error)
        except PictureError as error:
            problem = localized(QT_TR_NOOP("the last one {why}"), why=error)
        else:
            self._put(self._with_its_moment(ref))
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

    def _with_its_moment(self, ref: FrameRef) -> FrameRef:
        offset = self._measurement.offset_at(ref.stamp_ns)
        if offset is None:
            return ref
        taken_ns = clock.measured_ns(
            ref.robot_stamp_ns,
            arrival_ns=ref.stamp_ns,
            offset_ns=offset.offset_ns,
            uncertainty_ns=offset.uncertainty_ns,
        )
        return ref if taken_ns is None else replace(ref, taken_ns=taken_ns, taken_uncertainty_ns=offset.uncertainty_ns)

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

    def _take_lens(self, message: Any, camera: CameraTopic) -> None:
        lens = decode_camera_info(message)
        if lens is None:
            return
        seen = CameraModel(lens.width_px, lens.height_px, lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px)
        if camera.model is not None:
            # Its mounting is known only from the profile.
            model = camera.model
            seen = replace(
                seen,
                x_m=model.x_m,
                y_m=model.y_m,
                z_m=model.z_m,
                heading_rad=model.heading_rad,
                tilt_rad=model.tilt_rad,
                on_head=model.on_head,
            )
        if self._lenses.get(camera.name) != seen:
            self._lenses[camera.name] = seen
            self._put(CameraLens(self._ros.arrival_ns, lens.robot_stamp_ns, camera.name, seen))

    def _take_map(self, message: Any) -> None:
        grid = decode_occupancy_grid(message, stamp_ns=self._ros.arrival_ns)
        if self._takes_updates:
            self._merger.replace(grid)
        self._put(grid)

    def _take_map_update(self, message: Any) -> None:
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


def _unfolded(message: Any) -> tuple[NDArray[np.uint8], int | None]:
    """Compressed image as uint8 BGR within the size limit, and the robot's stamp. Raises
    MessageError and PictureError.
    """
    image = decode_compressed_image(message)
    return decode_compressed(image.content), image.robot_stamp_ns


def _raw(message: Any) -> tuple[NDArray[np.uint8], int | None]:
    image = decode_image(message)
    return fitted(image.image_bgr), image.robot_stamp_ns
