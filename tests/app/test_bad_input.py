"""Faults around a session: each causes a clear message, the console continues, and no recorded data is lost."""

import hashlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from caris_desktop.recording.session.session_reader import open_session
from tests.recording.told_session import TRIAL, tell
from tests.support.console_process import ConsoleProcess, without_models
from tests.support.polling import wait_for
from tests.support.processes import alive
from tests.support.simulated_robot import SimulatedRobot
from tests.support.twist_listener import TwistListener

LAYOUTS = Path(__file__).parents[2] / "layouts"
HIDE_OFFLINE_DETECTOR = """
import importlib.metadata
found = importlib.metadata.distribution
def distribution(name):
    if "fall" in name:
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)
importlib.metadata.distribution = distribution
"""


@pytest.fixture
def robot() -> Iterator[SimulatedRobot]:
    with SimulatedRobot() as robot:
        yield robot


def _console(address: str, tmp_path: Path, *, with_models: bool = False, **environment: str) -> ConsoleProcess:
    return ConsoleProcess(address, tmp_path / "study", with_models=with_models, **environment)


def _command(*words: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "caris_desktop", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen", **(environment or {})},
    )


def _written_to(output: int, *words: str, **environment: str) -> tuple[int, str]:
    """Exit status and messages of a command whose output goes there."""
    ended = subprocess.run(
        [sys.executable, "-m", "caris_desktop", *words],
        stdout=output,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=60,
        env={**os.environ, **environment},
    )
    return ended.returncode, ended.stderr


def test_a_reader_that_has_enough_ends_a_command_quietly() -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        assert _written_to(write, "robots") == (141, "")
    finally:
        os.close(write)


def test_a_command_works_without_output_and_messages(tmp_path: Path) -> None:
    tell(tmp_path / "sessions" / "s", [], lasts_s=1.0)
    # A scheduler may start programs with these closed.
    words = [sys.executable, "-m", "caris_desktop", "statistics", str(tmp_path)]
    subprocess.run(["sh", "-c", '"$@" >&- 2>&-', "sh", *words], check=True, timeout=60)
    assert (tmp_path / "statistics" / "summary.csv").exists()


def test_output_that_cannot_be_written_is_reported() -> None:
    with Path("/dev/full").open("wb") as full:
        assert _written_to(full.fileno(), "robots") == (
            1,
            "The output could not be written: No space left on device.\n",
        )


def test_a_name_is_listed_on_a_terminal_without_its_letters(tmp_path: Path) -> None:
    tell(tmp_path / "sessions" / "s", [], lasts_s=1.0, trial={**TRIAL, "participant": "Zoë \U0001f600"})
    with (tmp_path / "listed").open("wb") as listed:
        assert _written_to(listed.fileno(), "sessions", str(tmp_path), PYTHONIOENCODING="ascii") == (0, "")
    assert "Zo\\xeb \\U0001f600" in (tmp_path / "listed").read_text("ascii")


def test_a_command_says_that_it_failed_unexpectedly(tmp_path: Path) -> None:
    # A failure of the interpreter stands for every fault of ours: its trace is in the log.
    (tmp_path / "duckdb.py").write_text("raise RuntimeError('broken')\n")
    tell(tmp_path / "sessions" / "s", [], lasts_s=1.0)
    status, told = _written_to(subprocess.DEVNULL, "statistics", str(tmp_path), PYTHONPATH=str(tmp_path))
    assert status == 1
    assert "failed unexpectedly (RuntimeError: broken)" in told
    assert "Traceback" not in told


def _problem(console: ConsoleProcess, words: str, *, timeout_s: float = 30.0) -> str:
    def found() -> str:
        return next((text for text in console.shown.get("problems", []) if words in text), "")

    return str(wait_for(found, f"a problem with '{words}'", timeout_s=timeout_s))


def _topics(folder: Path) -> list[str]:
    with (folder / "events.mcap").open("rb") as stream:
        return [channel.topic for _schema, channel, _message in make_reader(stream).iter_messages()]


def _ended_because(folder: Path) -> str:
    with (folder / "events.mcap").open("rb") as stream:
        messages = list(make_reader(stream).iter_messages(topics=["/event/session_ended"]))
    return str(json.loads(messages[-1][2].data)["reason"])


def _scenario_with_typo(folder: Path) -> Path:
    path = folder / "typo.yaml"
    text = (LAYOUTS / "tour-guide.yaml").read_text("utf-8")
    path.write_text(text.replace("\npermissions:", "\npermisions:"), "utf-8")
    return path


