"""Distribution of test files over xdist workers that survives the death of a worker, and names tests that hang.

pytest-xdist assigns all files of a dead worker to the others, completed ones too. A worker that gets a completed file
runs nothing, never reports, gets no more work, and the run never ends.
"""

import subprocess
from collections.abc import Collection
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController


class LoadFileOnceScheduling(LoadFileScheduling):
    """Scheduler that assigns the remaining tests of a dead worker to the others, without the test that killed it.

    ``split_files``: files, as in node ids, whose tests share nothing and are distributed singly, so that no worker is
    left with a whole long file at the end.
    """

    def __init__(self, config: pytest.Config, log: Any, split_files: Collection[str] = ()) -> None:
        super().__init__(config, log)
        self._split_files = frozenset(split_files)

    def _split_scope(self, nodeid: str) -> str:
        file: str = super()._split_scope(nodeid)
        return nodeid if file in self._split_files else file

    def remove_node(self, node: WorkerController) -> str | None:
        left = {
            file: tests for file, tests in self.assigned_work.pop(node).items() if not all(tests.values())
        }  # in the order of assignment
        if not left:
            return None
        file, tests = next(iter(left.items()))
        fatal: str = next(test for test, done in tests.items() if not done)
        tests[fatal] = True
        if all(tests.values()):
            del left[file]
        self.workqueue.update(left)
        for other in self.assigned_work:
            self._reschedule(other)
        return fatal


class RunningTests:
    """Names the running tests when a run is interrupted because it took too long."""

    def __init__(self) -> None:
        self._tests: dict[str, None] = {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._tests[nodeid] = None

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self._tests.pop(nodeid, None)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, exitstatus: int) -> None:
        if exitstatus == pytest.ExitCode.INTERRUPTED and self._tests:
            terminalreporter.section("running when the run was interrupted")
            for test in self._tests:
                terminalreporter.write_line(test)


def exit_description(node: WorkerController) -> str:
    """Exit status or signal of a worker's process, which xdist does not report."""
    process = getattr(getattr(node.gateway, "_io", None), "popen", None)
    if process is None:
        return "exit status unknown"
    try:
        status: int = process.wait(5)
    except subprocess.TimeoutExpired:
        return "process still running"
    return f"signal {-status}" if status < 0 else f"exit status {status}"
