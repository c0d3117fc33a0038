"""A handle on ``tests.app.console_child`` and its kin: say what to press, see what is on show."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support.polling import wait_for


def without_models(scenario: Path, folder: Path) -> Path:
    """A copy of it that asks no language model and writes down nothing that is said, which costs six processes less."""
    text = scenario.read_text("utf-8")
    for permission in ("assistant", "transcription"):
        assert text.count(f"\n  {permission}: true\n") == 1
        text = text.replace(f"\n  {permission}: true\n", f"\n  {permission}: false\n")
    copy = folder / scenario.name
    copy.write_text(text, "utf-8")
    return copy


class ConsoleProcess:
    """The console in a process that may be stopped and killed. ``whole``: with its language model and recogniser."""

    def __init__(
        self,
        *arguments: str | Path,
        module: str = "tests.app.console_child",
        whole: bool = False,
        **environment: str,
    ) -> None:
        if whole:
            environment["CARIS_TEST_WHOLE"] = "1"
        # Of its own, as children that are killed leave files behind.
        self._folder = Path(tempfile.mkdtemp(prefix="console-"))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.run_module", module, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "QT_QPA_PLATFORM": "offscreen", "TMPDIR": str(self._folder), **environment},
            start_new_session=True,
        )
        self.history: list[dict[str, Any]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def shown(self) -> dict[str, Any]:
        """What is on show now; empty before the window is up."""
        return self.history[-1] if self.history else {}

    def say(self, line: str) -> None:
        if self._process.stdin is None:
            raise RuntimeError("the console has no stdin")
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait_until_shown(self, *, timeout_s: float = 60.0, **expected: object) -> dict[str, Any]:
        """The first report in which everything expected is on show."""
        first = len(self.history) - 1 if self.history else 0

        def found() -> dict[str, Any] | None:
            if self._process.poll() is not None and not self._reader.is_alive():
                raise AssertionError(f"the console ended with {self._process.returncode}; last: {self.shown}")
            for report in self.history[max(0, first) :]:
                if all(report[name] == value for name, value in expected.items()):
                    return report
            return None

        try:
            report = wait_for(found, f"{expected}", timeout_s=timeout_s)
        except AssertionError as error:
            raise AssertionError(f"{error}; last: {self.shown}") from error
        if report is None:
            raise AssertionError
        return report

    def hold(self, key: str, seen: Callable[[], object], what: str) -> None:
        """Press a drive key until ``seen``. A busy machine may stall the window, which ends a hold: press anew then."""
        for _attempt in range(5):
            self.say(f"press {key}")
            with contextlib.suppress(AssertionError):
                wait_for(seen, what, timeout_s=4.0)
                return
            self.say(f"release {key}")
        raise AssertionError(f"not after five presses of {key}: {what}; last: {self.shown}")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._remove_folder()

    def terminate(self, number: signal.Signals = signal.SIGTERM) -> int:
        """As the system does that is shut down; gives the exit status."""
        self._process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Until it has ended by itself; gives the exit status."""
        self._process.wait(60)
        self._remove_folder()
        return self._process.returncode

    def _remove_folder(self) -> None:
        """Children that end by themselves may still write into it."""

        def removed() -> bool:
            shutil.rmtree(self._folder, ignore_errors=True)
            return not self._folder.exists()

        wait_for(removed, "its temporary files are gone")

    def close(self) -> int:
        """Close the window and give the exit status."""
        if self._process.poll() is None:
            try:
                self.say("quit")
                self._process.wait(20)
            except (BrokenPipeError, subprocess.TimeoutExpired):
                self.kill()
        self._remove_folder()
        return self._process.returncode

    def _read(self) -> None:
        if self._process.stdout is None:
            return
        for line in self._process.stdout:
            if line.startswith("{"):
                self.history.append(json.loads(line))
