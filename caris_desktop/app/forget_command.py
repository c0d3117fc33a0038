"""``caris-desktop forget``: erases a person from a study."""

import argparse
import sys
from pathlib import Path

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.erasure_run import ErasureRequest, forget, person_of
from caris_desktop.recording.forgetting.study_erasure import Forgotten, receipt_words
from caris_desktop.recording.studies.study_index import study_dir_of
from caris_desktop.recording.terminal import CANCELLED, ProgressLine, reporting
from caris_desktop.study.study_folder import StudyFolder

_YES = "forget"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", type=Path, help="study folder")
    parser.add_argument("person", help="the person's id, or the name if it is unique in the study")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--mask-media",
        dest="recordings",
        action="store_const",
        const="mask",
        help="pixelate the person in the videos and photos in which they appear (default)",
    )
    how.add_argument(
        "--remove-media",
        dest="recordings",
        action="store_const",
        const="remove",
        help="remove the videos, photos and microphone audio of the sessions in which the person appears",
    )
    parser.add_argument(
        "--text",
        choices=("list", "redact", "keep"),
        default="list",
        help="texts that may name the person: list them for review (default), replace all, or leave all unchanged",
    )
    parser.add_argument("--review", type=Path, metavar="FILE", help="the list of texts with your decisions")
    parser.add_argument(
        "--also-called", action="append", default=[], metavar="NAME", help="another name or spelling to search for"
    )
    parser.add_argument(
        "--keep-exports",
        action="store_true",
        help="do not remove earlier exports that show or name the person; only list them",
    )
    parser.add_argument("--yes", action="store_true", help="start without confirmation")
    parser.set_defaults(recordings="mask")


@reporting(UserFacingError, cancelled="Interrupted. Nothing is lost; run the same command again to resume.")
def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 if nothing is left of the person, 1 if something is (as printed), 130 if cancelled."""
    from caris_desktop.app.composition import own_files  # imports all parts of the console

    if not arguments.study.is_dir():
        print(f"{arguments.study} is not a folder. Nothing was changed.", file=sys.stderr)
        return 1
    study = study_dir_of(arguments.study).absolute()
    request = ErasureRequest(
        study,
        StudyFolder(study).people_database,
        arguments.person,
        tuple(arguments.also_called),
        recordings=arguments.recordings,
        texts="" if arguments.text == "list" else arguments.text,
        review=None if arguments.review is None else arguments.review.absolute(),
        keep_exports=arguments.keep_exports,
        own_files=own_files(study),
    )
    person, _, _ = person_of(request)
    if not (arguments.yes or _agreed(request, person.names)):
        print("No person was erased; nothing was changed.", file=sys.stderr)
        return CANCELLED
    with ProgressLine() as line:
        outcome = forget(request, line.show)
    _notify(outcome, study, person.person_ids[0])
    return 0 if outcome.complete else 1


def _agreed(request: ErasureRequest, names: tuple[str, ...]) -> bool:
    done = "pixelated in" if request.recordings == "mask" else "removed with"
    print(
        f"{' / '.join(names) or request.who} will be permanently erased from {request.study}: removed from the study's "
        f"database, and {done} every video and photo in which they appear. Exports that show or name them "
        f"{'are not changed' if request.keep_exports else 'are removed'}. This cannot be undone."
    )
    if not sys.stdin.isatty():
        print("Add --yes to start without confirmation.", file=sys.stderr)
        return False
    return input(f"Type {_YES} to continue: ").strip() == _YES


def _notify(outcome: Forgotten, study: Path, person_id: str) -> None:
    if not outcome.complete:
        print("Incomplete: the person may still be named, shown or heard.", file=sys.stderr)
    print(receipt_words(outcome.receipt))
    for file in outcome.unexamined:
        print(f"{file} was not searched for people: it may show or name the person.", file=sys.stderr)
    for problem in outcome.problems:
        print(problem, file=sys.stderr)
    for what in outcome.closed:
        print(f"Searched only in compressed form, because it could not be decompressed: {what}.", file=sys.stderr)
    for file in outcome.left:
        print(f"{file} still contains data about the person.", file=sys.stderr)
    if outcome.review is not None:
        places = "1 place" if outcome.waiting == 1 else f"{outcome.waiting} places"
        print(
            f"{places} may name or show the person. Enter a decision for each in {outcome.review}, then run:\n"
            f"  caris-desktop forget {study} {person_id} --review {outcome.review}",
            file=sys.stderr,
        )
    print(f"Receipt: {outcome.receipt}")
