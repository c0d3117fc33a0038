"""Erasure of a person in copies of a study, killed at each file change in turn.

Each time the erasure is repeated, and no data of the person may remain. Prints the number of changes.
"""

import functools
import os
import shutil
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

from caris_desktop.recording.forgetting.byte_search import ByteSearch
from caris_desktop.recording.forgetting.study_erasure import ForgetRequest, forget_person, unfinished_erasures
from caris_desktop.recording.forgetting.text_erasure import all_of
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.media_files import content_of
from tests.recording.forgetting.named_study import NAME, PERSON
from tests.support.kill_at_event import kill_at_event

_CHANGES = {"os.rename", "os.remove", "open"}


def erase(study: Path) -> None:
    (study / "people.sqlite").unlink(missing_ok=True)


def forget(study: Path) -> bool:
    """Erase the person as the command does; a person missing from the database is not searched for."""
    known = (study / "people.sqlite").exists()
    names = (NAME,) if known else ()
    if not known and PERSON not in unfinished_erasures(study):
        return True
    request = ForgetRequest(study, (PERSON,), names, otherwise="redact")
    return forget_person(request, lambda: erase(study)).complete


def in_child(work: Callable[[], None]) -> int:
    """Exit status of ``work`` in a forked process.

    This process never decodes media: a fork would inherit the locks of decoder threads without the threads.
    """
    child = os.fork()
    if not child:
        status = 1
        try:
            work()
            status = 0
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def ask_again(source: Path, study: Path) -> None:
    assert forget(study)
    search = ByteSearch(all_of([NAME], []))
    assert not [path for path in study.rglob("*") if path.is_file() and search.file(path).hits]
    assert not [*study.rglob("*.part"), *study.rglob("under-way*")]
    assert all(verify_manifest(folder) == [] for folder in (study / "sessions").iterdir())
    before, after = ({path.name: content_of(path) for path in place.rglob("*.mp4")} for place in (source, study))
    assert before == after


def main(source: Path, copies: Path, first: int, step: int) -> None:
    (source / "people.sqlite").write_text(NAME, encoding="utf-8")
    count = first
    while True:
        study = copies / str(count)
        shutil.copytree(source, study)

        def forget_and_die(study: Path = study, count: int = count) -> None:
            kill_at_event(count, study, _CHANGES, reading=False)
            forget(study)

        status = in_child(forget_and_die)
        assert in_child(functools.partial(ask_again, source, study)) == 0, count
        shutil.rmtree(study)
        if status >= 0:
            assert status == 0
            print(count)
            return
        count += step


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
