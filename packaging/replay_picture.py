"""Takes a picture of a session in replay: ``python packaging/replay_picture.py SESSION PICTURE.png [THEME]``."""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QSettings, QTimer

from caris_desktop.app.replay_command import ReplayRun
from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_model import Vocabulary, VocabularyEntry

_SIZE_PX = (1920, 1080)
_GIVE_UP_MS = 60_000
_CODED = ((2.0, 6.5, "Curious"), (7.2, 12.0, "Engaged"), (13.0, 16.0, "Confused"), (16.5, 24.0, "Engaged"))


def main(session: Path, picture: Path, theme: str) -> int:
    with tempfile.TemporaryDirectory() as folder:
        settings = QSettings(str(Path(folder) / "settings.ini"), QSettings.Format.IniFormat)
        arguments = argparse.Namespace(session=session, at=None, at_ns=None, theme=theme, language=None)
        run = ReplayRun(arguments, settings=settings)
        run.window.resize(*_SIZE_PX)
        run.show()
        replay = run.console

        def when(ready: Callable[[], object], then: Callable[[], None], pause_ms: int = 0) -> None:
            def look() -> None:
                if ready():
                    QTimer.singleShot(pause_ms, then)
                else:
                    QTimer.singleShot(50, look)

            look()

        def code() -> None:
            values = tuple(VocabularyEntry(value) for value in ("Curious", "Engaged", "Confused", "Distracted"))
            replay.edit(lambda document: annotation_editing.add_vocabulary(document, Vocabulary("Engagement", values)))
            replay.edit(
                lambda document: annotation_editing.add_tier(document, "Visitor", coder="Kim", vocabulary="Engagement")
            )
            tier_id = replay.coding.value.tiers[-1].tier_id
            for start_s, end_s, value in _CODED:
                replay.edit(
                    lambda document, start_s=start_s, end_s=end_s, value=value: annotation_editing.add_annotation(
                        document, tier_id, round(start_s * 1000), round(end_s * 1000), value
                    )
                )
            replay.seek(session_ns(15.0))
            when(lambda: replay.settled and replay.state.frame.value is not None, take, pause_ms=3000)

        def session_ns(seconds: float) -> int:
            return replay.session.started_ns + round(seconds * 1e9)

        def take() -> None:
            run.window.grab().save(str(picture))
            run.application.exit(0)

        when(lambda: replay.overview.value is not None and replay.settled, code)
        QTimer.singleShot(_GIVE_UP_MS, lambda: run.application.exit(1))
        status = run.application.exec()
        run.close()
    return int(status)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "dark"))
