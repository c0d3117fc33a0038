"""``caris-desktop perceive --serve``: detection server for a remote console, on a computer with a graphics card."""

import argparse
import asyncio
import os
import signal
import ssl
import sys
from pathlib import Path
from typing import get_args

from caris_desktop.domain.address import before_port, is_loopback_host
from caris_desktop.domain.certificates import WrongFilesError, server_context
from caris_desktop.domain.translation import tr
from caris_desktop.perception.backends.remote import TOKEN_VARIABLE
from caris_desktop.perception.backends.selected_runtime import open_chosen
from caris_desktop.perception.backends.serving import serving
from caris_desktop.perception.inference_settings import LEAST_CONFIDENCE, DetectorSettings, Device, default_threads
from caris_desktop.perception.weights import DetectorChoice, WeightsError

DEFAULT_PORT = 8768
LEAST_TOKEN = 16


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--serve", action="store_true", required=True, help="run until Ctrl+C")
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (default: %(default)s, this computer only)"
    )
    parser.add_argument(
        "--port", type=int, default=DEFAULT_PORT, help="port to listen on; 0 chooses a free one (default: %(default)s)"
    )
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
    parser.add_argument(
        "--token-env",
        metavar="NAME",
        default=TOKEN_VARIABLE,
        help="environment variable with the token that consoles must send (default: %(default)s)",
    )
    parser.add_argument("--cert", metavar="FILE", type=Path, help="certificate for wss://, PEM")
    parser.add_argument("--key", metavar="FILE", type=Path, help="its key")


def run(arguments: argparse.Namespace) -> int:
    token = os.environ.get(arguments.token_env, "").strip()
    try:
        tls = server_context(arguments.cert, arguments.key)
        _check(arguments, token, tls)
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
    except (_WrongError, WrongFilesError) as error:
        print(error, file=sys.stderr)
        return 1
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


class _WrongError(Exception):
    """Failure that is sent to the client."""


def _check(arguments: argparse.Namespace, token: str, tls: ssl.SSLContext | None) -> None:
    if arguments.model and arguments.model.startswith("plugin:"):
        raise _WrongError("--model: a plug-in cannot be served to other computers.")
    if token and len(token) < LEAST_TOKEN:
        raise _WrongError(f"The token in {arguments.token_env} is too short: use at least {LEAST_TOKEN} characters.")
    if is_loopback_host(arguments.host):
        return
    if not token:
        raise _WrongError(
            f"Other computers can reach {arguments.host}: put a token of at least {LEAST_TOKEN} characters into the "
            f"environment variable {arguments.token_env}, both here and on the console's computer."
        )
    if tls is None:
        raise _WrongError(
            f"Other computers can reach {arguments.host} and could intercept the images: specify a certificate "
            "with --cert and --key, or listen on 127.0.0.1 and use an SSH tunnel."
        )


def _notify(words: str) -> None:
    print(words, flush=True)
