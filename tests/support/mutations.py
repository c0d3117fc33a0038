"""Foreign files with mistakes and malice in them, by a seed that a failure reports; what must not happen meanwhile."""

import json
import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.invalid_data import changed

MOST_MORE_BYTES = 700 << 20
"""How much memory may be taken for files of some kilobytes."""
_MARKS = (
    b"\x00", b"\xff" * 4, b"\xff" * 8, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x80\x00\x00\x00\x00", b"[" * 5000,
    b'{"a":' * 2000, b"NaN", b"1e999", b"-1", b"9" * 400, b"../" * 9, b"%s%n",
    b"\x1b]0;owned\x07", b"\r\n\r\n", b"\xe2\x80\xae",
)  # fmt: skip


def mutated(content: bytes, seed: int, *, paths: tuple[str, ...] = ()) -> bytes:
    """``content`` with one to four mistakes. JSON often stays JSON, with other values, among them ``paths``."""
    chance = random.Random(seed)  # noqa: S311 - which mistake is made
    if content[:1] in (b"{", b"[") and chance.random() < 0.6:
        try:
            return _of_json(json.loads(content), chance, paths)
        except ValueError:
            pass
    data = bytearray(content)
    for _ in range(chance.choice((1, 1, 2, 4))):
        at, length = chance.randrange(len(data) + 1), chance.choice((1, 4, 8, 40, 400))
        match chance.randrange(8):
            case 0:
                del data[at : at + length]
            case 1:
                data[at:at] = chance.choice(_MARKS)
            case 2:
                mark = chance.choice(_MARKS)
                data[at : at + len(mark)] = mark
            case 3:
                data[at:at] = data[chance.randrange(len(data) + 1) :][:length]
            case 4:
                data[at : at + length] = bytes(length)
            case 5 if chance.random() < 0.3:
                del data[at:]
            case _ if at < len(data):
                # The first bytes say what follows how long, so that they are changed as often as all others.
                data[at if chance.random() < 0.5 else at % 64] = chance.randrange(256)
    return bytes(data)


def _of_json(data: Any, chance: random.Random, paths: tuple[str, ...]) -> bytes:
    for _ in range(chance.choice((1, 1, 3))):
        whole = {"": data}
        data = changed(whole, chance, ("a", "__class__", "version", *paths)).get("", data)
        if paths and chance.random() < 0.4:
            data = _with_path(data, chance, chance.choice(paths))
    return json.dumps(data).encode()


def _with_path(data: Any, chance: random.Random, path: str) -> Any:
    """One of the texts that could be a name of a file is this path."""
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
        place, key = chance.choice([each for each in places if "." in str(each[0][each[1]])] or places)
        place[key] = path
    return data


_watched: list[tuple[Path, Path]] = []
_seen: list[str] = []


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _watched:
        return
    allowed, secret = _watched[-1]
    if event in ("os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "socket.connect", "socket.getaddrinfo"):
        if event != "socket.connect" or not isinstance(arguments[-1], str):
            _seen.append(f"{event} {arguments!r}")
    elif event in ("open", "os.remove", "os.rename", "os.mkdir", "shutil.rmtree", "os.chmod", "os.link", "os.symlink"):
        for path in arguments[: 2 if event in ("os.rename", "os.link", "os.symlink") else 1]:
            # What is relative to an open folder, as when a whole one is removed, was looked at with that folder.
            if not isinstance(path, str | Path) or (event == "os.remove" and arguments[1] not in (-1, None)):
                continue
            writes = event != "open" or (isinstance(arguments[1], str) and arguments[1][:1] in ("w", "a", "x", "+"))
            full = Path(path).absolute()
            if full == secret or (writes and not full.is_relative_to(allowed) and full != Path("/dev/null")):
                _seen.append(f"{event} {path}")


sys.addaudithook(_audit)


@contextmanager
def nothing_outside(allowed: Path, secret: Path) -> Iterator[list[str]]:
    """Gives what was run, connected to, written outside of ``allowed`` or read of ``secret`` by Python so far."""
    _seen.clear()
    _watched.append((allowed, secret))
    try:
        yield _seen
    finally:
        _watched.pop()


def most_memory_bytes() -> int:
    """The most that this process ever took."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
