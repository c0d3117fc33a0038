"""Search for a person's names and images in every byte of a file, including compressed parts, in bounded memory."""

import bz2
import contextlib
import errno
import gzip
import io
import lzma
import os
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value
from caris_desktop.recording.forgetting.text_erasure import AS_IT_IS, SearchTerms, folded
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.events_file import MAGIC as MCAP_MAGIC

ATTRIBUTES = "attributes"
"""``Hit.inside`` of a hit in a file's extended attributes."""
_BLOCK_BYTES = 1 << 22
_AROUND_BYTES = 256
_HEAD_BYTES = 16
_DEEPEST = 4
_SQLITE_MAGIC, _PARQUET_MAGIC, _ZIP_MAGIC = b"SQLite format 3\x00", b"PAR1", b"PK\x03\x04"
_PNG_MAGIC, _BAG_MAGIC, _ZLIB_BEGINS = b"\x89PNG\r\n\x1a\n", b"#ROSBAG V2.0", b"\x78"
_PNG_TEXTS = (b"zTXt", b"iTXt", b"iCCP")
# Video, audio and images: their bytes are never text, but for a title or a comment.
_MEDIA = (".mp4", ".wav", ".png", ".jpg", ".jpeg", ".mkv", ".webm", ".flac", ".onnx")
# Shorter names occur by chance in arrays, vectors and images: "Zoe" in every megabyte of random bytes.
_SHORT = 6
_TEXT_AROUND, _BINARY_AROUND, _CODE_PAGE_AROUND, _ODD = 6, 8, 24, 3


class Hit(Value):
    """Hit of the search: ``inside`` names the part of the file, empty for its own bytes; ``words`` is the text around
    it.
    """

    offset: int
    what: str  # "name" or "picture"
    inside: str = ""
    words: str = ""


class Searched(Value):
    """Result for one file; ``closed`` lists parts that could not be unpacked and were searched as stored."""

    hits: tuple[Hit, ...]
    searched_bytes: int
    closed: tuple[str, ...] = ()


class _Readable(Protocol):
    """Readable data: a file, or an unpacked part of one."""

    def read(self, size: int = ..., /) -> Any: ...

    def seek(self, offset: int, whence: int = ..., /) -> int: ...


