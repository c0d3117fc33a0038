"""Command line of the console."""

import argparse
import os
import ssl
from pathlib import Path
from typing import NoReturn

from caris_desktop import __version__
from caris_desktop.domain.address import is_loopback_host
from caris_desktop.domain.certificates import WrongFilesError, server_context
from caris_desktop.domain.foreign_text import printable
from caris_desktop.domain.plugins import PluginError, find


class CommandParser(argparse.ArgumentParser):
    """Argument parser whose errors do not control a terminal: a pattern such as ``*`` adds names of others' files."""

    def error(self, message: str) -> NoReturn:
        super().error(printable(message))


def build_parser() -> argparse.ArgumentParser:
    """Argument parser of the console. Other commands add their arguments in their own modules; few imports, for a fast
    start.
    """
    parser = CommandParser(
        prog="caris-desktop",
        description="An operator console for Wizard-of-Oz studies with mobile robots.",
    )
    parser.add_argument("--version", action="version", version=f"CARIS Desktop {__version__}")
    add_console_arguments(parser)
    return parser


def add_console_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scenario", metavar="FILE", help="scenario file or name (default: the last one used, or tour-guide)"
    )
    parser.add_argument(
        "--robot",
        metavar="PROFILE|ws://HOST:PORT|ros2:",
        help="robot profile name or file, or a rosbridge address (default: the robot in the scenario)",
    )
    parser.add_argument(
        "--camera",
        metavar="SOURCE",
        action="append",
        help=(
            "use this camera instead of the scenario's: a number, a device, a video file, a stream address, oak, "
            "simulated, or robot; can be repeated: '--camera robot --camera 0' adds camera 0 to the robot's "
            "cameras"
        ),
    )
    parser.add_argument("--study", metavar="DIR", type=Path, help="study folder (sessions and people)")
    parser.add_argument("--demo", action="store_true", help="start a simulated robot and connect to it")
    add_accept_named(parser)
    parser.add_argument("--theme", choices=("system", "dark", "light"), help="theme for this run")
    parser.add_argument("--language", metavar="NAME", help="language for this run, such as 'de' (default: English)")
    parser.add_argument("--verbose", action="store_true", help="show the log in the terminal")


def add_tracker(parser: argparse.ArgumentParser) -> None:
    """Add ``--tracker``, for commands that detect people in recordings."""
    parser.add_argument(
        "--tracker",
        metavar="NAME",
        type=_tracker,
        default="own",
        help="tracker for people: own, deepsort, bytetrack, botsort or a plug-in (default: own)",
    )


def _tracker(name: str) -> str:
    try:
        return find("trackers", name).name
    except PluginError as error:
        raise argparse.ArgumentTypeError(f"'{name}': {error}") from error


def add_accept_named(parser: argparse.ArgumentParser) -> None:
    """Add ``--accept-named``, for commands that read a scenario or robot profile, which the window would ask about."""
    parser.add_argument(
        "--accept-named",
        action="store_true",
        help=(
            "confirm the addresses, files, environment variables, models and plug-ins named in the scenario and the "
            "robot profile; the confirmation is saved for these files"
        ),
    )


# Arguments of commands that serve other computers: address, token and certificate.


LEAST_TOKEN = 16


class ServerArgumentsError(Exception):
    """Arguments with which no server starts; the text says why."""


def add_server_arguments(parser: argparse.ArgumentParser, *, port: int, variable: str = "") -> None:
    """``variable``: environment variable with the token if none is named."""
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (default: %(default)s, this computer only)"
    )
    parser.add_argument(
        "--port", type=int, default=port, help="port to listen on; 0 chooses a free one (default: %(default)s)"
    )
    token = parser.add_mutually_exclusive_group()
    token.add_argument(
        "--token-env",
        metavar="NAME",
        help="environment variable with the token that clients must send; a token is required if other computers may "
        f"connect{f' (default: {variable})' if variable else ''}",
    )
    token.add_argument("--token-file", metavar="FILE", type=Path, help="file with the token")
    parser.add_argument(
        "--cert",
        metavar="FILE",
        type=Path,
        help="certificate for encrypted connections, PEM; also required if other computers may connect",
    )
    parser.add_argument("--key", metavar="FILE", type=Path, help="its key")
    parser.set_defaults(token_variable=variable)


def read_server_arguments(arguments: argparse.Namespace, *, sent: str) -> tuple[str, ssl.SSLContext | None]:
    """Token (may be empty) and TLS context (None: unencrypted). ``sent`` names what others could intercept.

    Raises ServerArgumentsError.
    """
    token = _token(arguments)
    try:
        tls = server_context(arguments.cert, arguments.key)
    except WrongFilesError as error:
        raise ServerArgumentsError(str(error)) from error
    if is_loopback_host(arguments.host):
        return token, tls
    if not token:
        raise ServerArgumentsError(
            f"Other computers can reach {arguments.host}: put a token of at least {LEAST_TOKEN} characters into a file "
            "(--token-file FILE) or an environment variable (--token-env NAME), or listen on 127.0.0.1."
        )
    if tls is None:
        raise ServerArgumentsError(
            f"Other computers can reach {arguments.host} and could intercept the {sent} and the token: specify a "
            "certificate with --cert and --key, or listen on 127.0.0.1 and use an SSH tunnel."
        )
    return token, tls


def _token(arguments: argparse.Namespace) -> str:
    file: Path | None = arguments.token_file
    if file is not None:
        place = str(file)
        try:
            token = file.read_text("utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ServerArgumentsError(f"The token in {place} cannot be read: {error}.") from error
    else:
        variable = arguments.token_env or arguments.token_variable
        place = variable
        token = os.environ.get(variable, "").strip() if variable else ""
        if not token and not arguments.token_env:
            return ""
    if len(token) < LEAST_TOKEN:
        raise ServerArgumentsError(
            f"The token in {place} is missing or is too short: it needs at least {LEAST_TOKEN} characters; "
            "'openssl rand -hex 16' creates one."
        )
    return token
