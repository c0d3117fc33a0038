"""``caris-desktop simulate``: a robot to practise on, in its own process."""

import argparse
import asyncio
import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

from caris_desktop.ros.dialect import Dialect
from caris_desktop.simulator.base import STEP_S
from caris_desktop.simulator.camera import CameraProcess
from caris_desktop.simulator.camera_model import RATE_HZ
from caris_desktop.simulator.faults import MAX_LATENCY_MS, Faults
from caris_desktop.simulator.goal_topics import MoveBaseTopics, NavigateToPoseAction
from caris_desktop.simulator.robot import Robot
from caris_desktop.simulator.robot_topics import CAMERA_TOPIC, RobotTopics
from caris_desktop.simulator.rosapi import offer_rosapi
from caris_desktop.simulator.server import BridgeServer

logger = logging.getLogger(__name__)

DEFAULT_PORT = 9090
_HOPELESSLY_LATE_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of ``simulate``."""
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="port to listen on; 0 chooses a free one")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this computer only)")
    parser.add_argument("--ros", type=int, choices=(1, 2), default=1, help="which ROS the robot speaks (default: 1)")
    parser.add_argument("--seed", type=int, default=1, help="the same number repeats the same run (default: 1)")
    parser.add_argument("--mute", action="store_true", help="speak without sound")
    parser.add_argument(
        "--fault-latency-ms", type=float, default=0.0, metavar="MS", help="delay every message by this much"
    )
    parser.add_argument(
        "--end-with-stdin", action="store_true", help="end when standard input ends, as it does when its starter dies"
    )
    parser.add_argument("--verbose", action="store_true", help="log what clients do")


def run(args: argparse.Namespace) -> int:
    """Run the simulated robot until it is interrupted. Exit status 2: the address cannot be used."""
    logging.basicConfig(
        stream=sys.stderr,
        level=logging.INFO if args.verbose else logging.WARNING,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )
    if not 0 <= args.port <= 65535:
        sys.stderr.write(f"--port {args.port} is not a port: it must be between 0 (any free one) and 65535.\n")
        return 2
    if not 0.0 <= args.fault_latency_ms <= MAX_LATENCY_MS:
        sys.stderr.write(f"--fault-latency-ms must be between 0 and {MAX_LATENCY_MS:g}.\n")
        return 2
    with contextlib.suppress(KeyboardInterrupt):
        return asyncio.run(_simulate(args))
    return 0


async def _simulate(args: argparse.Namespace) -> int:
    stopped = asyncio.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows has no signal handlers in its event loop
            asyncio.get_running_loop().add_signal_handler(name, stopped.set)
    if args.end_with_stdin:
        _call_at_end_of_stdin(asyncio.get_running_loop(), stopped.set)
    dialect = Dialect.ROS1 if args.ros == 1 else Dialect.ROS2
    robot = Robot(args.seed)
    server = BridgeServer()
    topics = RobotTopics(robot, server, dialect, muted=args.mute, faults=Faults(args.fault_latency_ms / 1000.0))
    goals = (MoveBaseTopics if dialect is Dialect.ROS1 else NavigateToPoseAction)(robot, server)
    offer_rosapi(server, dialect)
    try:
        port = await server.start(args.host, args.port)
    except OSError as error:
        sys.stderr.write(
            f"The simulated robot cannot listen on {args.host} port {args.port}: {error.strerror or error}. "
            "Choose another with --port, or let it choose with --port 0.\n"
        )
        return 2
    host = f"[{args.host}]" if ":" in args.host else args.host
    sys.stdout.write(f"Simulated robot ready at ws://{host}:{port}\n")
    sys.stdout.flush()
    tasks = [
        asyncio.create_task(_step_forever(robot, topics, goals)),
        asyncio.create_task(_film_forever(robot, topics, server)),
    ]
    waiting = asyncio.create_task(stopped.wait())
    await asyncio.wait([waiting, *tasks], return_when=asyncio.FIRST_COMPLETED)
    for task in (waiting, *tasks):
        if task.done() and task is not waiting:
            task.result()  # a task that ended by itself failed: let the error out
        task.cancel()
    topics.voice.stop()
    await asyncio.gather(waiting, *tasks, return_exceptions=True)
    await server.stop()
    return 0


def _call_at_end_of_stdin(loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
    def wait() -> None:
        # Not sys.stdin: its lock must not be held by this thread when the interpreter shuts down.
        while os.read(0, 4096):
            pass
        with contextlib.suppress(RuntimeError):  # the loop has ended already
            loop.call_soon_threadsafe(callback)

    threading.Thread(target=wait, name="stdin", daemon=True).start()


async def _step_forever(robot: Robot, topics: RobotTopics, goals: MoveBaseTopics | NavigateToPoseAction) -> None:
    loop = asyncio.get_running_loop()
    due_s = loop.time()
    while True:
        due_s += STEP_S
        late_s = loop.time() - due_s
        if late_s > _HOPELESSLY_LATE_S:
            logger.warning("The computer is too slow: %.1f s of simulated time are skipped", late_s)
            due_s = loop.time()
        await asyncio.sleep(max(0.0, -late_s))
        robot.step()
        goals.publish_due()
        topics.publish_due()


async def _film_forever(robot: Robot, topics: RobotTopics, server: BridgeServer) -> None:
    loop = asyncio.get_running_loop()
    camera = CameraProcess()
    frozen: bytes | None = None
    due_s = loop.time()
    try:
        while True:
            due_s = max(due_s + 1.0 / RATE_HZ, loop.time())
            await asyncio.sleep(due_s - loop.time())
            faults = topics.faults
            if faults.camera_silent or not server.has_subscribers(CAMERA_TOPIC):
                continue
            stamp_ns = time.time_ns()
            if not (faults.camera_frozen and frozen):
                frozen = await camera.picture(None if faults.camera_black else robot.view())
            topics.publish_picture(frozen, stamp_ns=stamp_ns)
    finally:
        camera.close()
