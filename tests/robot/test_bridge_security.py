"""Secured links: server certificates, pinned fingerprints and client authentication, against third-party servers."""

import asyncio
import hashlib
import json
import logging
import pickle
import re
import ssl
import subprocess
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil
import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from caris_desktop.domain.events import LinkChanged, TrafficMeasured
from caris_desktop.domain.sensing import FrameRef, LaserScan, Odometry
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.robot.link import LinkSettings, run_control_link
from caris_desktop.robot.profile import load_profile
from caris_desktop.robot.profile_model import SecuritySettings
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from tests.robot.link_bench import LinkProcess
from tests.robot.test_media_link import run_with_ring
from tests.robot.test_transport import Observer, until
from tests.support.certificates import Authority, ServerFiles
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

SECRET = "sixteen_letters!"
SECRET_ENV = "CARIS_TEST_ROSAUTH"


class TellingObserver(Observer):
    """Observer that also records the reason of a failed connection."""

    def __init__(self) -> None:
        super().__init__()
        self.unreachable: list[tuple[str, str]] = []

    def link_unreachable(self, what: str, advice: str) -> None:
        super().link_unreachable(what, advice)
        self.unreachable.append((what, advice))


@dataclass
class Server:
    port: int = 0
    connections: int = 0
    authorized: int = 0
    operations: list[dict[str, Any]] = field(default_factory=list)


def rosauth_accepts(operation: dict[str, Any]) -> bool:
    """Decision of rosauth's ros_mac_authentication."""
    parts = [SECRET, *(str(operation[name]) for name in ("client", "dest", "rand", "t", "level", "end"))]
    return hashlib.sha512("".join(parts).encode()).hexdigest() == operation["mac"]


@asynccontextmanager
async def rosbridge(*, files: ServerFiles | None = None, demands_secret: bool = False) -> Any:
    """Server that answers every call with an empty message; ``demands_secret`` as with ``authenticate`` of
    rosbridge.
    """
    server = Server()

    async def handle(client: ServerConnection) -> None:
        server.connections += 1
        authorized = not demands_secret
        try:
            async for content in client:
                operation = json.loads(content)
                server.operations.append(operation)
                if not authorized:
                    authorized = operation["op"] == "auth" and rosauth_accepts(operation)
                    if not authorized:
                        await client.close()
                    else:
                        server.authorized += 1
                elif operation["op"] == "call_service":
                    answer = {"op": "service_response", "id": operation.get("id"), "values": {}, "result": True}
                    await client.send(json.dumps(answer))
                elif operation["op"] == "subscribe":
                    message = {"op": "publish", "topic": operation["topic"], "msg": {"data": "x" * 300_000}}
                    await client.send(json.dumps(message))
        except ConnectionClosed:
            pass

    context = None
    if files is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(files.certificate, files.key)
    async with serve(handle, "127.0.0.1", 0, ssl=context) as running:
        server.port = running.sockets[0].getsockname()[1]
        yield server


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("certificates"))


Use = Callable[[RosbridgeClient, TellingObserver, Server], Awaitable[None]]


def connect(
    use: Use,
    running: AbstractAsyncContextManager[Server],
    security: SecuritySettings,
    *,
    scheme: str = "wss",
    host: str = "127.0.0.1",
) -> None:
    async def run() -> None:
        async with running as server:
            observer = TellingObserver()
            ros = RosbridgeClient(f"{scheme}://{host}:{server.port}", observer, security=security)
            ros.connect()
            await use(ros, observer, server)
            await ros.aclose(1.0)

    asyncio.run(run())


async def is_told(observer: TellingObserver, *expected: str) -> None:
    what, advice = (await until(lambda: observer.unreachable, "a reason"))[0]
    for words in expected:
        assert words in f"{what} {advice}"
    assert "connected" not in observer.told


def trusting(authority: Authority) -> SecuritySettings:
    return SecuritySettings(ca_file=str(authority.file))


