"""Window on a virtual screen for ``test_desktop``: ``python -m tests.ui.desktop_subject``.

It prints each intent and each change of the displayed state, and executes commands from stdin.
"""

import sys
import time
from collections.abc import Callable

from PySide6.QtCore import QPoint, QRect, Qt, QTimer
from PySide6.QtWidgets import QApplication, QComboBox, QCompleter, QDialog, QLineEdit, QPushButton, QWidget

from caris_desktop.live.gamepad import Gamepads
from caris_desktop.scenario.scenario_model import panels_in
from caris_desktop.ui.dock_layout import groups_in, without
from caris_desktop.ui.input import drive_input_filter, physical_keys
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.speak.speak_field import SpeakField
from tests.support.stdin_commands import StdinCommands
from tests.support.virtual_gamepad import VirtualGamepad
from tests.ui import samples
from tests.ui.fake_console import FakeConsole

# test_drive_keys covers the limit for a double Esc with a simulated clock; this machine may be slow.
drive_input_filter.DOUBLE_STOP_S = 60.0


class Subject(StdinCommands):
    """The window, with commands for the test."""

    def __init__(self) -> None:
        super().__init__()
        self.console = FakeConsole(samples.TOUR)
        samples.fill_console(self.console)
        self.console.calls.clear()
        self.gamepads = Gamepads(self.console.state, lambda event: print("GAMEPAD", event.connected, flush=True))
        self.window = MainWindow(self.console, gamepads=self.gamepads)
        self.window.closed.connect(lambda: print("CLOSED", flush=True))
        self.window.layout_keeper.set_adapts(False)
        self.window.resize(1200, 700)
        field = self.window.findChild(SpeakField, "speak_field")
        assert field is not None
        self.field: SpeakField = field
        self.combo = QComboBox(self.window)
        self.combo.addItems(["one", "two", "three"])
        self.combo.setGeometry(500, 300, 120, 30)
        self.line = QLineEdit(self.window)
        self.line.setCompleter(QCompleter(["hello", "help"], self.line))
        self.line.setGeometry(500, 340, 120, 30)
        self.line.hide()
        self.button = QPushButton(self.window)
        self.button.setGeometry(500, 380, 120, 30)
        self.button.hide()
        self.pad: VirtualGamepad | None = None
        self._told = 0
        self._shown: dict[str, object] = {}
        self._timer = QTimer(interval=5)
        self._timer.timeout.connect(self._notify)
        self._timer.start()
        self.window.show()

    def _notify(self) -> None:
        for name, arguments in self.console.calls[self._told :]:
            print(name, arguments, flush=True)
        self._told = len(self.console.calls)
        popup, dialog = QApplication.activePopupWidget(), QApplication.activeModalWidget()
        shown = {
            "READY": self.window.isActiveWindow(),
            "TEXT": self._text(),
            "POPUP": popup is not None,
            "DIALOG": dialog is not None,
            "ACTIVE": type(QApplication.activeWindow()).__name__,
            "KEYS": self.window.hold.key_owner,
            "QUESTION": self._question(),
            "CAP": self.window.actions_table.key_text("drive_forward"),
            "LAYOUT": self._layout(),
            "PALETTE": (palette := self.window.findChild(QWidget, "command_palette")) is not None
            and palette.isVisible(),
        }
        for name, value in shown.items():
            if self._shown.get(name) != value:
                print(name, value, flush=True)
        self._shown = shown

    def _text(self) -> tuple[str, int]:
        if self.line.isVisible():
            return self.line.text(), self.line.cursorPosition()
        return self.field.toPlainText(), self.field.textCursor().position()

    def _layout(self) -> str:
        """Groups from left and top, tabs joined by +, floating panels after a ~."""
        arrangement = self.window.dock_host.arrangement
        if arrangement is None:
            return ""
        main = without(arrangement.tree, arrangement.hidden | arrangement.afloat)
        trees = [*([main] if main is not None else []), *(window.tree for window in arrangement.floating)]
        return " ~ ".join(" ".join("+".join(panels_in(group)) for group in groups_in(tree)) for tree in trees)

    def _question(self) -> str | None:
        band = self.window.findChild(QWidget, "question_band")
        return band.accessibleName() if band is not None and band.isVisible() else None

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        getattr(self, f"do_{word}")(*rest.split())

    def do_quit(self) -> None:
        QApplication.quit()

    def do_reset(self, number: str) -> None:
        """Restore the initial state: nothing open, no key held, the video in focus."""
        for widget in QApplication.topLevelWidgets():
            if widget is not self.window and (
                isinstance(widget, QDialog) or widget.windowType() == Qt.WindowType.Popup
            ):
                widget.close()
        if self.window.layout_keeper.is_own:
            self.window.layout_keeper.revert()
        self.line.hide()
        self.button.hide()
        self.line.clear()
        self.field.clear()
        self.console.clear_emergency_stop()
        self.window.hold.release_all("reset")
        self.window.hold.escape_pressed.emit()
        self.window.hold._last_escape = (
            drive_input_filter._NEVER
        )  # the next Esc is not the second one of an earlier test
        self.window.activateWindow()
        self.window.focus_driving()
        self._begin(number, time.monotonic() + 15.0)

    def _begin(self, number: str, deadline_s: float) -> None:
        """Start once the window has the focus, so that later states are reported as changes."""
        if self.window.hold.key_owner != "driving" and time.monotonic() < deadline_s:
            QTimer.singleShot(10, self, lambda: self._begin(number, deadline_s))
            return
        self._notify()
        self.console.calls.clear()
        self._told = 0
        print("RESET", number, flush=True)

    def do_nobody(self) -> None:
        self.console.state.persons.set(())

    def do_dialog(self) -> None:
        self.window.sessions.open_start_dialog()

    def do_slow_stop(self, seconds: str) -> None:
        """Let the next stop take this long, as on a busy machine."""
        stop = self.console.stop

        def slow_stop() -> None:
            del self.console.stop
            time.sleep(float(seconds))
            stop()

        self.console.stop = slow_stop  # type: ignore[method-assign]

    def do_keep_keys(self, seconds: str) -> None:
        physical_keys.KEPT_S = float(seconds)
        self.window.hold._keyboard_grab.give_back()

    def do_combo(self) -> None:
        self.combo.show()
        self.combo.raise_()
        self.combo.showPopup()

    def do_count_presses(self) -> None:
        """Focus a button as by Tab, and print how often it was pressed at each release."""
        presses: list[None] = []
        self.button.pressed.connect(lambda: presses.append(None))
        self.button.clicked.connect(lambda: print("CLICKED", len(presses), flush=True))
        self.button.show()
        self.button.setFocus(Qt.FocusReason.TabFocusReason)

    def do_completer(self) -> None:
        self.line.show()
        self.line.raise_()
        self.line.setFocus()

    def do_float(self, name: str, x: str, y: str) -> None:
        self.window.dock_host.float_panel(name, QRect(int(x), int(y), 420, 300))  # type: ignore[arg-type]

    def do_focus(self, name: str) -> None:
        widget = self.window.findChild(QWidget, name)
        assert widget is not None
        widget.setFocus()

    def do_where(self, name: str) -> None:
        widget = next(widget for widget in QApplication.allWidgets() if widget.objectName() == name)
        center = widget.mapToGlobal(QPoint(widget.width() // 2, widget.height() // 2))
        print("WHERE", name, center.x(), center.y(), flush=True)

    def do_title(self, name: str) -> None:
        """Print where the panel can be dragged: the title of its dock or its tab."""
        host = self.window.dock_host
        bar = next((bar for bar in host.bars if name in bar.panels), None)
        if bar is None:
            place = host.docks[name].mapToGlobal(QPoint(60, 12))  # type: ignore[index]
        else:
            place = bar.mapToGlobal(bar.tabRect(bar.panels.index(name)).center())  # type: ignore[arg-type]
        print("TITLE", name, place.x(), place.y(), flush=True)

    def do_float_button(self, name: str) -> None:
        button = self.window.dock_host.docks[name].findChild(QWidget, "float_button")  # type: ignore[index]
        assert button is not None
        place = button.mapToGlobal(button.rect().center())
        print("FLOAT_BUTTON", name, place.x(), place.y(), flush=True)

    def do_lock(self, word: str) -> None:
        self.window.layout_keeper.set_locked(word == "on")
        print("LOCKED", word, flush=True)

    def do_plug(self) -> None:
        self._when_sdl_is_up(lambda: setattr(self, "pad", VirtualGamepad()))

    def do_pad(self, action: str, *numbers: str) -> None:
        assert self.pad is not None
        if action == "push":
            self.pad.push(int(numbers[0]), float(numbers[1]))
        else:
            getattr(self.pad, action)(*(int(number) for number in numbers))

    def _when_sdl_is_up(self, do: Callable[[], None]) -> None:
        self.gamepads.start()
        try:
            do()
        except RuntimeError:
            QTimer.singleShot(20, self, lambda: self._when_sdl_is_up(do))


if __name__ == "__main__":
    app = QApplication([])
    subject = Subject()
    status = app.exec()
    subject.gamepads.stop()
    sys.exit(status)
