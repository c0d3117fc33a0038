"""Screenshots of the window for every scenario, screen, scale, theme and language.

``python -m tests.ui.pictures OUT [--all]``; without ``--all`` a few that cover every pair of values. Each scale needs a
separate process, as Qt reads it at the start.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from PySide6.QtWidgets import QApplication

from caris_desktop.ui.language import ENGLISH
from caris_desktop.ui.theme import Theme
from tests.ui.test_every_size import LANGUAGES, SCALES, Case, Shown, everything, pairwise


def picture_name(case: Case) -> str:
    scenario, (width_px, height_px), scale, theme, language = case
    return f"{scenario}-{width_px}x{height_px}-{round(scale * 100)}-{theme}-{language}.png"


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--scale", type=float, default=0.0, help="only this one, in this process")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if not arguments.scale:
        for scale in SCALES:
            again = [sys.executable, "-m", "tests.ui.pictures", str(arguments.out), "--scale", str(scale)]
            again += ["--all"] if arguments.all else []
            subprocess.run(again, env={**os.environ, "QT_SCALE_FACTOR": f"{scale:g}"}, check=True)
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
    print(f"{found} flaws at {arguments.scale:g} times the size")
    return 0


if __name__ == "__main__":
    sys.exit(main())
