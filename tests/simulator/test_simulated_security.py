"""Secured link: wss with a certificate, and authentication of rosauth."""

import hashlib
import shutil
import ssl
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from tests.simulator.test_simulate_command import refused
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

SECRET = "sixteen--letters"


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl to make a certificate")
    folder = tmp_path_factory.mktemp("tls")
    paths = folder / "cert.pem", folder / "key.pem"
    subject = ("-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost")
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", *subject]
    subprocess.run([*command, "-out", str(paths[0]), "-keyout", str(paths[1])], check=True, capture_output=True)
    return paths


def introduction(secret: str, **changed: Any) -> dict[str, Any]:
    """Authentication message made as in rosauth's documentation, without code of the package."""
    now = int(time.time())
    fields = {"client": "127.0.0.1", "dest": "robot", "rand": "xyz", "t": now, "level": "user", "end": now + 3600}
    fields |= changed
    written = secret + "".join(str(fields[name]) for name in ("client", "dest", "rand", "t", "level", "end"))
    return {"op": "auth", "mac": hashlib.sha512(written.encode()).hexdigest(), **fields}


def test_wss_is_spoken_to_who_trusts_the_certificate(certificate: tuple[Path, Path]) -> None:
    cert, key = certificate
    with SimulatedRobot("--tls-cert", str(cert), "--tls-key", str(key)) as robot:
        assert robot.address.startswith("wss://127.0.0.1:")
        with RosbridgeClient(robot.address, tls=ssl.create_default_context(cafile=cert)) as client:
            assert "/scan" in client.call("/rosapi/topics")["topics"]
        with pytest.raises(ssl.SSLError):
            RosbridgeClient(robot.address, tls=ssl.create_default_context())


def test_only_who_knows_the_secret_is_let_in(monkeypatch: pytest.MonkeyPatch) -> None:
    with SimulatedRobot("--rosauth-secret-env", "ROBOT_SECRET", environment={"ROBOT_SECRET": SECRET}) as robot:
        with RosbridgeClient(robot.address) as client:
            client.send(**introduction(SECRET))
            assert "/scan" in client.call("/rosapi/topics")["topics"]
        for first in (
            {"op": "subscribe", "topic": "/scan"},
            {"op": "call_service", "service": "/rosapi/topics"},
            introduction("another--letters"),
            introduction(SECRET, t=int(time.time()) - 60),
            introduction(SECRET, end=int(time.time()) - 1),
            introduction(SECRET, t="now"),
            {**introduction(SECRET), "level": "admin"},
            {"op": "auth"},
        ):
            with RosbridgeClient(robot.address) as stranger:
                stranger.send(**first)
                wait_for(lambda stranger=stranger: stranger.closed, f"{first} is sent away")
                assert stranger.received == []


@pytest.mark.long
def test_an_impossible_security_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "belong together" in refused("--tls-cert", "cert.pem")
    (tmp_path / "cert.pem").write_text("no certificate")
    cert = str(tmp_path / "cert.pem")
    assert "cannot be used" in refused("--tls-cert", cert, "--tls-key", cert)
    monkeypatch.setenv("ROBOT_SECRET", "short")
    assert "16" in refused("--rosauth-secret-env", "ROBOT_SECRET")
    assert "--log" in refused("--log", str(tmp_path / "no" / "such" / "folder"))
    assert "omit --ros" in refused("--dress", "tiago", "--ros", "2")
