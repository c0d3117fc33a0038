"""``caris-desktop export``: a recorded session as files for analysis."""

import argparse
import sys
from pathlib import Path

from caris_desktop.recording.export import BY_FORMAT, ExportError, export_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", type=Path, help="folder of the session")
    parser.add_argument("--to", choices=tuple(BY_FORMAT), default="csv", help="format (default: %(default)s)")
    parser.add_argument("out", type=Path, help="folder to make; must not hold files")


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 when exported, 1 when not (stderr says why)."""
    try:
        written = export_session(args.session, args.to, args.out)
    except ExportError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"Exported {len(written)} files to {args.out}")
    return 0
