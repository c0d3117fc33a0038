"""Screenshots of the window for every scenario, screen, scale, theme and language, and of every other window.

``python -m tests.ui.pictures OUT [--all]``; without ``--all`` a few that cover every pair of values. Each scale needs a
separate process, as Qt reads it at the start. ``--before FOLDER`` compares with pictures of an earlier commit and saves
those that differ side by side in ``OUT/changed``.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6.QtGui import QImage, QPainter
from PySide6.QtWidgets import QApplication

from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_appearance import ENGLISH
from tests.ui.every_window import USUAL, EveryWindow
from tests.ui.test_every_size import LANGUAGES, SCALES, Case, Shown, everything, pairwise


def picture_name(case: Case) -> str:
    scenario, (width_px, height_px), scale, theme, language = case
    return f"{scenario}-{width_px}x{height_px}-{round(scale * 100)}-{theme}-{language}.png"


def save_every_window(theme: Theme, out: Path) -> None:
    """Save a picture of each dialog, card and secondary window, in both themes."""
    for choice in ("dark", "light"):
        theme.set_choice(choice)
        opened = EveryWindow(theme, ENGLISH)
        for number, seen in enumerate(opened.seen(with_what_is_beside=True)):
            opened.flaws_in(seen, USUAL)
            seen.part.grab().save(str(out / f"window-{choice}-{number:02}-{seen.name.replace(' ', '-')}.png"))
        opened.close()


def _pixels(picture: QImage) -> NDArray[np.uint8]:
    rgba = picture.convertToFormat(QImage.Format.Format_RGBA8888)
    return np.frombuffer(rgba.constBits(), np.uint8).reshape(rgba.height(), rgba.width(), 4).copy()


def compare(before: Path, after: Path) -> list[str]:
    """List the pictures that are new, gone or different; save a pair of each different one in ``after/changed``."""
    names = {path.name for folder in (before, after) for path in folder.glob("*.png")}
    changes = []
    for name in sorted(names):
        old, new = QImage(str(before / name)), QImage(str(after / name))
        if old.isNull() or new.isNull():
            changes.append(f"{name}: {'new' if old.isNull() else 'gone'}")
        elif old.size() != new.size() or (different := int((_pixels(old) != _pixels(new)).any(axis=2).sum())):
            changes.append(f"{name}: {'another size' if old.size() != new.size() else f'{different} pixels differ'}")
            pair = QImage(old.width() + new.width(), max(old.height(), new.height()), QImage.Format.Format_RGB32)
            pair.fill(0)
            painter = QPainter(pair)
            painter.drawImage(0, 0, old)
            painter.drawImage(old.width(), 0, new)
            painter.end()
            (after / "changed").mkdir(exist_ok=True)
            pair.save(str(after / "changed" / name))
    return changes


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--scale", type=float, default=0.0, help="only this one, in this process")
    parser.add_argument("--before", type=Path, help="folder with pictures of an earlier commit")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if not arguments.scale:
        for scale in SCALES:
            again = [sys.executable, "-m", "tests.ui.pictures", str(arguments.out), "--scale", str(scale)]
            again += ["--all"] if arguments.all else []
            subprocess.run(again, env={**os.environ, "QT_SCALE_FACTOR": f"{scale:g}"}, check=True)
        if arguments.before:
            print(*compare(arguments.before, arguments.out), sep="\n")
        return 0
    cases = [case for case in (everything() if arguments.all else pairwise(everything())) if case[2] == arguments.scale]
    app = QApplication(sys.argv[:1])
    theme, found = Theme(app, "dark"), 0
    for language in LANGUAGES:
        shown = Shown(theme, language)
        for case in sorted(case for case in cases if case[4] == language):
            flaws = shown.flaws_in(case)
            shown.window.grab().save(str(arguments.out / picture_name(case)))
            found += len(flaws)
            print(picture_name(case), *(f"\n  {flaw}" for flaw in flaws))
        shown.speaks.use(ENGLISH)
        shown.window.close()
    if arguments.scale == 1.0:
        save_every_window(theme, arguments.out)
    print(f"{found} flaws at {arguments.scale:g} times the size")
    return 0


if __name__ == "__main__":
    sys.exit(main())
