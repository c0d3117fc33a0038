"""Messages of a broken or hostile server: refused, counted and reported, while teleoperation continues."""

import base64
import json
import struct
import time
import zlib
from collections.abc import Iterator

import psutil
import pytest

from caris_desktop.domain.events import Problem, TrafficMeasured
from caris_desktop.domain.sensing import FrameRef, LaserScan
from caris_desktop.live.frame_ring import FrameRing
from tests.robot.link_bench import BridgeDouble, LinkProcess
from tests.robot.test_media_link import CAMERA, image_message, jpeg, run_with_ring
from tests.support.polling import wait_for


@pytest.fixture
def bridge() -> Iterator[BridgeDouble]:
    double = BridgeDouble()
    yield double
    double.kill()


@pytest.fixture
def link(bridge: BridgeDouble) -> Iterator[LinkProcess]:
    process = LinkProcess(bridge.address)
    process.wait_for_state("connected")
    wait_for(lambda: process.of(LaserScan), "scans")
    yield process
    process.close()


def drives(bridge: BridgeDouble, link: LinkProcess) -> None:
    bridge.lines.clear()
    link.drive(0.3)
    link.hold(lambda: len([twist for twist in bridge.twists() if twist[1]]) > 3, "it drives")


def refusals(link: LinkProcess) -> list[Problem]:
    return [problem for problem in link.of(Problem) if "cannot be used" in problem.what]


@pytest.mark.long
def test_a_frame_of_200_megabytes_ends_the_connection_unread_and_the_next_one_works(
    bridge: BridgeDouble, link: LinkProcess
) -> None:
    before_bytes = psutil.Process(link.process.pid).memory_info().rss
    changes = len(link.states())
    bridge.tell(frame=200_000_000)
    link.wait_for_state("lost", after=changes)
    assert psutil.Process(link.process.pid).memory_info().rss - before_bytes < 100e6
    link.wait_for_state("connected", after=changes)
    assert refusals(link)
    wait_for(lambda: [told for told in link.of(TrafficMeasured) if told.refused == 1], "the refusal is counted")
    drives(bridge, link)


def test_deep_nesting_many_fragments_and_numbers_that_are_none_stop_nothing(
    bridge: BridgeDouble, link: LinkProcess
) -> None:
    drives(bridge, link)
    begun_s = time.monotonic()
    for text in (
        '{"op":"publish","topic":"/scan","msg":' + '{"a":' * 50_000,
        '{"op":"publish","topic":"/scan","msg":' + "[" * 500_000 + "]" * 500_000 + "}",
        json.dumps({"op": "publish", "topic": "/odom", "msg": {"pose": {"pose": {"position": {"x": float("nan")}}}}}),
        json.dumps({"op": "publish", "topic": "/battery_state", "msg": {"percentage": float("inf"), "voltage": "x"}}),
        json.dumps({"op": "publish", "topic": "/scan", "msg": {"angle_min": float("nan"), "ranges": [float("nan")]}}),
    ):
        bridge.tell(text=text)
    bridge.tell(hex="d9d9f7" + "81" * 5_000)
    bridge.tell(flood=20_000)
    link.hold(lambda: refusals(link), "a refusal is told")
    bridge.tell(text=json.dumps({"op": "publish", "topic": "/battery_state", "msg": {"percentage": 0.5}}))
    wait_for(lambda: [told for told in link.of(TrafficMeasured) if told.refused >= 3], "they are counted")
    # On a busy machine ping answers wait behind the flood, which is reported as trouble meanwhile.
    wait_for(lambda: link.states()[-1] == "connected", "the robot is connected")
    scans = len(link.of(LaserScan))
    wait_for(lambda: len(link.of(LaserScan)) > scans + 3, "scans go on")
    # The lease runs on the loop that reads all of this: its commands have no gap that a robot would notice.
    held = [at_s for at_s, forward, _ in bridge.twists() if at_s > begun_s - 0.2]
    assert held
    drives(bridge, link)


def png_of(width_px: int, height_px: int) -> bytes:
    """Black image with one bit per pixel: a few kilobytes for any size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width_px, height_px, 1, 0, 0, 0, 0)
    packer = zlib.compressobj(9)
    row = bytes(1 + (width_px + 7) // 8)
    rows = b"".join(packer.compress(row) for _ in range(height_px)) + packer.flush()
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_a_small_picture_that_would_unfold_into_gigabytes_is_refused(bridge: BridgeDouble) -> None:
    ring = FrameRing.create()
    media = LinkProcess(bridge.address, body=run_with_ring, extra=(ring.name,))
    try:
        media.wait_for_state("connected")
        wait_for(lambda: bridge.operations("subscribe", CAMERA), "the subscription")
        bomb = png_of(60_000, 30_000)
        assert len(bomb) < 300_000
        before_bytes = psutil.Process(media.process.pid).memory_info().rss
        bridge.publish(CAMERA, {**image_message(b""), "format": "png", "data": base64.b64encode(bomb).decode()})
        wait_for(lambda: [problem for problem in media.of(Problem) if "dropped" in problem.what], "told")
        assert psutil.Process(media.process.pid).memory_info().rss - before_bytes < 200e6
        bridge.publish(CAMERA, image_message(jpeg(90)))
        wait_for(lambda: media.of(FrameRef), "the next picture")
    finally:
        media.close()
        ring.close()
