"""Jobs over the sessions of a command's argument: one JSON object a session on standard output."""

import argparse
import json
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from caris_desktop.live.study_jobs import JobError, Progress, WorkersError, add_worker_arguments, run_jobs, workers_of
from caris_desktop.recording.session_export import ExportError, sessions_in
from caris_desktop.recording.terminal import ProgressLine


def add_session_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sessions, and how many are worked on at a time."""
    parser.add_argument("recording", metavar="SESSION|STUDY", type=Path, help="session folder, or study folder")
    parser.add_argument(
        "--threads",
        metavar="N",
        type=int,
        help="threads per session (default: half of the processors, or with several sessions at a time their share)",
    )
    add_worker_arguments(parser)


def run_over_sessions(
    job: Callable[[argparse.Namespace, Path, Progress], dict[str, object]], arguments: argparse.Namespace
) -> int:
    """Run ``job`` on each session with its share of ``arguments.threads``; exit status 1 if any failed."""
    if arguments.threads is not None and arguments.threads < 1:
        print("--threads must be at least 1.", file=sys.stderr)
        return 2
    try:
        folders = sessions_in(arguments.recording)
    except ExportError as error:
        print(error, file=sys.stderr)
        return 1
    workers = workers_of(arguments)
    at_a_time = workers.at_a_time(len(folders))
    if arguments.threads is None and at_a_time > 1:
        arguments.threads = max(1, (os.cpu_count() or 1) // at_a_time)
    failed = 0
    try:
        with ProgressLine() as line:
            for folder, result in run_jobs(partial(job, arguments), folders, line.show, workers=workers):
                line.clear()
                if isinstance(result, JobError):
                    print(f"{folder.name}: {result}", file=sys.stderr)
                    failed += 1
                else:
                    print(json.dumps(result), flush=True)
    except WorkersError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nCancelled. What was finished before is saved.", file=sys.stderr)
        return 130
    return 1 if failed else 0
