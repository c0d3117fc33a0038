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


def built_and_installed(folder: Path, *examples: Path) -> str:
    """Build wheels of these examples and install them below ``folder``; returns the PYTHONPATH."""
    wheels, there = folder / "wheels", folder / "there"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input"]
    made = ["wheel", "--quiet", "--no-build-isolation", "--no-deps", "--no-index", "--wheel-dir", wheels, *examples]
    subprocess.run([*pip, *made], check=True, timeout=200)
    assert len(list(wheels.iterdir())) == len(examples)
    subprocess.run(
        [*pip, "install", "--quiet", "--no-deps", "--target", there, *wheels.iterdir()], check=True, timeout=100
    )
    return os.pathsep.join((str(there), str(ROOT)))
