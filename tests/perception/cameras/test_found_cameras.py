"""List of connected cameras."""

from pathlib import Path

import pytest

from caris_desktop.perception.cameras import device_camera as module
from caris_desktop.perception.cameras.device_camera import found_cameras


def test_each_camera_is_listed_once_by_what_chooses_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "oak_devices", lambda: ["14442C10D13EABCE00"])
    for node, index, name in (("video10", 0, "Desk"), ("video2", 0, "HD Webcam"), ("video3", 1, "HD Webcam")):
        folder = tmp_path / node
        folder.mkdir()
        (folder / "index").write_text(f"{index}\n")
        (folder / "name").write_text(f"{name}\n")
    (tmp_path / "video7").mkdir()
    assert found_cameras(tmp_path) == ["2 (HD Webcam)", "10 (Desk)", "oak:14442C10D13EABCE00"]
    assert found_cameras(tmp_path / "missing") == ["oak:14442C10D13EABCE00"]
