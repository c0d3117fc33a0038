"""Bar and timeline of a replay, saved as screenshots: ``python -m tests.ui.preview_replay OUT``."""

import argparse
import sys
from pathlib import Path

from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.ui.replay.timeline_items import NAMES_PX
from caris_desktop.ui.theme import Theme
from tests.ui.fake_replay import FakeReplay, ReplayScene, sample_coding, sample_overview
from tests.ui.preview import spin


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    app = QApplication(sys.argv[:1])
    for choice in ("dark", "light"):
        theme = Theme(app, "dark" if choice == "dark" else "light")
        for name, replay in scenes().items():
            if arguments.only and arguments.only not in f"{name}-{choice}":
                continue
            scene = ReplayScene(theme, replay)
            scene.show()
            spin(250)
            if name == "coding":
                coding(scene, arguments.out, choice)
            save(scene, arguments.out / f"{name}-{choice}.png")
            scene.close()
            scene.deleteLater()
    app.processEvents()
    return 0


def save(widget: QWidget, path: Path) -> None:
    widget.grab().save(str(path))
    print(path)


def scenes() -> dict[str, FakeReplay]:
    usual = FakeReplay(overview=sample_overview(), coding=sample_coding(120_000))
    usual.at_ms(34_500)
    hour = FakeReplay(duration_s=3600, overview=sample_overview(3600), coding=sample_coding(3_600_000))
    hour.at_ms(1_234_500)
    bare = FakeReplay(
        overview=sample_overview(video=False, sound=False), coding=AnnotationDocument(duration_ms=120_000)
    )
    many = FakeReplay(overview=sample_overview(more_tiers=24), coding=sample_coding(120_000))
    return {"coding": usual, "hour": hour, "uncoded": bare, "many": many, "waiting": FakeReplay()}


def coding(scene: ReplayScene, out: Path, choice: str) -> None:
    """The timeline during annotation."""
    canvas, timeline = scene.timeline.canvas, scene.timeline
    canvas.setFocus()
    canvas.zoom(4.0)
    first = scene.timeline.acts.document.annotations[5]
    rect = canvas.rect_of(first)
    assert rect is not None
    QTest.mouseClick(canvas, Qt.MouseButton.LeftButton, pos=rect.center().toPoint())
    spin(100)
    save(scene, out / f"selected-{choice}.png")
    QTest.mousePress(canvas, Qt.MouseButton.LeftButton, pos=rect.center().toPoint())
    QTest.mouseMove(canvas, rect.center().toPoint() + QPoint(90, 0))
    QTest.mouseMove(canvas, rect.center().toPoint() + QPoint(120, 0))
    spin(60)
    save(scene, out / f"moving-{choice}.png")
    QTest.mouseRelease(canvas, Qt.MouseButton.LeftButton, pos=rect.center().toPoint() + QPoint(120, 0))
    spin(60)
    save(scene, out / f"refused-{choice}.png")
    QTest.keyClick(canvas, Qt.Key.Key_Return)
    spin(100)
    save(scene, out / f"renaming-{choice}.png")
    timeline.acts.give_up()
    scene.bar.scrubber.setFocus()
    middle = QPoint(round(scene.bar.scrubber.x_of(scene.replay.playback.value.position_ns)) + 260, 16)
    QTest.mouseMove(scene.bar.scrubber, middle)
    spin(250)
    save(scene, out / f"scrubbing-{choice}.png")
    QTest.mouseMove(scene.bar.scrubber, QPoint(0, 200))
    timeline.open_tier_dialog()
    spin(200)
    _dialog(scene, "tier_dialog", out / f"tier-{choice}.png")
    timeline.open_import()
    spin(200)
    _dialog(scene, "import_dialog", out / f"import-{choice}.png")
    try:
        timeline.open_agreement()
    except NotImplementedError:
        print("agreement is not there yet")
    else:
        spin(200)
        _dialog(scene, "agreement_dialog", out / f"agreement-{choice}.png")
    canvas.select("")
    canvas.setFocus()
    scene.replay.play()
    scene.replay.at_ms(41_000)
    timeline.acts.code(2)
    scene.replay.at_ms(41_900)
    QTest.mouseMove(canvas, QPoint(NAMES_PX // 2, 200))
    spin(100)


def _dialog(scene: ReplayScene, name: str, path: Path) -> None:
    dialog = scene.findChild(QWidget, name)
    if dialog is not None:
        save(dialog, path)
        dialog.close()


if __name__ == "__main__":
    sys.exit(main())
