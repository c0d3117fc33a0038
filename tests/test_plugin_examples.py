"""Example plug-ins: built as wheels, installed, listed, tested by their own tests, used, and absent without them."""

import contextlib
import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

from caris_desktop.app.plugin_contracts import record_sample
from caris_desktop.domain.sensing import CameraState, FrameRef
from tests.perception.cameras.running_camera import RunningCamera, has
from tests.support.plugins import ROOT, built_and_installed

EXAMPLES = sorted((ROOT / "examples" / "plugins").iterdir())
LISTED = (
    "nearest              caris-nearest-tracker 1.0",
    "blobs                caris-blob-detector 1.0",
    "phrases              caris-phrase-model 1.0",
    "talk                 caris-talk-exporter 1.0",
    "longest_silence_s    caris-silence-measure 1.0",
    "clock                caris-clock-camera 1.0",
    "morse                caris-morse-speech 1.0",
    "dot                  caris-dot-robot 1.0",
    "turn_timer           caris-turn-timer 1.0",
)
_SPEAK_AND_LISTEN = """
import numpy as np
from caris_desktop.conversation.listening.engines import PluginEngine
from caris_desktop.conversation.voices.voice_selection import PluginVoice
from caris_desktop.conversation.voices.utterance_sound import Stop

if __name__ == "__main__":
    voice = PluginVoice("plugin:morse", "en", rate=1.0, volume=1.0, on_failure=print)
    sound = np.concatenate(list(voice.parts("Hello world", Stop()))).astype(np.float32) / 32768
    found = PluginEngine("plugin:morse", "en").transcribe(sound, "", careful=True)
    print(*(word.text for word in found.words))
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> str:
    """PYTHONPATH with all examples."""
    return built_and_installed(tmp_path_factory.mktemp("examples"), *EXAMPLES)


def done(python_path: str, *words: object, status: int = 0) -> subprocess.CompletedProcess[str]:
    finished = subprocess.run(
        [sys.executable, *words],
        env={**os.environ, "PYTHONPATH": python_path}, capture_output=True, text=True, check=False, timeout=200,
    )  # fmt: skip
    assert finished.returncode == status, finished.stdout + finished.stderr
    return finished


@pytest.mark.timeout(300)
def test_all_are_listed_while_they_are_installed(path: str) -> None:
    listed = done(path, "-m", "caris_desktop", "plugins").stdout
    assert len(LISTED) == len(EXAMPLES)
    assert all(f"  ok   {line}" in listed for line in LISTED)
    without = done(str(ROOT), "-m", "caris_desktop", "plugins").stdout
    assert not any(line in without for line in LISTED)


@pytest.mark.timeout(300)
def test_each_passes_its_own_test_and_is_short(path: str, tmp_path: Path) -> None:
    done(path, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", tmp_path, *EXAMPLES)
    for example in EXAMPLES:
        (module,) = example.glob("caris_*.py")
        assert module.read_text("utf-8").count("\n") <= 60


@pytest.mark.timeout(300)
def test_the_measure_is_in_the_statistics(path: str, tmp_path: Path) -> None:
    for name in ("one", "two"):
        record_sample(tmp_path / "study" / "sessions" / name, talk=name == "one")

    def header_of(python_path: str) -> dict[str, str]:
        done(python_path, "-m", "caris_desktop", "statistics", tmp_path / "study", "--workers", "2")
        with (tmp_path / "study" / "statistics" / "measures.csv").open(encoding="utf-8", newline="") as file:
            return next(csv.DictReader(file))

    assert header_of(path)["longest_silence_s"] == "0.5"
    assert "longest_silence_s" not in header_of(str(ROOT))


@pytest.mark.timeout(300)
def test_the_exporter_writes_its_format(path: str, tmp_path: Path) -> None:
    record_sample(tmp_path / "one", talk=True)
    words = ("-m", "caris_desktop", "export", tmp_path / "one", "--to", "talk")
    done(path, *words, tmp_path / "out")
    lines = (tmp_path / "out" / "talk.txt").read_text("utf-8").splitlines()
    assert lines[0] == "one (participant P01, condition A, trial 1)"
    assert lines[2:] == [
        "   1 PAR: Where is the “café” & the exit?", "          (0.5)", "   2 ROB: On the ground floor.",
    ]  # fmt: skip
    assert "unknown format talk" in done(str(ROOT), *words, tmp_path / "removed", status=2).stderr


def test_the_voice_is_understood_by_the_recogniser(path: str, tmp_path: Path) -> None:
    (tmp_path / "use.py").write_text(_SPEAK_AND_LISTEN, "utf-8")
    assert done(path, tmp_path / "use.py").stdout == "hello world\n"


def test_the_camera_shows_pictures(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(path.partition(os.pathsep)[0])
    with contextlib.closing(RunningCamera("plugin:clock:30")) as camera:
        camera.until(has(FrameRef, 5), within_s=60.0)
        assert camera.of(CameraState)[-1].width_px == 640
