"""Help window: the installed guide, offline, at the page of the panel or window that has the focus."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QSize, Qt, QUrl
from PySide6.QtGui import QImage, QKeySequence, QShortcut, QTextCursor, QTextDocument
from PySide6.QtWidgets import QApplication, QTextBrowser, QWidget

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.focus_widget import VisualTabOrderMixin, focused_widget
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import line_edit, named
from caris_desktop.ui.window_place import bring_up

_PICTURE_MARGIN_PX, _ABOVE_HEADING_PX = 40, 18


class GuideBrowser(QTextBrowser):
    """Markdown pages and pictures of the installed resources. Any other link is not followed."""

    def __init__(self) -> None:
        super().__init__()
        # Tab leaves the page, as in every window; the list of pages reaches the same by keyboard.
        by_mouse = Qt.TextInteractionFlag.LinksAccessibleByMouse | Qt.TextInteractionFlag.TextSelectableByMouse
        self.setTextInteractionFlags(by_mouse)
        self.sourceChanged.connect(self._show_heading)

    def doSetSource(
        self,
        name: QUrl | str,
        type: QTextDocument.ResourceType = QTextDocument.ResourceType.UnknownResource,  # noqa: A002 - Qt's name
    ) -> None:
        url = self.source().resolved(QUrl(name))
        if _installed(url) is not None:
            super().doSetSource(url, type)

    def loadResource(self, kind: int, name: QUrl | str) -> Any:
        path = _installed(QUrl(name))
        if path is None:
            return None
        if kind != QTextDocument.ResourceType.ImageResource.value:
            return super().loadResource(kind, name)
        picture, room_px = QImage(str(path)), self.viewport().width() - _PICTURE_MARGIN_PX
        smooth = Qt.TransformationMode.SmoothTransformation
        return picture.scaledToWidth(room_px, smooth) if picture.width() > room_px else picture

    def _show_heading(self, page: QUrl) -> None:
        """Scroll to the heading of the link; Qt's Markdown has no anchors and no space around headings."""
        self.document().documentLayout().documentSize()  # format changes in an unfinished layout hide paragraphs
        block, heading = self.document().begin(), None
        while block.isValid():
            if block.blockFormat().headingLevel():
                spaced = block.blockFormat()
                spaced.setTopMargin(_ABOVE_HEADING_PX)
                spaced.setBottomMargin(tokens.GRID_PX)
                QTextCursor(block).setBlockFormat(spaced)
                if page.hasFragment() and anchor_of(block.text()) == page.fragment():
                    heading = block
            block = block.next()
        if heading is not None:
            top_px = self.document().documentLayout().blockBoundingRect(heading).top()
            self.verticalScrollBar().setValue(round(top_px))


def _installed(url: QUrl) -> Path | None:
    """Local path of an installed resource; None for any other address."""
    path = Path(url.toLocalFile()).resolve()
    return path if url.isLocalFile() and path.is_relative_to(resources_dir().resolve()) and path.is_file() else None


