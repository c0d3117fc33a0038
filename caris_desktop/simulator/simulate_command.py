"""``caris-desktop simulate``: the simulated robot, in its own process."""

import argparse
import asyncio
import contextlib
import logging
import math
import os
import signal
import ssl
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from caris_desktop.domain.address import before_port
from caris_desktop.domain.certificates import WrongFilesError, server_context
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.simulator import robot_models
from caris_desktop.simulator.characters import CHARACTERS
from caris_desktop.simulator.faults import MAX_LATENCY_MS, Faults
from caris_desktop.simulator.robot_models import RobotInterface
from caris_desktop.simulator.robot_simulation import RATE_HZ, Robot, View
from caris_desktop.simulator.robot_topics import RobotTopics
from caris_desktop.simulator.ros_context import RobotClock, RosContext, offer_rosapi
from caris_desktop.simulator.server import SECRET_CHARS, BridgeServer, LineLog
from caris_desktop.simulator.simulated_base import STEP_S
from caris_desktop.simulator.simulated_camera_process import CameraProcess
from caris_desktop.simulator.simulated_mapping import MapFiles
from caris_desktop.simulator.simulated_people import BadVisits, Seen, Visit, read_visits, visits_by_chance
from caris_desktop.simulator.simulated_speech import BadSentences, read_sentences

logger = logging.getLogger(__name__)

