"""``caris-desktop anonymise``: copies of sessions without names, faces and voices."""

import argparse
import io
import secrets
import shutil
import sys
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

from caris_desktop.domain.file_replacement import narrow, no_room, replace_file
from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.person_marks import mark_of
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.study_jobs import JobError, WorkersError, add_worker_arguments, run_jobs, workers_of
from caris_desktop.people.people_store import PeopleStore, PeopleStoreError
from caris_desktop.perception import blur
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.anonymising.pseudonymous_copy import copy_file
from caris_desktop.recording.anonymising.session_copy import AnonymiseOptions, FoundText, KnownNames, anonymise_session
from caris_desktop.recording.csv_cells import add_csv_arguments, csv_style_of
from caris_desktop.recording.pseudonyms import pseudonyms_of
from caris_desktop.recording.recorder.recorder_messages import BlurDemand, UseConsents
from caris_desktop.recording.session.session_header import SessionError, is_session, read_header
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import (
    ExportError,
    Progress,
    export_names,
    remove_partial_exports,
    sessions_in,
    whole_folder,
)
from caris_desktop.recording.studies.study_index import study_dir_of
from caris_desktop.recording.study_file import FILE_NAME, StudyFileError, read_study_file, study_file_of
from caris_desktop.recording.terminal import ProgressLine, reporting
from caris_desktop.study.study_folder import StudyFolder, file_name_part

_INSIDE = QT_TR_NOOP(
    "{out} is inside the study, with the names that the copy must not have. Nothing was written; "
    "choose a folder outside."
)
_REVIEW_EXISTS = QT_TR_NOOP("{review} exists. Nothing was written; move it away, or choose another folder.")
_NO_REVIEW = QT_TR_NOOP("{review} could not be written: {reason}. The copy is complete.")
# Factors between which a changed pitch lies, higher or lower: the voice stays understandable.
_PITCHES = (1.18, 1.32)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="SESSION|STUDY", type=Path, help="session folder, or study folder")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder to create outside the study; of a study, each session gets its own subfolder",
    )
    parser.add_argument(
        "--blur",
        choices=("without-consent", "everybody", "nobody"),
        default="without-consent",
        help="whom to make unrecognisable in videos and photos (default: people without noted consent)",
    )
    parser.add_argument(
        "--blur-what", choices=("faces", "persons"), default="faces", help="how much of them (default: faces)"
    )
    parser.add_argument(
        "--voice",
        choices=("keep", "remove", "change"),
        default="keep",
        help="voices of people: unchanged (default), removed, or with another pitch; the robot's voice stays",
    )
    parser.add_argument(
        "--also-called",
        action="append",
        default=[],
        metavar="NAME",
        help="further name to replace, of somebody whom neither the study's people nor the start dialog name",
    )
    parser.add_argument("--keep-wizards", action="store_true", help="keep the names of wizards")
    add_csv_arguments(parser)
    add_worker_arguments(parser)