def test_a_server_whose_certificate_is_in_order_is_connected_and_messages_of_every_size_pass(
    authority: Authority,
) -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        messages: list[Any] = []
        await until(lambda: "connected" in observer.told, "connected")
        RosbridgeTopic(ros, "/a", "std_msgs/String").subscribe(messages.append)
        await until(lambda: messages, "the message")
        assert len(messages[0]["data"]) == 300_000
        RosbridgeTopic(ros, "/cmd_vel", "geometry_msgs/Twist").publish({"linear": {"x": 0.5}})
        await until(lambda: [op for op in server.operations if op["op"] == "publish"], "the command")
        assert await ros.ask("/any", "std_srvs/Empty") == {}
        assert ros.unsent_bytes == 0

    connect(use, rosbridge(files=authority.issue("127.0.0.1")), trusting(authority))


def test_a_server_by_name_is_checked_by_name(authority: Authority) -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await until(lambda: "connected" in observer.told, "connected")

    connect(use, rosbridge(files=authority.issue("localhost")), trusting(authority), host="localhost")


def test_a_certificate_that_nobody_known_signed_is_refused(authority: Authority) -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "is not trusted", "ca_file")
        assert server.operations == []

    connect(use, rosbridge(files=authority.issue("127.0.0.1")), SecuritySettings())


def test_a_certificate_that_has_expired_is_refused(authority: Authority) -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "has expired", "Renew it")

    connect(use, rosbridge(files=authority.issue("127.0.0.1", expired=True)), trusting(authority))


@pytest.mark.parametrize("issued_for", ["robot.example", "10.0.0.9"])
def test_a_certificate_for_another_host_is_refused(authority: Authority, issued_for: str) -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, f"for another name: {issued_for}")

    connect(use, rosbridge(files=authority.issue(issued_for)), trusting(authority))


KINDS: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"self_signed": True}, ("not trusted: it is self-signed",)),
    ({}, ("not trusted: this computer does not know its issuer",)),
    ({"self_signed": True, "expired": True}, ("self-signed", "has expired", "Renew it")),
    (
        {"expired": True, "host": "robot.example"},
        ("does not know its issuer", "has expired", "for another name: robot.example"),
    ),
    ({"self_signed": True, "early": True}, ("self-signed", "is not valid yet", "Check the date")),
    ({"self_signed": True, "named": False}, ("self-signed", "subjectAltName is missing")),
    ({"self_signed": True, "host": "10.0.0.9"}, ("self-signed", "for another name: 10.0.0.9")),
)


def issued(authority: Authority, kind: dict[str, Any]) -> ServerFiles:
    return authority.issue(**{"host": "127.0.0.1", **kind})


def fingerprint(files: ServerFiles) -> str:
    """Fingerprint read with openssl, as the guide explains."""
    command = ["openssl", "x509", "-in", files.certificate, "-noout", "-fingerprint", "-sha256"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip().partition("=")[2]


@pytest.mark.parametrize(("kind", "told"), KINDS)
def test_everything_that_is_wrong_with_a_certificate_is_reported_with_its_fingerprint(
    authority: Authority, kind: dict[str, Any], told: tuple[str, ...]
) -> None:
    files = issued(authority, kind)

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, *told, fingerprint(files))
        assert server.operations == []

    connect(use, rosbridge(files=files), SecuritySettings())


@pytest.mark.parametrize("kind", [kind for kind, _ in KINDS])
def test_a_confirmed_certificate_is_accepted_and_no_other(authority: Authority, kind: dict[str, Any]) -> None:
    files, other = issued(authority, kind), issued(authority, kind)

    async def let_in(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await until(lambda: "connected" in observer.told, "connected")
        assert await ros.ask("/any", "std_srvs/Empty") == {}

    async def not_let_in(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "is not the one that was confirmed")
        assert server.operations == []

    confirmed = SecuritySettings(certificate_sha256=fingerprint(files))
    connect(let_in, rosbridge(files=files), confirmed)
    connect(not_let_in, rosbridge(files=other), confirmed)
    # A certificate that the system trusts does not match either.
    trusted = replace(confirmed, ca_file=str(authority.file))
    connect(not_let_in, rosbridge(files=authority.issue("127.0.0.1")), trusted)


def test_a_fingerprint_that_is_none_is_named(authority: Authority) -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "not a SHA-256 fingerprint", "certificate_sha256")

    connect(use, rosbridge(files=authority.issue("127.0.0.1")), SecuritySettings(certificate_sha256="AB:CD"))