DEFAULT_PORT = 9090
_HOPELESSLY_LATE_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``simulate``."""
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="port to listen on; 0 chooses a free one")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this computer only)")
    parser.add_argument(
        "--dress",
        choices=robot_models.robot_model_names(),
        default=robot_models.DEFAULT,
        help="robot model: its names and types are used (default: generic)",
    )
    parser.add_argument(
        "--ros", type=int, choices=(1, 2), help="ROS version of the robot (default: that of the robot model, or 1)"
    )
    parser.add_argument("--namespace", metavar="NAME", help="prefix for the relative names of the robot model")
    parser.add_argument("--holonomic", action="store_true", help="the base can move sideways, whatever the robot model")
    parser.add_argument(
        "--simulation-time", action="store_true", help="publish /clock and use simulation time for timestamps"
    )
    parser.add_argument(
        "--send-action-goals-in-new-thread",
        action="store_true",
        help="rosbridge parameter of ROS 2: a goal does not block later messages from the same client",
    )
    parser.add_argument(
        "--call-services-in-new-thread",
        action="store_true",
        help="rosbridge parameter of ROS 2: a service call does not block later messages from the same client",
    )
    parser.add_argument("--empty", action="store_true", help="no people walk around")
    parser.add_argument(
        "--people",
        type=int,
        metavar="N",
        help=f"N different people (up to {len(CHARACTERS)}) come and go instead, in a different order each round",
    )
    parser.add_argument(
        "--visits",
        type=Path,
        metavar="FILE",
        help="people who come instead, as a table (.csv) with the columns person, comes_s, stays_s, clothes",
    )
    parser.add_argument(
        "--participant",
        type=Path,
        metavar="FILE",
        help=(
            "sentences of a person in front of the robot, one per line; the next one is said each time the robot "
            "has spoken"
        ),
    )
    parser.add_argument(
        "--desk-camera",
        type=int,
        metavar="PORT",
        help="a second camera, on the reception desk: MJPEG on this port of this computer; 0 chooses a free one",
    )
    parser.add_argument(
        "--maps-folder", type=Path, metavar="FOLDER", help="folder for saved maps (default: a temporary folder)"
    )
    parser.add_argument("--tls-cert", type=Path, metavar="FILE", help="certificate for wss://")
    parser.add_argument("--tls-key", type=Path, metavar="FILE", help="the certificate's private key")
    parser.add_argument(
        "--rosauth-secret-env",
        metavar="NAME",
        help="accept only clients that authenticate with the secret in this environment variable",
    )
    parser.add_argument("--log", type=Path, metavar="FILE", help="log each message that is delivered")
    parser.add_argument("--obeyed-log", type=Path, metavar="FILE", help="log each message that is carried out")
    parser.add_argument(
        "--seed", type=int, default=1, help="random seed; the same number repeats the same run (default: 1)"
    )
    parser.add_argument("--mute", action="store_true", help="speak without sound")
    parser.add_argument(
        "--fault-latency-ms", type=float, default=0.0, metavar="MS", help="delay of every message, in milliseconds"
    )
    parser.add_argument(
        "--topics-glob", nargs="+", default=(), metavar="GLOB", help="topics that are allowed through (default: all)"
    )
    parser.add_argument(
        "--lidar-roll-deg", type=float, default=0.0, metavar="DEG", help="roll angle of the LIDAR; 180: upside down"
    )
    parser.add_argument(
        "--lidar-pitch-deg", type=float, default=0.0, metavar="DEG", help="pitch angle of the LIDAR; positive: down"
    )
    parser.add_argument(
        "--end-with-stdin",
        action="store_true",
        help="end when standard input is closed, as when the parent process ends",
    )
    parser.add_argument("--verbose", action="store_true", help="log the activity of clients")


def run(args: argparse.Namespace) -> int:
    """Run the simulated robot until interrupted. Exit status 2: the address cannot be used."""
    logging.basicConfig(
        stream=sys.stderr,
        level=logging.INFO if args.verbose else logging.WARNING,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )
    if not 0 <= args.port <= 65535:
        sys.stderr.write(f"--port {args.port} is invalid: it must be between 0 (any free port) and 65535.\n")
        return 2
    if not 0.0 <= args.fault_latency_ms <= MAX_LATENCY_MS:
        sys.stderr.write(f"--fault-latency-ms must be between 0 and {MAX_LATENCY_MS:g}.\n")
        return 2
    try:
        model, visits = _robot_model_of(args), _visits_of(args)
        lines = () if args.participant is None else read_sentences(args.participant)
        robot = Robot(args.seed, body=model.body, populated=not args.empty, visits=visits)
        clock = RobotClock((lambda: robot.now_s) if args.simulation_time else None)
        tls = _tls_of(args)
        with contextlib.ExitStack() as opened, contextlib.suppress(KeyboardInterrupt):
            server = _server_of(args, model, clock, opened)
            ros = RosContext(robot, server, model, clock, Faults(args.fault_latency_ms / 1000.0))
            temporary = tempfile.TemporaryDirectory(prefix="caris-simulator-maps-", ignore_cleanup_errors=True)
            maps = MapFiles(args.maps_folder or Path(opened.enter_context(temporary)))
            return asyncio.run(_simulate(args, ros, tls, lines, maps))
    except (_CannotStart, BadSentences, BadVisits, WrongFilesError, robot_models.UnknownRobotModel) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


class _CannotStart(Exception):  # noqa: N818 - the arguments do not allow it; the text says why
    """The robot cannot start with these arguments."""


def _robot_model_of(args: argparse.Namespace) -> RobotInterface:
    model = robot_models.robot_model_named(args.dress, args.ros, namespace=args.namespace, holonomic=args.holonomic)
    if model.body.lidar is None:
        return model
    roll_rad, pitch_rad = math.radians(args.lidar_roll_deg), math.radians(args.lidar_pitch_deg)
    lidar = replace(model.body.lidar, roll_rad=roll_rad, pitch_rad=pitch_rad)
    return replace(model, body=replace(model.body, lidar=lidar))


def _tls_of(args: argparse.Namespace) -> ssl.SSLContext | None:
    if (args.tls_cert is None) != (args.tls_key is None):
        raise _CannotStart("--tls-cert and --tls-key belong together: give both, or none for ws://.")
    return server_context(args.tls_cert, args.tls_key)


def _server_of(
    args: argparse.Namespace, model: RobotInterface, clock: RobotClock, logs: contextlib.ExitStack
) -> BridgeServer:
    """Server that is not yet started; ``logs`` closes its logs."""
    secret = None if args.rosauth_secret_env is None else os.environ.get(args.rosauth_secret_env, "")
    if secret is not None and len(secret) != SECRET_CHARS:
        raise _CannotStart(
            f"The environment variable {args.rosauth_secret_env} must contain the secret with {SECRET_CHARS} "
            "characters that rosauth requires."
        )
    opened: dict[str, LineLog] = {}
    for option, path in (("--log", args.log), ("--obeyed-log", args.obeyed_log)):
        if path is not None:
            try:
                opened[option] = logs.enter_context(contextlib.closing(LineLog(path)))
            except OSError as error:
                raise _CannotStart(f"{option} {path} cannot be written: {error.strerror or error}.") from error
    return BridgeServer(
        model.dialect,
        secret=secret,
        now_s=clock.now_s,
        log=opened.get("--log"),
        obeyed_log=opened.get("--obeyed-log"),
        topics_glob=args.topics_glob,
        goals_in_new_threads=args.send_action_goals_in_new_thread,
        services_in_new_threads=args.call_services_in_new_thread,
    )


def _visits_of(args: argparse.Namespace) -> list[Visit] | None:
    if sum((args.empty, args.people is not None, args.visits is not None)) > 1:
        raise _CannotStart("--empty, --people and --visits say different things: give one of them.")
    if args.people is not None:
        if not 1 <= args.people <= len(CHARACTERS):
            raise _CannotStart(f"--people must be between 1 and {len(CHARACTERS)}.")
        return visits_by_chance(args.people, args.seed)
    return None if args.visits is None else read_visits(args.visits)


async def _simulate(
    args: argparse.Namespace, ros: RosContext, tls: ssl.SSLContext | None, lines: Sequence[str], maps: MapFiles
) -> int:
    stopped = asyncio.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows has no signal handlers in its event loop
            asyncio.get_running_loop().add_signal_handler(name, stopped.set)
    if args.end_with_stdin:
        _call_at_end_of_stdin(asyncio.get_running_loop(), stopped.set)
    topics = RobotTopics(ros, muted=args.mute, simulation_time=args.simulation_time, maps=maps, lines=lines)
    offer_rosapi(ros.server, ros.dialect, clock=ros.clock)
    try:
        port = await ros.server.start(args.host, args.port, tls=tls)
    except OSError as error:
        raise _CannotStart(
            f"The simulated robot cannot listen on {args.host} port {args.port}: {error.strerror or error}. "
            "Choose another with --port, or let it choose with --port 0."
        ) from error
    camera, desk = CameraProcess(), DeskCamera()
    ready = [f"Simulated robot ready at {'ws' if tls is None else 'wss'}://{before_port(args.host)}:{port}\n"]
    jobs = [_step_forever(topics, ros), _film_forever(camera, topics, ros)]
    if args.desk_camera is not None:
        try:
            ready.append(f"Desk camera at http://127.0.0.1:{await desk.start(args.desk_camera)}/\n")
        except OSError as error:
            await ros.server.stop()
            raise _CannotStart(
                f"The desk camera cannot use port {args.desk_camera}: {error.strerror or error}."
            ) from error
        jobs.append(_film_from_desk(camera, ros.robot, desk))
    sys.stdout.write("".join(ready))
    sys.stdout.flush()
    waiting = asyncio.create_task(stopped.wait())
    tasks = [asyncio.create_task(job) for job in jobs]
    voices = [asyncio.create_task(topics.sound.participant.get_ready())] if topics.sound is not None else []
    await asyncio.wait([waiting, *tasks], return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        if task.done():
            task.result()  # a task that ended without cancellation failed: raise its error
    for ending in (waiting, *tasks, *voices):
        ending.cancel()
    topics.stop()
    await asyncio.gather(waiting, *tasks, *voices, return_exceptions=True)
    desk.stop()
    camera.close()
    await ros.server.stop()
    return 0


def _call_at_end_of_stdin(loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
    def wait() -> None:
        # Not sys.stdin: this thread must not hold its lock at interpreter shutdown.
        while os.read(0, 4096):
            pass
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(callback)

    threading.Thread(target=wait, name="stdin", daemon=True).start()


async def _step_forever(topics: RobotTopics, ros: RosContext) -> None:
    loop = asyncio.get_running_loop()
    due_s = loop.time()
    while True:
        due_s += STEP_S
        late_s = loop.time() - due_s
        if late_s > _HOPELESSLY_LATE_S:
            logger.warning("The computer is too slow: %.1f s of simulated time are skipped", late_s)
            if topics.sound is not None:
                topics.sound.skip_time(late_s)
            due_s = loop.time()
        await asyncio.sleep(max(0.0, -late_s))
        ros.robot.step()
        ros.publish_due()


async def _film_forever(camera: CameraProcess, topics: RobotTopics, ros: RosContext) -> None:
    loop = asyncio.get_running_loop()
    frozen: bytes | None = None
    due_s = loop.time()
    while True:
        due_s = max(due_s + 1.0 / RATE_HZ, loop.time())
        await asyncio.sleep(due_s - loop.time())
        faults = ros.faults
        if faults.camera_silent or topics.camera_topic is None or not ros.wanted(topics.camera_topic):
            continue
        stamp_ns = ros.stamp_ns()
        if not (faults.camera_frozen and frozen):
            frozen = await camera.picture(None if faults.camera_black else ros.robot.view())
        topics.publish_picture(frozen, stamp_ns=stamp_ns)


DESK_CAMERA_IN_MAP = Pose2D(5.2, 2.6, math.radians(-170.0))
DESK_CAMERA_HEIGHT_M, DESK_CAMERA_TILT_RAD = 1.5, 0.25
DESK_RATE_HZ = 7.5
_BOUNDARY = b"frame"
_REQUEST_WITHIN_S = 5.0


def desk_view(people: tuple[Seen, ...]) -> View:
    """Its view: the hall in front of the desk, where visitors stand when the robot waits at the reception."""
    return View(DESK_CAMERA_IN_MAP, people, DESK_CAMERA_TILT_RAD, DESK_CAMERA_HEIGHT_M)


class DeskCamera:
    """Network camera on the reception desk, not on the robot: MJPEG over HTTP.

    Sends the newest image to each client whenever it can accept another one.
    """

    def __init__(self) -> None:
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()
        self._changed = asyncio.Condition()
        self._picture = b""

    @property
    def watched(self) -> bool:
        """True if there are clients."""
        return bool(self._clients)

    async def start(self, port: int) -> int:
        """Listen on this computer only; return the port. Raises OSError."""
        self._server = await asyncio.start_server(self._on_client, "127.0.0.1", port)
        opened: int = self._server.sockets[0].getsockname()[1]
        return opened

    async def show(self, jpeg: bytes) -> None:
        async with self._changed:
            self._picture = jpeg
            self._changed.notify_all()

    def stop(self) -> None:
        if self._server is not None:
            self._server.close()
        for client in self._clients:
            client.close()

    async def _on_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _REQUEST_WITHIN_S)
            if not request.startswith(b"GET "):
                writer.write(b"HTTP/1.1 405 Method Not Allowed\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                return
            self._clients.add(writer)
            kind = b"multipart/x-mixed-replace; boundary=" + _BOUNDARY
            writer.write(b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Type: " + kind + b"\r\n\r\n")
            picture = self._picture
            while True:
                async with self._changed:
                    while self._picture is picture:
                        await self._changed.wait()
                    picture = self._picture
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n".encode()
                writer.write(b"--" + _BOUNDARY + b"\r\n" + head + picture + b"\r\n")
                await writer.drain()
        except (OSError, EOFError, asyncio.LimitOverrunError, TimeoutError):
            pass  # the client left, or speaks another protocol
        finally:
            self._clients.discard(writer)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()


async def _film_from_desk(camera: CameraProcess, robot: Robot, desk: DeskCamera) -> None:
    while True:
        await asyncio.sleep(1.0 / DESK_RATE_HZ)
        if desk.watched:
            await desk.show(await camera.picture(desk_view(robot.people)))
