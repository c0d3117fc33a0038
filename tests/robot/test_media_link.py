"""Media link against a rosbridge double: images into the ring, maps to the console."""

import base64
import pickle
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection

import cv2
import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import LinkChanged, Problem
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import CameraLens, FrameRef, OccupancyGrid
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.robot.link import LinkSettings, run_media_link
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile, TopicSource
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import encode_camera_info, encode_occupancy_grid_update
from tests.robot.link_bench import BridgeDouble, LinkProcess
from tests.robot.loop_bench import Bridge, LoopBench, with_link
from tests.support.polling import wait_for

CAMERA = "/camera/image_raw/compressed"


def run_with_ring(connection: Connection, settings: LinkSettings, ring_name: str) -> None:
    ring = FrameRing.attach(ring_name)
    run_media_link(connection, settings, ring)
    ring.close()


@pytest.fixture(scope="module")
def bridge() -> Iterator[BridgeDouble]:
    double = BridgeDouble()
    yield double
    double.kill()


@pytest.fixture(scope="module")
def ring() -> Iterator[FrameRing]:
    created = FrameRing.create()
    yield created
    created.close()


@pytest.fixture(scope="module")
def running_link(bridge: BridgeDouble, ring: FrameRing) -> Iterator[LinkProcess]:
    process = LinkProcess(bridge.address, body=run_with_ring, extra=(ring.name,))
    process.wait_for_state("connected")
    yield process
    process.close()


@pytest.fixture
def link(running_link: LinkProcess) -> LinkProcess:
    running_link.values.clear()
    return running_link


def image_message(content: bytes) -> dict[str, object]:
    return {"header": {"stamp": {"secs": 3, "nsecs": 4}}, "format": "jpeg", "data": base64.b64encode(content).decode()}


def jpeg(grey: int, *, width_px: int = 64, height_px: int = 48) -> bytes:
    return cv2.imencode(".jpg", np.full((height_px, width_px, 3), grey, np.uint8))[1].tobytes()


def test_a_picture_lands_in_the_ring(bridge: BridgeDouble, ring: FrameRing, link: LinkProcess) -> None:
    bridge.publish(CAMERA, image_message(jpeg(200)))
    [ref] = wait_for(lambda: link.of(FrameRef), "a frame")
    assert (ref.camera, ref.width_px, ref.height_px, ref.robot_stamp_ns) == ("front", 64, 48, 3_000_000_004)
    image_bgr = ring.read(ref)
    assert image_bgr is not None
    assert abs(int(image_bgr.mean()) - 200) < 3


def test_cameras_are_requested_one_frame_at_a_time(bridge: BridgeDouble, link: LinkProcess) -> None:
    [subscription] = wait_for(lambda: bridge.operations("subscribe", CAMERA), "the subscription")
    assert subscription["queue_length"] == 1
    assert subscription["throttle_rate"] > 0


def test_a_map_larger_than_is_accepted_costs_a_problem_and_not_the_link(
    bridge: BridgeDouble, link: LinkProcess
) -> None:
    bridge.tell(size=70 * 2**20)
    [problem] = wait_for(lambda: link.of(Problem), "a problem")
    assert "70 MB" in problem.what
    bridge.publish(CAMERA, image_message(jpeg(100)))
    wait_for(lambda: link.of(FrameRef), "a frame after it")
    assert link.of(LinkChanged) == []


def test_broken_pictures_are_one_problem_and_the_next_good_one_is_shown(
    bridge: BridgeDouble, link: LinkProcess
) -> None:
    for content in (b"", b"no picture", jpeg(9)[:60], b"\xff\xd8\xff\xff" * 100):
        bridge.publish(CAMERA, image_message(content))
    bridge.publish(CAMERA, image_message(jpeg(9, width_px=3000, height_px=2000)))
    bridge.publish(CAMERA, {"format": "jpeg", "data": "§"})
    bridge.tell(text="{}")
    bridge.publish(CAMERA, image_message(jpeg(100)))
    wait_for(lambda: link.of(FrameRef), "a frame")
    wait_for(lambda: link.of(Problem), "a problem")
    assert len({problem.what for problem in link.of(Problem)}) <= 2
    assert link.of(LinkChanged) == []