@reporting(ExportError, StudyFileError, WorkersError, cancelled="Cancelled. Nothing was written.")
def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 if everything was copied, 1 if a session was not (reasons on stderr), 130 if cancelled."""
    try:
        return _copy_all(arguments)
    except PeopleStoreError as error:
        print(f"{error} Without it, names of people would stay. Nothing was written.", file=sys.stderr)
    except OSError as error:
        print(f"The copy failed: {error.strerror or error}. Nothing was written.", file=sys.stderr)
    return 1


def _copy_all(arguments: argparse.Namespace) -> int:
    out = arguments.out.absolute()
    review = out.with_name(f"{out.name}-review.csv")
    sessions = sessions_in(arguments.recording)
    study = _study_of(arguments.recording)
    home = study.path.resolve()
    if home in (out.resolve(), *out.resolve().parents):
        raise ExportError(_INSIDE, out=out)
    if review.exists():
        raise ExportError(_REVIEW_EXISTS, review=review)
    study_file = study_file_of(sessions[0])
    if study_file is not None:
        read_study_file(study_file)
    found: dict[Path, tuple[tuple[str, ...], tuple[FoundText, ...]]] = {}
    failures: list[str] = []
    remove_partial_exports(out)
    with ProgressLine() as line, whole_folder(out, arguments.recording) as part:
        one = sessions == (arguments.recording,)
        options = _options(arguments, sessions, study)
        names = KnownNames({**options.names, **options.pseudonyms.people, **options.pseudonyms.wizards})
        targets: dict[Path, Path] = {}
        for folder, name in zip(sessions, export_names(sessions), strict=True):
            called = free_name(names.replace(name), "", lambda each: part / each in targets.values())
            targets[folder] = part if one else part / called
        if study_file is not None and not one:
            copy_file(study_file, part / FILE_NAME)
        job = partial(_anonymise, options, targets, study_file if one else None)
        for folder, result in run_jobs(job, sessions, line.show, workers=workers_of(arguments)):
            if isinstance(result, JobError):
                failures.append(f"{folder.name}: {result}")
                shutil.rmtree(targets[folder], ignore_errors=True)
            else:
                found[folder] = result
        if not found:
            raise ExportError(QT_TR_NOOP("{failures} Nothing was written."), failures=" ".join(failures))
    left_out = [f"{folder.name}: {sentence}" for folder in sessions if folder in found for sentence in found[folder][0]]
    rows = [
        (
            targets[folder].name if targets[folder] != part else out.name,
            text.file,
            text.place,
            text.kind,
            text.count,
            text.text,
        )
        for folder in sessions
        if folder in found
        for text in found[folder][1]
    ]
    _write_review(review, rows, arguments)
    for sentence in (*left_out, *failures):
        print(sentence, file=sys.stderr)
    if not study.people_database.exists():
        print("The study has no people database: only names of wizards, coders and participants were known.")
    print(f"Anonymised {len(found)} of {len(sessions)} sessions to {out}")
    print(f"Read {review}: {len(rows)} texts may still say who somebody is. It is not part of the copy.")
    return 1 if failures else 0


def _study_of(recording: Path) -> StudyFolder:
    """Study of a session (itself, if it is in none), or the study."""
    path = recording.absolute()
    if is_session(path):
        return StudyFolder(path.parent.parent if path.parent.name == "sessions" else path)
    return StudyFolder(study_dir_of(path))


def _options(arguments: argparse.Namespace, sessions: Sequence[Path], study: StudyFolder) -> AnonymiseOptions:
    low, high = _PITCHES
    factor = low + (high - low) * secrets.randbelow(1000) / 1000  # not noted anywhere, so that it cannot be undone
    names: dict[str, str] = {}
    consents = None
    everybody = sessions
    if (study.path / "sessions").is_dir():
        everybody = sessions_in(study.path)  # so that pseudonyms do not depend on who is anonymised first
    pseudonyms = pseudonyms_of(everybody, arguments.also_called)
    for folder in everybody:
        with suppress(SessionError):
            trial = read_header(folder).trial
            # As they were typed: the pseudonyms are stored in small letters, and folders shorten long names.
            wizard, participant = (trial.get(name, "").strip() for name in ("wizard", "participant"))
            if len(wizard) > 2 and not arguments.keep_wizards:
                names[wizard] = pseudonyms.wizard(wizard)
            if participant and pseudonyms.participant(participant) != participant:
                names |= dict.fromkeys((participant, file_name_part(participant)), pseudonyms.participant(participant))
    if study.people_database.exists():
        with closing(PeopleStore(study.people_database)) as store:
            people, noted = store.everybody(), store.consents()
        root_of = {person.person_id: person.is_person_id or person.person_id for person in people}
        names = {person.name: mark_of(root_of[person.person_id]) for person in people if person.name} | names
        video, photos = (
            frozenset(
                each for each, root in root_of.items() if kind in (held := noted.get(root, {})) and held[kind].given
            )
            for kind in ("video", "photo")
        )
        consents = UseConsents(video, photos)
    return AnonymiseOptions(
        pseudonyms,
        names,
        consents,
        BlurDemand(arguments.blur.replace("-", "_"), arguments.blur_what),
        arguments.voice,
        factor if secrets.randbelow(2) else 1 / factor,
        arguments.keep_wizards,
    )


def _anonymise(
    options: AnonymiseOptions, targets: dict[Path, Path], study_file: Path | None, folder: Path, progress: Progress
) -> tuple[tuple[str, ...], tuple[FoundText, ...]]:
    target = targets[folder]
    try:
        shutil.rmtree(target, ignore_errors=True)  # of a process that died
        target.mkdir(parents=True)
        if study_file is not None:
            copy_file(study_file, target / FILE_NAME)
        return anonymise_session(
            open_session(folder), target, options, blur, lambda share: progress(share, folder.name)
        )
    except (SessionError, AnnotationError) as error:
        raise JobError(str(error)) from error
    except OSError as error:
        reason = "the disk is full" if no_room(error) else error.strerror or str(error)
        raise JobError(f"the copy could not be written: {reason}.") from error


def _write_review(path: Path, rows: Sequence[Sequence[object]], arguments: argparse.Namespace) -> None:
    style = csv_style_of(arguments)
    text = io.StringIO(newline="")
    writer = style.writer(text)
    writer.writerow(("session", "file", "place", "kind", "count", "text"))
    writer.writerows(rows)
    try:
        replace_file(path, text.getvalue().encode(style.encoding, "replace"), durable=False)
        narrow([path])
    except OSError as error:
        raise ExportError(_NO_REVIEW, review=path, reason=error.strerror or error) from error
