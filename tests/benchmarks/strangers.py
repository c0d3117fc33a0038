"""Half-open connections of attackers: continuity of recording, and access with the token.

``python -m tests.benchmarks.strangers`` as root: in a separate network namespace, with attackers from one address and
from 26 addresses, against the face page, the camera server and ``perceive``.
"""

import asyncio
import base64
import http.client
import json
import os
import resource
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from caris_desktop.conversation.face.page import PageOpened, run_face_page
from caris_desktop.domain import clock
from caris_desktop.domain.events import Marked
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.session.session_reader import open_session
from tests.app.traced_body import Body
from tests.perception.cameras.running_camera import write_video
from tests.recording.driving import RecorderUnderTest, start
from tests.support.certificates import Authority

ATTACKERS, OWNER = [f"10.9.0.{number}" for number in range(2, 28)], "10.9.0.1"
CONNECTIONS = 1300
HELD_S = 12.0
TOKEN = "a-token-of-enough-characters"


def asked(port: int, path: str, *, tls: bool) -> int:
    """Status of the owner's request, with the token or a secret path; raises without an answer."""
    if tls:
        context = ssl._create_unverified_context()  # noqa: S323 - the server's identity is not measured
        connection: http.client.HTTPConnection = http.client.HTTPSConnection(
            OWNER, port, timeout=3, source_address=(OWNER, 0), context=context
        )
    else:
        connection = http.client.HTTPConnection(OWNER, port, timeout=3, source_address=(OWNER, 0))
    head = {"Authorization": f"Bearer {TOKEN}", "Upgrade": "websocket", "Connection": "Upgrade",
            "Sec-WebSocket-Key": base64.b64encode(bytes(16)).decode(), "Sec-WebSocket-Version": "13"}  # fmt: skip
    try:
        connection.request("GET", path, headers=head)
        return connection.getresponse().status
    finally:
        connection.close()


async def attacked(port: int, sources: list[str], ask: Callable[[], int]) -> dict[str, object]:
    """Results of the owner while half-open connections are renewed as they are closed."""
    until, made, tries, first_s = time.monotonic() + HELD_S, 0, [0, 0], None

    async def hold(number: int) -> None:
        nonlocal made
        while time.monotonic() < until:
            try:
                reader, writer = await asyncio.open_connection(
                    OWNER, port, local_addr=(sources[number % len(sources)], 0)
                )
            except OSError:
                await asyncio.sleep(0.2)
                continue
            made += 1
            writer.write(b"GET / HT")
            try:
                async with asyncio.timeout(max(0.1, until - time.monotonic())):
                    await reader.read()
            except (TimeoutError, OSError):
                pass
            writer.close()
            await asyncio.sleep(0.2)

    holding = [asyncio.create_task(hold(number)) for number in range(CONNECTIONS)]
    await asyncio.sleep(1.0)
    began = time.monotonic()
    while time.monotonic() < until - 1.0:
        tries[0] += 1
        try:
            status = await asyncio.to_thread(ask)
        except (OSError, http.client.HTTPException):
            continue
        tries[1] += status in (101, 200)
        if status in (101, 200) and first_s is None:
            first_s = round(time.monotonic() - began, 2)
        await asyncio.sleep(0.2)
    await asyncio.gather(*holding)
    return {"connections": made, "asked": tries[0], "answered": tries[1], "first_after_s": first_s}


def measure(folder: Path) -> dict[str, object]:
    write_video(folder / "walk.mp4")
    files = Authority(folder).issue(OWNER, self_signed=True)
    environment = {**os.environ, "CAMERA_TOKEN": TOKEN, "CARIS_PERCEPTION_TOKEN": TOKEN}
    tls = ["--cert", str(files.certificate), "--key", str(files.key), "--host", "0.0.0.0", "--port", "0"]
    program = [sys.executable, "-m", "caris_desktop"]
    log = (folder / "servers.log").open("w+")
    page = Body(run_face_page, True)
    address = page.until(PageOpened).address
    servers = {"face page": (int(address.split(":")[2].split("/")[0]), f"/{address.split('/')[3]}/", False)}
    processes = []
    for name, words, path in (
        ("camera server", ["camera-server", "--source", folder / "walk.mp4", "--token-env", "CAMERA_TOKEN"], "/clock"),
        ("perceive", ["perceive", "--serve"], "/"),
    ):
        process = subprocess.Popen(
            [*program, *map(str, words), *tls], env=environment, stdout=subprocess.PIPE, stderr=log, text=True
        )
        processes.append(process)
        assert process.stdout is not None
        line = process.stdout.readline()
        port = int("".join(c for c in line.split("s://")[1].split(":")[1][:5] if c.isdigit()))
        servers[name] = (port, path, True)
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring)
    recorder.send(start(folder / "session"))
    found: dict[str, object] = {}
    marks = 0
    for name, (port, path, encrypted) in servers.items():
        for kind, sources in (("one address", ATTACKERS[:1]), ("26 addresses", ATTACKERS)):
            for _ in range(20):
                ring.write(np.zeros((480, 640, 3), np.uint8), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="a")
                recorder.send(Marked(clock.now_ns(), f"mark {marks}"))
                marks += 1
            found[f"{name}, {kind}"] = asyncio.run(
                attacked(port, sources, lambda p=port, at=path, tls=encrypted: asked(p, at, tls=tls))  # type: ignore[misc]
            )
            recorder.send(Marked(clock.now_ns(), f"mark {marks}"))
            marks += 1
    recorder.stop_session()
    recorder.close()
    page.end()
    for process in processes:
        process.terminate()
        process.wait()
    session = open_session(folder / "session")
    recorded = sum(1 for _ in session.values("event/marked"))
    found["recorded"] = f"{recorded} of {marks} values, closed properly: {session.closed_properly}"
    found["log_bytes"] = log.tell() + sum(path.stat().st_size for path in folder.rglob("*.log"))
    ring.close()
    return found


if __name__ == "__main__":
    if os.environ.get("OWN_NETWORK") != "yes":
        own = ["unshare", "--net", sys.executable, "-m", "tests.benchmarks.strangers"]
        sys.exit(subprocess.run(own, env={**os.environ, "OWN_NETWORK": "yes"}, check=False).returncode)
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    for address in (OWNER, *ATTACKERS):
        subprocess.run(["ip", "address", "add", f"{address}/24", "dev", "lo"], check=True)
    resource.setrlimit(resource.RLIMIT_NOFILE, (20_000, 20_000))
    with tempfile.TemporaryDirectory() as temporary:
        print(json.dumps(measure(Path(temporary)), indent=1))
