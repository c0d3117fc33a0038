"""``caris-desktop agreement``: how far two coders of a session agree."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", type=Path, help="folder of the session")
    parser.add_argument("first", metavar="CODER_A", help="the one coder")
    parser.add_argument("second", metavar="CODER_B", help="the other coder")
    parser.add_argument("--tier", default="", help="compare this tier only (default: all that both have)")


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 when compared, 1 when not (stderr says why)."""
    raise NotImplementedError
