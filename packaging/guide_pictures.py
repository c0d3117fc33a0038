"""Takes the pictures of the guide's pages: ``python packaging/guide_pictures.py FOLDER [THEME]``.

The console runs on its own simulated robot; each picture is the part of the window that its page is about.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from PySide6.QtCore import QPoint, QRect, QSettings, QTimer
from PySide6.QtWidgets import QAbstractButton, QApplication, QDialog, QLabel, QMenu, QWidget

from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.domain import intents
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.ui.notifications import AlarmsButton
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.protocol_strip import BranchesCard

_SIZE_PX = (1366, 768)
_MARGIN_PX = 24
_LOOK_MS, _SETTLED_MS, _GIVE_UP_MS = 50, 1500, 120_000
_Wait = Callable[[], object]


class Pictures:
    """Takes one picture after another, each once the window shows its content."""

    def __init__(self, run: ConsoleRun, folder: Path) -> None:
        self._run = run
        self._folder = folder
        self._steps = self._all()
        self.done = False

    def next(self) -> None:
        """Do the next step; the following one starts once its condition has been true for a while."""
        ready = next(self._steps, None)
        if ready is None:
            self.done = True
            self._run.application.quit()
            return
        self._look(ready)

    def _look(self, ready: _Wait) -> None:
        if ready():
            QTimer.singleShot(_SETTLED_MS, self.next)
        else:
            QTimer.singleShot(_LOOK_MS, lambda: self._look(ready))

    def _all(self) -> Iterator[_Wait]:
        window, state = self._run.window, self._run.console.state
        yield lambda: state.link.value.state == "connected" and state.frame.value is not None and state.scan.value
        window.show_command_palette()
        self._type("kit")
        yield self._card
        self._take("palette", self._around(self._card()))
        yield self._away
        window.show_preflight()
        yield self._card
        self._take("preflight", self._around(self._card()))
        yield self._away
        window.show_shortcuts()
        yield self._card
        self._take("shortcuts", self._around(self._card()))
        yield self._away
        window.show_set_up()
        yield self._card
        self._take("first-use", self._around(self._card()))
        yield self._away
        window.robots.open_dialog()
        yield self._dialog
        dialog = self._dialog()
        assert dialog is not None  # noqa: S101 - it was waited for
        look, summary = dialog.findChild(QAbstractButton, "robot_look"), dialog.findChild(QLabel, "robot_summary")
        assert look is not None and summary is not None  # noqa: S101 - parts of every such dialog
        look.click()
        yield lambda: summary.isVisible() and summary.text()
        dialog.grab().save(str(self._folder / "robot-dialog.png"))
        dialog.close()
        yield lambda: self._dialog() is None
        window.practice.begin()
        yield lambda: state.practice.value.state == "running" and state.frame.freshness == "fresh"
        self._take("practice", window.rect())
        end = window.findChild(QAbstractButton, "practice_end")
        assert end is not None  # noqa: S101 - it has begun
        for _ in ("end", "close what came of it"):
            end.click()
        yield from self._of_the_reception()

    def _of_the_reception(self) -> Iterator[_Wait]:
        window, console = self._run.window, self._run.console
        console.do(intents.OpenScenario(layouts_dir() / "reception.yaml"))
        yield lambda: console.scenario.title == "Reception" and window.board.whole
        for _ in range(2):
            console.do(intents.NextStep())
        yield lambda: console.state.protocol.value.title == "Greet" and console.state.frame.freshness == "fresh"
        window.hold.escape_pressed.emit()  # closes the note on its session
        self._take("small-screen", window.rect())
        choices = self._run.window.findChild(QAbstractButton, "strip_branch")
        assert choices is not None  # noqa: S101 - a part of every window
        choices.click()
        yield self._branches
        branches = self._branches()
        assert branches is not None  # noqa: S101 - it was waited for
        below = self._around(branches).bottom() + _MARGIN_PX
        self._take("protocol", QRect(0, 0, window.width(), below))
        branches.hide()
        menu = self._layout_menu()
        menu.popup(window.mapToGlobal(QPoint(window.width() // 2, _MARGIN_PX)))
        yield menu.isVisible
        menu.grab().save(str(self._folder / "layout-menu.png"))
        menu.close()
        robot, alarms = self._run.demo_robot, window.findChild(AlarmsButton)
        assert robot is not None and alarms is not None  # noqa: S101 - the demonstration has both
        robot.stop()
        yield lambda: bool(console.state.alarms.value)
        alarms.click()
        yield self._card
        self._take("alarms", self._around(self._card()))
        yield self._away

    def _branches(self) -> QWidget | None:
        card = self._run.window.findChild(BranchesCard)
        return card if card is not None and card.isVisible() else None

    def _layout_menu(self) -> QMenu:
        window = self._run.window
        window.menus.open_window_menu()
        whole = next(menu for menu in window.findChildren(QMenu) if menu.objectName() == "window_menu")
        whole.close()
        return next(menu for menu in whole.findChildren(QMenu) if menu.objectName() == "layout_menu")

    def _take(self, name: str, part: QRect) -> None:
        self._run.window.grab(part).save(str(self._folder / f"{name}.png"))

    def _around(self, widget: QWidget | None) -> QRect:
        window = self._run.window
        if widget is None:
            return window.rect()
        return QRect(widget.mapTo(window, QPoint()), widget.size())

    def _card(self) -> QWidget | None:
        open_ = (overlay for overlay in self._run.window.findChildren(Overlay) if overlay.isVisible())
        return next((overlay.card for overlay in open_), None)

    def _dialog(self) -> QDialog | None:
        shown = (widget for widget in QApplication.topLevelWidgets() if widget.isVisible())
        return next((widget for widget in shown if isinstance(widget, QDialog)), None)

    def _type(self, text: str) -> None:
        field = QApplication.focusWidget()
        if field is not None:
            field.setProperty("text", text)

    def _away(self) -> bool:
        """Close what is open; True once nothing is open."""
        for overlay in self._run.window.findChildren(Overlay):
            overlay.close_overlay()
        return self._card() is None


def main(folder: Path, theme: str) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as private:
        settings = QSettings(str(Path(private) / "settings.ini"), QSettings.Format.IniFormat)
        arguments = default_arguments(scenario="tour-guide", theme=theme, study=Path(private) / "study", demo=True)
        run = ConsoleRun(arguments, settings=settings)
        run.window.resize(*_SIZE_PX)
        run.show()
        pictures = Pictures(run, folder)
        QTimer.singleShot(_LOOK_MS, pictures.next)
        QTimer.singleShot(_GIVE_UP_MS, run.application.quit)
        run.application.exec()
        run.close()
    return 0 if pictures.done else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "dark"))
