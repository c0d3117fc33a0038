"""Forgets somebody in copies of a study, killed at the first change of a file, at the second, and so on.

Each time it is asked again, and nothing of the person may be left. Prints how many changes there are.
"""

import os
import shutil
import sys
from pathlib import Path

from caris_desktop.recording.forgetting.byte_search import ByteSearch
from caris_desktop.recording.forgetting.canaries import all_of
from caris_desktop.recording.forgetting.study import ForgetRequest, forget_person, under_way
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.media_repair import content_of
from tests.recording.forgetting.named_study import NAME, PERSON
from tests.support.dying import die_at

_CHANGES = {"os.rename", "os.remove", "open"}


def erase(study: Path) -> None:
    (study / "people.sqlite").unlink(missing_ok=True)


def forget(study: Path) -> bool:
    """As the command does: what the database does not know any more nobody looks for."""
    known = (study / "people.sqlite").exists()
    names = (NAME,) if known else ()
    if not known and PERSON not in under_way(study):
        return True
    request = ForgetRequest(study, (PERSON,), names, otherwise="redact")
    return forget_person(request, lambda: erase(study)).complete


def main(source: Path, copies: Path, first: int, step: int) -> None:
    frames = {path.name: content_of(path) for path in source.rglob("*.mp4")}
    search = ByteSearch(all_of([NAME], []))
    (source / "people.sqlite").write_text(NAME, encoding="utf-8")
    count = first
    while True:
        study = copies / str(count)
        shutil.copytree(source, study)
        child = os.fork()
        if not child:
            die_at(count, study, _CHANGES, reading=False)
            forget(study)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        assert forget(study), count
        left = [path for path in study.rglob("*") if path.is_file() and search.file(path).hits]
        assert not left, (count, left)
        assert not [*study.rglob("*.part"), *study.rglob("under-way*")], count
        for folder in (study / "sessions").iterdir():
            assert verify_manifest(folder) == [], count
        assert {path.name: content_of(path) for path in study.rglob("*.mp4")} == frames, count
        shutil.rmtree(study)
        if os.WIFEXITED(status):
            assert os.WEXITSTATUS(status) == 0
            print(count)
            return
        count += step


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
