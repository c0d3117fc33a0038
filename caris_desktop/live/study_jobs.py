"""Jobs over the sessions of a study: in this process, in several of this computer, or on a Dask cluster."""

import argparse
import contextlib
import json
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

from caris_desktop import __version__
from caris_desktop.domain.address import is_loopback
from caris_desktop.domain.value_class import Value
from caris_desktop.live.logs import configure_child_logging
from caris_desktop.recording.session_export import ExportError, Progress, run_here, sessions_in
from caris_desktop.recording.terminal import ProgressLine, reporting

_log = logging.getLogger(__name__)
_CONNECT_S = 10.0
_CLEAN_UP_S = 10.0

R = TypeVar("R")
Job = Callable[[Path, Progress], R]
"""Work on one session folder, in any process. It reports a fraction 0..1 and what it does now. Its result is pickled.
It cleans up if it is interrupted by SystemExit or KeyboardInterrupt.
"""


class WorkersError(Exception):
    """Workers that cannot be used, with the reason as text for the user."""


class JobError(Exception):
    """Job that failed, with the reason as text for the user."""


class Workers(Value):
    """``count`` processes of this computer, or the cluster of a Dask ``scheduler``, if one is named."""

    count: int = 1
    scheduler: str = ""

    def at_a_time(self, jobs: int) -> int:
        """Number of processes of this computer that run ``jobs``; 1 if none is started."""
        return 1 if self.scheduler else min(self.count, jobs)


def add_worker_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers",
        metavar="N",
        type=_positive,
        default=os.cpu_count() or 1,
        help="sessions at a time, each in a process (default: number of processors)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        default="",
        help="run on the workers of this Dask scheduler, which must have the same folders; needs the extra [cluster]",
    )


def workers_of(arguments: argparse.Namespace) -> Workers:
    return Workers(arguments.workers, arguments.scheduler)


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError("must be a whole number of at least 1")
    return int(text)


def run_jobs(
    job: Job[R], folders: Sequence[Path], progress: Progress = lambda _fraction, _what: None, *, workers: Workers
) -> Generator[tuple[Path, R | JobError]]:
    """Run ``job`` on each folder; yield each result as soon as it is there, or why there is none.

    A process that dies costs only the session of which it dies. Ctrl+C, an exception of ``progress`` and closing the
    iterator cancel the rest; only workers of a cluster finish the job that they have begun.

    Raises
    ------
    WorkersError
        If the scheduler cannot or must not be used.
    """
    if not workers.scheduler and workers.at_a_time(len(folders)) == 1:
        yield from run_here(partial(_guarded, job), folders, progress)
        return
    remaining, done, alone = list(folders), 0, False
    while remaining:
        batch = remaining[:1] if alone else remaining
        lost = set()
        with _open_executor(workers, len(batch)) as executor:
            futures = {executor.submit(_guarded, job, folder, _ignore): folder for folder in batch}
            for future in as_completed(futures):
                folder = futures[future]
                try:
                    result = future.result()
                except Exception as error:
                    # A dead worker of a cluster counts against all jobs that it was to run.
                    if isinstance(error, BrokenProcessPool) or type(error).__name__ == "KilledWorker":
                        lost.add(folder)
                        continue
                    _log.exception("job of %s", folder)
                    result = JobError(f"{type(error).__name__}: {error}")
                done += 1
                progress(done / len(folders), folder.name)
                yield folder, result
        # The process that died took the others along, and nobody knows of which session: one at a time from here on.
        if alone and lost:
            done += 1
            yield batch[0], JobError("its process ended unexpectedly, perhaps for lack of memory")
            lost.clear()
        remaining = [folder for folder in batch if folder in lost] + remaining[len(batch) :]
        alone = True


def _ignore(_fraction: float, _what: str) -> None:
    pass


def _guarded(job: Job[R], folder: Path, progress: Progress) -> R | JobError:
    try:
        return job(folder, progress)
    except JobError as error:
        return error
    except SystemExit:
        if (parent := multiprocessing.parent_process()) is not None and not parent.is_alive():
            os._exit(1)  # the executor would report it, and wait for another job
        raise
    except Exception as error:
        _log.exception("job of %s", folder)
        return JobError(f"{type(error).__name__}: {error}")


@contextlib.contextmanager
def _open_executor(workers: Workers, jobs: int) -> Iterator[Executor]:
    if workers.scheduler:
        with _open_cluster(workers.scheduler) as executor:
            yield executor
        return
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers.count, jobs), mp_context=context, initializer=_begin_worker)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        processes = set(multiprocessing.active_children()) - others
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(_CLEAN_UP_S)
            process.kill()
        raise
    finally:
        pool.shutdown()


def _begin_worker() -> None:
    configure_child_logging("job")
    # Ctrl+C reaches the whole process group; this process ends when its parent says so, by SIGTERM.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(10)  # the robot may be in use at the same time


def _end_with_parent() -> None:
    """End this process as soon as the command that started it has ended, however that happened."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


@contextlib.contextmanager
def _open_cluster(address: str) -> Iterator[Executor]:
    try:
        import distributed
    except ImportError:
        raise WorkersError('--scheduler needs the extra [cluster]: pip install "caris-desktop[cluster]".') from None
    security = distributed.Security()
    if not is_loopback(address):
        keys = (security.tls_ca_file, security.tls_client_cert, security.tls_client_key)
        # A worker executes what it is sent, so that both ends must know with whom they talk.
        if urlsplit(address).scheme != "tls" or not all(keys):
            raise WorkersError(
                f"{address} is not used: the connection to another computer needs a tls:// address and certificates of "
                "both ends. Set distributed.comm.tls (ca-file, and client with cert and key) in Dask's configuration."
            )
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, security=security, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise WorkersError(f"The scheduler {address} cannot be reached: {error}.") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError:
            raise WorkersError(f"The scheduler {address} has no workers.") from None
        versions = client.run(_program_version)
        if others := set(versions.values()) - {__version__}:
            raise WorkersError(
                f"Workers run version {', '.join(sorted(others))} of this program, here is {__version__}."
            )
        executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


def _program_version() -> str:
    return __version__


# Jobs over the sessions of a command's argument: one JSON object a session on standard output.


def add_session_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sessions, and how many are worked on at a time."""
    parser.add_argument("recording", metavar="SESSION|STUDY", type=Path, help="session folder, or study folder")
    parser.add_argument(
        "--threads",
        metavar="N",
        type=int,
        help="threads per session (default: its share of the processors)",
    )
    add_worker_arguments(parser)


@reporting(ExportError, WorkersError, cancelled="Cancelled. What was finished before is saved.")
def run_over_sessions(
    job: Callable[[argparse.Namespace, Path, Progress], dict[str, object]], arguments: argparse.Namespace
) -> int:
    """Run ``job`` on each session with its share of ``arguments.threads``; exit status 1 if any failed."""
    if arguments.threads is not None and arguments.threads < 1:
        print("--threads must be at least 1.", file=sys.stderr)
        return 2
    folders = sessions_in(arguments.recording)
    workers = workers_of(arguments)
    at_a_time = workers.at_a_time(len(folders))
    if arguments.threads is None:
        arguments.threads = max(1, (os.cpu_count() or 1) // max(1, at_a_time))
    failed = 0
    with ProgressLine() as line:
        for folder, result in run_jobs(partial(job, arguments), folders, line.show, workers=workers):
            line.clear()
            if isinstance(result, JobError):
                print(f"{folder.name}: {result}", file=sys.stderr)
                failed += 1
            else:
                print(json.dumps(result), flush=True)
    return 1 if failed else 0
