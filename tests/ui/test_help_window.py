"""Guide in the program: each panel and window has a page, available offline."""

import re
from pathlib import Path

import pytest
from PySide6.QtCore import Qt, QUrl
from PySide6.QtGui import QImage, QTextDocument
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QApplication, QLineEdit
from pytestqt.qtbot import QtBot

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.ui.help_window import FIRST_PAGE, PAGES, GuideBrowser, HelpWindow, anchor_of, guide_dir
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel_table import PANELS
from tests.support.window_classes import widget_classes, window_classes
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "speak", "people")

WITHOUT_A_PAGE = {
    "MainWindow": "its panels have pages",
    "FloatingWindow": "its panels have pages",
    "HelpWindow": "it is the help",
    "ClosingWindow": "takes no input",
    "Dock": "its panel has a page",
    "DragWords": "takes no input",
    "ChoiceCard": "lies in a panel, whose page is shown",
    "NameCard": "lies in a panel, whose page is shown",
}
ADDRESS = re.compile(r"\]\(([^)]+)\)")


def headings(page: Path) -> set[str]:
    lines = page.read_text(encoding="utf-8").splitlines()
    return {anchor_of(line.lstrip("# ")) for line in lines if re.match("#+ ", line)}


def opened(window: MainWindow) -> HelpWindow:
    (found,) = (one for one in window.findChildren(HelpWindow) if one.isVisible())
    return found


def shown(qtbot: QtBot, window: MainWindow) -> HelpWindow:
    found = opened(window)
    qtbot.waitUntil(lambda: QApplication.activeWindow() is found)
    return found


def page(help_window: HelpWindow) -> str:
    source = help_window.browser.source()
    return source.fileName() + (f"#{source.fragment()}" if source.hasFragment() else "")


@pytest.mark.long
def test_each_panel_and_window_has_a_page() -> None:
    wanted = {f"{name.capitalize()}Panel" for name in PANELS} | {kind.__name__ for kind in window_classes()}
    assert wanted - set(WITHOUT_A_PAGE) <= set(PAGES)
    assert set(PAGES) <= {kind.__name__ for kind in widget_classes()}, "a page for something that is not there"
    assert set(WITHOUT_A_PAGE) <= wanted


def test_each_page_and_each_link_between_pages_is_there() -> None:
    guide = guide_dir()
    linked = [(file, link) for file in guide.glob("*.md") for link in ADDRESS.findall(file.read_text("utf-8"))]
    assert len(linked) > 40
    for file, link in [(guide / FIRST_PAGE, link) for link in (*PAGES.values(), FIRST_PAGE)] + linked:
        name, _, anchor = link.partition("#")
        target = file.parent / name if name else file
        assert target.is_file(), f"{file.name}: {link}"
        assert not anchor or anchor in headings(target), f"{file.name}: {link}"


def test_ctrl_f1_shows_the_page_of_the_panel_that_has_the_keys(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClick(field, Qt.Key.Key_F1, Qt.KeyboardModifier.ControlModifier)
    assert page(shown(qtbot, window)) == PAGES["SpeakPanel"]
    assert "Speaking" in shown(qtbot, window).browser.toPlainText()
    assert QApplication.focusWidget() is shown(qtbot, window).browser
    assert not window.actions_table.driving_focus
    window.hold.escape_pressed.emit()
    assert not window.findChildren(HelpWindow)[0].isVisible()
    window.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is window)
    find(window, "video_view").setFocus()
    window.actions_table.run("help")
    assert page(shown(qtbot, window)) == PAGES["VideoPanel"]
    assert console.named("say") == []


