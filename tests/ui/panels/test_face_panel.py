"""Robot's face: panel, window and editor."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QSlider, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.face.drawing import FaceState, drawing_of
from caris_desktop.conversation.face.face_file import Face, load_face, parse_face
from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.live.status import FaceStatus
from caris_desktop.scenario.scenario_model import PanelLeaf, SplitNode
from caris_desktop.ui.face_window import FaceView
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.face_panel import FacePanel
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole

FACE_INTENTS = (
    intents.UseFace, intents.KeepFace, intents.ShowExpression, intents.ShowOnFace,
    intents.ShowFaceWindow, intents.ServeFace,
)  # fmt: skip
CALM = FaceStatus("calm", "Calm", "calm", ("calm", "happy"), "face")


class Console(FakeConsole):
    """Records the requests about the face."""

    refusal = ""

    def do(self, intent: Intent) -> str:
        if isinstance(intent, FACE_INTENTS):
            self.calls.append((type(intent).__name__, intent))
            return self.refusal
        return super().do(intent)

    @property
    def asked(self) -> list[Any]:
        return [intent for _, intent in self.calls if isinstance(intent, Intent)]


@pytest.fixture
def console() -> Console:
    layout = SplitNode("horizontal", (PanelLeaf("video"), PanelLeaf("face")))
    console = Console(replace(samples.TOUR, layout=layout))
    console.state.face.set(CALM)
    return console


@pytest.fixture
def window(qtbot: QtBot, console: Console, settings: MemorySettings, theme: Theme) -> MainWindow:
    return open_window(qtbot, console, settings, theme)


@pytest.fixture
def panel(window: MainWindow) -> FacePanel:
    panel = window.panels["face"]
    assert isinstance(panel, FacePanel)
    return panel


def color_in_the_middle_of(view: QWidget) -> str:
    return str(QColor(view.grab().toImage().pixelColor(view.rect().center())).name())


def test_each_expression_has_a_button_and_a_key(qtbot: QtBot, console: Console, panel: FacePanel) -> None:
    click(qtbot, find(panel, "expression_2"))
    QTest.keyClick(
        panel.window(), Qt.Key.Key_F1, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier
    )
    assert console.asked == [intents.ShowExpression("happy"), intents.ShowExpression("calm")]
    console.state.face.set(replace(CALM, expressions=("calm", "sad", "sorry")))
    QApplication.processEvents()
    assert [find(panel, f"expression_{number}").text() for number in (1, 2, 3)] == ["calm", "sad", "sorry"]


def test_the_title_says_what_it_does_and_whether_anybody_can_see_it(console: Console, panel: FacePanel) -> None:
    assert panel.fact == ("calm · not on a screen", "dim")
    console.state.face.set(replace(CALM, window=True, speaking=True))
    assert panel.fact == ("speaking · calm", "blue")
    console.state.face.set(replace(CALM, pages=1, served=True, what="text", text="Back soon"))
    assert panel.fact == ("showing text", "dim")


def test_the_panel_shows_what_the_participant_sees(console: Console, panel: FacePanel) -> None:
    view = panel.findChild(FaceView)
    console.state.face_drawing.reset_value(drawing_of(Face("A", background="#204060"), FaceState()))
    assert color_in_the_middle_of(view) == "#204060"
    console.state.face_drawing.reset_value(np.full((40, 60, 3), (10, 20, 200), np.uint8))
    assert color_in_the_middle_of(view) == "#c8140a"
    image = QImage(8, 8, QImage.Format.Format_RGB32)
    image.fill(QColor("#00ff00"))
    console.state.face_drawing.reset_value(None)
    assert color_in_the_middle_of(view) == "#000000"


def test_a_text_is_saved_in_its_field_when_it_is_refused(qtbot: QtBot, console: Console, panel: FacePanel) -> None:
    field = find(panel, "face_text")
    assert isinstance(field, QLineEdit)
    field.setFocus()
    console.refusal = "no"
    qtbot.keyClicks(field, "Back soon")
    qtbot.keyClick(field, Qt.Key.Key_Return)
    assert (console.asked, field.text()) == ([intents.ShowOnFace("text", "Back soon")], "Back soon")
    console.refusal = ""
    qtbot.keyClick(field, Qt.Key.Key_Return)
    assert field.text() == ""
    console.state.face.set(replace(CALM, what="text", text="Back soon"))
    click(qtbot, find(panel, "face_again"))
    assert console.asked[-1] == intents.ShowOnFace("face")


def test_the_window_comes_and_goes_as_asked_and_never_takes_the_keys(
    qtbot: QtBot, console: Console, window: MainWindow, panel: FacePanel
) -> None:
    click(qtbot, find(window, "face_window_button"))
    assert console.asked == [intents.ShowFaceWindow(on=True)]
    console.state.face.set(replace(CALM, window=True))
    (shown,) = [widget for widget in QApplication.topLevelWidgets() if widget.objectName() == "face_window"]
    assert shown.isVisible() and QApplication.activeWindow() is window
    console.state.face_drawing.reset_value(drawing_of(Face("A", background="#204060"), FaceState()))
    assert color_in_the_middle_of(shown) == "#204060"
    console.state.face.set(CALM)
    assert not shown.isVisible()


def test_the_address_of_the_page_is_shown_and_copied(qtbot: QtBot, console: Console, panel: FacePanel) -> None:
    click(qtbot, find(panel.window(), "face_page_button"))
    assert console.asked == [intents.ServeFace(on=True)]
    panel.window().resize(1366, 900)
    console.state.face_page.set("http://127.0.0.1:1/secret/")
    assert "http://127.0.0.1:1/secret/" in find(panel, "face_address").text()
    click(qtbot, find(panel, "face_copy_address"))
    assert QApplication.clipboard().text() == "http://127.0.0.1:1/secret/"


def test_a_face_is_changed_next_to_its_preview_and_saved_under_a_name(
    qtbot: QtBot, console: Console, window: MainWindow
) -> None:
    window.faces.edit()
    editor = window.findChild(QWidget, "face_editor")
    smile = editor.findChild(QSlider, "face_expression_smile")
    width = editor.findChild(QSlider, "face_eyes_width")
    smile.setValue(smile.maximum())
    width.setValue(width.minimum())
    ink = editor.findChild(QLineEdit, "face_ink")
    qtbot.waitUntil(editor.isActiveWindow)
    ink.setFocus()
    ink.selectAll()
    qtbot.keyClicks(ink, "#12345")
    assert "#rrggbb" in editor.findChild(QWidget, "face_note").text()
    qtbot.keyClicks(ink, "6")
    name = editor.findChild(QLineEdit, "face_name")
    name.setFocus()
    name.selectAll()
    qtbot.keyClicks(name, "mine")
    click(qtbot, editor.findChild(QWidget, "face_keep"))
    (asked,) = console.asked
    kept = parse_face(asked.content, file_name="kept", name=asked.name)
    calm = load_face("calm")
    assert (kept.name, kept.ink, kept.eyes.width, kept.expressions[0].smile) == ("mine", "#123456", 2.0, 1.0)
    assert (kept.mouth, kept.expressions[1:]) == (calm.mouth, calm.expressions[1:])
    editor.close()