@pytest.mark.parametrize("self_signed", [True, False])
def test_a_certificate_that_the_profile_names_itself_is_trusted(authority: Authority, self_signed: bool) -> None:
    """Any signature, also without the extensions that Python 3.13 requires."""
    files = authority.issue("127.0.0.1", self_signed=self_signed)

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await until(lambda: "connected" in observer.told, "connected")

    connect(use, rosbridge(files=files), SecuritySettings(ca_file=str(files.certificate)))


def test_a_certificate_made_as_the_guide_says_is_accepted_here_and_by_the_strictest(tmp_path: Path) -> None:
    guide = (resources_dir() / "guide" / "robot-profiles.md").read_text("utf-8")
    (command,) = re.findall(r"^    (openssl req (?:.*\\\n)+.*)$", guide, re.MULTILINE)
    command = command.replace("robot2.lab.example", "localhost").replace("192.168.1.20", "127.0.0.1")
    subprocess.run(["sh", "-ec", command], cwd=tmp_path, capture_output=True, check=True)
    files = ServerFiles(tmp_path / "cert.pem", tmp_path / "key.pem")

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await until(lambda: "connected" in observer.told, "connected")
        strict = ssl.create_default_context(cafile=str(files.certificate))
        strict.verify_flags |= ssl.VERIFY_X509_STRICT
        _, writer = await asyncio.open_connection("localhost", server.port, ssl=strict)
        writer.close()
        with suppress(ssl.SSLError, OSError):
            await writer.wait_closed()

    for host in ("127.0.0.1", "localhost"):
        connect(use, rosbridge(files=files), SecuritySettings(ca_file=str(files.certificate)), host=host)


def test_a_server_without_tls_and_a_client_without_tls_are_distinguished(authority: Authority) -> None:
    async def plain_server(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "does not use TLS", "ws://")

    async def plain_client(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "is not a rosbridge server", "wss://")

    connect(plain_server, rosbridge(), trusting(authority))
    connect(plain_client, rosbridge(files=authority.issue("127.0.0.1")), SecuritySettings(), scheme="ws")


@pytest.mark.parametrize("content", [None, "no certificate"])
def test_a_file_of_certificates_that_cannot_be_used_is_named(tmp_path: Path, content: str | None) -> None:
    file = tmp_path / "trusted.pem"
    if content is not None:
        file.write_text(content)

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, str(file), "ca_file")

    connect(use, rosbridge(), SecuritySettings(ca_file=str(file)))


WITH_SECRET = SecuritySettings(rosauth_secret_env=SECRET_ENV)


def test_the_right_secret_is_accepted_again_after_each_reconnect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SECRET_ENV, SECRET)

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        RosbridgeTopic(ros, "/cmd_vel", "geometry_msgs/Twist").advertise()
        await until(lambda: "connected" in observer.told, "connected")
        await until(lambda: [op for op in server.operations if op["op"] == "advertise"], "advertised")
        assert server.operations[0]["op"] == "auth"
        protocol = ros.factory.protocol
        assert protocol is not None
        protocol.wire.abort("a broken network")
        await until(lambda: server.authorized == 2, "authorized again")
        await until(lambda: observer.told.count("connected") == 2, "connected again")

    connect(use, rosbridge(demands_secret=True), WITH_SECRET, scheme="ws")


def test_a_wrong_secret_is_refused_in_words_and_never_shown_as_connected(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(SECRET_ENV, "a wrong secret..")
    caplog.set_level(logging.DEBUG)

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, "refused this console", SECRET_ENV)
        await until(lambda: len(observer.unreachable) >= 2, "another attempt")
        assert "connected" not in observer.told
        assert server.connections <= 3

    connect(use, rosbridge(demands_secret=True), WITH_SECRET, scheme="ws")
    assert "a wrong secret.." not in caplog.text