class ByteSearch:
    """Search for one person."""

    def __init__(self, terms: SearchTerms) -> None:
        self._words = terms.words
        self._beginnings = terms.words.beginnings
        self._probes = terms.probes
        keys = [text[:2] for text, _ in self._beginnings] + [folded(probe[:2]) for probe in self._probes]
        self._pairs = np.zeros(1 << 16, np.bool_)
        self._pairs[[key[0] | key[1] << 8 for key in keys]] = True
        self._of_pair: dict[bytes, list[tuple[bytes, str]]] = {}
        for text, encoding in self._beginnings:
            self._of_pair.setdefault(text[:2], []).append((text, encoding))
        for probe in self._probes:
            self._of_pair.setdefault(folded(probe[:2]), []).append((folded(probe), ""))
        texts = [text for many in self._of_pair.values() for text, _ in many]
        self._fours = np.unique(np.array([_number(text) for text in texts if len(text) >= 4], np.uint32))
        self._shorter = np.unique(np.array([_number(text) for text in texts if len(text) < 4], np.uint32))
        self._exact = set(self._probes)

    def file(self, path: Path) -> Searched:
        """Search a file. Raises OSError."""
        with path.open("rb") as file:
            searched = self._opened(file, path.name.lower(), 0)
        hits = self._opened(io.BytesIO(_attributes_of(path)), "", 0, ATTRIBUTES).hits
        return replace(searched, hits=(*searched.hits, *hits)) if hits else searched

    def data(self, content: bytes) -> Searched:
        return self._opened(io.BytesIO(content), "", 0)

    def _opened(self, file: _Readable, name: str, depth: int, inside: str = "") -> Searched:
        head = file.read(_HEAD_BYTES)
        hits, total = self._stream(head, file.read, inside, media=name.endswith(_MEDIA))
        closed: list[str] = []
        if _is_packed(head):
            for part, opened in self._unpacked(file, head, inside or name, inside, closed):
                if depth + 1 >= _DEEPEST:
                    closed.append(f"{part}: nested too deeply")
                    continue
                with _noting_damage(part, closed):
                    found = self._opened(opened, part.lower(), depth + 1, part)
                    hits += found.hits
                    total += found.searched_bytes
                    closed += found.closed
        return Searched(tuple(hits), total, tuple(closed))

    def _unpacked(
        self, file: Any, head: bytes, name: str, inside: str, closed: list[str]
    ) -> Iterator[tuple[str, _Readable]]:
        """Unpack each compressed part of a file; append those that fail to ``closed``."""
        where = f"{inside}/" if inside else ""
        with _noting_damage(name, closed):
            file.seek(0)
            if head.startswith(MCAP_MAGIC):
                # All in one stream: there are thousands, and starting a search takes longer than searching one.
                yield f"{where}blocks", _Row(_mcap_blocks(file, closed, name))
            elif head.startswith(_SQLITE_MAGIC):
                # Texts apart from images and vectors, beside whose bytes a short name would look like chance.
                for part, kind in (("rows", str), ("bytes", bytes)):
                    yield f"{where}{part}", _Row(_values_of(file, kind))
            elif head.startswith(_PARQUET_MAGIC):
                yield f"{where}columns", _Row(_texts_of(file))
            elif head.startswith(_PNG_MAGIC):
                for content in _png_texts(file):
                    yield f"{where}text", io.BytesIO(content)
            elif head.startswith(_ZIP_MAGIC):
                with zipfile.ZipFile(file) as archive:
                    for info in archive.infolist():
                        packed: Any
                        with archive.open(info) as packed:
                            stored = info.compress_type == zipfile.ZIP_STORED
                            if not stored or _is_packed(packed.peek(_HEAD_BYTES)[:_HEAD_BYTES]):
                                yield f"{where}{info.filename}", packed
            elif head.startswith(_BAG_MAGIC):
                head = file.read(1 << 16)
                if b"compression=lz4" in head or b"compression=bz2" in head:
                    closed.append(f"{name}: its chunks are compressed")
            elif (opener := opener_of(head)) is not None:
                with opener(file) as packed:
                    yield f"{where}unpacked", packed

    def _stream(self, head: bytes, read: Callable[[int], bytes], inside: str, *, media: bool) -> tuple[list[Hit], int]:
        hits: list[Hit] = []
        overlap, at, total = b"", 0, len(head)
        block = head
        while True:
            more = read(_BLOCK_BYTES)
            total += len(more)
            data = overlap + block + more
            block = b""
            # The end of a piece is searched again with the next one: word ends depend on the following text.
            until = len(data) - _AROUND_BYTES if more else len(data)
            for hit in self._in_block(data, _AROUND_BYTES if at else 0, until, media=media):
                hits.append(replace(hit, offset=at + hit.offset, inside=inside))
            if not more:
                return hits, total
            overlap = data[-2 * _AROUND_BYTES :] if at or len(data) > 2 * _AROUND_BYTES else data
            at += len(data) - len(overlap)

    def _in_block(self, data: bytes, begin: int, until: int, *, media: bool) -> Iterator[Hit]:
        small = folded(data)
        array = np.frombuffer(small + bytes(4), np.uint8)
        places = []
        for shift in (0, 1):
            pairs = array[shift : shift + (len(array) - shift) // 2 * 2].view("<u2")
            places.append(2 * np.flatnonzero(self._pairs[pairs]) + shift)
        found: NDArray[np.int64] = np.sort(np.concatenate(places))
        found = found[found < len(small)]
        threes = array[found] | array[found + 1].astype(np.uint32) << 8 | array[found + 2].astype(np.uint32) << 16
        good = np.isin(threes | array[found + 3].astype(np.uint32) << 24, self._fours)
        if len(self._shorter):
            good |= np.isin(threes, self._shorter) | np.isin(threes & 0xFFFF, self._shorter)
        candidates: list[int] = found[good].tolist()
        for place in candidates:
            if not begin <= place < until:
                continue
            for text, encoding in self._of_pair.get(small[place : place + 2], ()):
                if not small.startswith(text, place):
                    continue
                if not encoding:
                    if data[place : place + len(text)] in self._exact:
                        yield Hit(place, "picture")
                        break
                elif (words := self._named(data, place, encoding, media=media)) is not None:
                    yield Hit(place, "name", words=words)
                    break

    def _named(self, data: bytes, place: int, encoding: str, *, media: bool) -> str | None:
        """Text around a name that begins at the offset; None if there is none."""
        wide, errors = (1, AS_IT_IS[encoding]) if encoding == "utf-8" else (2, "ignore")
        begin = max(place % wide, place - _AROUND_BYTES)
        before = data[begin:place].decode(encoding, errors)
        window = before + data[place : place + _AROUND_BYTES].decode(encoding, errors)
        for start, end in self._words.spans(window):
            if start == len(before):
                length = len(window[start:end].encode(encoding, errors))
                short = wide == 1 and end - start < _SHORT
                by_chance = short and not _amid_text(data, place, length, media=media)
                return None if by_chance else window[max(0, start - 40) : end + 40]
        return None


def is_damage(error: Exception) -> bool:
    """True if a library failed because of the data, with a type of its own, and not because of the disk."""
    return not isinstance(error, OSError) or error.errno in (None, errno.EINVAL)  # a place before the file's begin


@contextlib.contextmanager
def _noting_damage(what: str, closed: list[str]) -> Iterator[None]:
    """Append what cannot be unpacked to ``closed``. Raises OSError."""
    try:
        yield
    except Exception as error:
        if not is_damage(error):
            raise
        closed.append(f"{what}: {error}")


def _attributes_of(path: Path) -> bytes:
    """Extended attributes of a file, one a line: its tags and comments in a file manager."""
    if not hasattr(os, "listxattr"):
        return b""
    try:
        return b"\n".join(os.getxattr(path, name) for name in os.listxattr(path))
    except OSError:  # not on this file system, or not for this user
        return b""


def _number(text: bytes) -> int:
    return int.from_bytes(text[:4], "little")


def _amid_text(data: bytes, place: int, length: int, *, media: bool) -> bool:
    """True if the surrounding bytes are text rather than chance; tags and lengths of fields may be among them."""
    around = _TEXT_AROUND if media else _BINARY_AROUND
    before, after = data[max(0, place - around) : place], data[place + length : place + length + around]
    if media:
        return sum(32 <= byte < 127 or byte == 0 for byte in before + after) >= len(before + after) - 1
    wider = data[max(0, place - _CODE_PAGE_AROUND) : place + length + _CODE_PAGE_AROUND]
    if not any(byte < 32 and byte not in b"\t\n\r" for byte in wider):
        return True  # of whatever encoding
    text = before.decode("utf-8", "replace") + after.decode("utf-8", "replace")
    # The window may cut a letter of another alphabet at either end.
    cut = text.startswith("\ufffd") + text.endswith("\ufffd")
    odd = sum(letter == "\ufffd" or (letter < " " and letter not in "\0\t\n\r") for letter in text)
    return odd - cut <= _ODD


def _is_packed(head: bytes) -> bool:
    return head.startswith((MCAP_MAGIC, _SQLITE_MAGIC, _PARQUET_MAGIC, _PNG_MAGIC, _ZIP_MAGIC, _BAG_MAGIC, *_OPENERS))


def _unzstd(file: Any) -> Any:
    import zstandard

    return zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True, closefd=False)


