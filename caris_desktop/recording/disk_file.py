"""Files of a running session, and the handling of a full disk."""

import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Self

from caris_desktop.domain.file_replacement import no_room


class Reserve:
    """Disk space reserved at the start for data that must still be written once the disk is full.

    It is released in ``steps`` down to ``kept_bytes``, so that other writers on the disk cannot use all of it at once.
    Any thread.
    """

    def __init__(self, folder: Path, size_bytes: int, *, steps: int = 1, kept_bytes: int = 0) -> None:
        """Reserve the space. Raises OSError if there is not enough."""
        # Unlinked, so that a kill leaves no file behind.
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - open until release
        self._step_bytes = -(-(size_bytes - kept_bytes) // steps)
        self._kept_bytes = kept_bytes
        self.held_bytes = size_bytes
        self._releasing = threading.Lock()
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
    def left_bytes(self) -> int:
        """Bytes that steps may still release."""
        return max(self.held_bytes - self._kept_bytes, 0)

    def release_step(self) -> bool:
        """Release one step; True if this freed space."""
        with self._releasing:
            return self._shorten(max(self.held_bytes - self._step_bytes, self._kept_bytes))

    def release(self, *, down_to_bytes: int = 0) -> bool:
        """Release everything but so much; True if this freed space."""
        with self._releasing:
            return self._shorten(down_to_bytes)

    def _shorten(self, size_bytes: int) -> bool:
        if self.held_bytes <= size_bytes:
            return False
        try:
            self._file.truncate(size_bytes)
        except OSError:
            size_bytes = 0
        self.held_bytes = size_bytes
        if not size_bytes:
            self._file.close()
        return True


class DiskFile:
    """Unbuffered file: its bytes are with the operating system when ``write`` returns.

    ``on_full`` is called when the disk is full; if it freed space, the write continues. An incomplete write at the end
    is truncated, so that no partial record remains. Only one thread may write; ``sync`` may be called from another.
    """

    def __init__(self, path: Path, *, on_full: Callable[[], bool] = lambda: False) -> None:
        """Create the file. Raises OSError if it exists or cannot be created."""
        self.path = path
        self._on_full = on_full
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        self._position = 0
        self._size = 0
        self._written = self._synced = 0
        self._slowest_write_s = 0.0
        self._closing = threading.Lock()
        self._closed = False
        self._held_back: list[tuple[int, bytes]] | None = None

    @property
    def size_bytes(self) -> int:
        return self._size

    @property
    def written_bytes(self) -> int:
        """Bytes written to the disk: less than the size if the file has holes."""
        return self._written

    def take_slowest_write_s(self) -> float:
        """Return and reset the longest write time since the last call. Any thread."""
        slowest_s, self._slowest_write_s = self._slowest_write_s, 0.0
        return slowest_s

    def write(self, data: bytes) -> int:
        if self._held_back is not None:
            self._held_back.append((self._position, bytes(data)))
            self._position += len(data)
            return len(data)
        rest = memoryview(data)
        begun_s = time.monotonic()
        begin, at_the_end = self._position, self._position == self._size
        while rest:
            try:
                count = os.write(self._descriptor, rest)
            except OSError as error:
                if no_room(error) and self._on_full():
                    continue
                if at_the_end and self._position > begin:
                    with suppress(OSError):
                        self.end_at(begin)
                raise
            rest = rest[count:]
            self._position += count
            self._written += count
            self._size = max(self._size, self._position)
        self._slowest_write_s = max(self._slowest_write_s, time.monotonic() - begun_s)
        return len(data)

    def patch(self, offset: int, data: bytes) -> None:
        """Overwrite earlier bytes; the position for the next write is unchanged."""
        position = self._position
        self.seek(offset)
        try:
            self.write(data)
        finally:
            self.seek(position)

    def end_at(self, size_bytes: int) -> None:
        """Truncate the file, or extend it with zeros (sparse where supported); the next write continues there."""
        os.ftruncate(self._descriptor, size_bytes)
        self._size = size_bytes
        self._written += 1
        self.seek(size_bytes)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = base + offset
        if self._held_back is None:
            os.lseek(self._descriptor, self._position, os.SEEK_SET)
        return self._position

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer, but format writers call it."""

    def hold_back(self) -> None:
        """Defer writes until :meth:`commit`."""
        self._held_back = []

    def discard(self) -> None:
        """Discard deferred writes, present and future: the file stays as it is."""
        self._held_back = []

    def commit(self) -> None:
        """Write the deferred data: first past the present end, then over the front.

        Until the last step the old content is intact with data appended, even after a kill.
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

    def sync(self) -> bool:
        """Flush to the disk (fsync); False if nothing was pending. Raises OSError."""
        with self._closing:
            written = self._written
            if self._closed or written == self._synced:
                return False
            if hasattr(os, "fdatasync"):
                os.fdatasync(self._descriptor)
            else:
                os.fsync(self._descriptor)
            self._synced = written
            return True

    def close(self) -> None:
        with self._closing:
            if not self._closed:
                self._closed = True
                os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
