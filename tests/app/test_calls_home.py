"""No telemetry of neural network libraries in any process: no name lookup, and no stored id of this computer.

test_rehearsal runs the whole program under strace.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SWITCHES = ("ORT_DISABLE_TELEMETRY", "HF_HUB_DISABLE_TELEMETRY", "HF_HUB_OFFLINE", "DO_NOT_TRACK")
_MODEL = "next(Path(importlib.util.find_spec({package!r}).origin).parent.rglob({pattern!r}))"
_NETWORKS = {
    "onnxruntime": "import onnxruntime\n"
    "model = " + _MODEL.format(package="faster_whisper", pattern="silero*.onnx") + "\n"
    "onnxruntime.InferenceSession(str(model))",
    "recogniser": "from faster_whisper.vad import get_speech_timestamps\nimport numpy\n"
    "get_speech_timestamps(numpy.zeros(16000, numpy.float32))",
    "voice": "import piper\nmodel = next(path for path in map(Path, sys.path) if any(path.rglob('*.onnx')))\n"
    "model = next(path for path in model.rglob('*.onnx') if Path(f'{path}.json').is_file())\n"
    "list(piper.PiperVoice.load(str(model)).synthesize('Hello.'))",
    "openvino": "import openvino\n"
    "model = " + _MODEL.format(package="faster_whisper", pattern="silero*.onnx") + "\n"
    "openvino.Core().read_model(str(model))",
}


# Libraries connect from background threads with a delay, which the test allows for.
_UNTIL_IT_CALLS = """
import os, time
began = time.monotonic()
while time.monotonic() - began < float(sys.argv[1]):
    kept = [path for path in Path.home().rglob("*") if "deviceid" in path.name]
    if kept or "AF_INET" in Path(sys.argv[2]).read_text("utf-8", "replace"):
        break
    time.sleep(0.1)
print("it took", time.monotonic() - began)
"""


def calls_of(code: str, home: Path, *, within_s: float) -> tuple[str, list[Path], float]:
    """Connections of a process with this code, files left in its home, and the time until then, at most ``within_s``.

    Skips without strace.
    """
    if shutil.which("strace") is None:
        pytest.skip("needs strace to see whom a process calls")
    environment = {name: value for name, value in os.environ.items() if name not in SWITCHES}
    environment = {name: value for name, value in environment.items() if not name.startswith("XDG_")}
    trace = home.with_suffix(".trace")
    tracer = ["strace", "-f", "--seccomp-bpf", "-e", "trace=connect,sendto,sendmsg,sendmmsg", "-e", "signal=none"]
    home.mkdir()
    done = subprocess.run(
        [
            *tracer, "-o", trace, sys.executable, "-c",
            f"import importlib.util, sys\nfrom pathlib import Path\n{code}\n{_UNTIL_IT_CALLS}",
            str(within_s), str(trace),
        ],
        env=environment | {"HOME": str(home), "TMPDIR": str(home)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "strace:" in done.stderr:
        pytest.skip(f"strace may not trace here: {done.stderr}")
    assert done.returncode == 0, done.stderr
    took_s = float(done.stdout.split("it took")[-1])
    return trace.read_text("utf-8", "replace"), [path for path in home.rglob("*") if path.is_file()], took_s


_TRIED_S = 30.0


@pytest.fixture(scope="module")
def calls_after_s(tmp_path_factory: pytest.TempPathFactory) -> float | None:
    """Time until onnxruntime connects to its vendor by default; None if it does not."""
    calls, files, took_s = calls_of(
        _NETWORKS["onnxruntime"], tmp_path_factory.mktemp("by itself") / "home", within_s=_TRIED_S
    )
    by_itself = "AF_INET" in calls or any("deviceid" in path.name for path in files)
    return took_s if by_itself else None


@pytest.mark.long  # test_rehearsal and test_bodies_call_nobody test the program itself
@pytest.mark.parametrize("network", _NETWORKS)
def test_no_process_of_the_program_reveals_what_it_runs(
    network: str, tmp_path: Path, calls_after_s: float | None
) -> None:
    """Observed for twice the time that it takes without the program's switches."""
    code = f"import caris_desktop.app.process_entry_points\n{_NETWORKS[network]}"
    calls, files, _ = calls_of(code, tmp_path / "home", within_s=2 * (calls_after_s or 0) + 1)
    assert not re.findall(r".*AF_INET.*", calls)
    assert not [path for path in files if "onnxruntime" in str(path) or "Microsoft" in str(path)]
    if calls_after_s is None:
        pytest.skip(
            f"nobody was called, which shows nothing here: this onnxruntime calls nobody without the switches either "
            f"({_TRIED_S:.0f} s)"
        )