def test_a_secret_that_is_not_set_is_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SECRET_ENV, raising=False)

    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        await is_told(observer, f"the environment variable {SECRET_ENV} is not set")

    connect(use, rosbridge(demands_secret=True), WITH_SECRET, scheme="ws")


def test_a_server_that_demands_a_secret_which_the_profile_does_not_name_is_explained_and_not_hammered() -> None:
    async def use(ros: RosbridgeClient, observer: TellingObserver, server: Server) -> None:
        RosbridgeTopic(ros, "/cmd_vel", "geometry_msgs/Twist").advertise()
        what, advice = (await until(lambda: observer.unreachable, "a reason"))[0]
        assert "closes every connection immediately" in what
        assert "rosauth_secret_env" in advice
        assert observer.told.count("connected") == 1

    connect(use, rosbridge(demands_secret=True), SecuritySettings(), scheme="ws")


def test_the_secret_is_not_in_what_a_link_process_is_started_with(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SECRET_ENV, SECRET)
    profile = replace(load_profile("simulated"), security=WITH_SECRET)
    settings = LinkSettings(profile, "ws://127.0.0.1:9090")
    assert SECRET.encode() not in pickle.dumps(settings)
    assert SECRET_ENV.encode() in pickle.dumps(settings)
    assert SECRET not in repr(settings)


def secured_control(connection: Connection, settings: LinkSettings, security: SecuritySettings) -> None:
    run_control_link(connection, replace(settings, profile=replace(settings.profile, security=security)))


def secured_media(connection: Connection, settings: LinkSettings, security: SecuritySettings, ring_name: str) -> None:
    run_with_ring(connection, replace(settings, profile=replace(settings.profile, security=security)), ring_name)


def test_both_links_drive_and_see_a_secured_robot_that_demands_a_secret(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SECRET_ENV, SECRET)
    files = authority.issue("127.0.0.1")
    security = SecuritySettings(ca_file=str(authority.file), rosauth_secret_env=SECRET_ENV)
    arguments = ["--tls-cert", str(files.certificate), "--tls-key", str(files.key), "--rosauth-secret-env", SECRET_ENV]
    ring = FrameRing.create()
    with SimulatedRobot(*arguments) as robot:
        assert robot.address.startswith("wss://")
        control = LinkProcess(robot.address, body=secured_control, extra=(security,))
        media = LinkProcess(robot.address, body=secured_media, extra=(security, ring.name))
        try:
            wait_for(lambda: control.of(LaserScan) and media.of(FrameRef), "scans and pictures")
            control.drive(0.0, 0.5)
            control.hold(lambda: control.of(Odometry)[-1].twist.turn_radps > 0.2, "the robot turns")
            # Each link measures its own traffic: CBOR, and the age of images.
            told = wait_for(
                lambda: [
                    topic
                    for event in media.of(TrafficMeasured)
                    for topic in event.topics
                    if topic.type == "sensor_msgs/CompressedImage" and topic.age_ms is not None
                ],
                "the age of pictures",
            )
            # Without the clock offset the age would be off by years; the wide range allows for a slow machine.
            assert -50.0 < told[-1].age_ms < 60_000.0  # type: ignore[operator]
            wait_for(lambda: control.of(TrafficMeasured), "the traffic of the control link")
            wait_for(lambda: control.of(TrafficMeasured)[-1].encoding == "both", "scans in CBOR, odometry in JSON")
            assert media.of(TrafficMeasured)[-1].encoding in ("cbor", "both")
            for process in (control.process, media.process):
                assert SECRET not in " ".join(psutil.Process(process.pid).cmdline())
            for value in [*control.values, *media.of(TrafficMeasured), *media.of(LinkChanged)]:
                assert SECRET not in repr(value)
        finally:
            control.close()
            media.close()
            ring.close()
