"""PulseAudio server of the tests, with one sink that is recorded."""

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.polling import wait_for

RATE_HZ = 22050


def require_pulseaudio() -> None:
    for program in ("pulseaudio", "pactl", "parec"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed (Debian: pulseaudio, pulseaudio-utils)")
    if not list(Path("/usr/lib").glob("**/alsa-lib/libasound_module_pcm_pulse.so")):
        pytest.skip("PortAudio cannot reach PulseAudio here (Debian: libasound2-plugins)")


class SoundServer:
    """PulseAudio with a continuously recorded null sink. Nothing outside ``folder`` is read or written.

    The recording also keeps the latency of the sink as low as that of real hardware: an idle null sink stalls for two
    seconds.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._environment = {
            "PATH": os.environ["PATH"],
            "HOME": str(folder),
            "XDG_RUNTIME_DIR": str(folder),
            "PULSE_SERVER": self.address,
            "LC_ALL": "C",
        }
        self._server: subprocess.Popen[bytes] | None = None
        self._recorder: subprocess.Popen[bytes] | None = None
        self._recording = folder / "heard.raw"
        self.start()

    @property
    def address(self) -> str:
        return f"unix:{self._folder}/native"

    def start(self) -> None:
        (self._folder / "native").unlink(missing_ok=True)
        modules = (f"module-native-protocol-unix socket={self._folder}/native", "module-null-sink sink_name=speaker")
        self._server = subprocess.Popen(
            ["pulseaudio", "--daemonize=no", "--exit-idle-time=-1", "-n", *(f"-L{module}" for module in modules)],
            env=self._environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait_for(self._answers, "PulseAudio answers")
        sound_format = ("--format=s16le", f"--rate={RATE_HZ}", "--channels=1")
        with self._recording.open("wb") as file:
            self._recorder = subprocess.Popen(
                ["parec", "--device=speaker.monitor", "--latency-msec=20", *sound_format],
                env=self._environment,
                stdout=file,
                stderr=subprocess.DEVNULL,
            )
        wait_for(lambda: self._recording.stat().st_size > 0, "the recording begins")

    def signal(self, number: signal.Signals) -> None:
        if self._server is not None:
            self._server.send_signal(number)

    def kill(self) -> None:
        for process in (self._server, self._recorder):
            if process is not None:
                process.send_signal(signal.SIGCONT)
                process.kill()
                process.wait()
        self._server = self._recorder = None

    def listen(self) -> "Listening":
        """Sound from now on."""
        return Listening(self._recording, skip_bytes=self._recording.stat().st_size // 2 * 2)

    @contextmanager
    def stamped(self) -> Iterator["StampedSound"]:
        """Sound while this is open, with the time of each sample."""
        words = ("parec", "--device=speaker.monitor", "--latency-msec=5", "--format=s16le", f"--rate={RATE_HZ}")
        with subprocess.Popen(
            [*words, "--channels=1"], env=self._environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as program:
            recording = StampedSound()
            thread = threading.Thread(target=recording.read, args=(program.stdout,))
            thread.start()
            wait_for(lambda: recording.length, "the sink is listened to")
            yield recording
            program.kill()
            thread.join()

    def _answers(self) -> bool:
        asked = subprocess.run(["pactl", "info"], env=self._environment, capture_output=True, timeout=10, check=False)
        return b"Default Sink: speaker" in asked.stdout


class StampedSound:
    """Sound of a sink with the arrival time of its samples; the fastest delivery gives the delay of the others."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.int16]] = []
        self.length = 0
        self._begun_ns = 2**63

    def read(self, stream: IO[bytes]) -> None:
        while part := os.read(stream.fileno(), 4096):
            now_ns = time.monotonic_ns()
            self._parts.append(np.frombuffer(part[: len(part) // 2 * 2], dtype="<i2"))
            self.length += len(part) // 2
            self._begun_ns = min(self._begun_ns, now_ns - self.length * 1_000_000_000 // RATE_HZ)

    def loud_between(self, from_ns: int, to_ns: int, *, least: int) -> tuple[int, int]:
        """Times of the first and the last sample of at least ``least``."""
        samples = np.concatenate(self._parts)
        first, last = (max(0, (at_ns - self._begun_ns) * RATE_HZ // 1_000_000_000) for at_ns in (from_ns, to_ns))
        loud = np.flatnonzero(np.abs(samples[first:last].astype(np.int32)) >= least) + first
        assert loud.size, "nothing was heard"
        ends = [int(self._begun_ns + number * 1_000_000_000 // RATE_HZ) for number in (loud[0], loud[-1])]
        return ends[0], ends[1]


class Listening:
    """Sound of a sink from some time on."""

    def __init__(self, path: Path, *, skip_bytes: int) -> None:
        self._path = path
        self._skip_bytes = skip_bytes

    def samples(self) -> NDArray[np.float64]:
        """All sound so far, -1..1, at ``RATE_HZ``."""
        raw = self._path.read_bytes()[self._skip_bytes :]
        return np.frombuffer(raw[: len(raw) // 2 * 2], dtype="<i2").astype(np.float64) / 32768.0

    def loud_span_s(self, *, from_s: float = 0.0) -> float:
        """Duration from the first to the last loud 20 ms window."""
        loud = np.flatnonzero(self._loudness(from_s) > 0.01)
        return 0.0 if loud.size == 0 else float(loud[-1] - loud[0] + 1) * 0.02

    def loud_total_s(self) -> float:
        return float(np.count_nonzero(self._loudness(0.0) > 0.01)) * 0.02

    @property
    def length_s(self) -> float:
        return (self._path.stat().st_size - self._skip_bytes) / 2 / RATE_HZ

    def _loudness(self, from_s: float) -> NDArray[np.float64]:
        window = RATE_HZ // 50
        samples = self.samples()[int(from_s * RATE_HZ) :]
        whole = samples[: samples.size // window * window].reshape(-1, window)
        return np.sqrt(np.mean(whole**2, axis=1)) if whole.size else np.zeros(0)
