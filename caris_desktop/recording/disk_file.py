"""Files of a running session: what happens when the disk is full is decided here."""

import errno
import os
import tempfile
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


def no_room(error: OSError) -> bool:
    """Whether ``error`` says that the disk, or the user's share of it, is full."""
    return error.errno in _NO_ROOM


class Reserve:
    """Room that is set aside at the start, so that a session can be closed properly on a full disk."""

    def __init__(self, folder: Path, size_bytes: int) -> None:
        """Raises OSError when there is not that much room."""
        # Without a name on the disk, so that a kill leaves nothing behind.
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - open until release
        try:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._file.fileno(), 0, size_bytes)
            else:
                for _ in range(0, size_bytes, 65536):
                    self._file.write(bytes(65536))
        except OSError:
            self._file.close()
            raise

    @property
    def held(self) -> bool:
        return not self._file.closed

    def release(self) -> bool:
        """Give the room back; True when this made room."""
        was_held = self.held
        self._file.close()
        return was_held


class DiskFile:
    """An unbuffered file whose bytes are with the operating system when ``write`` returns.

    ``on_full`` is asked for room when the disk is full; when it has made some, the write goes on where it stopped,
    so that no half record remains. Writing belongs to one thread; ``sync`` may be called from another.
    """

    def __init__(self, path: Path, *, on_full: Callable[[], bool] = lambda: False) -> None:
        """Raises OSError when the file is there already or cannot be made."""
        self.path = path
        self._on_full = on_full
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self._position = 0
        self._size = 0
        self._closing = threading.Lock()
        self._closed = False
        self._held_back: list[tuple[int, bytes]] | None = None

    @property
    def size_bytes(self) -> int:
        return self._size

    def write(self, data: bytes) -> int:
        if self._held_back is not None:
            self._held_back.append((self._position, bytes(data)))
            self._position += len(data)
            return len(data)
        rest = memoryview(data)
        while rest:
            try:
                count = os.write(self._descriptor, rest)
            except OSError as error:
                if no_room(error) and self._on_full():
                    continue
                raise
            rest = rest[count:]
            self._position += count
            self._size = max(self._size, self._position)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = base + offset
        if self._held_back is None:
            os.lseek(self._descriptor, self._position, os.SEEK_SET)
        return self._position

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing is buffered here; writers of formats ask for it."""

    def hold_back(self) -> None:
        """From now on writes wait for :meth:`commit`."""
        self._held_back = []

    def discard(self) -> None:
        """Forget what is held back, now and later: the file stays as it is."""
        self._held_back = []

    def commit(self) -> None:
        """Write what was held back: first what comes after the present end, then what changes the front.

        Until the last step the file is what it was before with something behind it, also after a kill.
        """
        waiting, self._held_back = self._held_back or [], None
        old_size = self._size
        try:
            self._apply(change for change in waiting if change[0] >= old_size)
            self.sync()
        except OSError:
            os.ftruncate(self._descriptor, old_size)
            raise
        self._apply(change for change in waiting if change[0] < old_size)

    def _apply(self, changes: Iterable[tuple[int, bytes]]) -> None:
        for offset, data in changes:
            self.seek(offset)
            self.write(data)

    def sync(self) -> None:
        """Bring what was written to the disk itself."""
        with self._closing:
            if not self._closed:
                os.fsync(self._descriptor)

    def close(self) -> None:
        with self._closing:
            if not self._closed:
                self._closed = True
                os.close(self._descriptor)


def replace_file(path: Path, data: bytes, *, durable: bool, on_full: Callable[[], bool] = lambda: False) -> None:
    """Put ``data`` in the place of ``path``, whole or not at all. Raises OSError.

    ``durable`` waits until the disk has it, which may take long on a busy one.
    """
    temporary = path.with_name(f".{path.name}.part")
    temporary.unlink(missing_ok=True)
    file = DiskFile(temporary, on_full=on_full)
    try:
        file.write(data)
        if durable:
            file.sync()
    except OSError:
        file.close()
        temporary.unlink(missing_ok=True)
        raise
    file.close()
    temporary.replace(path)
