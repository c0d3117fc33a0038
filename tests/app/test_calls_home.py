"""Libraries that run networks tell nobody, in any process: no name is looked up, and no id of this computer is kept.

The whole program under strace is in test_rehearsal.
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


def calls_of(code: str, home: Path) -> tuple[str, list[Path]]:
    """What a process with this code connects to, and the files it leaves in its home. Skips without strace."""
    if shutil.which("strace") is None:
        pytest.skip("needs strace to see whom a process calls")
    environment = {name: value for name, value in os.environ.items() if name not in SWITCHES}
    environment = {name: value for name, value in environment.items() if not name.startswith("XDG_")}
    trace = home.with_suffix(".trace")
    tracer = ["strace", "-f", "--seccomp-bpf", "-e", "trace=connect,sendto,sendmsg,sendmmsg", "-e", "signal=none"]
    home.mkdir()
    done = subprocess.run(
        [*tracer, "-o", trace, sys.executable, "-c", f"import importlib.util, sys\nfrom pathlib import Path\n{code}"],
        env=environment | {"HOME": str(home), "TMPDIR": str(home)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "strace:" in done.stderr:
        pytest.skip(f"strace may not trace here: {done.stderr}")
    assert done.returncode == 0, done.stderr
    return trace.read_text("utf-8", "replace"), [path for path in home.rglob("*") if path.is_file()]


@pytest.mark.parametrize("network", _NETWORKS)
def test_a_process_of_the_program_tells_nobody_what_it_runs(network: str, tmp_path: Path) -> None:
    calls, files = calls_of(f"import caris_desktop.app.bodies\n{_NETWORKS[network]}", tmp_path / "home")
    assert not re.findall(r".*AF_INET.*", calls)
    assert not [path for path in files if "onnxruntime" in str(path) or "Microsoft" in str(path)]


def test_without_the_switches_it_would(tmp_path: Path) -> None:
    """Else the test above could not fail."""
    _, files = calls_of(_NETWORKS["onnxruntime"], tmp_path / "home")
    assert [path for path in files if "deviceid" in path.name]