def test_a_command_line_that_cannot_be_followed_gets_one_clear_message(tmp_path: Path) -> None:
    typo = _scenario_with_typo(tmp_path)
    (tmp_path / "file").touch()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for words, expected in (
            (["--scenario", str(typo)], ["typo.yaml, line", "permisions", "Allowed", "'permissions'"]),
            (["--scenario", "nowhere"], ["nowhere", "tour-guide"]),
            (["--study", str(tmp_path / "file" / "study")], ["cannot be used", "Choose"]),
            (["fly"], ["no command 'fly'", "simulate"]),
            (["simulate", "--port", port], [port, "--port 0"]),
        ):
            result = _command(*words)
            assert result.returncode == 2, (words, result)
            assert "Traceback" not in result.stderr
            for part in expected:
                assert part in result.stderr, (words, result.stderr)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems always have a screen")
def test_without_a_screen_the_console_says_what_to_do() -> None:
    nothing = {"DISPLAY": "", "WAYLAND_DISPLAY": "", "QT_QPA_PLATFORM": ""}
    result = _command("--scenario", "tour-guide", environment=nothing)
    assert result.returncode == 2
    assert "No screen is available" in result.stderr and "rehearse" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.long
def test_problems_known_only_to_the_window_are_reported_there(tmp_path: Path) -> None:
    """A robot profile with a fault and a missing camera: the window opens and reports them."""
    profile = tmp_path / "robot.yaml"
    profile.write_text("version: 1\ntitel: Robot\n", "utf-8")
    console = _console(str(profile), tmp_path, CARIS_TEST_CAMERA=str(tmp_path / "no.mp4"))
    try:
        assert "titel" in _problem(console, "robot.yaml")
        assert "no.mp4" in _problem(console, "no.mp4")
        assert console.shown["drive_allowed"] is False
        assert console.close() == 0
    finally:
        console.kill()


@pytest.mark.long  # perception/test_inference tests the process alone
def test_a_missing_detector_costs_only_the_people(robot: SimulatedRobot, tmp_path: Path) -> None:
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "sitecustomize.py").write_text(HIDE_OFFLINE_DETECTOR, "utf-8")
    environment = {
        "PYTHONPATH": f"{tmp_path / 'hidden'}{os.pathsep}{Path(__file__).parents[2]}",
        "CARIS_MODELS_DIR": str(tmp_path / "models"),
        "XDG_DATA_HOME": str(tmp_path / "data"),
        "YOLO_OFFLINE": "1",
        "HTTPS_PROXY": "http://127.0.0.1:9",
    }
    console = _console(robot.address, tmp_path, **environment)
    try:
        checked = _command(
            "check", "--robot", robot.address, "--study", str(tmp_path / "study"), environment=environment
        )
        assert "FIX  Person detector" in checked.stdout
        assert checked.returncode == 1
        console.wait_until_shown(perception="failed")
        _problem(console, "No person detector")
        console.wait_until_shown(link="connected", drive_allowed=True, video="fresh", scan="fresh")
        console.send_command("record")
        console.wait_until_shown(recording="recording")
    finally:
        console.close()