_OPENERS: dict[bytes, Callable[[IO[bytes]], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
    b"\x28\xb5\x2f\xfd": _unzstd,
}


def opener_of(head: bytes) -> Callable[[IO[bytes]], Any] | None:
    """Opener of a single compressed file, by its first bytes; None if it is not compressed."""
    return next((opener for magic, opener in _OPENERS.items() if head.startswith(magic)), None)


def _mcap_blocks(file: Any, closed: list[str], name: str) -> Iterator[bytes]:
    index = events_file.scan(file, thorough=False)
    for number in range(index.count):
        try:
            record = events_file.read_record(file, index, number)
            if events_file.is_chunk(record):
                yield events_file.decompress(record) + b"\n"
        except events_file.DamagedBlockError as error:
            closed.append(f"{name}: the chunk at byte {index.offsets[number]}: {error}")


def _png_texts(file: Any) -> Iterator[bytes]:
    """Compressed texts of a PNG."""
    at = len(_PNG_MAGIC)
    while True:
        file.seek(at)
        head = file.read(8)
        if len(head) < 8:
            return
        (length,), kind = struct.unpack(">I", head[:4]), head[4:]
        if kind in _PNG_TEXTS:
            content = file.read(length)
            begins = content.find(_ZLIB_BEGINS)
            while begins >= 0:
                try:
                    yield zlib.decompressobj().decompress(content[begins:], _BLOCK_BYTES)
                    break
                except zlib.error:
                    begins = content.find(_ZLIB_BEGINS, begins + 1)
        at += 12 + length


class _Row(io.RawIOBase):
    """Concatenated values, since long ones are not contiguous in their file."""

    def __init__(self, parts: Iterator[bytes]) -> None:
        self._parts = parts
        self._rest = b""

    def read(self, size: int = -1) -> bytes:
        parts = [self._rest]
        have = len(self._rest)
        while (size < 0 or have < size) and (part := next(self._parts, None)) is not None:
            parts.append(part)
            have += len(part)
        data = b"".join(parts)
        taken, self._rest = (data, b"") if size < 0 else (data[:size], data[size:])
        return taken


def _values_of(file: Any, kind: type[str] | type[bytes]) -> Iterator[bytes]:
    name = getattr(file, "name", None)
    if not isinstance(name, str):
        raise ValueError("it is a database inside another file")  # noqa: TRY004 - of what lies in it
    with closing(sqlite3.connect(f"{Path(name).absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for table in tables:
            quoted = table.replace('"', '""')
            for row in database.execute(f'SELECT * FROM "{quoted}"'):  # noqa: S608 - a table of this very file
                yield from (_text_of(value) for value in row if isinstance(value, kind))


def _texts_of(file: Any) -> Iterator[bytes]:
    from pyarrow import parquet

    for batch in parquet.ParquetFile(file).iter_batches(batch_size=8192):
        for column in batch.columns:
            yield from map(_text_of, column.to_pylist())


def _text_of(value: Any) -> bytes:
    if isinstance(value, bytes):
        return value + b"\n"
    if isinstance(value, str):
        return value.encode("utf-8", "replace") + b"\n"
    return repr(value).encode("utf-8", "replace") + b"\n" if isinstance(value, (list, dict)) else b""
