"""Search for recogniser weights, and error messages for unusable ones."""

import hashlib
import io
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.conversation.listening import engines
from caris_desktop.conversation.listening.engines import LocalEngine, NoEngineError, find_recogniser
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings

SETTINGS = RecogniserSettings()
WEIGHTS = b"weights"
SHA256 = hashlib.sha256(WEIGHTS).hexdigest()


def _model(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "model.bin").write_bytes(WEIGHTS)
    return folder


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    return tmp_path / "configured", tmp_path / "data"


def test_the_usual_one_is_in_a_models_folder_or_in_the_package(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    package = _model(folders[0].parent / "package")
    monkeypatch.setattr(engines, "packaged_file", lambda *_parts: package)
    assert find_recogniser(SETTINGS, folders=folders) == package
    own = _model(folders[1] / "faster-whisper")
    assert find_recogniser(SETTINGS, folders=folders) == own
    monkeypatch.setattr(engines, "packaged_file", lambda *_parts: None)
    with pytest.raises(NoEngineError, match="No speech recogniser") as told:
        find_recogniser(SETTINGS, folders=(folders[0],))
    assert "pip install" in told.value.advice


def test_a_named_one_is_next_to_the_scenario_or_in_a_models_folder(tmp_path: Path, folders: tuple[Path, Path]) -> None:
    beside = _model(tmp_path / "scenarios" / "small")
    _model(folders[0] / "small")
    named = replace(SETTINGS, model="small")
    assert find_recogniser(replace(named, folder=tmp_path / "scenarios"), folders=folders) == beside
    assert find_recogniser(named, folders=folders) == folders[0] / "small"
    assert find_recogniser(replace(SETTINGS, model=str(beside)), folders=folders) == beside


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"model": "missing"}, "not a faster-whisper model"),
        ({"model": "../elsewhere"}, "outside the scenario's folder"),
        ({"model": "small", "sha256": "0" * 64}, "the checksum does not match"),
        ({"model": "https://example.org/model.zip"}, "has no checksum"),
        ({"model": "https://example.org/model.tar", "sha256": "0" * 64}, "end in the name of a .zip"),
        ({"model": "https://example.org/m.zip", "sha256": "0" * 64, "allow_download": False}, "not on this computer"),
        ({"model": "http://127.0.0.1:1/m.zip", "sha256": "0" * 64}, "this computer is offline"),
    ],
)
def test_a_configured_file_is_never_replaced(folders: tuple[Path, Path], change: dict[str, Any], words: str) -> None:
    _model(folders[0] / "small")
    with pytest.raises(NoEngineError, match=words):
        find_recogniser(replace(SETTINGS, **change), folders=folders)


def test_the_right_checksum_is_taken(folders: tuple[Path, Path]) -> None:
    own = _model(folders[0] / "small")
    assert find_recogniser(replace(SETTINGS, model="small", sha256=SHA256.upper()), folders=folders) == own


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_args: Any) -> None:
        """No log output."""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    folder = tmp_path / "served"
    folder.mkdir()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield folder, f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def _packed(**files: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return packed.getvalue()


def test_an_address_is_fetched_once_and_nothing_of_it_leaves_its_folder(
    tmp_path: Path, folders: tuple[Path, Path], served: tuple[Path, str]
) -> None:
    folder, address = served
    packed = _packed(**{"small/model.bin": WEIGHTS, "../../config.json": b"{}", "../evil.py": b"x", "run.sh": b"x"})
    (folder / "small.zip").write_bytes(packed)
    wanted = replace(SETTINGS, model=f"{address}/small.zip", sha256=hashlib.sha256(packed).hexdigest())
    found = find_recogniser(wanted, folders=folders)
    checksums = {"model.bin.sha256", "config.json.sha256"}
    assert {path.name for path in found.iterdir()} == {"model.bin", "config.json"} | checksums
    assert list(tmp_path.rglob("evil.py")) == []
    (folder / "small.zip").unlink()
    assert find_recogniser(wanted, folders=folders) == found
    assert [path.name for path in found.parent.iterdir()] == [found.name], "nothing else is left of it"
    (found / "config.json").write_bytes(b"{ }")
    with pytest.raises(NoEngineError, match=r"model file config\.json does not match its checksum"):
        LocalEngine(replace(SETTINGS, model=str(found)))


@pytest.mark.parametrize("fault", ["no model", "damaged"])
def test_an_archive_without_a_model_leaves_nothing(
    folders: tuple[Path, Path], served: tuple[Path, str], fault: str
) -> None:
    folder, address = served
    packed = _packed(**{"readme.txt" if fault == "no model" else "model.bin": b"nothing"})
    if fault == "damaged":
        packed = packed.replace(b"\x14\x00\x00\x00\x00\x00", b"\x14\x00\x01\x00\x0e\x00")  # encrypted LZMA
    (folder / "small.zip").write_bytes(packed)
    wanted = replace(SETTINGS, model=f"{address}/small.zip", sha256=hashlib.sha256(packed).hexdigest())
    with pytest.raises(NoEngineError, match="could not be unpacked"):
        find_recogniser(wanted, folders=folders)
    assert list((folders[1] / "named").iterdir()) == []
