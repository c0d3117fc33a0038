"""Packages with plug-ins, installed into a folder."""

from pathlib import Path
from textwrap import dedent

import pytest


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