class HelpWindow(VisualTabOrderMixin, QWidget):
    """Guide page with navigation and search."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("help_window")
        self.setWindowTitle(tr("Help · CARIS Desktop"))
        self.browser = named(GuideBrowser(), "help_page", tr("Guide"))
        pages = DropDown(theme, "help_pages", tr("Page"))
        for title, name in sorted((_title(path), path.name) for path in guide_dir().glob("*.md")):
            pages.addItem(title, name)
        pages.activated.connect(lambda row: self.show_page(pages.itemData(row)))
        self.search = line_edit(
            "help_search", tr("Search"), placeholderText=tr("Search…"), returnPressed=self._find_next
        )
        row = layouts.hbox(margins_px=(12, 8, 12, 0), spacing_px=8)
        for name, text, icon, step, can in (
            ("help_back", tr("Back"), "arrow-left", self.browser.backward, self.browser.backwardAvailable),
            ("help_forward", tr("Forward"), "arrow-right", self.browser.forward, self.browser.forwardAvailable),
        ):
            button = ActionButton(
                theme, text, icon=icon, role="ghost", may_lose_words=True, objectName=name, toolTip=text, enabled=False,
                clicked=step,
            )  # fmt: skip
            can.connect(button.setEnabled)
            row.addWidget(button)
        layouts.fill(row, (pages, 1), (self.search, 1))
        layouts.vbox(self, row, (self.browser, 1), margins_px=0, spacing_px=8)
        self.browser.sourceChanged.connect(lambda page: pages.setCurrentIndex(pages.findData(page.fileName())))
        QShortcut(QKeySequence(QKeySequence.StandardKey.Find), self, self._on_find)
        theme.changed.connect(self.browser.reload)  # link colours are stored in the document
        self.resize(self.sizeHint().boundedTo(self.screen().availableSize() - QSize(40, 80)))

    def sizeHint(self) -> QSize:
        return QSize(860, 720)

    def show_page(self, page: str) -> None:
        """Show a page of the guide, as "keys.md#change-keys"."""
        url = QUrl.fromLocalFile(str(guide_dir()) + "/").resolved(QUrl(page))
        self.browser.setSource(url, QTextDocument.ResourceType.MarkdownResource)
        self.browser.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_find(self) -> None:
        self.search.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.search.selectAll()

    def _find_next(self) -> None:
        if not self.browser.find(self.search.text()):
            self.browser.moveCursor(QTextCursor.MoveOperation.Start)
            self.browser.find(self.search.text())


def _title(page: Path) -> str:
    lines = page.read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.startswith("# ")).removeprefix("# ")


class HelpWindows(QObject):
    """Opens the guide, one window for each window that blocks others."""

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(window)
        self._theme = theme
        self._window = window

    def open(self) -> None:
        """Open the page of the panel or window that has the focus."""
        dialog = QApplication.activeModalWidget()
        page = page_of(dialog or focused_widget() or QApplication.activeWindow())
        owner = dialog or self._window  # a modal dialog blocks every window except its own children
        window = owner.findChild(HelpWindow, options=Qt.FindChildOption.FindDirectChildrenOnly)
        if window is None:
            window = HelpWindow(self._theme, owner)
        bring_up(window)
        window.show_page(page)

    def close(self, *, only_active: bool = False) -> None:
        """Close the help. ``only_active``: a stop from the main window leaves it open."""
        for window in self._window.findChildren(HelpWindow):
            if window.isActiveWindow() or not only_active:
                window.close()


FIRST_PAGE = "wizard.md"
PAGES: Mapping[str, str] = {
    "AgreementDialog": "sessions.md#annotation",
    "AlarmList": "alarms.md#alarms",
    "AssistantPanel": "assistant.md",
    "BranchesCard": "protocol.md#keys",
    "CommandPalette": "keys.md#find-anything",
    "ConfirmFileDialog": "scenarios.md#sharing",
    "ConnectionCard": "wizard.md#when-something-goes-wrong",
    "ConversationPanel": "conversation.md",
    "DiagnosticsPanel": "wizard.md#robot-and-other-panels",
    "DrivePanel": "wizard.md#driving",
    "ExportDialog": "sessions.md#export",
    "FaceEditor": "face.md#your-own-faces",
    "FacePanel": "face.md",
    "FaceWindow": "face.md#show-the-face",
    "GamepadDialog": "wizard.md#driving",
    "ImportConflictDialog": "scenarios.md#sharing",
    "ImportDialog": "sessions.md#annotation",
    "LabelCard": "sessions.md#annotation",
    "MapPanel": "wizard.md#map",
    "MarkCard": "wizard.md#recording",
    "MotionPanel": "wizard.md#robot-and-other-panels",
    "NotesPanel": "alarms.md#notes",
    "ObserverWindow": "wizard.md#observer-windows",
    "PeoplePanel": "people.md",
    "PersonCard": "people.md",
    "PhotosPanel": "wizard.md#photos",
    "PracticeStrip": "practice.md",
    "PreflightCard": "preflight.md",
    "ProtocolStrip": "protocol.md",
    "ResumeTrialCard": "practice.md#resume-a-trial-after-a-crash",
    "RobotDialog": "robot-profiles.md#quick-start",
    "RobotPanel": "robot-profiles.md#the-robot-panel",
    "SavedSessionCard": "wizard.md#recording",
    "ScenarioEditor": "editing-scenarios.md",
    "SessionPanel": "wizard.md#recording",
    "SessionsWindow": "sessions.md",
    "SetUpPage": "first-use.md",
    "ShortcutSheet": "keys.md#change-keys",
    "SpeakPanel": "wizard.md#speaking",
    "StartDialog": "wizard.md#recording",
    "StepsCard": "protocol.md#keys",
    "TierDialog": "sessions.md#annotation",
    "TitleDialog": "layouts.md#the-layout-menu",
    "VideoPanel": "wizard.md#several-cameras",
}
"""Guide page by class name of a panel, popup or window."""


def guide_dir() -> Path:
    return resources_dir() / "guide"


def page_of(widget: QWidget | None) -> str:
    """Page of the innermost panel, popup or window around ``widget``; the wizard's guide for all others."""
    while widget is not None:
        if page := PAGES.get(type(widget).__name__):
            return page
        widget = widget.parentWidget()
    return FIRST_PAGE


def anchor_of(heading: str) -> str:
    """Anchor of a heading, as the documentation site makes it."""
    return re.sub(r"[^\w\s-]", "", heading).strip().lower().replace(" ", "-")
