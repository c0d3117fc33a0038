"""What only a desktop shows: activation, focus and physical keys, on a virtual screen with a window manager."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    any(shutil.which(tool) is None for tool in ("Xvfb", "openbox", "xdotool")),
    reason="needs Xvfb, openbox and xdotool",
)

_SUBJECT = """
import sys, time
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication, QWidget
from caris_desktop.ui.main_window import MainWindow
from tests.ui import samples
from tests.ui.fake_console import FakeConsole

app = QApplication([])
console = FakeConsole(samples.TOUR)
samples.fill_console(console)
console.calls.clear()
window = MainWindow(console)
window.resize(1200, 700)
window.show()
told = 0
field = window.findChild(QWidget, "speak_field")
state = {"ready": False, "text": ""}

def tell():
    global told
    if not state["ready"] and window.isActiveWindow():
        state["ready"] = True
        print("READY", flush=True)
    for name, arguments in console.calls[told:]:
        print(name, arguments, flush=True)
    told = len(console.calls)
    if field.text() != state["text"]:
        state["text"] = field.text()
        print("TEXT", state["text"], flush=True)

timer = QTimer(interval=5)
timer.timeout.connect(tell)
timer.start()
app.exec()
"""


_OTHER = """
from PySide6.QtWidgets import QApplication, QWidget

app = QApplication([])
window = QWidget()
window.show()
window.activateWindow()
app.exec()
"""


class Desktop:
    """A virtual screen with a window manager and the window on it."""

    def __init__(self, folder: Path) -> None:
        read_end, write_end = os.pipe()
        self._screen = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write_end), "-screen", "0", "1400x900x24"],
            pass_fds=(write_end,),
            stderr=subprocess.DEVNULL,
        )
        os.close(write_end)
        with os.fdopen(read_end) as pipe:
            number = pipe.readline().strip()
        self._environment = {**os.environ, "DISPLAY": f":{number}", "QT_QPA_PLATFORM": "xcb", "HOME": str(folder)}
        self._manager = subprocess.Popen(["openbox"], env=self._environment, stderr=subprocess.DEVNULL)
        self._output = (folder / "output").open("w+")
        self._subject = subprocess.Popen(
            [sys.executable, "-c", _SUBJECT],
            env=self._environment,
            cwd=Path(__file__).resolve().parents[2],
            stdout=self._output,
            stderr=self._output,
        )

    def lines(self) -> list[str]:
        return Path(self._output.name).read_text().splitlines()

    def wait_for(self, line: str, *, after: int = 0, timeout_s: float = 20.0) -> int:
        """Index of the first such line from ``after`` on."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            for index, seen in enumerate(self.lines()[after:], start=after):
                if seen.startswith(line):
                    return index
            time.sleep(0.02)
        seen = "\n".join(self.lines())
        raise AssertionError(f"waited in vain for {line!r}; seen:\n{seen}")

    def do(self, *arguments: str) -> None:
        subprocess.run(["xdotool", *arguments], env=self._environment, check=True, timeout=20, capture_output=True)

    def start_other_program(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-c", _OTHER], env=self._environment, stderr=subprocess.DEVNULL)

    def close(self) -> None:
        for process in (self._subject, self._manager, self._screen):
            process.terminate()
            process.wait(timeout=10)
        self._output.close()


@pytest.fixture
def desktop(tmp_path: Path) -> Iterator[Desktop]:
    desktop = Desktop(tmp_path)
    try:
        desktop.wait_for("READY", timeout_s=40.0)
        yield desktop
    finally:
        desktop.close()


def test_physical_keys_drive_stop_and_type(desktop: Desktop) -> None:
    desktop.do("keydown", "w")
    at = desktop.wait_for("drive (1.0, 0.0, 0.0, 'keyboard')")
    desktop.do("keydown", "a")
    at = desktop.wait_for("drive (1.0, 0.0, 1.0, 'keyboard')", after=at)
    desktop.do("keyup", "w", "keyup", "a")
    at = desktop.wait_for("release_drive", after=at)
    # Into the Speak field and out again: Alt goes up before W, and nothing of it is typed.
    desktop.do("key", "Return")
    desktop.do("type", "wads")
    at = desktop.wait_for("TEXT wads", after=at)
    desktop.do("keydown", "alt", "keydown", "w")
    at = desktop.wait_for("drive (1.0, 0.0, 0.0, 'keyboard')", after=at)
    desktop.do("keyup", "alt")
    desktop.do("sleep", "0.8")  # longer than the keyboard's repeat delay, so that repeats do come
    desktop.do("keyup", "w")
    at = desktop.wait_for("release_drive", after=at)
    desktop.do("type", "!")
    desktop.wait_for("TEXT wads!", after=at)
    desktop.do("key", "Escape")
    at = desktop.wait_for("stop", after=at)
    desktop.do("key", "Pause")
    desktop.wait_for("emergency_stop", after=at)
    assert not [line for line in desktop.lines() if "arning" in line or "rror" in line]


def test_a_held_phrase_key_says_its_phrase_once(desktop: Desktop) -> None:
    desktop.do("keydown", "F1", "sleep", "1.0", "keyup", "F1")
    desktop.do("key", "F2")
    desktop.wait_for("say ('Please follow me.', 'phrase')")
    assert sum(line.startswith("say ('Hello!") for line in desktop.lines()) == 1


def test_a_key_held_across_another_program_has_to_be_pressed_anew(desktop: Desktop) -> None:
    desktop.do("keydown", "w")
    at = desktop.wait_for("drive (1.0, 0.0, 0.0, 'keyboard')")
    other = desktop.start_other_program()
    at = desktop.wait_for("release_drive", after=at)
    other.terminate()
    other.wait(timeout=10)
    desktop.do("sleep", "0.8", "keyup", "w", "key", "Escape")
    stopped = desktop.wait_for("stop", after=at)
    assert not [line for line in desktop.lines()[at:stopped] if line.startswith("drive")]
    desktop.do("keydown", "w")
    at = desktop.wait_for("drive (1.0, 0.0, 0.0, 'keyboard')", after=stopped)
    desktop.do("keyup", "w")
    desktop.wait_for("release_drive", after=at)


def test_another_program_in_front_ends_driving(desktop: Desktop) -> None:
    desktop.do("keydown", "w")
    at = desktop.wait_for("drive (1.0, 0.0, 0.0, 'keyboard')")
    other = desktop.start_other_program()
    try:
        desktop.wait_for("release_drive", after=at)
    finally:
        desktop.do("keyup", "w")
        other.terminate()
        other.wait(timeout=10)
