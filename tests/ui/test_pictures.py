"""Legibility with a global scale factor of Qt, which is read at program start."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from PySide6.QtGui import QImage

from tests.ui.pictures import compare

REPOSITORY = Path(__file__).parents[2]


@pytest.mark.long  # each size is in test_every_size
def test_at_one_and_a_half_times_the_size_the_whole_window_can_be_read(tmp_path: Path) -> None:
    told = subprocess.run(
        [sys.executable, "-m", "tests.ui.pictures", str(tmp_path), "--scale", "1.5"],
        cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=110,
        env={**os.environ, "QT_SCALE_FACTOR": "1.5"},
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    assert "0 flaws at 1.5 times the size" in told.stdout, told.stdout
    pictures = {path.name: QImage(str(path)) for path in tmp_path.glob("*.png")}
    assert {name.split("-150-")[0].rsplit("-", 1)[1] for name in pictures} == {"1366x768", "1920x1080", "2560x1440"}
    for name, picture in pictures.items():
        width_px, height_px = (int(px) for px in name.split("-150-")[0].rsplit("-", 1)[1].split("x"))
        assert abs(picture.width() - width_px) <= 2 and abs(picture.height() - height_px) <= 2, name


def test_changed_pictures_are_listed_and_saved_side_by_side(tmp_path: Path) -> None:
    before, after = tmp_path / "before", tmp_path / "after"
    colours_before, colours_after = {"same": 1, "changed": 2, "gone": 3}, {"same": 1, "changed": 5, "new": 4}
    for folder, colours in ((before, colours_before), (after, colours_after)):
        folder.mkdir()
        for name, colour in colours.items():
            picture = QImage(8, 6, QImage.Format.Format_RGB32)
            picture.fill(colour)
            picture.save(str(folder / f"{name}.png"))
    assert compare(before, after) == ["changed.png: 48 pixels differ", "gone.png: gone", "new.png: new"]
    assert [path.name for path in (after / "changed").iterdir()] == ["changed.png"]
