"""Wheel and source distribution contain the program's data files and its command."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from caris_desktop import __version__

REPOSITORY = Path(__file__).resolve().parents[2]


def files_under(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def build(target: str, source: Path, folder: Path) -> Path:
    """Wheel or source distribution of a source tree, built offline."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(folder)]
    subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=60, check=True)
    (made,) = folder.iterdir()
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", REPOSITORY, tmp_path_factory.mktemp("dist"))


def test_an_unpacked_wheel_finds_its_own_resources_and_layouts(wheel: Path, tmp_path: Path) -> None:
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
    menu = {"applications/caris-desktop.desktop", "icons/hicolor/scalable/apps/caris-desktop.svg"}
    assert {f"caris_desktop-{__version__}.data/data/share/{name}" for name in menu} <= files_under(unpacked)


@pytest.mark.long
def test_the_source_distribution_builds_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    sdist = build("sdist", REPOSITORY, tmp_path / "sdist")
    shutil.unpack_archive(sdist, tmp_path, filter="data")
    source = tmp_path / sdist.name.removesuffix(".tar.gz")
    contents = []
    for each in (wheel, build("wheel", source, tmp_path / "dist")):
        with zipfile.ZipFile(each) as archive:
            contents.append({entry.filename: entry.CRC for entry in archive.infolist()})
    assert contents[0] == contents[1]
    assert {path.name for path in source.iterdir()} >= {"LICENSE", "README.md", "packaging", "tests"}


@pytest.mark.long
def test_pip_installs_the_wheel_with_a_command_that_starts(wheel: Path, tmp_path: Path) -> None:
    """The dependencies are those of this environment; packaging/test-wheel.sh installs them, too."""
    prefix = tmp_path / "installed"
    pip = [sys.executable, "-m", "pip", "install", "--no-index", "--no-deps", "--ignore-installed"]
    subprocess.run([*pip, "--prefix", str(prefix), str(wheel)], capture_output=True, timeout=60, check=True)
    places = {"base": str(prefix), "platbase": str(prefix)}
    packages = sysconfig.get_path("purelib", "venv", places)
    command = Path(sysconfig.get_path("scripts", "venv", places)) / "caris-desktop"
    environment = os.environ | {"PYTHONPATH": packages, "HOME": str(tmp_path)}
    for argument, expected in (("--version", __version__), ("--help", "usage: caris-desktop")):
        ran = subprocess.run(
            [command, argument], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60, check=True
        )
        assert expected in ran.stdout
