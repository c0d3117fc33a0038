"""``caris-desktop camera-server``: a camera of this computer for a remote console, with capture times.

For the small computer on the robot: it needs numpy, opencv, PyAV and aiortc, but neither Qt nor torch.
"""

import argparse
import asyncio
import logging
import signal
import ssl
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from caris_desktop.app.arguments import ServerArgumentsError, add_server_arguments, read_server_arguments
from caris_desktop.domain.address import before_port

if TYPE_CHECKING:
    from caris_desktop.perception.cameras.camera_source import ChosenCamera

_log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--source", metavar="SOURCE", required=True, help="oak, webcam, a device number, an address, or a video file"
    )
    add_server_arguments(parser, port=8090)
    parser.add_argument(
        "--microphone",
        metavar="NAME",
        nargs="?",
        const="",
        help=(
            "send audio with the video over WebRTC to clients that request it: part of the input's name, or the "
            "system default if no name is given; the microphone is open only while a client listens"
        ),
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl+C (exit status 0); 2 if the start fails."""
    from caris_desktop.perception.cameras.camera_source import CameraError, parse_camera

    logging.basicConfig(format="%(message)s", level=logging.WARNING, stream=sys.stderr)
    text = "0" if arguments.source == "webcam" else arguments.source
    try:
        chosen = parse_camera(text)
    except CameraError as error:
        print(f"{error} {error.advice}", file=sys.stderr)
        return 2
    if chosen.kind in ("robot", "simulated") or (chosen.recorded and not Path(chosen.target).is_file()):
        print(f"{text} is not a camera or video file on this computer.", file=sys.stderr)
        return 2
    try:
        token, tls = read_server_arguments(arguments, sent="video")
    except ServerArgumentsError as error:
        print(error, file=sys.stderr)
        return 2
    return asyncio.run(_serve(chosen, arguments, token, tls))


async def _serve(chosen: "ChosenCamera", arguments: argparse.Namespace, token: str, tls: ssl.SSLContext | None) -> int:
    from caris_desktop.perception.cameras.camera_process import open_camera
    from caris_desktop.perception.cameras.camera_server import CameraServer, LocalSound, NewestFrame, ServedSound

    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    frames = NewestFrame(chosen, open_camera)
    host, port = arguments.host, arguments.port
    sound = None if arguments.microphone is None else ServedSound(LocalSound(arguments.microphone))
    server = CameraServer(frames, token=token, sound=sound)
    try:
        listening = await server.serve(host, port, tls)
    except OSError as error:
        print(f"Cannot listen on {host}:{port}: {error.strerror or error}. Choose another --port.", file=sys.stderr)
        return 2
    at = listening.sockets[0].getsockname()
    where = f"http{'' if tls is None else 's'}://{before_port(at[0])}:{at[1]}"
    print(f"Serving {chosen.name} at {where}/video.mjpg (MJPEG) and whep+{where}/whep (WebRTC).", flush=True)
    reading = asyncio.create_task(frames.run())
    await ended.wait()
    listening.close()
    reading.cancel()
    await asyncio.gather(reading, return_exceptions=True)
    await server.close()
    return 0
