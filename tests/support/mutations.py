"""Mutated foreign files, reproducible by seed, and a check for side effects of reading them."""

import json
import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.invalid_data import with_mistake

MEMORY_LIMIT_BYTES = 700 << 20
"""Limit of additional memory for reading files of some kilobytes."""
_MARKS = (
    b"\x00", b"\xff" * 4, b"\xff" * 8, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x80\x00\x00\x00\x00", b"[" * 5000,
    b'{"a":' * 2000, b"NaN", b"1e999", b"-1", b"9" * 400, b"../" * 9, b"%s%n",
    b"\x1b]0;owned\x07", b"\r\n\r\n", b"\xe2\x80\xae",
)  # fmt: skip


def mutated(content: bytes, seed: int, *, paths: tuple[str, ...] = ()) -> bytes:
    """``content`` with one to four mistakes; JSON often stays valid, with other values, among them ``paths``."""
    rng = random.Random(seed)  # noqa: S311 - a test, not cryptography
    if content[:1] in (b"{", b"[") and rng.random() < 0.6:
        try:
            return _mutated_json(json.loads(content), rng, paths)
        except ValueError:
            pass
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, length = rng.randrange(len(data) + 1), rng.choice((1, 4, 8, 40, 400))
        match rng.randrange(8):
            case 0:
                del data[at : at + length]
            case 1:
                data[at:at] = rng.choice(_MARKS)
            case 2:
                mark = rng.choice(_MARKS)
                data[at : at + len(mark)] = mark
            case 3:
                data[at:at] = data[rng.randrange(len(data) + 1) :][:length]
            case 4:
                data[at : at + length] = bytes(length)
            case 5 if rng.random() < 0.3:
                del data[at:]
            case _ if at < len(data):
                # Length fields are mostly in the first bytes, which are therefore changed as often as all others.
                data[at if rng.random() < 0.5 else at % 64] = rng.randrange(256)
    return bytes(data)


def _mutated_json(data: Any, rng: random.Random, paths: tuple[str, ...]) -> bytes:
    for _ in range(rng.choice((1, 1, 3))):
        whole = {"": data}
        data = with_mistake(whole, rng, ("a", "__class__", "version", *paths)).get("", data)
        if paths and rng.random() < 0.4:
            data = _with_path(data, rng, rng.choice(paths))
    return json.dumps(data).encode()


def _with_path(data: Any, rng: random.Random, path: str) -> Any:
    """Replace a random text, preferably a file name, by ``path``."""
    places: list[tuple[Any, Any]] = []

    def look(inner: Any) -> None:
        for key, value in inner.items() if isinstance(inner, dict) else enumerate(inner):
            if isinstance(value, str):
                places.append((inner, key))
            elif isinstance(value, dict | list):
                look(value)

    if isinstance(data, dict | list):
        look(data)
    if places:
        place, key = rng.choice([each for each in places if "." in str(each[0][each[1]])] or places)
        place[key] = path
    return data


_allowed_and_secret: list[tuple[Path, Path]] = []
_violations: list[str] = []


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _allowed_and_secret:
        return
    allowed, secret = _allowed_and_secret[-1]
    if event in ("os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "socket.connect", "socket.getaddrinfo"):
        if event != "socket.connect" or not isinstance(arguments[-1], str):
            _violations.append(f"{event} {arguments!r}")
    elif event in ("open", "os.remove", "os.rename", "os.mkdir", "shutil.rmtree", "os.chmod", "os.link", "os.symlink"):
        for path in arguments[: 2 if event in ("os.rename", "os.link", "os.symlink") else 1]:
            # Removal of a folder: paths relative to its descriptor were checked with the folder.
            if not isinstance(path, str | Path) or (event == "os.remove" and arguments[1] not in (-1, None)):
                continue
            writes = event != "open" or (isinstance(arguments[1], str) and arguments[1][:1] in ("w", "a", "x", "+"))
            full = Path(path).absolute()
            if full == secret or (writes and not full.is_relative_to(allowed) and full != Path("/dev/null")):
                _violations.append(f"{event} {path}")


sys.addaudithook(_audit)


@contextmanager
def recorded_side_effects(allowed: Path, secret: Path) -> Iterator[list[str]]:
    """List of programs run, connections, writes outside ``allowed`` and reads of ``secret`` by Python code."""
    _violations.clear()
    _allowed_and_secret.append((allowed, secret))
    try:
        yield _violations
    finally:
        _allowed_and_secret.pop()


def peak_memory_bytes() -> int:
    """Peak memory of this process."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
