"""Repair of copies of a session, killed at each touched file in turn; prints the number of files."""

import os
import shutil
import sys
from pathlib import Path

from caris_desktop.recording.session.recovery import repair_session
from tests.support.kill_at_event import kill_at_event

_TOUCHING = {"open", "os.link", "os.mkdir", "os.remove", "os.rename", "os.truncate", "shutil.copyfile"}


def main(source: Path, copies: Path, first: int, step: int) -> None:
    count = first
    while True:
        folder = copies / str(count)
        shutil.copytree(source, folder)
        child = os.fork()
        if not child:
            kill_at_event(count, folder, _TOUCHING)
            repair_session(folder)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if os.WIFEXITED(status):
            assert os.WEXITSTATUS(status) == 0
            print(count)
            return
        count += step


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
