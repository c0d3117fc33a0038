"""Rehearsal as of ``caris-desktop rehearse``, with LiveState sampled twice a second.

``python -m tests.app.watched_rehearsal SAMPLES_FILE SENTENCES SCENARIO --out DIR`` writes one JSON line per sample. The
participant says the first SENTENCES sentences.
"""

import json
import sys
from pathlib import Path
from typing import Any

from PySide6.QtCore import QTimer

from caris_desktop.app import rehearse_command
from caris_desktop.app.command_table import run
from caris_desktop.domain import clock
from tests.app.shown_state import shown_state

_EVERY_MS = 500


class WatchedRehearsal(rehearse_command.Rehearsal):
    """Rehearsal that samples the state."""

    samples_path = Path()

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._samples = self.samples_path.open("w", encoding="utf-8")
        self._watch = QTimer(self)
        self._watch.timeout.connect(self._sample)
        self._watch.start(_EVERY_MS)

    def _sample(self) -> None:
        state = self._console.state
        if state.recording.value.state == "recording":
            self._samples.write(json.dumps({"at_ns": clock.now_ns(), "shown": shown_state(state)}) + "\n")
            self._samples.flush()


if __name__ == "__main__":
    WatchedRehearsal.samples_path = Path(sys.argv[1])
    rehearse_command.Rehearsal = WatchedRehearsal  # type: ignore[misc]
    rehearse_command.SAYS = {name: text[: int(sys.argv[2])] for name, text in rehearse_command.SAYS.items()}
    sys.exit(run(["rehearse", *sys.argv[3:]]))
