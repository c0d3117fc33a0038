"""Virtual screen with a window manager and one program, driven by real key and mouse events."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

TOOLS = ("Xvfb", "openbox", "xdotool", "setxkbmap")
MISSING_TOOLS = tuple(tool for tool in TOOLS if shutil.which(tool) is None)

_REPOSITORY = Path(__file__).resolve().parents[2]
# By default Openbox binds Alt+Escape (it lowers the window). Here programs receive it, and Ctrl+Escape is bound
# instead.
_OPENBOX = """<?xml version="1.0" encoding="UTF-8"?>
<openbox_config xmlns="http://openbox.org/3.4/rc">
  <desktops><number>2</number><popupTime>0</popupTime></desktops>
  <focus><focusNew>yes</focusNew><followMouse>no</followMouse></focus>
  <keyboard>
    <keybind key="C-Escape"><action name="Lower"/></keybind>
    <keybind key="C-F11"><action name="Lower"/></keybind>
    <keybind key="A-F4"><action name="Close"/></keybind>
  </keyboard>
  <mouse><context name="Client"><mousebind button="Left" action="Press">
    <action name="Focus"/><action name="Raise"/></mousebind></context></mouse>
</openbox_config>
"""


class VirtualDesktop:
    """``python -m MODULE`` on a separate screen, with its output in ``lines()``."""

    def __init__(
        self,
        folder: Path,
        module: str,
        *arguments: str,
        size: str = "1400x900",
        environment: dict[str, str] | None = None,
    ) -> None:
        read_end, write_end = os.pipe()
        self._screen = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write_end), "-screen", "0", f"{size}x24"],
            pass_fds=(write_end,),
            stderr=subprocess.DEVNULL,
        )
        os.close(write_end)
        with os.fdopen(read_end) as pipe:
            number = pipe.readline().strip()
        self.environment = {
            **os.environ,
            **(environment or {}),
            "DISPLAY": f":{number}",
            "QT_QPA_PLATFORM": "xcb",
            "HOME": str(folder),
        }
        (folder / "rc.xml").write_text(_OPENBOX)
        self._manager = subprocess.Popen(
            ["openbox", "--config-file", str(folder / "rc.xml")], env=self.environment, stderr=subprocess.DEVNULL
        )
        self._output = (folder / "output").open("w+")
        self._subject = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-m", "tests.support.run_module", module, *arguments],
            env=self.environment,
            cwd=_REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=self._output,
            stderr=self._output,
            text=True,
        )

    def send_command(self, line: str) -> None:
        """Write a line to the program's stdin."""
        if self._subject.stdin is None:
            raise RuntimeError("the program has no stdin")
        self._subject.stdin.write(line + "\n")
        self._subject.stdin.flush()

    def lines(self) -> list[str]:
        """Complete lines of the output so far."""
        written = Path(self._output.name).read_text()
        return written[: written.rfind("\n") + 1].splitlines()

    def wait_for(self, line: str, *, after: int = 0, timeout_s: float = 20.0) -> int:
        """Index after the first such line from ``after`` on."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            for index, seen in enumerate(self.lines()[after:], start=after):
                if seen.startswith(line):
                    return index + 1
            if self._subject.poll() is not None:
                break
            time.sleep(0.01)
        seen = "\n".join(self.lines()[-60:])  # with the traceback, if it crashed
        raise AssertionError(f"timeout while waiting for {line!r}; last lines:\n{seen}")

    def do(self, *arguments: str) -> None:
        """Real key and mouse events, as xdotool commands."""
        subprocess.run(["xdotool", *arguments], env=self.environment, check=True, timeout=60, capture_output=True)

    def use_layout(self, layout: str) -> None:
        subprocess.run(["setxkbmap", layout], env=self.environment, check=True, timeout=20, capture_output=True)

    @contextmanager
    def busy_manager(self) -> Iterator[None]:
        """Stop the window manager: keys pressed while a window closes reach no window."""
        self._manager.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._manager.send_signal(signal.SIGCONT)

    def start_program(self, code: str) -> "subprocess.Popen[bytes]":
        return subprocess.Popen([sys.executable, "-c", code], env=self.environment, stderr=subprocess.DEVNULL)

    def close(self) -> None:
        for process in (self._subject, self._manager, self._screen):
            process.terminate()
            try:
                process.wait(timeout=15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._output.close()