def test_a_map_arrives(bridge: BridgeDouble, link: LinkProcess) -> None:
    origin = {"position": {"x": -1.0, "y": -2.0, "z": 0.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    info = {"resolution": 0.05, "width": 3, "height": 2, "origin": origin}
    bridge.publish("/map", {"info": info, "data": [-1, 0, 100, 0, 0, 50]})
    [grid] = wait_for(lambda: link.of(OccupancyGrid), "the map")
    assert grid.cells.tolist() == [[-1, 0, 100], [0, 0, 50]]
    assert grid.origin_in_map.x_m == -1.0


def grid_message(width: int, height: int, cell: int) -> dict[str, object]:
    origin = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    info = {"resolution": 0.05, "width": width, "height": height, "origin": origin}
    return {"info": info, "data": [cell] * (width * height)}


UPDATING = RobotProfile("test", "Test", map=TopicSource("/map"), map_updates=TopicSource("/map_updates"))


def test_updates_are_written_into_the_map_and_a_new_map_replaces_all() -> None:
    async def test(bench: LoopBench) -> None:
        def update(x: int, y: int, cells: list[list[int]]) -> dict[str, object]:
            return encode_occupancy_grid_update(Dialect.ROS1, np.array(cells, np.int8), x=x, y=y, stamp_ns=7)

        # An update before its map is ignored.
        await bench.bridge.publish("/map_updates", update(0, 0, [[5]]))
        await bench.bridge.publish("/map", grid_message(3, 2, 0))
        await bench.bridge.publish("/map_updates", update(1, 0, [[100, 100]]), cbor=True)
        await bench.bridge.publish("/map_updates", update(0, 1, [[-1]]))
        await bench.until(lambda: len(bench.of(OccupancyGrid)) == 2, "the map, and once all that is new")
        first, second = bench.of(OccupancyGrid)
        assert first.cells.tolist() == [[0, 0, 0], [0, 0, 0]]
        assert second.cells.tolist() == [[0, 100, 100], [-1, 0, 0]]
        assert second.robot_stamp_ns == 7
        for x, y in ((2, 0), (0, 3), (50, 50)):
            await bench.bridge.publish("/map_updates", update(x, y, [[1, 1]]))
        [problem] = await bench.until(lambda: bench.of(Problem), "a problem")
        assert "were rejected" in problem.what
        assert "is outside the map of 3 x 2" in problem.what
        await bench.bridge.publish("/map", grid_message(2, 1, 50))
        await bench.bridge.publish("/map_updates", update(1, 0, [[0]]))
        await bench.until(lambda: bench.of(OccupancyGrid)[-1].cells.tolist() == [[50, 0]], "the new map, updated")

    with_link(UPDATING, test, media=True)


def test_a_large_map_is_deflated_in_transit_and_noise_is_not() -> None:
    corridor = np.zeros((1000, 1000), np.int8)
    corridor[:, ::50] = 100
    grid = OccupancyGrid(1, 2, 0.05, Pose2D(1.0, 2.0, 0.0), corridor)
    content = pickle.dumps(grid)
    assert len(content) < 100_000
    back = pickle.loads(content)  # noqa: S301 - made just before
    assert (back.stamp_ns, back.robot_stamp_ns, back.origin_in_map) == (1, 2, grid.origin_in_map)
    assert back.cells.dtype == np.int8
    assert np.array_equal(back.cells, corridor)
    noise = np.random.default_rng(1).integers(-1, 101, (1000, 1000), dtype=np.int8)
    for cells in (noise, noise[:5, :5], noise[::2, ::2], np.zeros((0, 7), np.int8)):
        content = pickle.dumps(OccupancyGrid(1, None, 0.05, Pose2D(0, 0, 0), cells))
        back = pickle.loads(content)  # noqa: S301 - made just before
        assert np.array_equal(back.cells, cells)


def test_a_camera_reports_its_own_lens_and_the_profile_where_it_is() -> None:
    model = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0, x_m=0.2, z_m=1.1, on_head=True)
    robot = RobotProfile("test", "Test", cameras=(CameraTopic("front", "/image", model=model, info="/info"),))

    async def test(bench: LoopBench) -> None:
        lens = CameraModel(1280, 720, 900.0, 910.0, 650.0, 355.0)
        await bench.bridge.publish("/info", encode_camera_info(Dialect.ROS1, replace(lens, fx_px=0.0), stamp_ns=1))
        await bench.bridge.publish("/info", encode_camera_info(Dialect.ROS1, lens, stamp_ns=7))
        await bench.until(lambda: bench.of(CameraLens), "the lens")
        await bench.bridge.publish("/info", encode_camera_info(Dialect.ROS1, lens, stamp_ns=8), cbor=True)
        other = encode_camera_info(Dialect.ROS2, replace(lens, cx_px=1.0), stamp_ns=9)
        await bench.bridge.publish("/info", other, cbor=True)
        await bench.until(lambda: bench.of(CameraLens)[-1].model.cx_px == 1.0, "another lens")
        assert len(bench.of(CameraLens)) == 2
        first = bench.of(CameraLens)[0]
        assert (first.camera, first.robot_stamp_ns) == ("front", 7)
        expected = replace(model, width_px=1280, height_px=720, fx_px=900.0, fy_px=910.0, cx_px=650.0, cy_px=355.0)
        assert first.model == expected

    with_link(robot, test, media=True)


class Kept:
    """Receives frames in place of the ring."""

    def __init__(self) -> None:
        self.images: list[np.ndarray] = []

    def write(self, image_bgr: np.ndarray, *, stamp_ns: int, robot_stamp_ns: int | None, camera: str) -> FrameRef:
        self.images.append(image_bgr)
        height, width = image_bgr.shape[:2]
        return FrameRef(stamp_ns, robot_stamp_ns, camera, "kept", 0, len(self.images), width, height)


def raw_message(image: np.ndarray, encoding: str) -> dict[str, object]:
    height, width = image.shape[:2]
    step = image.nbytes // height
    stamp = {"secs": 3, "nsecs": 4}
    return {"header": {"stamp": stamp}, "encoding": encoding, "width": width, "height": height, "step": step,
            "is_bigendian": 0, "data": image.tobytes()}  # fmt: skip


RAW = RobotProfile("test", "Test", cameras=(CameraTopic("front", "/camera/image_raw", type="Image"),))


def test_raw_pictures_arrive_and_torn_ones_are_one_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("caris_desktop.robot.media_link._ADVISE_AFTER_NS", 100_000_000)
    monkeypatch.setattr("caris_desktop.robot.media_link._HEAVY_MB_PER_S", 0.0)

    async def test(bench: LoopBench) -> None:
        kept = Kept()
        bench.link._frames = kept
        [subscribed] = await bench.until(
            lambda: [each for each in bench.bridge.lines if each.get("op") == "subscribe"], "the subscription"
        )
        assert subscribed["type"] == "sensor_msgs/Image"
        image = np.zeros((48, 64, 3), np.uint8)
        image[:, :, 0] = 200  # red, as rgb8
        whole = raw_message(image, "rgb8")
        await bench.bridge.publish("/camera/image_raw", whole, cbor=True)
        [ref] = await bench.until(lambda: bench.of(FrameRef), "the picture")
        assert (ref.camera, ref.robot_stamp_ns, ref.width_px, ref.height_px) == ("front", 3_000_000_004, 64, 48)
        assert kept.images[0][5, 5].tolist() == [0, 0, 200]
        await bench.bridge.publish("/camera/image_raw", {**whole, "data": image.tobytes()[:-7]}, cbor=True)
        [refused] = await bench.until(lambda: bench.of(Problem), "a problem")
        assert "1 frame(s) from the camera front were dropped" in refused.what
        assert "9209 bytes for 48 rows of 192" in refused.what
        for torn in ({"step": 64}, {"height": 47}, {"encoding": "h264"}):
            await bench.bridge.publish("/camera/image_raw", {**whole, **torn}, cbor=True)
        as_text = {**whole, "data": base64.b64encode(image.tobytes()).decode()}
        while len(bench.of(Problem)) == 1:
            seen = len(bench.of(FrameRef))
            await bench.bridge.publish("/camera/image_raw", as_text)
            await bench.until(lambda seen=seen: len(bench.of(FrameRef)) > seen, "the next whole picture")
        [advice] = [problem for problem in bench.of(Problem) if problem.severity == "info"]
        assert "uncompressed" in advice.what
        assert "image_transport republish raw compressed" in advice.advice

    with_link(RAW, test, media=True)


def test_a_picture_reports_when_it_was_taken_by_the_robots_clock() -> None:
    ahead_ns = 1_700_000_000 * 1_000_000_000

    def told_time(_request: object) -> dict[str, object]:
        secs, nsecs = divmod(clock.now_ns() + ahead_ns, 1_000_000_000)
        return {"time": {"secs": secs, "nsecs": nsecs}}

    def prepare(bridge: Bridge) -> None:
        bridge.answers["/rosapi/get_time"] = told_time

    async def test(bench: LoopBench) -> None:
        bench.link._frames = Kept()
        image = raw_message(np.zeros((8, 8, 3), np.uint8), "rgb8")
        taken: list[tuple[int, FrameRef]] = []

        async def publish() -> FrameRef:
            seen = len(bench.of(FrameRef))
            taken_ns = clock.now_ns() - 150_000_000
            secs, nsecs = divmod(taken_ns + ahead_ns, 1_000_000_000)
            stamp = {"stamp": {"secs": secs, "nsecs": nsecs}}
            await bench.bridge.publish("/camera/image_raw", {**image, "header": stamp}, cbor=True)
            refs = await bench.until(lambda: bench.of(FrameRef)[seen:], "the picture")
            taken.append((taken_ns, refs[0]))
            return refs[0]

        while (await publish()).taken_ns is None:
            pass  # until the robot's time is known
        taken_ns, ref = taken[-1]
        assert ref.taken_ns is not None
        assert ref.taken_uncertainty_ns is not None
        assert abs(ref.taken_ns - taken_ns) <= ref.taken_uncertainty_ns
        assert ref.stamp_ns - ref.taken_ns >= 150_000_000 - ref.taken_uncertainty_ns
        # A stamp of another clock is ignored.
        await bench.bridge.publish("/camera/image_raw", image, cbor=True)
        await bench.until(lambda: bench.of(FrameRef)[-1].robot_stamp_ns == 3_000_000_004, "that picture")
        assert bench.of(FrameRef)[-1].taken_ns is None

    with_link(RAW, test, media=True, prepare=prepare)


def test_odd_pictures_are_made_to_fit_and_those_of_no_use_are_one_problem() -> None:
    robot = RobotProfile(
        "test", "Test", cameras=(CameraTopic("front", CAMERA), CameraTopic("raw", "/raw", type="Image"))
    )

    def png(image: np.ndarray) -> bytes:
        return cv2.imencode(".png", image)[1].tobytes()

    async def test(bench: LoopBench) -> None:
        kept = Kept()
        bench.link._frames = kept
        odd = (
            jpeg(90, width_px=7680, height_px=4320),
            png(np.full((48, 64), 40, np.uint8)),
            png(np.full((48, 64), 50 << 8, np.uint16)),
            png(np.full((48, 64, 4), 60, np.uint8)),
        )
        for count, content in enumerate(odd, start=1):
            await bench.bridge.publish(CAMERA, {**image_message(content), "data": content}, cbor=True)
            await bench.until(lambda count=count: len(bench.of(FrameRef)) == count, "the picture")
        assert [image.shape for image in kept.images] == [(1080, 1920, 3), *[(48, 64, 3)] * 3]
        assert [abs(int(image[5, 5, 0]) - grey) <= 1 for image, grey in zip(kept.images, (90, 40, 50, 60), strict=True)]
        large = raw_message(np.full((2160, 3840, 1), 70, np.uint8), "mono8")
        await bench.bridge.publish("/raw", large, cbor=True)
        await bench.until(lambda: len(bench.of(FrameRef)) == 5, "the raw picture")
        assert kept.images[-1].shape == (1080, 1920, 3)
        await bench.bridge.publish("/raw", raw_message(np.zeros((1, 1, 3), np.uint8), "rgb8"), cbor=True)
        whole = jpeg(100)
        for content in (jpeg(9, width_px=1, height_px=1), whole[: len(whole) // 2], whole[:-40]):
            await bench.bridge.publish(CAMERA, {**image_message(content), "data": content}, cbor=True)
        await bench.bridge.publish(CAMERA, {**image_message(whole), "data": whole}, cbor=True)
        await bench.until(lambda: len(bench.of(FrameRef)) == 6, "the next whole one")
        told = await bench.until(lambda: len(bench.of(Problem)) >= 2 and bench.of(Problem), "a problem of each camera")
        first = {problem.what.partition(" were")[0].rpartition(" ")[2]: problem.what for problem in reversed(told)}
        assert sorted(first) == ["front", "raw"]
        assert "1 x 1 pixels, which is too small" in first["raw"]

    with_link(robot, test, media=True)
