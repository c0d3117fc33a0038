"""Scenario editor window: sections, form, preview, text, undo and saving."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QSize, Qt, QUrl, Signal
from PySide6.QtGui import QCloseEvent, QKeySequence, QResizeEvent, QShortcut
from PySide6.QtWidgets import (
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QSplitter,
    QStackedWidget,
    QTextBrowser,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.conversation.face.face_file import face_names
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.plugins import installed
from caris_desktop.domain.schema_fields import KeyPath, Known
from caris_desktop.domain.schema_paths import value_at
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.translation import tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.robot.profile import list_profiles
from caris_desktop.scenario.document import Step
from caris_desktop.scenario.phrases import LOOK, NOD
from caris_desktop.scenario.scenario_file import own_file
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import cap_text
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.focus_widget import VisualTabOrderMixin
from caris_desktop.ui.scenario_editor.form import FormContext, FormPart, InputKeys, Names
from caris_desktop.ui.scenario_editor.pages import ComparePage, Other, SectionPage, TextPage, sections
from caris_desktop.ui.scenario_editor.preview import preview_page
from caris_desktop.ui.scenario_editor.saving import EditedDocument, Notice, Opened, Saving, as_sentence, opened_file
from caris_desktop.ui.theme import Theme, icon
from caris_desktop.ui.tokens import Colors
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel, named, restyle

_NAV_PX, _NARROW_NAV_PX = 208, 176
_NARROW_PX, _LEAST_PX, _LEAST_TITLE_PX = 900, (560, 280), 140
_FORM_AND_PREVIEW_PX = (880, 340)
_DONE_AT_ONCE = ("button", "toggle")
"""Kinds of controls that a phrase can trigger: others need a value."""


def _style_sheet(colors: Colors) -> str:
    radius, status, body = tokens.CONTROL_RADIUS_PX, tokens.STATUS_PX, tokens.BODY_PX
    notices = "".join(
        f'QWidget#editor_notice[role="{role}"] {{ background: {getattr(colors, f"{role}_soft")};'
        f" border-color: {getattr(colors, role)}; }}"
        for role in ("blue", "green", "amber", "red")
    )
    return f"""
