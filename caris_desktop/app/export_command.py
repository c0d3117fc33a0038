"""``caris-desktop export``: recorded sessions as files for analysis."""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.study_jobs import WorkersError, add_worker_arguments, run_jobs, workers_of
from caris_desktop.recording.csv_cells import add_csv_arguments, csv_style_of
from caris_desktop.recording.exporters.templates import OF_FORMAT, check_template
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.recovery import missing_values, missing_words
from caris_desktop.recording.session.session_header import SessionError, read_header, reading
from caris_desktop.recording.session.session_reader import RECOVERED
from caris_desktop.recording.session_export import (
    BY_FORMAT,
    FORMATS,
    ExportError,
    ExportRequest,
    all_formats,
    export_all,
    export_folders,
    sessions_in,
    written_in,
)
from caris_desktop.recording.terminal import CANCELLED, ProgressLine, reporting

_TOGETHER = {fmt.name for fmt in FORMATS if fmt.together}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    formats = all_formats().values()
    width = max(len(fmt.name) for fmt in formats)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "formats:\n" + "\n".join(f"  {fmt.name:<{width}}  {fmt.description}" for fmt in formats)
    parser.add_argument("session", type=Path, help="session folder, or study folder for all of its sessions")
    parser.add_argument(
        "--to",
        type=_formats,
        default=("csv",),
        metavar="FORMAT[,FORMAT...]",
        help="formats to write (default: csv); all: every format except those of plug-ins",
    )
    parser.add_argument("--licence", default="", metavar="SPDX", help="licence of the data, such as CC-BY-4.0")
    parser.add_argument(
        "--with-names",
        action="store_true",
        help=(
            "include the names of wizards and coders and the robot's address, instead of pseudonyms (W1, C1) and "
            "the robot profile"
        ),
    )
    add_csv_arguments(parser)
    parser.add_argument(
        "--template",
        type=Path,
        metavar="FILE",
        help=f"your own template of the text, NAME.md.j2 or NAME.html.j2, with --to {' or --to '.join(OF_FORMAT)}",
    )
    parser.add_argument(
        "--print-template",
        action=_PrintTemplate,
        choices=tuple(OF_FORMAT),
        help="print the program's template of a format, to start your own from, and exit",
    )
    add_worker_arguments(parser)
    parser.add_argument("--verify", action="store_true", help="first verify the files against the session's checksums")
    parser.add_argument(
        "out",
        type=Path,
        help="folder to create; for a study, each session gets its own subfolder. Nothing is overwritten",
    )


@reporting(ExportError, WorkersError)
def run(args: argparse.Namespace) -> int:
    """Exit status: 0 if everything was exported, 1 if not (reasons on stderr), 130 if cancelled by Ctrl-C."""
    if args.template is not None:
        _check_template(args.template, args.to)
    sessions = sessions_in(args.session)
    damaged = _verify(sessions) if args.verify else []
    one = sessions == (args.session,)
    request = ExportRequest(
        sessions, args.to, args.out, args.licence,
        folder_per_session=not one, with_names=args.with_names, csv=csv_style_of(args),
        template=args.template,
    )  # fmt: skip
    targets = export_folders(request)
    before = len(written_in(targets))
    try:
        with ProgressLine() as line:
            finished = export_all(request, line.show, run=partial(run_jobs, workers=workers_of(args)))
    except KeyboardInterrupt:
        written = len(written_in(targets)) - before
        print(f"Cancelled. {written} of {len(sessions)} exports are complete; nothing else was saved.", file=sys.stderr)
        return CANCELLED
    for sentence in (*finished.notices, *damaged, *finished.problems):
        print(sentence, file=sys.stderr)
    if one and finished.written:
        print(f"Exported {args.session} to {args.out}")
    elif not one:
        exported = len(set(finished.written) & set(targets))
        together = [f"{path.name} for all" for path in finished.written if path.name in BY_FORMAT]
        # A study of one session has them in its folder.
        apart = [f"{exported} of {len(sessions)} sessions"] if exported or not set(args.to) <= _TOGETHER else []
        print(f"Exported {' and '.join([*apart, *together]) or 'nothing'} to {args.out}")
    return 1 if damaged or finished.problems else 0


class _PrintTemplate(argparse.Action):
    """Prints a shipped template and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, _namespace: object, values: object, *_: object) -> None:
        print((resources_dir() / "templates" / OF_FORMAT[str(values)]).read_text("utf-8"), end="")
        parser.exit()


def _check_template(template: Path, formats: Sequence[str]) -> None:
    if len(formats) != 1 or formats[0] not in OF_FORMAT:
        alone = QT_TR_NOOP("A template is for one format: {formats}. Nothing was written; name it with --to.")
        raise ExportError(alone, formats=", ".join(OF_FORMAT))
    check_template(template)


def _formats(text: str) -> tuple[str, ...]:
    if text == "all":
        return tuple(BY_FORMAT)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    known = all_formats()
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise argparse.ArgumentTypeError(
            f"unknown format {', '.join(unknown) or repr(text)}; allowed: {', '.join(known)}, all"
        )
    return names


def _verify(sessions: Sequence[Path]) -> list[str]:
    """Differences from the manifest, a sentence each; sessions without checksums are listed too.

    What a repair found missing from a closed session is reported even if the checksums match.
    """
    found = []
    for folder in sessions:
        try:
            found += [f"{folder.name}: {problem}" for problem in verify_manifest(folder)]
        except FileNotFoundError:
            found.append(f"{folder.name}: no checksums: the session was not closed properly, or by an older version.")
        except OSError as error:
            found.append(f"{folder.name}: the checksums cannot be read: {error.strerror or error}.")
        found += [f"{folder.name}: {loss}" for loss in _losses_since_closed(folder)]
    return found


def _losses_since_closed(folder: Path) -> tuple[str, ...]:
    try:
        header = read_header(folder)
        with reading(folder / "events.mcap"):
            missing = missing_words(header, missing_values(folder, header))
    except SessionError as error:
        return (str(error),)
    return missing if header.reason == RECOVERED else (*header.losses, *missing)
