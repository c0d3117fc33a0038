"""The wheel carries what the program reads at run time."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def files_under(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_an_unpacked_wheel_finds_its_own_resources_and_layouts(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "dist")]
    subprocess.run(build, cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=True)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    unpacked = tmp_path / "unpacked"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(unpacked)
    ask = "from caris_desktop.domain import shipped; print(shipped.resources_dir()); print(shipped.layouts_dir())"
    answer = subprocess.run(
        [sys.executable, "-c", ask],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(unpacked)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    resources, layouts = (Path(line) for line in answer.stdout.splitlines())
    assert resources.is_relative_to(unpacked) and layouts.is_relative_to(unpacked)
    assert files_under(resources) == files_under(REPOSITORY / "resources")
    assert files_under(layouts) == files_under(REPOSITORY / "layouts")
    assert "tour-guide.yaml" in files_under(layouts)
