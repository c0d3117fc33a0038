"""Command line of the console."""

import argparse
from pathlib import Path

from caris_desktop import __version__
from caris_desktop.domain.plugins import PluginError, find


def build_parser() -> argparse.ArgumentParser:
    """Argument parser of the console. Other commands add their arguments in their own modules; few imports, for a fast
    start.
    """
    parser = argparse.ArgumentParser(
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