@pytest.mark.long  # robot/test_link tests the link alone
def test_a_robot_that_is_not_there_yet_is_connected_when_it_comes(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    console = _console(f"ws://127.0.0.1:{port}", tmp_path)
    try:
        console.wait_until_shown(recording="idle", drive_allowed=False)
        _problem(console, str(port))
        said = [report["link"] for report in console.history]
        assert "connected" not in said
        with SimulatedRobot(port=port):
            console.wait_until_shown(link="connected", drive_allowed=True)
            about_the_robot = [text for text in console.shown["problems"] if str(port) in text]
            assert len(about_the_robot) == 1, "said once, not at each attempt"
            assert console.close() == 0
    finally:
        console.kill()


@pytest.mark.long  # robot/test_link tests the link alone
def test_malformed_messages_do_not_end_the_window(tmp_path: Path) -> None:
    connections = []
    recording = threading.Event()

    def nonsense(connection: ServerConnection) -> None:
        connections.append(connection)
        recording.wait(60.0)  # earlier messages are in no session
        try:
            for message in ("not json", "[1, 2", '{"op": "publish"}', b"\xff\x00\x01", "[]", '{"op": 7}'):
                connection.send(message)
            connection.send('{"op": "publish", "topic": "/scan", "msg": {"ranges": "many"}}')
            connection.send('{"op": "publish", "topic": "/scan", "msg": {"ranges": [' + "1.0," * 500_000 + "1.0]}}")
            for _message in connection:
                connection.send('{"op": "service_response", "id": 4}')
        except ConnectionClosed:
            pass

    with serve(nonsense, "127.0.0.1", 0, max_size=None) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        port = server.socket.getsockname()[1]
        console = _console(f"ws://127.0.0.1:{port}", tmp_path)
        try:
            console.wait_until_shown(recording="idle")
            console.send_command("record")
            said_before = len(console.wait_until_shown(recording="recording")["problems"])
            recording.set()
            wait_for(lambda: connections, "the console has connected")
            # On a busy machine the console may report an unclear robot and ask again before a link is tried.
            wait_for(
                lambda: len(console.shown["problems"]) > said_before and "control" in console.shown["children"],
                "it is said",
            )
            children = console.shown["children"]
            console.send_command("end_recording")
            folder = Path(console.wait_until_shown(recording="idle")["session"])
            assert console.shown["children"]["control"] == children["control"], "the link process lives"
            assert console.shown["scan"] == "none", "nothing of it is taken for a scan"
            assert "/event/problem" in _topics(folder)
            assert console.close() == 0
        finally:
            console.kill()
            server.shutdown()


@pytest.mark.long  # test_nothing_lost opens another scenario, too
def test_scenarios_switch_while_recording_and_a_broken_one_changes_nothing(
    robot: SimulatedRobot, tmp_path: Path
) -> None:
    console = _console(robot.address, tmp_path)
    others = tmp_path / "others"
    others.mkdir()
    try:
        console.wait_until_shown(link="connected", video="fresh")
        console.send_command("record")
        recording = console.wait_until_shown(recording="recording")
        folder, children = Path(recording["session"]), recording["children"]
        missing = recording["frames_missing"]
        assert missing is not None
        console.send_command("photo")
        wait_for(lambda: list(folder.glob("photos/*.png")), "a photo is kept")

        console.send_command(f"open {_scenario_with_typo(tmp_path)}")
        assert "typo.yaml, line" in _problem(console, "The scenario was not opened.")
        assert console.shown["scenario"] == "Tour guide"
        assert console.shown["recording"] == "recording"

        console.send_command(f"open {without_models(LAYOUTS / 'mental-health-check.yaml', others)}")
        console.wait_until_shown(scenario="Mental health check")
        console.send_command("photo")

        def video_bytes() -> int:
            return sum(path.stat().st_size for path in folder.glob("video-*.mp4"))

        def has_settled() -> bool:
            # Each report of the recorder follows all data received before; video grows several times in between.
            before, sizes = len(_topics_so_far(folder)), video_bytes()
            wait_for(lambda: len(_topics_so_far(folder)) > before + 200, "events go on being recorded")
            return video_bytes() == sizes

        wait_for(has_settled, "the video has ended", timeout_s=20)
        assert len(list(folder.glob("photos/*.png"))) == 1, "no photo where the scenario takes none"
        assert console.shown["link"] == "connected"
        assert "connecting" not in [report["link"] for report in console.history[console.history.index(recording) :]]

        ended_bytes = video_bytes()
        console.send_command(f"open {without_models(LAYOUTS / 'tour-guide.yaml', others)}")
        console.wait_until_shown(scenario="Tour guide")
        wait_for(lambda: video_bytes() > ended_bytes, "there is video again")
        console.send_command(f"open {without_models(LAYOUTS / 'reception.yaml', others)}")
        console.wait_until_shown(scenario="Reception")
        of_the_tour = video_bytes()
        wait_for(lambda: video_bytes() > of_the_tour, "there is video of it, too")
        for process in ("control", "recorder"):
            assert console.shown["children"][process] == children[process], "it is the same through all of it"
        assert console.shown["frames_missing"] == missing, "no frame was lost between scenarios"
        console.close()
        assert _ended_because(folder) == "console_closed"
        header = json.loads((folder / "session.json").read_text("utf-8"))
        first = tmp_path / "tour-guide.yaml"
        assert header["scenario"] == {"title": "Tour guide", "file": first.name, "sha256": _sha256(first)}
    finally:
        console.kill()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _topics_so_far(folder: Path) -> range:
    """Size of the file as a counter: it grows with each event, and reading all of it would be slow."""
    return range((folder / "events.mcap").stat().st_size // 100)


@pytest.mark.long
def test_a_killed_child_costs_only_its_part(robot: SimulatedRobot, tmp_path: Path) -> None:
    console = _console(robot.address, tmp_path, with_models=True)
    listener = TwistListener(robot.address)

    def kill(name: str) -> None:
        pid = wait_for(lambda: console.shown["children"].get(name), f"{name} runs")
        os.kill(pid, signal.SIGKILL)
        wait_for(
            lambda: console.shown["children"].get(name) not in (None, pid), f"{name} is started again", timeout_s=20
        )

    try:
        console.wait_until_shown(link="connected", drive_allowed=True, video="fresh", scan="fresh")
        console.send_command("record")
        first = Path(console.wait_until_shown(recording="recording")["session"])
        control = console.shown["children"]["control"]
        kill("media")
        console.wait_until_shown(video="fresh")
        assert console.shown["children"]["control"] == control, "the pictures do not take driving along"
        kill("speech")
        kill("language-model")
        kill("inference")
        assert console.shown["recording"] == "recording"

        console.send_command("press A")
        wait_for(lambda: [twist for twist in listener.seen if twist.moving], "the robot is driven")
        kill("control")
        wait_for(lambda: robot.state()["speed_radps"] == 0, "the robot stands still")
        seen = len(listener.seen)
        console.wait_until_shown(link="connected", drive_allowed=True)
        assert not [twist for twist in listener.seen[seen:] if twist.moving], "a key held from before does not drive"
        console.send_command("release A")
        console.send_command("press D")
        wait_for(lambda: [twist for twist in listener.seen[seen:] if twist.moving], "a new press drives")
        console.send_command("release D")

        kill("recorder")
        console.wait_until_shown(recording="failed")
        _problem(console, "The recorder stopped unexpectedly.")
        assert open_session(first), "what is on disk opens, torn end and all"
        console.send_command("record")
        second = Path(console.wait_until_shown(recording="recording")["session"])
        assert second != first
        pids = list(console.shown["children"].values())
        assert console.close() == 0
        assert _ended_because(second) == "console_closed"
        assert not alive(pids)
    finally:
        listener.close()
        console.kill()


@pytest.mark.long  # recording/recorder tests the recorder alone
def test_a_full_disk_ends_the_recording_and_nothing_else(robot: SimulatedRobot, tmp_path: Path) -> None:
    if (
        os.name != "posix"
        or subprocess.run(
            ["unshare", "--mount", "sh", "-c", "mount -t tmpfs none /mnt"], capture_output=True, check=False
        ).returncode
    ):
        pytest.skip("needs the right to mount a small disk of its own (root)")
    disk = tmp_path / "disk"
    disk.mkdir()
    result = subprocess.run(
        [
            *("unshare", "--mount", "--propagation", "private", "sh", "-ec"),
            'mount -t tmpfs -o size=300m none "$1"; '
            'exec "$2" -m tests.support.run_module tests.app.fill_disk "$1" "$3"',
            *("sh", str(disk), sys.executable, robot.address),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=90,
    )
    assert result.returncode == 0, result.stderr
    seen = json.loads(result.stdout.splitlines()[-1])
    assert any("disk is full" in text for text in seen["problems"])
    assert seen["link"] == "connected"
    assert seen["reason"] == "disk_full"
    assert seen["exported"]
    assert seen["closed_with"] == 0


def title_of(process: psutil.Process) -> str:
    try:
        return "".join(process.cmdline()[:1])
    except psutil.Error:  # it has just exited
        return ""


@pytest.mark.parametrize(
    "how",
    [*(pytest.param(each, marks=pytest.mark.long) for each in (signal.SIGTERM, signal.SIGINT)), signal.SIGKILL],
)
@pytest.mark.long("9")
def test_nothing_stays_behind_a_demonstration(how: signal.Signals, tmp_path: Path) -> None:
    program = subprocess.Popen(
        [sys.executable, "-m", "caris_desktop", "--demo", "--study", str(tmp_path / "study")],
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    children: list[psutil.Process] = []
    does = ("console", "driving and sensors", "pictures and maps", "people detection", "recording", "simulated robot")
    wanted = {f"caris: {what}" for what in does}

    def has_all() -> bool:
        children[:] = psutil.Process(program.pid).children(recursive=True)
        return len(children) >= 6 and wanted <= {title_of(child) for child in (psutil.Process(program.pid), *children)}

    try:
        wait_for(has_all, "the children run, each called after what it does", timeout_s=60)
        program.send_signal(how)
        _out, errors = program.communicate(timeout=30)
        assert program.returncode == (-9 if how is signal.SIGKILL else 0)
        wait_for(lambda: not alive([child.pid for child in children]), "all children have ended", timeout_s=20)
        if how is not signal.SIGKILL:
            assert "Traceback" not in errors
    finally:
        program.kill()
