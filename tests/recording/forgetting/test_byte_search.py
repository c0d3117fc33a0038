"""Search for names and images in every encoding and compression that files use, without false matches."""

import base64
import bz2
import gzip
import io
import json
import lzma
import sqlite3
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import zstandard
from pyarrow import parquet

from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting import byte_search
from caris_desktop.recording.forgetting.byte_search import ByteSearch, Hit
from caris_desktop.recording.forgetting.erasure_files import is_opaque
from caris_desktop.recording.forgetting.text_erasure import all_of
from caris_desktop.recording.session.events_file import McapFile
from tests.recording.forgetting.named_study import NAME, portrait

FACE = portrait()
VECTOR = np.random.default_rng(3).normal(size=128).astype("<f4").tobytes()
SENTENCE = f"Hello {NAME}, welcome."


@pytest.fixture(scope="module")
def search() -> ByteSearch:
    return ByteSearch(all_of([NAME], [FACE, VECTOR]))


def whats(hits: tuple[Hit, ...]) -> set[str]:
    return {hit.what for hit in hits}


@pytest.mark.parametrize(
    "text",
    [
        SENTENCE.encode(),
        SENTENCE.upper().encode(),
        SENTENCE.encode("utf-16"),
        b"\0" + SENTENCE.encode("utf-16-be"),
        json.dumps([SENTENCE]).encode(),
        json.dumps([f"\n{NAME}"]).encode(),
        json.dumps([f"“{NAME}”"]).encode(),
        SENTENCE.encode("ascii", "xmlcharrefreplace"),
        b"https://example.org/Zo%C3%AB%20Quillfeather",
        "Zoe\u0308 Quillfeather".encode(),
        b"Quillfeather's cup, and no first name",
        b"/home/lab2/studies/2026/tour/ZoeQuillfeather/video-front-0001.mp4",
        b"hello zoe",
        "a;Zoë;b".encode("cp1252"),
        "a;ZOË;b".encode("cp1252"),
    ],
)
def test_a_name_is_found_however_a_text_writes_it(search: ByteSearch, text: bytes) -> None:
    assert whats(search.data(b"\xff\x00 before " + text).hits) == {"name"}


def test_pictures_are_found_as_they_are_and_as_base64_at_any_place(search: ByteSearch) -> None:
    for content in (FACE, VECTOR):
        assert whats(search.data(b"before" + content + b"behind").hits) == {"picture"}
        for shift in range(3):
            coded = base64.b64encode(b"x" * shift + content)
            assert whats(search.data(b'{"jpeg":"' + coded + b'"}').hits) == {"picture"}


def test_pictures_of_others_and_words_that_only_contain_a_part_are_not_taken_for_them() -> None:
    search = ByteSearch(all_of(["Ann Ada"], [FACE]))
    others = portrait() + np.random.default_rng(5).normal(size=128).astype("<f4").tobytes()
    assert not search.data(others).hits
    assert not search.data(b"An annual canada, bannister; sha256 0ada" + b"4ada7" * 20).hits
    assert len(search.data(b"Ann, ADA and Ann_Ada; ann's").hits) == 4


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("Jürgen Groß", "MUELLER, JUERGEN; Gross"),
        ("Søren Kjær", "soren, soeren, KJAER"),
        ("Łukasz", "Lukasz"),
        ("O'Brien", "o’brien"),
        ("O’Brien", "O'Brien"),
        ("Иван", "Иван".encode("cp1251")),
        ("李娜", "李娜".encode("gbk")),
        ("Иван", "Меня зовут Иван, я живу здесь".encode("cp1251")),
        ("Иван", "Меня зовут Иван, я живу здесь".encode("koi8_r")),
        ("健太", "私の名前は健太です。".encode("cp932")),
        ("יעל", "אני יעל, שלום".encode("cp1255")),
        ("Jürgen", "Für Jürgen, Größe".encode("mac_roman")),
        ("Jürgen", "Für Jürgen, Größe".encode("cp850")),
        ("Jürgen", "J&uuml;rgen, J&#xFC;rgen, J%FCrgen, J=C3=BCrgen"),
        ("Jürgen", r"J\'fcrgen, J\u252?rgen, J\xfcrgen, J\303\274rgen"),
        ("Jürgen", r"J\"urgen, J\"{u}rgen, J{\"u}rgen, J{\"{u}}rgen"),
        ("Jürgen", "JÃ¼rgen, JUERGEN2.wav, 2jürgen"),
    ],
)
def test_a_name_is_found_as_typed_without_its_letters_and_in_the_code_page_of_its_country(
    name: str, written: str | bytes
) -> None:
    content = written.encode() if isinstance(written, str) else written
    names = len(content.split(b",")) if isinstance(written, str) else 1
    assert len(ByteSearch(all_of([name], [])).data(content).hits) >= names


@pytest.mark.parametrize("kind", ["gz", "bz2", "xz", "zst", "zip", "lzma.zip", "sqlite", "parquet"])
def test_a_damaged_file_is_named_and_its_other_bytes_are_searched(kind: str, tmp_path: Path) -> None:
    path, search = tmp_path / f"damaged.{kind}", ByteSearch(all_of([NAME], []))
    noise = np.random.default_rng(1).bytes(300_000)
    if kind == "parquet":
        parquet.write_table(pa.table({"text": [noise]}), path)
    elif kind == "sqlite":
        with closing(sqlite3.connect(path)) as database:
            database.execute("CREATE TABLE t (content BLOB)")
            database.executemany("INSERT INTO t VALUES (?)", [(noise,)] * 2)
            database.commit()
    elif kind.endswith("zip"):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA if "lzma" in kind else zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("a.txt", noise)
    else:
        pack = {"gz": gzip.compress, "bz2": bz2.compress, "xz": lzma.compress, "zst": zstandard.compress}[kind]
        path.write_bytes(pack(noise))
    content = path.read_bytes()
    path.write_bytes(content[:100_000] + SENTENCE.encode() + bytes(90_000) + content[200_000:])
    searched = search.file(path)
    assert searched.closed
    assert {hit.inside for hit in searched.hits if hit.what == "name"} == {""}
    assert is_opaque(path) in (True, False)


