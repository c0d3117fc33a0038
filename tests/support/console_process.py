"""Handle on ``tests.app.console_child`` and similar programs: sends commands and reads the reported state."""

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
    """Copy of a scenario without assistant and transcription, which saves six processes."""
    text = scenario.read_text("utf-8")
    for permission in ("assistant", "transcription"):
        assert text.count(f"\n  {permission}: true\n") == 1
        text = text.replace(f"\n  {permission}: true\n", f"\n  {permission}: false\n")
    copy = folder / scenario.name
    copy.write_text(text, "utf-8")
    return copy


class ConsoleProcess:
    """Console in a separate process that may be stopped and killed; ``with_models`` also starts its models."""

    def __init__(
        self,
        *arguments: str | Path,
        module: str = "tests.app.console_child",
        with_models: bool = False,
        **environment: str,
    ) -> None:
        if with_models:
            environment["CARIS_TEST_WITH_MODELS"] = "1"
        # A separate folder: killed child processes leave files behind.
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
        """Last reported state; empty until the window is open."""
        return self.history[-1] if self.history else {}

    def send_command(self, line: str) -> None:
        if self._process.stdin is None:
            raise RuntimeError("the console process has no stdin")
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait_until_shown(self, *, timeout_s: float = 60.0, **expected: object) -> dict[str, Any]:
        """Wait for the first report that contains all expected values, and return it."""
        first = len(self.history) - 1 if self.history else 0

        def found() -> dict[str, Any] | None:
            if self._process.poll() is not None and not self._reader.is_alive():
                raise AssertionError(
                    f"the console exited with status {self._process.returncode}; last report: {self.shown}"
                )
            for report in self.history[max(0, first) :]:
                if all(report[name] == value for name, value in expected.items()):
                    return report
            return None

        try:
            report = wait_for(found, f"{expected}", timeout_s=timeout_s)
        except AssertionError as error:
            raise AssertionError(f"{error}; last report: {self.shown}") from error
        if report is None:
            raise AssertionError
        return report

    def hold(self, key: str, seen: Callable[[], object], what: str) -> None:
        """Hold a drive key until ``seen`` is true; press again if a stalled window on a busy machine ended the hold."""
        for _attempt in range(5):
            self.send_command(f"press {key}")
            with contextlib.suppress(AssertionError):
                wait_for(seen, what, timeout_s=4.0)
                return
            self.send_command(f"release {key}")
        raise AssertionError(f"five presses of {key} without effect: {what}; last report: {self.shown}")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._remove_folder()

    def terminate(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal, by default that of a system shutdown, and return the exit status."""
        self._process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Wait until the process has exited, and return its status."""
        self._process.wait(60)
        self._remove_folder()
        return self._process.returncode

    def _remove_folder(self) -> None:
        """Remove the temporary folder; child processes that are still exiting may write into it meanwhile."""

        def removed() -> bool:
            shutil.rmtree(self._folder, ignore_errors=True)
            return not self._folder.exists()

        wait_for(removed, "its temporary files to be removed")

    def close(self) -> int:
        """Close the window and return the exit status."""
        if self._process.poll() is None:
            try:
                self.send_command("quit")
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
