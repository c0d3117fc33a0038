"""Builds each image's file system with the steps of Containerfile, and runs its services as compose.yaml says.

    python packaging/containers/test.py [--built] [--folder DIR]... BASE [SERVICE]...

It needs no container engine: BASE is a bare Debian 13 (debootstrap), of which each target gets a copy next to it. A
service runs in namespaces of its own, as the user, with the read-only root, the file systems in memory, the secrets,
the environment and the command of compose.yaml, without a network but its own computer's. It starts, its health check
passes, it answers a request of this program, and it stops. Needs root, some 6 GB, and this program with its test tools.
--built: use the systems of an earlier run. --folder: folder of packages that pip reads.
"""

import argparse
import asyncio
import contextlib
import fnmatch
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
sys.path.insert(0, str(REPOSITORY))
PATHS = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
PASSED_ON = r"PIP_|SSL_CERT|REQUESTS_CA_BUNDLE|(https?|no)_proxy"
SHARED_MEMORY = "/dev/shm:size=64m,mode=1777"  # noqa: S108 - as engines give it
OWNER = 1000
HEALTHY_WITHIN_S = 300.0
STOPS_WITHIN_S = 10.0


@dataclass
class Image:
    """Instructions of one target."""

    run: list[str] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)
    arguments: dict[str, str] = field(default_factory=dict)
    entrypoint: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)

    def following(self) -> "Image":
        return Image(list(self.run), dict(self.environment), {}, list(self.entrypoint), list(self.command))


def read_containerfile() -> dict[str, Image]:
    images: dict[str, Image] = {}
    image = Image()
    text = re.sub(r"\\\n\s*", " ", (HERE / "Containerfile").read_text("utf-8"))
    for instruction, rest in re.findall(r"^([A-Z]+) (.*)$", text, re.MULTILINE):
        match instruction:
            case "FROM":
                base, _, name = rest.split()
                image = images[name] = images[base].following() if base in images else Image()
            case "ENV" | "ARG":
                values = image.environment if instruction == "ENV" else image.arguments
                values.update(pair.split("=", 1) for pair in shlex.split(rest))
            case "RUN":
                image.run.append(re.sub(r"--mount=\S+ ", "", rest))
            case "ENTRYPOINT":
                image.entrypoint = json.loads(rest)
            case "CMD":
                image.command = json.loads(rest)
    return images


def read_compose(**variables: str) -> dict[str, Any]:
    def value(found: re.Match[str]) -> str:
        return variables.get(found[1], found[2] or "")

    text = re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", value, (HERE / "compose.yaml").read_text("utf-8"))
    content: dict[str, Any] = yaml.safe_load(text)
    return content


# --- images -----------------------------------------------------------------------------------------------------------


def copy_context(folder: Path) -> None:
    """Copy what an engine would give to the build: the files that Containerfile.dockerignore leaves."""
    rules = (HERE / "Containerfile.dockerignore").read_text("utf-8").split()
    tops = {rule[1:].split("/")[0] for rule in rules if rule.startswith("!")}

    def given(path: str) -> bool:
        parts = path.split("/")
        names = ["/".join(parts[:count]) for count in range(1, len(parts) + 1)]
        answer = True
        for rule in rules:
            pattern = rule.removeprefix("!").removeprefix("**/")
            tried = parts if "**/" in rule else names
            if any(fnmatch.fnmatchcase(name, pattern) for name in tried):
                answer = rule.startswith("!")
        return answer

    for top in sorted(tops):
        found = [REPOSITORY / top] if (REPOSITORY / top).is_file() else sorted((REPOSITORY / top).rglob("*"))
        found += sorted(REPOSITORY.glob(top)) if "*" in top else []
        for path in found:
            name = path.relative_to(REPOSITORY).as_posix()
            if path.is_file() and given(name):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, folder / name)


def build(base: Path, target: str, image: Image, context: Path, folders: list[Path]) -> Path:
    root = base.parent / target
    subprocess.run(["rm", "-rf", "--one-file-system", root], check=True)
    subprocess.run(["cp", "-a", base, root], check=True)
    lines = [f"mount --bind {root} {root}", f"mount -t proc proc {root}/proc", f"mount --rbind /dev {root}/dev"]
    for source, at in [(context, root / "src"), *((folder, root / folder.relative_to("/")) for folder in folders)]:
        lines += [f"mkdir -p {at}", f"mount --bind -o ro {source} {at}"]
    settings = [f"{name}={value}" for name, value in os.environ.items() if re.match(PASSED_ON, name, re.IGNORECASE)]
    values = [f"{name}={value}" for name, value in (image.environment | image.arguments).items()]
    for step in image.run:
        command = [
            "chroot",
            str(root),
            "env",
            "-i",
            f"PATH={PATHS}",
            *settings,
            *values,
            "bash",
            "-euo",
            "pipefail",
            "-c",
            step,
        ]
        script = "\n".join(["set -eu", *lines, shlex.join(command)])
        with (base.parent / f"{target}.log").open("w") as log:
            unshared = ["unshare", "--mount", "--propagation", "private", "bash", "-c", script]
            if subprocess.run(unshared, stdout=log, stderr=log, check=False).returncode:
                sys.exit(f"{target} is not built; the end of {log.name}:\n{Path(log.name).read_text()[-2000:]}")
    return root


