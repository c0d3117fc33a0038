"""Several workers share the tests of a run, a file at a time; here is what happens when one of them dies or hangs.

pytest-xdist hands all the files of a worker that died to the others, those that were done too. Another worker that is
handed such a file has nothing to run in it, so never reports, is never given more, and the run never ends.
"""

import subprocess
from collections.abc import Collection
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController


class FilesOnce(LoadFileScheduling):
    """What a dead worker had left is done by the others; the test at which it died is not tried on them as well.

    ``by_test``: files, as in the ids of their tests, whose tests share nothing: any worker that is free takes one of
    them, so that nobody is left with a whole long file at the end.
    """

    def __init__(self, config: pytest.Config, log: Any, by_test: Collection[str] = ()) -> None:
        super().__init__(config, log)
        self._by_test = frozenset(by_test)

    def _split_scope(self, nodeid: str) -> str:
        file: str = super()._split_scope(nodeid)
        return nodeid if file in self._by_test else file

    def remove_node(self, node: WorkerController) -> str | None:
        left = {
            file: tests for file, tests in self.assigned_work.pop(node).items() if not all(tests.values())
        }  # in the order in which the worker took them
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


class UnderWay:
    """The tests that have begun and not ended: what to look at when a run was stopped because it took too long."""

    def __init__(self) -> None:
        self._tests: dict[str, None] = {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._tests[nodeid] = None

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self._tests.pop(nodeid, None)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, exitstatus: int) -> None:
        if exitstatus == pytest.ExitCode.INTERRUPTED and self._tests:
            terminalreporter.section("under way when the run was stopped")
            for test in self._tests:
                terminalreporter.write_line(test)


def end_of(node: WorkerController) -> str:
    """How a worker's process ended, in words; xdist says no more than that it did."""
    process = getattr(getattr(node.gateway, "_io", None), "popen", None)
    if process is None:
        return "its end is not known"
    try:
        status: int = process.wait(5)
    except subprocess.TimeoutExpired:
        return "its process still runs"
    return f"signal {-status}" if status < 0 else f"exit status {status}"
