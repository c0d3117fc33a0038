"""A layout of two screens, opened with one screen, and with both again."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

_DPI = {"logicalDpi": 96, "logicalBaseDpi": 96, "dpr": 1}
_SCREENS = [
    {"name": "left", "x": 0, "y": 0, "width": 1920, "height": 1080, **_DPI},
    {"name": "right", "x": 1920, "y": 0, "width": 2560, "height": 1440, **_DPI},
]


def run(folder: Path, screens: int, *where: int) -> dict[str, str]:
    config = folder / f"{screens}.json"
    config.write_text(json.dumps({"screens": _SCREENS[:screens]}))
    done = subprocess.run(
        [sys.executable, "-m", "tests.ui.layout.two_screens_subject", str(folder / "settings.ini"), *map(str, where)],
        env={**os.environ, "QT_QPA_PLATFORM": f"offscreen:configfile={config}"},
        cwd=Path(__file__).resolve().parents[3],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return dict(line.split(" ", 1) for line in done.stdout.splitlines())


@pytest.mark.skipif(sys.platform != "linux", reason="screens are made up by Qt's offscreen platform")
@pytest.mark.long
def test_a_layout_of_two_screens_opens_on_one(tmp_path: Path) -> None:
    two = run(tmp_path, 2, 2500, 300)
    assert two["SCREENS"] == "2"
    assert two["MAP"] == "2500 300 600 500"
    one = run(tmp_path, 1)
    left, top, width, height = map(int, one["MAP"].split())
    assert one["SCREENS"] == "1"
    assert left >= 0 and left + width <= 1920 and top >= 0 and top + height <= 1080
    assert (width, height) == (600, 500)
    assert one["KEPT"] == two["KEPT"]
    assert run(tmp_path, 2)["MAP"] == "2500 300 600 500"
