"""``caris-desktop perceive --serve``: detection server for a remote console, on a computer with a graphics card."""

import argparse
import asyncio
import signal
import sys
from pathlib import Path
from typing import get_args

from caris_desktop.app.arguments import ServerArgumentsError, add_server_arguments, read_server_arguments
from caris_desktop.domain.address import before_port
from caris_desktop.domain.translation import tr
from caris_desktop.perception.backends.remote_detector import TOKEN_VARIABLE, serving
from caris_desktop.perception.backends.runtime_selection import open_chosen
from caris_desktop.perception.inference_messages import LEAST_CONFIDENCE, DetectorSettings, Device, default_threads
from caris_desktop.perception.weights import DetectorChoice, WeightsError
from caris_desktop.recording.terminal import reporting

DEFAULT_PORT = 8768


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--serve", action="store_true", required=True, help="run until Ctrl+C")
    add_server_arguments(parser, port=DEFAULT_PORT, variable=TOKEN_VARIABLE)
    parser.add_argument("--model", metavar="FILE|URL", default="", help="detector (default: the default detector)")
    parser.add_argument("--sha256", default="", help="checksum of the detector")
    parser.add_argument(
        "--input-px", type=int, default=416, help="longer side of the detector's input image (default: %(default)s)"
    )
    parser.add_argument(
        "--device", choices=get_args(Device), default="auto", help="compute device (default: %(default)s)"
    )
    parser.add_argument(
        "--threads", type=int, default=default_threads(), help="number of threads (default: %(default)s)"
    )


@reporting(ServerArgumentsError)
def run(arguments: argparse.Namespace) -> int:
    if arguments.model.startswith("plugin:"):
        print("--model: a plug-in cannot be served to other computers.", file=sys.stderr)
        return 1
    try:
        token, tls = read_server_arguments(arguments, sent="images")
        user_weights = (
            Path(arguments.model) if arguments.model and not arguments.sha256 and "://" not in arguments.model else None
        )
        if user_weights is not None and user_weights.suffix.lower() == ".pt":
            _notify(
                tr("{name} may contain its maker's code, which runs here because you specified the file.").format(
                    name=user_weights.name
                )
            )
        chosen = open_chosen(
            user_weights,
            DetectorSettings(
                DetectorChoice(
                    "" if user_weights else arguments.model, arguments.sha256, Path.cwd(), arguments.input_px
                ),
                device=arguments.device,
            ),
            confidence=LEAST_CONFIDENCE,
            threads=arguments.threads,
            allow_download=True,
        )
    except WeightsError as error:
        print(f"{error}. {error.advice}.", file=sys.stderr)
        return 1

    async def serve() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        async with serving(
            chosen.detector, chosen.people, host=arguments.host, port=arguments.port, token=token, tls=tls, note=_notify
        ) as server:
            host, port = server.sockets[0].getsockname()[:2]
            scheme = "ws" if tls is None else "wss"
            _notify(
                f"{chosen.detector.label} is available at {scheme}://{before_port(host)}:{port}; press Ctrl+C to stop."
            )
            await stop.wait()

    try:
        asyncio.run(serve())
    except OSError as error:
        print(f"Port {arguments.port} of {arguments.host} cannot be used ({error.strerror}).", file=sys.stderr)
        return 1
    return 0


def _notify(words: str) -> None:
    print(words, flush=True)