# --- containers -------------------------------------------------------------------------------------------------------


class Container:
    """A service in namespaces of its own, until ``stop`` or ``close``."""

    def __init__(self, name: str, service: dict[str, Any], secrets: dict[str, Any], image: Image, root: Path) -> None:
        self.name = name
        user, _, group = service["user"].partition(":")
        groups = "44" if "video" in service.get("group_add", ()) else ""
        environment = {"PATH": PATHS} | image.environment | service.get("environment", {})
        self._as_user = [
            *("setpriv", "--reuid", user, "--regid", group, *(["--groups", groups] if groups else ["--clear-groups"])),
            *(["--no-new-privs"] if "no-new-privileges:true" in service["security_opt"] else []),
            *(["--bounding-set=-all", "--inh-caps=-all"] if service["cap_drop"] == ["ALL"] else []),
            *("env", "-i", *(f"{variable}={value}" for variable, value in environment.items())),
        ]
        kind, *self._health = service["healthcheck"]["test"]
        assert kind == "CMD"
        command = image.entrypoint + [str(word) for word in service.get("command", image.command)]
        lines = ["set -eu", *self._mounts(root, service, secrets)]
        lines.append(shlex.join(["exec", "chroot", str(root), *self._as_user, *command]))
        self._log = root.parent / f"{name}.output"
        own = ["--mount", "--propagation", "private", "--pid", "--ipc", "--uts", "--fork", "--kill-child=KILL"]
        with self._log.open("w") as log:
            self._parent = subprocess.Popen(
                ["unshare", *own, "bash", "-c", "\n".join(lines)], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    @staticmethod
    def _mounts(root: Path, service: dict[str, Any], secrets: dict[str, Any]) -> Iterator[str]:
        bound = [(secrets[name]["file"], f"/run/secrets/{name}", True) for name in service["secrets"]]
        bound += [(device, device, False) for device in service.get("devices", ())]
        bound += [(each["source"], each["target"], bool(each.get("read_only"))) for each in service.get("volumes", ())]
        yield f"mount --bind {root} {root}"
        for source, target, _ in bound:
            at = root / target.lstrip("/")
            at.parent.mkdir(parents=True, exist_ok=True)
            if Path(source).is_dir():
                at.mkdir(exist_ok=True)
            else:
                at.touch()
        for name in ("null", "zero", "full", "random", "urandom"):
            (root / "dev" / name).touch()
        (root / "etc" / "hosts").write_text("127.0.0.1 localhost scheduler\n")
        if service["read_only"]:
            yield f"mount -o remount,bind,ro {root}"
        yield f"mount -t proc proc {root}/proc"
        for name in ("null", "zero", "full", "random", "urandom"):
            yield f"mount --bind /dev/{name} {root}/dev/{name}"
        for entry in (SHARED_MEMORY, *service["tmpfs"]):
            path, _, options = entry.partition(":")
            yield f"mount -t tmpfs -o {options},nosuid,nodev tmpfs {root}{path}"
        for source, target, read_only in bound:
            # In a file system in memory, where there is nothing yet.
            at = shlex.quote(f"{root}{target}")
            make = "mkdir" if Path(source).is_dir() else "touch"
            yield f'[ -e {at} ] || {{ mkdir -p "$(dirname {at})"; {make} {at}; }}'
            yield shlex.join(["mount", "--bind", *(["-o", "ro"] if read_only else []), source, f"{root}{target}"])

    @property
    def process(self) -> int:
        """Its first process; 0 if it has ended."""
        with contextlib.suppress(OSError):
            return int(Path(f"/proc/{self._parent.pid}/task/{self._parent.pid}/children").read_text() or 0)
        return 0

    def execute(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run a command in it, as its user."""
        namespaces = ["nsenter", "--target", str(self.process), "--mount", "--pid", "--ipc", "--root", "--wd=/"]
        return subprocess.run([*namespaces, *self._as_user, *command], capture_output=True, text=True, check=False)

    def wait_until_healthy(self) -> float:
        started = time.monotonic()
        while True:
            result = self.execute(*self._health)
            waited_s = time.monotonic() - started
            if result.returncode == 0:
                return waited_s
            if self._parent.poll() is not None or waited_s > HEALTHY_WITHIN_S:
                sys.exit(f"{self.name} is not healthy: {result.stdout}{result.stderr}\n{self.log()}")
            time.sleep(1.0)

    def confinement(self) -> str:
        """What holds it; ends the test where something does not."""
        status = dict(line.split(":\t", 1) for line in Path(f"/proc/{self.process}/status").read_text().splitlines())
        held = {name: status[name].split()[0] for name in ("Uid", "NoNewPrivs", "CapEff", "CapBnd")}
        if held != {"Uid": str(OWNER), "NoNewPrivs": "1", "CapEff": "0" * 16, "CapBnd": "0" * 16}:
            sys.exit(f"{self.name} is not confined: {held}")
        for place in ("/", "/opt/caris", "/etc", "/run", "/run/secrets"):
            if self.execute("touch", f"{place}/written").returncode == 0:
                sys.exit(f"{self.name} can write to {place}")
        return f"user {held['Uid']}, no capabilities, no new privileges, read-only root"

    def stop(self) -> float:
        started = time.monotonic()
        os.kill(self.process, signal.SIGTERM)
        try:
            status = self._parent.wait(STOPS_WITHIN_S)
        except subprocess.TimeoutExpired:
            sys.exit(f"{self.name} does not stop by SIGTERM\n{self.log()}")
        if status:
            sys.exit(f"{self.name} ends with status {status}\n{self.log()}")
        return time.monotonic() - started

    def log(self) -> str:
        return self._log.read_text("utf-8", "replace")[-3000:]

    def close(self) -> None:
        self._parent.kill()
        self._parent.wait()


# --- requests ---------------------------------------------------------------------------------------------------------


def request_perceive(folder: Path) -> str:
    from caris_desktop.perception.backends.remote_detector import SERVER_VARIABLE, TOKEN_VARIABLE, RemoteDetector
    from tests.perception.shared_data import bus_picture

    os.environ |= {SERVER_VARIABLE: "wss://127.0.0.1:8768", TOKEN_VARIABLE: (folder / "token").read_text().strip()}
    detector = RemoteDetector("wss://127.0.0.1:8768", confidence=0.25)
    people = [row for row in detector.detect(bus_picture()).classes if row in detector.people]
    detector.close()
    assert len(people) >= 2, people
    return f"{len(people)} people found by {detector.label}"


def request_camera(folder: Path) -> str:
    from caris_desktop.perception.cameras.camera_process import open_camera
    from caris_desktop.perception.cameras.camera_source import parse_camera

    os.environ["CAMERA_TOKEN"] = (folder / "token").read_text().strip()
    address = "https://127.0.0.1:8090/video.mjpg#token-env=CAMERA_TOKEN"
    with contextlib.closing(open_camera(parse_camera(address))) as camera:
        picture = camera.read()
    assert picture is not None and picture.taken_ns is not None
    return f"a picture of {picture.image.shape[1]} x {picture.image.shape[0]} px with its time"


def request_simulator(_folder: Path) -> str:
    from websockets.sync.client import connect

    with connect("ws://127.0.0.1:9090") as bridge:
        for operation in (
            {"op": "subscribe", "topic": "/odom", "type": "nav_msgs/Odometry"},
            {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"},
        ):
            bridge.send(json.dumps(operation))
        positions = []
        for _ in range(30):
            bridge.send(
                json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 0.3}, "angular": {}}})
            )
            positions.append(json.loads(bridge.recv(10))["msg"]["pose"]["pose"]["position"])
    first, last = positions[0], positions[-1]
    moved_m = ((last["x"] - first["x"]) ** 2 + (last["y"] - first["y"]) ** 2) ** 0.5
    assert moved_m > 0.05, moved_m
    return f"the robot drove {moved_m:.2f} m"


def request_models(folder: Path) -> str:
    from caris_desktop.conversation.models.chat import stream_chat
    from caris_desktop.conversation.models.endpoint import resolve_endpoint
    from caris_desktop.domain.events import ChatMessage

    key = (folder / "token").read_text().strip()
    os.environ |= {"OPENAI_BASE_URL": "https://127.0.0.1:8080/v1", "OPENAI_API_KEY": key}

    async def answer() -> str:
        endpoint = resolve_endpoint("openai:SmolLM2-135M-Instruct", embedded_url=None)
        question = [ChatMessage("user", "Say hello to a visitor.")]
        pieces = stream_chat(endpoint, question, local_only=True, max_tokens=20, temperature=0.0)
        return "".join([piece async for piece in pieces])

    answered = asyncio.run(answer())
    assert answered.strip()
    return f"the model answered {answered!r}"


def request_worker(folder: Path) -> str:
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    certificate = {f"{tls}CLIENT__CERT": f"{folder}/cert.pem", f"{tls}CLIENT__KEY": f"{folder}/key.pem"}
    environment = os.environ | {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": f"{folder}/cert.pem"} | certificate
    command = [
        sys.executable,
        "-m",
        "caris_desktop",
        "perceive-again",
        f"{folder}/study",
        "--scheduler",
        "tls://127.0.0.1:8786",
    ]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    layers = list((folder / "study").glob("sessions/*/derived/*/people.mcap"))
    assert done.returncode == 0 and layers and layers[0].stat().st_uid == OWNER, done.stdout + done.stderr
    return f"perceive-again on the cluster: {done.stdout.strip().splitlines()[-1]}"


REQUESTS: dict[str, Callable[[Path], str]] = {
    "perceive": request_perceive,
    "camera-server": request_camera,
    "simulator": request_simulator,
    "models": request_models,
    "worker": request_worker,
}
"""By service; the scheduler runs with the worker."""


def prepare(folder: Path) -> None:
    """Make what a user has: secrets, a camera (a video) and a study."""
    import cv2
    import numpy as np

    from tests.perception.shared_data import bus_picture
    from tests.support import recorded_session

    names = "subjectAltName=DNS:localhost,IP:127.0.0.1"
    make = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "825", "-subj", "/CN=localhost"]
    make += ["-addext", names, "-addext", "keyUsage=critical,digitalSignature,keyCertSign"]
    make += ["-keyout", f"{folder}/key.pem", "-out", f"{folder}/cert.pem"]
    subprocess.run(make, capture_output=True, check=True)
    (folder / "token").write_text("7f0b8f2d9c1e4a6b8d3f5c7e9a1b2d4f\n")
    (folder / "models").mkdir()
    photo = np.asarray(cv2.resize(bus_picture()[350:950], (640, 480)), np.uint8)
    recorded_session.picture_of = lambda *_: photo
    session = folder / "study" / "sessions" / "one"
    recorded_session.make_session(session, seconds=1.0, fps=10.0, cameras=("front",), size_px=(640, 480))
    shutil.copy(next(session.rglob("*.mp4")), folder / "camera.mp4")
    for path in [folder, *folder.rglob("*")]:
        os.chown(path, OWNER, OWNER)
        path.chmod(0o700 if path.is_dir() else 0o600)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("base", type=Path)
    parser.add_argument("--built", action="store_true")
    parser.add_argument("--folder", type=Path, action="append", default=[])
    parser.add_argument("services", nargs="*", metavar="SERVICE")
    arguments = parser.parse_args()
    base, services = arguments.base.resolve(), arguments.services or list(REQUESTS)
    images = read_containerfile()
    if not arguments.built:
        with tempfile.TemporaryDirectory(dir=base.parent) as context:
            copy_context(Path(context))
            for name in services:
                started = time.monotonic()
                build(base, name, images[name], Path(context), arguments.folder)
                print(f"{name}: built in {time.monotonic() - started:.0f} s", flush=True)
        # Without a network, but with this computer's own addresses.
        own = [sys.executable, __file__, "--built", str(base), *services]
        return subprocess.run(["unshare", "--net", *own], check=False).returncode
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        os.environ["SSL_CERT_FILE"] = f"{folder}/cert.pem"
        places = {"CARIS_SECRETS": name, "CARIS_CAMERA": f"{name}/camera.mp4", "CARIS_MODELS": f"{name}/models"}
        compose = read_compose(**places, CARIS_STUDY=f"{name}/study")
        for service in services:
            with contextlib.ExitStack() as stack:
                running = []
                for part in ("scheduler", "worker") if service == "worker" else (service,):
                    root = base.parent / service
                    container = Container(part, compose["services"][part], compose["secrets"], images[service], root)
                    running.append(stack.enter_context(contextlib.closing(container)))
                    healthy_s = container.wait_until_healthy()
                    print(f"{part}: healthy after {healthy_s:.1f} s; {container.confinement()}", flush=True)
                print(f"{service}: {REQUESTS[service](folder)}", flush=True)
                for container in reversed(running):
                    print(f"{container.name}: stopped by SIGTERM in {container.stop():.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
