"""What a program leaves that was killed while it recorded."""

import os
import subprocess
import sys
from pathlib import Path

from caris_desktop.study import unfinished_trial
from caris_desktop.study.unfinished_trial import UnfinishedTrial


def leave(folder: Path, trial: UnfinishedTrial) -> None:
    """As if another program had recorded ``trial`` and been killed."""
    unfinished_trial.save_unfinished(folder, trial)
    of_one_that_is_gone(folder)


def of_one_that_is_gone(folder: Path) -> None:
    """What this program wrote is now of one that runs no more."""
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    (folder / f"{os.getpid()}.json").rename(folder / f"{ended.pid}.json")
