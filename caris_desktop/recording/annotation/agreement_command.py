"""``caris-desktop agreement``: how far the coders of a session agree."""

import argparse
from pathlib import Path

from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_store import load_documents
from caris_desktop.recording.annotation.coder_agreement import coders_report, compare_coders
from caris_desktop.recording.session.session_header import SessionError, read_header
from caris_desktop.recording.terminal import reporting


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", type=Path, help="session folder")
    parser.add_argument("coders", nargs="*", metavar="CODER", help="coders to compare (default: all)")
    parser.add_argument("--tier", default="", help="compare only this tier (default: all that two coders have)")
    parser.add_argument("--unit", type=int, default=100, metavar="MS", help="time step (default: %(default)s ms)")
    parser.add_argument(
        "--tolerance",
        type=int,
        default=500,
        metavar="MS",
        help="maximum distance between the boundaries of matching annotations (default: %(default)s ms)",
    )


@reporting(SessionError, AnnotationError)
def run(args: argparse.Namespace) -> int:
    """Exit status: 0 if compared, 1 if not (reason on stderr)."""
    read_header(args.session)
    document = load_documents(args.session)
    results = compare_coders(document, args.coders, tier=args.tier, unit_ms=args.unit, tolerance_ms=args.tolerance)
    print("\n".join(coders_report(result) for result in results), end="")
    return 0