def test_f1_is_a_phrase_in_the_window_and_help_in_another_one(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    QTest.keyClick(find(window, "video_view"), Qt.Key.Key_F1)
    assert len(console.named("say")) == 1
    window.sessions.open_start_dialog()
    dialog = QApplication.activeModalWidget()
    assert dialog is not None and dialog.objectName() == "start_dialog"
    QTest.keyClick(dialog, Qt.Key.Key_F1)
    assert len(console.named("say")) == 1
    assert page(opened(window)) == PAGES["StartDialog"]
    assert opened(window).parentWidget() is dialog, "a window of the console would be blocked by the dialog"
    opened(window).close()
    dialog.close()


def test_f1_is_help_in_the_editor_of_the_scenario(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    window.editor.open()
    qtbot.waitUntil(lambda: window.editor.editor is not None)
    editor = window.editor.editor
    assert editor is not None
    qtbot.waitUntil(lambda: QApplication.activeWindow() is editor)
    QTest.keyClick(QApplication.focusWidget() or editor, Qt.Key.Key_F1)
    assert page(shown(qtbot, window)) == PAGES["ScenarioEditor"]
    assert console.named("say") == []
    shown(qtbot, window).close()
    window.editor.close()


def test_a_link_leads_to_its_heading_and_back_returns(qtbot: QtBot, window: MainWindow) -> None:
    window.actions_table.run("help")
    help_window = shown(qtbot, window)
    help_window.show_page("conversation.md")
    browser = help_window.browser
    browser.setSource(QUrl("conversation.md#response-time"))
    assert browser.verticalScrollBar().value() > 0
    browser.setSource(QUrl("keys.md"))
    assert browser.source().fileName() == "keys.md" and "Change keys" in browser.toPlainText()
    back = help_window.findChild(QAbstractButton, "help_back")
    assert back is not None
    back.click()
    assert page(shown(qtbot, window)) == "conversation.md#response-time"


@pytest.mark.parametrize("link", ["https://example.org/x.md", "file:///etc/passwd", "../../README.md", "missing.md"])
def test_a_link_out_of_the_guide_is_not_followed(qtbot: QtBot, window: MainWindow, link: str) -> None:
    window.actions_table.run("help")
    browser = shown(qtbot, window).browser
    before = browser.source()
    browser.setSource(QUrl(link))
    assert browser.source() == before and len(browser.toPlainText()) > 1000
    picture = QTextDocument.ResourceType.ImageResource
    assert browser.loadResource(picture.value, before.resolved(QUrl(link))) is None


def test_pictures_of_the_guide_fit_into_the_window(qtbot: QtBot) -> None:
    browser = GuideBrowser()
    qtbot.addWidget(browser)
    browser.resize(400, 300)
    browser.show()
    path = resources_dir() / "screenshots" / "guide" / "alarms.png"
    picture = browser.loadResource(QTextDocument.ResourceType.ImageResource.value, QUrl.fromLocalFile(str(path)))
    assert isinstance(picture, QImage) and 0 < picture.width() <= 400


def test_search_continues_at_the_top_after_the_last_find(qtbot: QtBot, window: MainWindow) -> None:
    window.actions_table.run("help")
    help_window = shown(qtbot, window)
    help_window.show_page("keys.md")
    QTest.keyClick(help_window.browser, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier)
    field = QApplication.focusWidget()
    assert isinstance(field, QLineEdit) and field.objectName() == "help_search"
    field.setText("Find anything")
    found = set()
    for _ in range(len(re.findall("find anything", help_window.browser.toPlainText(), re.IGNORECASE)) + 1):
        field.returnPressed.emit()
        assert help_window.browser.textCursor().selectedText().lower() == "find anything"
        found.add(help_window.browser.textCursor().position())
    assert found


@pytest.mark.parametrize("page", sorted(path.name for path in guide_dir().glob("*.md")))
def test_each_paragraph_of_a_page_has_its_room(qtbot: QtBot, page: str) -> None:
    browser = GuideBrowser()
    qtbot.addWidget(browser)
    browser.resize(860, 640)
    browser.show()
    browser.setSource(QUrl.fromLocalFile(str(guide_dir() / page)), QTextDocument.ResourceType.MarkdownResource)
    layout, block = browser.document().documentLayout(), browser.document().begin()
    hidden = []
    while block.isValid():
        if block.text() and layout.blockBoundingRect(block).height() < 1:
            hidden.append(block.text())
        block = block.next()
    assert not hidden
