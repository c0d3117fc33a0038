"""Each process entry point with all features under strace: no name lookup, and no connection to another computer."""

import inspect
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from caris_desktop.app import process_entry_points
from caris_desktop.app.process_entry_points import EntryPoint
from tests.app.test_calls_home import SWITCHES
from tests.app.traced_body import Driven
from tests.conversation.sound_server import SoundServer
from tests.support.simulated_robot import SimulatedRobot

_ELSEWHERE = re.compile(
    r"AF_INET6?, sin6?_port=htons\((\d+)\).*?(?:inet_addr\(\"([^\"]+)\"|inet_pton\(AF_INET6, \"([^\"]+)\")"
)
_HERE = re.compile(r"127\..*|::1|::ffff:127\..*|0\.0\.0\.0|::")
_BODIES = {
    name
    for name, one in vars(process_entry_points).items()
    if isinstance(one, EntryPoint) or (inspect.isfunction(one) and one.__module__ == process_entry_points.__name__)
}
# Entry points that are started on demand.
_OTHERS = {"run_exports", "run_overview", "run_face_page"}
# Their libraries contain a remote address. The rehearsal under strace covers nearly all the others.
_IN_EVERY_RUN = {"recogniser", "language_model"}
_CASES = [
    pytest.param(name, marks=[] if name in _IN_EVERY_RUN else [pytest.mark.long]) for name in sorted(_BODIES | _OTHERS)
]


@pytest.fixture(scope="module")
def robot() -> Iterator[str]:
    with SimulatedRobot() as robot:
        yield robot.address


@pytest.fixture(scope="module")
def pulse(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Environment with a sound server; empty without PulseAudio."""
    if any(shutil.which(program) is None for program in ("pulseaudio", "pactl", "parec")):
        yield {}
        return
    server = SoundServer(tmp_path_factory.mktemp("sound"))
    yield {"PULSE_SERVER": server.address}
    server.kill()


def test_every_body_can_be_driven_here() -> None:
    """A new entry point needs a driver here, to check its connections."""
    drivers = {name for name, _ in inspect.getmembers(Driven, inspect.isfunction)} - {"__init__", "picture"}
    assert drivers == _BODIES | _OTHERS


def test_every_entry_point_names_a_function() -> None:
    for one in vars(process_entry_points).values():
        if isinstance(one, EntryPoint):
            assert inspect.isfunction(pkgutil.resolve_name(one.name))


@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", _CASES)
@pytest.mark.long("language_model", "recogniser")
def test_a_body_calls_nobody_outside(
    name: str, robot: str, pulse: dict[str, str], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if shutil.which("strace") is None:
        pytest.skip("needs strace to see whom a process calls")
    trace, home, place = tmp_path / "trace", tmp_path / "home", tmp_path / "place"
    home.mkdir()
    place.mkdir()
    kept = {one: value for one, value in os.environ.items() if one not in SWITCHES and not one.startswith("XDG_")}
    # onnxruntime connected to its vendor after 25 s.
    lives_s = "40" if request.config.getoption("--long") else "1"
    done = subprocess.run(
        [
            "strace", "-f", "--seccomp-bpf", "-e", "trace=connect,sendto,sendmsg,sendmmsg", "-e", "signal=none",
            "-s", "0", "-o", trace, sys.executable, "-m", "tests.app.traced_body", name, place, robot, lives_s,
        ],
        env={**kept, "HOME": str(home), "TMPDIR": str(place), **pulse}, cwd=Path(__file__).parents[2],
        capture_output=True, text=True, check=False, timeout=380,
    )  # fmt: skip
    if done.stderr.startswith("strace:"):
        pytest.skip(f"strace may not trace here: {done.stderr}")
    assert "it did its work" in done.stdout, done.stderr
    called = {(port, ipv4 or ipv6) for port, ipv4, ipv6 in _ELSEWHERE.findall(trace.read_text("utf-8", "replace"))}
    assert not {port for port, _ in called} & {"53", "853", "5353"}, "also a resolver on this computer is asked nothing"
    assert not {address for _, address in called if not _HERE.fullmatch(address)}
    told = [path for path in home.rglob("*") if "deviceid" in path.name or "Microsoft" in str(path)]
    assert not told
