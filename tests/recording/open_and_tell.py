"""Open a session and print its messages, number of marks and files as JSON."""

import json
import sys
from pathlib import Path

from caris_desktop.recording.session.session_reader import open_session


def main(folder: Path) -> None:
    session = open_session(folder)
    marks = sum(1 for _ in session.values("event/marked"))
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    print(json.dumps({"notices": session.notices, "reason": session.reason, "marks": marks, "files": files}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
