"""Robot on the real rclpy, the console's process that reaches it without rosbridge, and a real rosbridge server.

``CARIS_ROS2_PYTHON`` names a Python with rclpy, test_msgs and rosbridge-server-rs: ``packaging/ros2.sh --test`` makes
one. Tests are skipped without it.
"""

import json
import os
import random
import re
import socket
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.control_definitions import CallService, RobotControl, SendActionGoal
from caris_desktop.robot.profile import load_profile
from caris_desktop.robot.profile_model import (
    EmergencyStopInterface,
    RobotProfile,
    SpeechInterface,
    TopicSource,
    VelocityTopic,
)
from caris_desktop.robot.ros2_robot import PYTHON_VARIABLE
from tests.support.polling import wait_for

PYTHON = os.environ.get(PYTHON_VARIABLE, "")
_LIBRARIES = """
import glob, json, site, sys, sysconfig
print(json.dumps({
    "servers": glob.glob(f"{site.getsitepackages()[0]}/rosbridge_server_rs/rosbridge_server_rs_jazzy"),
    "folders": [f"{sys.prefix}/lib", *glob.glob(f"{site.getsitepackages()[0]}/ros_*.libs")],
    "rmw": glob.glob(f"{sys.prefix}/lib/**/librmw_fastrtps_cpp.so", recursive=True),
    "python": f"{sysconfig.get_config_var('LIBDIR')}/{sysconfig.get_config_var('INSTSONAME')}",
    "prefix": sys.prefix,
}))
"""
needs_rclpy = pytest.mark.skipif(not PYTHON, reason=f"{PYTHON_VARIABLE} names no Python with rclpy")


class NativeRobot:
    """``rclpy_robot.py`` in a domain of its own; of ``log`` each line is what it executed."""

    def __init__(self, folder: Path, *, domain: int | None = None) -> None:
        self.domain = random.randint(1, 100) if domain is None else domain  # noqa: S311 - no secret
        self.address = f"ros2:{self.domain}"
        self._log = folder / f"rclpy-{self.domain}.jsonl"
        self._position = 0
        self._lines: list[dict[str, Any]] = []
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        self._process = subprocess.Popen(
            [PYTHON, str(Path(__file__).with_name("rclpy_robot.py")), str(self._log)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={**environment, "ROS_DOMAIN_ID": str(self.domain)},
        )  # fmt: skip
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    @property
    def pid(self) -> int:
        return self._process.pid

    def profile(self) -> RobotProfile:
        profile = load_profile(self.address)
        fibonacci = "test_msgs/action/Fibonacci"
        return replace(
            profile, name="native", title="Native", cameras=(), navigation=None, tf=None, tf_static=None, pose=None,
            path=None, battery=None, initial_pose=None,
            velocity=VelocityTopic("/cmd_vel", timeout_s=None),
            scan=TopicSource("/scan"), odometry=TopicSource("/odom"), map=TopicSource("/map"),
            speech=SpeechInterface(topic="/tts"),
            emergency_stop=EmergencyStopInterface(service="/e_stop"),
            controls=(
                RobotControl("slow", "Slow", "button", CallService("/slow", "std_srvs/srv/Trigger", {})),
                RobotControl("goal", "Goal", "button", SendActionGoal("/spin", fibonacci, {"order": 1})),
                RobotControl("refused", "Refused", "button", SendActionGoal("/refuse", fibonacci, {"order": 1})),
                RobotControl("never", "Never", "button", SendActionGoal("/nobody", fibonacci, {"order": 1})),
            ),
        )  # fmt: skip

    def lines(self) -> list[dict[str, Any]]:
        """Everything that it executed so far."""
        if self._log.exists():
            with self._log.open("rb") as stream:
                stream.seek(self._position)
                for raw in stream:
                    if not raw.endswith(b"\n"):
                        break
                    self._position += len(raw)
                    self._lines.append(json.loads(raw))
        return self._lines

    @property
    def goals(self) -> int:
        """Goals that have not ended."""
        ends = [line["goal"] for line in self.lines() if "goal" in line]
        return ends.count("begun") - ends.count("cancelled")

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


class RustBridge:
    """rosbridge-server-rs for a robot's domain. Its wheel expects an installed ROS: its libraries are named here."""

    def __init__(self, folder: Path, domain: int) -> None:
        found = json.loads(subprocess.run([PYTHON, "-c", _LIBRARIES], capture_output=True, check=True).stdout)
        if not found["servers"]:
            pytest.skip(f"{PYTHON_VARIABLE} has no rosbridge-server-rs")
        (folder / "rmw").mkdir()
        (folder / "rmw/librmw_implementation.so").symlink_to(found["rmw"][0])
        self._server = Path(found["servers"][0])
        self._server.chmod(0o755)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port: int = free.getsockname()[1]
        self._settings = folder / "rosbridge.toml"
        self._settings.write_text(f'no_rosapi = true\naddress = "127.0.0.1"\nport = {self.port}\n')
        self._environment = {
            **os.environ, "ROS_DISTRO": "jazzy", "ROS_DOMAIN_ID": str(domain), "AMENT_PREFIX_PATH": found["prefix"],
            "LD_LIBRARY_PATH": os.pathsep.join([str(folder / "rmw"), *found["folders"]]), "LD_PRELOAD": found["python"],
        }  # fmt: skip
        self._log = (folder / "rosbridge.log").open("w")
        self.start()

    def start(self) -> None:
        """Start it, again after a kill."""
        command = [str(self._server), "--config", str(self._settings)]
        self._process = subprocess.Popen(command, env=self._environment, stdout=self._log, stderr=self._log)
        wait_for(self._listens, "rosbridge-server-rs", timeout_s=30.0)

    def _listens(self) -> bool:
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", self.port)) == 0

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        self.kill()
        self._log.close()


def bridges_below(pid: int) -> list[int]:
    """Processes of robot plug-ins of the links of this process, oldest first; the control link starts first."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
        children.setdefault(parent, []).append(int(folder.name))
    return [child for child in _below(pid, children) if re.search(r"bridge_server\.py|run_plugin", _command(child))]


def _below(pid: int, children: dict[int, list[int]]) -> Iterator[int]:
    for child in sorted(children.get(pid, ())):
        yield child
        yield from _below(child, children)


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text("utf-8", "replace")
    except OSError:
        return ""


def wait_for_bridge(pid: int) -> int:
    """First of :func:`bridges_below`, once it is there."""
    return wait_for(lambda: bridges_below(pid), "a bridge process", timeout_s=30.0)[0]
