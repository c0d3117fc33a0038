"""Command line: readiness, exit and refused arguments."""

import argparse
import http.client
import subprocess
import sys
import time
import urllib.parse
import urllib.request

import cv2
import numpy as np
import psutil
import pytest

from caris_desktop.simulator import simulate_command
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot


def refused(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "caris_desktop.simulator", *arguments],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    return done.stderr


@pytest.mark.long
def test_a_port_in_use_is_explained() -> None:
    with SimulatedRobot() as robot:
        text = refused("--port", str(robot.port))
        assert f"cannot listen on 127.0.0.1 port {robot.port}" in text
        assert "--port 0" in text
        assert "Traceback" not in text


@pytest.mark.long
def test_bad_arguments_are_explained() -> None:
    assert "--fault-latency-ms" in refused("--fault-latency-ms", "-5")
    assert "--ros" in refused("--ros", "3")
    assert "65535" in refused("--port", "99999")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--people", "21"], "between 1 and 20"),
        (["--people", "3", "--empty"], "one of them"),
        (["--visits", "nowhere.csv"], "nowhere.csv cannot be read"),
    ],
)
def test_visits_that_cannot_be_are_explained(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    simulate_command.add_arguments(parser)
    assert simulate_command.run(parser.parse_args(arguments)) == 2
    assert words in capsys.readouterr().err


@pytest.mark.long
def test_it_ends_when_asked_and_takes_its_camera_along() -> None:
    with SimulatedRobot() as robot:
        with RosbridgeClient(robot.address) as client:
            client.subscribe("/camera/image_raw/compressed")
            client.wait_for_messages("/camera/image_raw/compressed")
        children = psutil.Process(robot.pid).children(recursive=True)
        titles = [process.cmdline()[0] for process in (psutil.Process(robot.pid), *children)]
        assert titles[0] == "caris: simulated robot"
        assert "caris: simulated camera" in titles
        assert robot.terminate() == 0
        assert psutil.wait_procs(children, timeout=20)[1] == []


@pytest.mark.long
def test_a_kill_takes_its_camera_along() -> None:
    with SimulatedRobot() as robot:
        with RosbridgeClient(robot.address) as client:
            client.subscribe("/camera/image_raw/compressed")
            client.wait_for_messages("/camera/image_raw/compressed")
        children = psutil.Process(robot.pid).children(recursive=True)
        robot.kill()
        wait_for(lambda: not any(child.is_running() for child in children), "the camera process is gone")


@pytest.mark.long
def test_started_with_latency_it_has_latency() -> None:
    with SimulatedRobot("--fault-latency-ms", "150") as robot, RosbridgeClient(robot.address) as client:
        asked_s = time.monotonic()
        client.call("/simulator/state")
        assert time.monotonic() - asked_s >= 0.29, "once on the way there, once on the way back"
        robot.fault("clear")
        client.subscribe("/scan", queue_length=1)
        client.wait_for_messages("/scan", 3)


@pytest.mark.long
def test_it_ends_when_its_starter_is_gone() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "caris_desktop.simulator", "--port", "0", "--mute", "--end-with-stdin"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stdout is not None
    assert process.stdout.readline().startswith("Simulated robot ready")
    assert process.poll() is None
    process.stdin.close()
    assert process.wait(20) == 0
    process.stdout.close()


@pytest.mark.long
def test_the_camera_on_the_desk_sends_pictures_of_the_same_rooms() -> None:
    with SimulatedRobot("--desk-camera", "0") as robot:
        address = robot.next_line().removeprefix("Desk camera at ").strip()
        with urllib.request.urlopen(address, timeout=20) as pictures:  # noqa: S310 - address of this test
            assert pictures.headers.get_content_type() == "multipart/x-mixed-replace"
            for _ in range(2):
                assert pictures.readline() == b"--frame\r\n"
                head = http.client.parse_headers(pictures)
                jpeg = pictures.read(int(head["Content-Length"]))
                assert pictures.readline() == b"\r\n"
                shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
                assert shown is not None and shown.shape == (480, 640, 3)
        taken = urllib.parse.urlsplit(address).port
        assert f"port {taken}" in refused("--desk-camera", str(taken))
        assert robot.terminate() == 0