QWidget#scenario_editor {{ background: {colors.window}; }}
QLabel#page_title {{ font-size: {tokens.SPEECH_PX + 2}px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QLabel#editor_title {{ font-size: {tokens.SPEECH_PX}px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QLabel#group_title {{ font-size: {body + 1}px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QLabel#field_title, QCheckBox {{ font-size: {body}px; font-weight: {tokens.WEIGHT_MEDIUM}; }}
QLabel#page_words, QLabel#help, QLabel#switch_help, QLabel#row_title {{ color: {colors.dim}; }}
QLabel#help, QLabel#switch_help, QLabel#row_title, QLabel#mistake, QLabel#known_names, QLabel#editor_state {{
    font-size: {status}px;
}}
QLabel#switch_help {{ padding: 0 0 4px 25px; }}
QLabel#mistake {{ color: {colors.red}; }}
QWidget#entry_card {{
    background: {colors.panel}; border: 1px solid {colors.line}; border-radius: {radius}px;
}}
QWidget#editor_notice {{ border: 2px solid; border-radius: {radius}px; margin: 2px 16px; }}
{notices}
QListWidget {{ border: 2px solid transparent; border-radius: {tokens.PANEL_RADIUS_PX}px; outline: 0; }}
QListWidget:focus {{ border-color: {colors.blue}; }}
QListWidget::item {{
    border-left: 3px solid transparent; border-radius: {radius}px; padding-left: 5px; color: {colors.text};
}}
QListWidget::item:hover {{ background: {colors.raised}; }}
QListWidget::item:selected {{
    background: {colors.blue_soft}; color: {colors.text}; border-color: {colors.blue};
}}
QTextBrowser {{
    background: {colors.panel}; border: 1px solid {colors.line}; border-radius: {tokens.PANEL_RADIUS_PX}px;
    padding: 6px 4px 6px 10px; font-size: {status + 1}px;
}}
"""


class ScenarioEditor(VisualTabOrderMixin, QWidget):
    """Window owned by the main window. Unsaved changes are never discarded without a question."""

    closed = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, opened: Opened, parent: QWidget | None = None) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("scenario_editor")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setStyleSheet(_style_sheet(theme.colors))
        self._theme = theme
        self._console = console
        self.after_closing: Callable[[], None] | None = None
        self.document = EditedDocument(opened.text, opened.path, self)
        self._file_names: dict[Known, tuple[str, ...]] = {}
        read_for(self, console, _names_of_files, self._on_file_names)
        self.context = FormContext(
            theme, self.document, InputKeys(self.document, self), self._robot_pose, self._known_names
        )
        self.pages = [SectionPage(self.context, section) for section in sections()]
        self.text_page = TextPage(self.context)
        self.compare_page = ComparePage(self.context, console, self._others)
        self.notice = Notice(theme)
        self.saving = Saving(console, self.document, self.notice, opened, self)
        self.saving.refused.connect(partial(self.show_mistake, 0))
        self.saving.title_requested.connect(self.ask_for_name)
        self.saving.saved.connect(self.leave_name)
        self.saving.version_changed.connect(self.compare_page.offer_again)
        self.saving.finished.connect(self.close)
        self.stack = QStackedWidget()
        nav = named(QListWidget(), "editor_sections", tr("Sections of the scenario"))
        nav.setIconSize(QSize(18, 18))
        nav.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        titles = [*(tr(page.section.title) for page in self.pages), tr("Text of the file"), tr("Compare")]
        for title, page in zip(titles, (*self.pages, self.text_page, self.compare_page), strict=True):
            nav.addItem(_nav_item(title))
            self.stack.addWidget(page)
        nav.currentRowChanged.connect(self._on_section)
        self.nav = nav
        preview = QTextBrowser(openLinks=False)
        self.preview = named(preview, "scenario_preview", tr("Preview for the wizard, and changes"))
        self.preview.setMinimumWidth(280)
        self.preview.anchorClicked.connect(self._on_link)
        self._lay_out()
        keys: dict[str, Callable[[], object]] = {
            "Ctrl+Z": self.undo,
            "Ctrl+Shift+Z": self.redo,
            "Ctrl+Y": self.redo,
            "Ctrl+S": self.save,
            "Ctrl+Shift+S": self.ask_for_name,
            "Ctrl+PgDown": partial(self._next_section, 1),
            "Ctrl+PgUp": partial(self._next_section, -1),
        }
        for key, do in keys.items():
            QShortcut(QKeySequence(key), self, do)
        self.document.history.changed.connect(self._on_changed)
        theme.changed.connect(self._on_theme_changed)
        self._show_icons()
        self._on_changed()
        self.nav.setCurrentRow(0)
        self.nav.setFocus(Qt.FocusReason.OtherFocusReason)
        self.resize(self.sizeHint().boundedTo(self.screen().availableSize() - QSize(24, 56)))

    def sizeHint(self) -> QSize:
        return QSize(1440, 860)

    # ---- construction

    def _button(self, name: str, text: str, icon_name: str, do: Callable[[], Any], **more: Any) -> ActionButton:
        return ActionButton(
            self._theme,
            text,
            icon=icon_name,
            may_lose_words=True,
            **more,
            toolTip=text,
            objectName=name,
            clicked=lambda _checked=False: do(),
        )

    def _lay_out(self) -> None:
        self._title, self._state = named(ElidedLabel(), "editor_title"), named(ElidedLabel(), "editor_state")
        for label in (self._title, self._state):
            label.setMinimumWidth(_LEAST_TITLE_PX)
        titles = layouts.vbox(None, self._title, self._state, spacing_px=0)
        self.undo_button = self._button("editor_undo", tr("Undo"), "arrow-u-up-left", self.undo, role="ghost")
        self.redo_button = self._button("editor_redo", tr("Redo"), "arrow-u-up-right", self.redo, role="ghost")
        self.revert_button = self._button(
            "editor_revert", tr("Revert to saved"), "clock-counter-clockwise", self.revert, role="ghost"
        )
        self.save_as_button = self._button("editor_save_as", tr("Save as…"), "copy", self.ask_for_name)
        self.save_button = self._button(
            "editor_save", tr("Save"), "floppy-disk", self.save, role="primary", key=cap_text("Ctrl+S")
        )
        head = layouts.hbox(
            None, (titles, 1), self.undo_button, self.redo_button, self.revert_button, self.save_as_button,
            self.save_button, margins_px=(16, 12, 16, 8), spacing_px=8,
        )  # fmt: skip
        self._name_row = QWidget()
        name = QLineEdit(placeholderText=tr("Title of the new scenario, for example “Second study”"))
        self.name = named(name, "editor_name", tr("Title of the new scenario"))
        self.name.returnPressed.connect(self.save_as)
        save = self._button("editor_name_save", tr("Save under this title"), "check", self.save_as)
        cancel = self._button("editor_name_cancel", tr("Cancel"), "x", self.leave_name, role="ghost")
        layouts.hbox(self._name_row, (self.name, 1), save, cancel, margins_px=(16, 0, 16, 8))
        self._name_row.hide()
        side = self._side = QSplitter(Qt.Orientation.Horizontal, childrenCollapsible=False)
        side.addWidget(self.stack)
        side.addWidget(self.preview)
        side.setStretchFactor(0, 5)
        side.setStretchFactor(1, 3)
        side.setSizes(list(_FORM_AND_PREVIEW_PX))
        body = layouts.hbox(None, self.nav, (side, 1), margins_px=(8, 0, 8, 8), spacing_px=8)
        column = layouts.vbox(self, head, self._name_row, self.notice, (body, 1), margins_px=0, spacing_px=0)
        # resizeEvent decides what a narrow window hides; the sum of minimum sizes must not.
        column.setSizeConstraint(QVBoxLayout.SizeConstraint.SetNoConstraint)
        self.setMinimumSize(*_LEAST_PX)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """In a narrow window the preview becomes a separate page."""
        super().resizeEvent(event)
        narrow, is_page = self.width() < _NARROW_PX, self.stack.indexOf(self.preview) >= 0
        self.nav.setFixedWidth(_NARROW_NAV_PX if narrow else _NAV_PX)
        if narrow and not is_page:
            self.stack.addWidget(self.preview)
            self.nav.addItem(_nav_item(tr("Preview")))
        elif is_page and not narrow:
            if self.nav.currentRow() == self.nav.count() - 1:
                self.nav.setCurrentRow(0)
            self.nav.takeItem(self.nav.count() - 1)
            self._side.addWidget(self.preview)
            self._side.setSizes(list(_FORM_AND_PREVIEW_PX))
            self._show_preview()

    # ---- display

    def _next_section(self, by: int) -> None:
        self.nav.setCurrentRow((self.nav.currentRow() + by) % self.nav.count())

    def _on_section(self, row: int) -> None:
        self.notice.take_back("saved")
        self.stack.setCurrentIndex(row)
        self._show_preview()

    def show_page(self, page: QWidget) -> None:
        self.nav.setCurrentRow(self.stack.indexOf(page))

    def reveal(self, path: KeyPath) -> FormPart | None:
        """Show and focus the field of a path."""
        page = next((page for page in self.pages if path[0] in {key.name for key in page.section.keys}), None)
        if page is None:
            return None
        self.show_page(page)
        return page.reveal(path)

    def _on_changed(self) -> None:
        document, title, where = self.document, self._shown_title(), str(self.document.path)
        if document.changed:
            self.notice.take_back("saved")
        self.setWindowTitle(tr("{title} · scenario editor").format(title=title))
        self._title.setText(title)
        if own_file(document.path) != document.path:
            where = tr("built-in scenario; saving creates your own copy")
        state = tr("Not saved · {where}") if document.changed else tr("Saved · {where}")
        if document.mistakes:
            state = tr("Errors: %n · {where}", "", len(document.mistakes))
        self._state.setText(state.format(where=where))
        restyle(self._state, tone="red" if document.mistakes else "amber" if document.changed else "dim")
        history = document.history
        self.undo_button.setEnabled(history.canUndo())
        self.redo_button.setEnabled(history.canRedo())
        self.undo_button.setToolTip(tr("Undo: {what}").format(what=history.undoText()) if history.canUndo() else "")
        self.redo_button.setToolTip(tr("Redo: {what}").format(what=history.redoText()) if history.canRedo() else "")
        self.revert_button.setEnabled(document.changed)
        self.save_button.setEnabled(document.changed)
        self._mark_sections()
        self._show_preview()
        self._report_unreadable()

    def _shown_title(self) -> str:
        title = self.document.data.get("title")
        return title if isinstance(title, str) and title else self.document.path.name

    def _mark_sections(self) -> None:
        document = self.document
        changed = {difference.path[0] for difference in document.differences()}
        for row, page in enumerate(self.pages):
            names = {key.name for key in page.section.keys}
            wrong = sum(bool(mistake.path) and mistake.path[0] in names for mistake in document.mistakes)
            title = text = tr(page.section.title)
            if wrong:
                text = tr("{section}, errors: %n", "", wrong).format(section=title)
                title = f"{title}  !"
            elif names & changed:
                text = tr("{section}, changed").format(section=title)
                title = f"{title}  •"
            item = self.nav.item(row)
            if item.text() != title:
                item.setText(title)
                item.setToolTip(text)
                item.setData(Qt.ItemDataRole.AccessibleTextRole, text)

    def _show_preview(self) -> None:
        page = self.stack.currentWidget()
        if self.stack.indexOf(self.preview) < 0:
            self.preview.setVisible(page is not self.compare_page)
        section = page.section.title if isinstance(page, SectionPage) else ""
        scrolled = self.preview.verticalScrollBar().value()
        self.preview.setHtml(preview_page(self.document, section, self._theme.colors))
        self.preview.verticalScrollBar().setValue(scrolled)

    def _on_link(self, url: QUrl) -> None:
        kind, _, number = url.toString().partition(":")
        if kind == "change":
            self.reveal(self.document.differences()[int(number)].path)
        elif kind == "mistake":
            self.show_mistake(int(number))

    def show_mistake(self, number: int) -> None:
        """Show the field of an error, or its line of the text if it has no field."""
        mistake = self.document.mistakes[number]
        on_text = self.stack.currentWidget() is self.text_page or not mistake.path
        if self.document.unreadable is not None or on_text or self.reveal(mistake.path) is None:
            self.show_page(self.text_page)
            self.text_page.show_line(mistake.line)

    def _report_unreadable(self) -> None:
        mistake = self.document.unreadable
        if not self.document.mistakes:
            self.notice.take_back("refused")
        if mistake is None:
            self.notice.take_back("unreadable")
            return
        notice = tr("Line {line} of the text: {reason} The form shows the last valid state.").format(
            line=mistake.line, reason=as_sentence(mistake.message)
        )
        self.notice.say(
            "unreadable", notice, "red",
            (tr("Show the line"), partial(self.show_mistake, 0)), (tr("Undo typing"), self.undo),
        )  # fmt: skip

    # ---- undo

    def undo(self) -> None:
        self._turn(self.document.undo)

    def redo(self) -> None:
        self._turn(self.document.redo)

    def _turn(self, turn: Callable[[], Step | None]) -> None:
        self.text_page.flush()
        step = turn()
        if step is not None and step.path and isinstance(self.stack.currentWidget(), SectionPage):
            self.reveal(step.path)

    def revert(self) -> None:
        self.text_page.flush()
        self.document.revert()

    # ---- saving and closing

    def save(self) -> None:
        self.saving.save()

    def ask_for_name(self) -> None:
        self.name.setText(tr("{title} 2").format(title=self._shown_title()))
        self._name_row.show()
        self.name.selectAll()
        self.name.setFocus(Qt.FocusReason.OtherFocusReason)

    def leave_name(self) -> None:
        self.notice.take_back("name")
        if self._name_row.isVisible():
            self.nav.setFocus(Qt.FocusReason.OtherFocusReason)
            self._name_row.hide()

    def save_as(self) -> None:
        if title := " ".join(self.name.text().split()):
            self.saving.save_as(title)

    def report_not_read(self, problem: str) -> None:
        """Report that the file has become unreadable; the scenario in force is shown."""
        notice = tr(
            "The file cannot be shown as a form: {problem} The editor shows the scenario currently in use; "
            "saving replaces the file."
        )
        self.notice.say("meanwhile", notice.format(problem=as_sentence(problem)), "amber")

    @property
    def unsaved(self) -> bool:
        self.text_page.flush()
        return self.document.changed

    def ask_before_closing(self, message: str = "", then: Callable[[], None] | None = None) -> None:
        """Ask about unsaved changes; ``then`` runs after closing, unless the wizard continues editing."""
        self.after_closing = then
        self.notice.say(
            "closing", message or tr("Your changes are not saved."), "amber",
            (tr("Save"), self._save_and_close), (tr("Discard"), self._discard),
            (tr("Continue editing"), self._continue),
        )  # fmt: skip

    def _continue(self) -> None:
        self.after_closing = None
        self.notice.take_back("closing")

    def _save_and_close(self) -> None:
        self.notice.take_back("closing")
        self.saving.save(then_close=True)

    def _discard(self) -> None:
        self.document.revert()
        self.close()

    def closeEvent(self, event: QCloseEvent) -> None:
        if event.spontaneous() and self.unsaved:
            event.ignore()
            self.ask_before_closing()
            return
        super().closeEvent(event)
        self.closed.emit()

    # ---- program state

    def _robot_pose(self) -> Pose2D | None:
        pose = self._console.state.pose
        return pose.value.pose_in_map if pose.value is not None and pose.freshness != "lost" else None

    def _others(self) -> Sequence[Other]:  # reads files
        path, saved = self.document.path, Other(tr("Saved version"), lambda: self.document.saved_text)
        shipped = [
            Other(tr("{name}, built-in version").format(name=file.stem), partial(_text_of, file))
            for file in sorted(layouts_dir().glob("*.yaml"), key=lambda file: (file.name != path.name, file.name))
        ]
        same_name = bool(shipped) and (layouts_dir() / path.name).is_file() and own_file(path) == path
        return [*shipped[:1], saved, *shipped[1:]] if same_name else [saved, *shipped]

    def _on_file_names(self, names: dict[Known, tuple[str, ...]]) -> None:
        self._file_names = names
        self.document.history.changed.emit()

    def _known_names(self, kind: Known) -> Names:
        """Names that fields may reference outside the file: of the connected robot, its face, and existing files."""
        state, document = self._console.state, self.document
        if kind == "gestures":
            controls = document.data.get("controls")
            of_scenario = [
                value_at(each, ("id",))
                for each in (controls if isinstance(controls, list) else ())
                if value_at(each, ("kind",)) in _DONE_AT_ONCE
            ]
            of_robot = [control.id for control in state.controls.value if control.kind in _DONE_AT_ONCE]
            found = dict.fromkeys(name for name in (NOD, LOOK, *of_scenario, *of_robot) if isinstance(name, str))
            return Names(tuple(found), state.link.value.state == "connected")
        if kind == "expressions":
            return Names(state.face.value.expressions, document.value(("face", "face")) == state.face.value.face)
        # A robot may also be an address.
        return Names(self._file_names.get(kind, ()), kind in ("faces", "trackers") and kind in self._file_names)

    def _on_theme_changed(self) -> None:
        self.setStyleSheet(_style_sheet(self._theme.colors))
        self._show_icons()
        self.document.history.changed.emit()

    def _show_icons(self) -> None:
        icons = [*(page.section.icon for page in self.pages), "code", "git-diff"]
        for row, name in enumerate(icons):
            self.nav.item(row).setIcon(icon(name, self._theme.color("dim"), 18))


def _nav_item(title: str) -> QListWidgetItem:
    item = QListWidgetItem(title)
    item.setSizeHint(QSize(_NAV_PX, tokens.CONTROL_HEIGHT_PX))
    return item


def _text_of(path: Path) -> str:
    """Text of a file. Raises OSError, UnicodeDecodeError."""
    return opened_file(path).text


def _names_of_files() -> dict[Known, tuple[str, ...]]:
    """Names of existing robot profiles, faces and trackers. Reads files."""
    return {
        "robots": tuple(profile.name for profile in list_profiles()),
        "faces": face_names(),
        "trackers": tuple(installed("trackers")),
    }
