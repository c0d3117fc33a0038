"""Packages with plug-ins, installed into a folder."""

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

from caris_desktop.domain.plugin_process import SWITCHED_OFF

ROOT = Path(__file__).parents[2]


def install(folder: Path, group: str, name: str, source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install version 2.1 of the package ``lab-NAME`` whose plug-in is called ``Plugin``, for this process and its
    children.
    """
    module = f"lab_{name.replace('-', '_')}"
    folder.mkdir(exist_ok=True)
    (folder / f"{module}.py").write_text(dedent(source), "utf-8")
    about = folder / f"{module}-2.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: lab-{name}\nVersion: 2.1\n", "utf-8")
    (about / "entry_points.txt").write_text(f"[caris_desktop.{group}]\n{name} = {module}:Plugin\n", "utf-8")
    monkeypatch.syspath_prepend(str(folder))
    SWITCHED_OFF.clear()


def built_and_installed(example: Path, folder: Path) -> str:
    """Build the wheel of an example of ``examples/plugins`` and install it below ``folder``; returns the PYTHONPATH."""
    wheels, there = folder / "wheels", folder / "there"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input"]
    made = ["wheel", "--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", wheels, example]
    subprocess.run([*pip, *made], check=True, timeout=100)
    (wheel,) = wheels.iterdir()
    subprocess.run([*pip, "install", "--quiet", "--no-deps", "--target", there, wheel], check=True, timeout=100)
    return os.pathsep.join((str(there), str(ROOT)))


def listed(python_path: str) -> str:
    """What ``caris-desktop plugins`` says."""
    done = subprocess.run(
        [sys.executable, "-m", "caris_desktop", "plugins"],
        env={**os.environ, "PYTHONPATH": python_path}, capture_output=True, text=True, check=True, timeout=100,
    )  # fmt: skip
    return done.stdout


def check_example(name: str, folder: Path, line: str) -> str:
    """Build, install, list and test an example by its own test; returns the PYTHONPATH with which it is there."""
    example = ROOT / "examples" / "plugins" / name
    path = built_and_installed(example, folder)
    assert line in listed(path)
    (test,) = example.glob("test_*.py")
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", folder, test]
    subprocess.run([sys.executable, *words], env={**os.environ, "PYTHONPATH": path}, check=True, timeout=100)
    (module,) = example.glob("caris_*.py")
    assert module.read_text("utf-8").count("\n") <= 60
    assert line not in listed(str(ROOT))
    return path
