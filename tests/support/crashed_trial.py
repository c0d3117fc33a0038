"""Saved trial of a console process that was killed while recording."""

import os
import subprocess
import sys
from pathlib import Path

from caris_desktop.study import unfinished_trial
from caris_desktop.study.unfinished_trial import UnfinishedTrial


def save_crashed_trial(folder: Path, trial: UnfinishedTrial) -> None:
    """Save ``trial`` as if by a console process that was killed."""
    unfinished_trial.save_unfinished(folder, trial)
    assign_to_ended_process(folder)


def assign_to_ended_process(folder: Path) -> None:
    """Rename this process's file to the PID of a process that has exited."""
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    (folder / f"{os.getpid()}.json").rename(folder / f"{ended.pid}.json")