def test_a_name_in_a_script_without_spaces_is_found_among_its_neighbours() -> None:
    search = ByteSearch(all_of(["\u674e\u5a1c"], []))
    text = "\u4f60\u597d\u674e\u5a1c\u60a8\u597d"
    for content in (text.encode(), json.dumps(text).encode(), text.encode("utf-16")):
        assert len(search.data(content).hits) == 1


def test_short_names_are_found_as_words_and_in_film_only_amid_text(tmp_path: Path) -> None:
    search = ByteSearch(all_of(["Bo"], []))
    assert len(search.data(b"Bo said hello to Boris, bo").hits) == 2
    film = tmp_path / "video.mp4"
    film.write_bytes(bytes(range(128, 256)) + b"Bo" + bytes(range(128, 256)) + b"title: Bo at home")
    assert len(search.file(film).hits) == 1


def test_short_names_are_not_found_by_chance_in_arrays_vectors_and_databases(tmp_path: Path) -> None:
    search = ByteSearch(all_of(["Zoë Quillfeather"], []))
    random = np.random.default_rng(1)
    noise = random.integers(0, 256, 8_000_000, np.uint8).tobytes()
    arrays = random.normal(3, 1, 2_000_000).astype("<f4").tobytes() + random.normal(size=1_000_000).tobytes()
    assert not search.data(noise + arrays).hits
    database = tmp_path / "people.sqlite"
    with closing(sqlite3.connect(database)) as people:
        people.execute("CREATE TABLE people (id TEXT, name TEXT, portrait BLOB)")
        people.execute("INSERT INTO people VALUES ('p-1', 'Nobody', ?)", (noise,))
        people.commit()
        assert not search.file(database).hits
        people.execute("INSERT INTO people VALUES ('p-2', 'Zoe', ?)", (noise[:4000],))
        people.commit()
    assert "rows" in {hit.inside for hit in search.file(database).hits}


@pytest.mark.parametrize(
    "content",
    [
        b"\x04\0\0\0name\x03\0\0\0Zoe\0\x07\0\0\0\x01",
        "你好您好 Zoe 你好您好".encode(),
        "Grüße, Zoë, für Ännchen".encode(),
        b"Zoe",
        b"\x01\x02Zoe",
    ],
)
def test_a_short_name_is_found_among_fields_of_records_and_in_any_alphabet(content: bytes) -> None:
    assert len(ByteSearch(all_of(["Zoë"], [])).data(content).hits) == 1


def _packed_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        inner = io.BytesIO()
        with gzip.GzipFile(fileobj=inner, mode="wb") as packed:
            packed.write(SENTENCE.encode())
        archive.writestr("inside/words.gz", inner.getvalue())


def _mcap(path: Path) -> None:
    writer = McapFile(DiskFile(path))
    channel = writer.add_channel("/said", writer.add_schema("said", b"{}"))
    for number in range(200):
        data = json.dumps({"text": SENTENCE if number == 150 else "nobody" * 50}).encode()
        writer.add_message(channel, data, log_time=number, publish_time=number, sequence=number)
    writer.finish()


def _sqlite(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE said (text TEXT, picture BLOB)")
        # Long enough for overflow pages.
        database.execute("INSERT INTO said VALUES (?, ?)", ("x " * 3000 + SENTENCE, FACE))
        database.commit()


def _parquet(path: Path) -> None:
    parquet.write_table(pa.table({"text": ["nobody", SENTENCE] * 20}), path, compression="zstd")


def _png(path: Path) -> None:
    import struct
    import zlib

    import cv2

    coded = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    body = b"zTXtComment\0\0" + zlib.compress(SENTENCE.encode())
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    path.write_bytes(coded[:33] + chunk + coded[33:])


def _zstd(path: Path) -> None:
    path.write_bytes(zstandard.ZstdCompressor().compress(SENTENCE.encode() * 3))


@pytest.mark.parametrize("make", [_packed_zip, _mcap, _sqlite, _parquet, _png, _zstd])
def test_packed_data_is_unpacked(search: ByteSearch, tmp_path: Path, make: Callable[[Path], None]) -> None:
    path = tmp_path / "file"
    make(path)
    found = search.file(path)
    assert "name" in whats(found.hits)
    assert not found.closed


def test_a_name_across_two_blocks_is_found_once_and_half_a_word_is_none(
    search: ByteSearch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(byte_search, "_BLOCK_BYTES", 1024)
    for begin in range(980, 1040):
        content = b"." * begin + NAME.encode() + b"." * 3000
        assert [hit.offset for hit in search.data(content).hits] == [begin]
    short = ByteSearch(all_of(["Ann"], []))
    for begin in range(1000, 1030):
        assert not short.data(b"." * begin + b"Annual" + b"." * 3000).hits


def test_unreadable_archives_are_reported(search: ByteSearch, tmp_path: Path) -> None:
    path = tmp_path / "torn.zip"
    _packed_zip(path)
    path.write_bytes(path.read_bytes()[:60])
    assert search.file(path).closed
