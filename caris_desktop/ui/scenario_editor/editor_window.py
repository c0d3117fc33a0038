"""Scenario editor window: sections, form, preview, text, undo and saving."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from PySide6.QtCore import QSize, Qt, QUrl, Signal
from PySide6.QtGui import QCloseEvent, QKeySequence, QPainter, QPaintEvent, QResizeEvent, QShortcut
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

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.translation import tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.document import ScenarioDocument, UndoStep
from caris_desktop.scenario.scenario_library import own_file
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.icons import icon
from caris_desktop.ui.scenario_editor.compare_page import ComparePage, Other
from caris_desktop.ui.scenario_editor.editing_context import Editing, FormContext
from caris_desktop.ui.scenario_editor.editor_notice import Notice
from caris_desktop.ui.scenario_editor.known_names import KnownNames
from caris_desktop.ui.scenario_editor.opened_scenario import Opened, text_of
from caris_desktop.ui.scenario_editor.preview import preview_page
from caris_desktop.ui.scenario_editor.saving import Saving, as_sentence
from caris_desktop.ui.scenario_editor.section_page import SectionPage
from caris_desktop.ui.scenario_editor.sections import sections
from caris_desktop.ui.scenario_editor.text_page import TextPage
from caris_desktop.ui.scenario_editor.value_fields import Field
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel

_NAV_PX, _NARROW_NAV_PX = 208, 176
_NARROW_PX, _LEAST_PX, _LEAST_TITLE_PX = 900, (560, 280), 140
_FORM_AND_PREVIEW_PX = (880, 340)


class ScenarioEditor(VisualTabOrderMixin, QWidget):
    """Window owned by the main window. Unsaved changes are never discarded without a question."""

    closed = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, opened: Opened, parent: QWidget | None = None) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("scenario_editor")
        self._theme = theme
        self._console = console
        self.after_closing: Callable[[], None] | None = None
        document = ScenarioDocument(opened.text, opened.path)
        self.editing = Editing(document, self)
        known = KnownNames(console, self.editing)
        self.context = FormContext(theme, self.editing, self._robot_pose, known.of)
        self.pages = [SectionPage(self.context, section) for section in sections()]
        self.text_page = TextPage(self.context)
        self.compare_page = ComparePage(self.context, console, self._others)
        self._make_head()
        self.notice = Notice(theme)
        self._make_nav()
        self.stack = QStackedWidget()
        for page in (*self.pages, self.text_page, self.compare_page):
            self.stack.addWidget(page)
        self.preview = QTextBrowser()
        self.preview.setObjectName("scenario_preview")
        self.preview.setAccessibleName(tr("Preview for the wizard, and changes"))
        self.preview.setOpenLinks(False)
        self.preview.anchorClicked.connect(self._on_link)
        self._lay_out()
        self._make_keys()
        self.editing.changed.connect(self._on_changed)
        self.saving = Saving(self, console, opened, self)
        theme.restyle_on_change(self._style)
        self.nav.setCurrentRow(0)
        self.nav.setFocus(Qt.FocusReason.OtherFocusReason)
        self._on_changed()
        self.resize(self.sizeHint().boundedTo(self.screen().availableSize() - QSize(24, 56)))

    def sizeHint(self) -> QSize:
        return QSize(1440, 860)

    @property
    def document(self) -> ScenarioDocument:
        return self.editing.document

    # ---- construction

    def _make_head(self) -> None:
        self._title = ElidedLabel()
        self._state = ElidedLabel()
        self._state.setObjectName("editor_state")
        self.undo_button = self._button("editor_undo", tr("Undo"), "arrow-u-up-left", self.undo, look="ghost")
        self.redo_button = self._button("editor_redo", tr("Redo"), "arrow-u-up-right", self.redo, look="ghost")
        self.revert_button = self._button(
            "editor_revert", tr("Revert to saved"), "clock-counter-clockwise", self.revert, look="ghost"
        )
        self.save_as_button = self._button("editor_save_as", tr("Save as…"), "copy", self.ask_for_name)
        self.save_button = self._button("editor_save", tr("Save"), "floppy-disk", self.save, look="primary")
        self.save_button.set_key("Ctrl+S")
        self._name_row = QWidget()
        self.name = QLineEdit(placeholderText=tr("Title of the new scenario, for example “Second study”"))
        self.name.setObjectName("editor_name")
        self.name.setAccessibleName(tr("Title of the new scenario"))
        self.name.returnPressed.connect(self.save_as)
        name_row = layouts.hbox(self._name_row, margins_px=(16, 0, 16, 8))
        name_row.addWidget(self.name, 1)
        name_row.addWidget(self._button("editor_name_save", tr("Save under this title"), "check", self.save_as))
        name_row.addWidget(self._button("editor_name_cancel", tr("Cancel"), "x", self.leave_name, look="ghost"))
        self._name_row.hide()

    def _button(self, name: str, text: str, icon_name: str, do: Callable[[], Any], **more: Any) -> ActionButton:
        button = ActionButton(self._theme, text, icon=icon_name, may_lose_words=True, **more)
        button.setToolTip(text)
        button.setObjectName(name)
        button.clicked.connect(lambda _checked=False: do())
        return button

    def _make_nav(self) -> None:
        self.nav = QListWidget()
        self.nav.setObjectName("editor_sections")
        self.nav.setAccessibleName(tr("Sections of the scenario"))
        self.nav.setFixedWidth(_NAV_PX)
        self.nav.setIconSize(QSize(18, 18))
        self.nav.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        for page in self.pages:
            self.nav.addItem(QListWidgetItem(tr(page.section.title)))
        self.nav.addItem(QListWidgetItem(tr("Text of the file")))
        self.nav.addItem(QListWidgetItem(tr("Compare")))
        for row in range(self.nav.count()):
            self.nav.item(row).setSizeHint(QSize(_NAV_PX, tokens.CONTROL_HEIGHT_PX))
        self.nav.currentRowChanged.connect(self._on_section)

    def _lay_out(self) -> None:
        head = layouts.hbox(margins_px=(16, 12, 16, 8), spacing_px=8)
        titles = layouts.vbox(spacing_px=0)
        titles.addWidget(self._title)
        titles.addWidget(self._state)
        head.addLayout(titles, 1)
        for label in (self._title, self._state):
            label.setMinimumWidth(_LEAST_TITLE_PX)
        for button in (
            self.undo_button, self.redo_button, self.revert_button, self.save_as_button, self.save_button,
        ):  # fmt: skip
            head.addWidget(button)
        side = self._side = QSplitter(Qt.Orientation.Horizontal, childrenCollapsible=False)
        side.addWidget(self.stack)
        side.addWidget(self.preview)
        side.setStretchFactor(0, 5)
        side.setStretchFactor(1, 3)
        side.setSizes(list(_FORM_AND_PREVIEW_PX))
        self.preview.setMinimumWidth(280)
        body = layouts.hbox(margins_px=(8, 0, 8, 8), spacing_px=8)
        body.addWidget(self.nav)
        body.addWidget(side, 1)
        column = layouts.vbox(self, margins_px=0, spacing_px=0)
        column.addLayout(head)
        column.addWidget(self._name_row)
        column.addWidget(self.notice)
        column.addLayout(body, 1)
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
            item = QListWidgetItem(tr("Preview"))
            item.setSizeHint(QSize(_NAV_PX, tokens.CONTROL_HEIGHT_PX))
            self.nav.addItem(item)
        elif is_page and not narrow:
            if self.nav.currentRow() == self.nav.count() - 1:
                self.nav.setCurrentRow(0)
            self.nav.takeItem(self.nav.count() - 1)
            self._side.addWidget(self.preview)
            self._side.setSizes(list(_FORM_AND_PREVIEW_PX))
            self._show_preview()

    def _make_keys(self) -> None:
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

    # ---- display

    def _next_section(self, by: int) -> None:
        self.nav.setCurrentRow((self.nav.currentRow() + by) % self.nav.count())

    def _on_section(self, row: int) -> None:
        self.notice.take_back("saved")
        self.stack.setCurrentIndex(row)
        self._show_preview()

    def show_page(self, page: QWidget) -> None:
        self.nav.setCurrentRow(self.stack.indexOf(page))

    def reveal(self, path: KeyPath) -> Field | None:
        """Show and focus the field of a path."""
        for page in self.pages:
            if path and any(part == path[0] for part in (key.name for key in page.section.keys)):
                self.show_page(page)
                field = page.reveal(path)
                if field is not None:
                    page.ensureWidgetVisible(field)
                    getattr(field, "control", field).setFocus(Qt.FocusReason.OtherFocusReason)
                return field
        return None

    def _on_changed(self) -> None:
        document = self.document
        if document.changed:
            self.notice.take_back("saved")
        self.setWindowTitle(tr("{title} · scenario editor").format(title=self._shown_title()))
        self._title.setText(self._shown_title())
        count = len(document.mistakes)
        where = self._where()
        if count:
            said = tr("Errors: %n · {where}", "", count).format(where=where)
        else:
            said = (tr("Not saved · {where}") if document.changed else tr("Saved · {where}")).format(where=where)
        self._state.setText(said)
        self._theme.color_text(self._state, "red" if count else "amber" if document.changed else "dim")
        undo, redo = document.to_undo, document.to_redo
        self.undo_button.setEnabled(undo is not None)
        self.redo_button.setEnabled(redo is not None)
        self.undo_button.setToolTip(_step_words(tr("Undo: {what}"), undo))
        self.redo_button.setToolTip(_step_words(tr("Redo: {what}"), redo))
        self.revert_button.setEnabled(document.changed)
        self.save_button.setEnabled(document.changed)
        self._show_nav()
        self._show_preview()
        self._report_unreadable()

    def _shown_title(self) -> str:
        title = self.document.data.get("title")
        return title if isinstance(title, str) and title else self.document.path.name

    def _where(self) -> str:
        path = self.document.path
        if own_file(path) != path:
            return tr("built-in scenario; saving creates your own copy")
        return str(path)

    def _show_nav(self) -> None:
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
                item.setForeground(self._theme.color("red" if wrong else "text"))

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
        document = self.document
        if kind == "change":
            self.reveal(document.differences()[int(number)].path)
        elif kind == "mistake":
            self.show_mistake(int(number))

    def show_mistake(self, number: int) -> None:
        """Show the field of an error, or its line of the text if it has no field."""
        mistake = self.document.mistakes[number]
        on_text = self.stack.currentWidget() is self.text_page
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
        said = tr("Line {line} of the text: {reason} The form shows the last valid state.").format(
            line=mistake.line, reason=as_sentence(mistake.message)
        )
        self.notice.say(
            "unreadable", said, "red",
            (tr("Show the line"), lambda: self.show_mistake(0)), (tr("Undo typing"), self.undo),
        )  # fmt: skip

    # ---- undo

    def undo(self) -> None:
        self.text_page.flush()
        self._show_step(self.editing.undo())

    def redo(self) -> None:
        self.text_page.flush()
        self._show_step(self.editing.redo())

    def _show_step(self, step: UndoStep | None) -> None:
        if step is not None and step.path and isinstance(self.stack.currentWidget(), SectionPage):
            self.reveal(step.path)

    def revert(self) -> None:
        self.text_page.flush()
        self.document.revert()
        self.editing.emit_changes(reshaped=True)

    # ---- saving

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

    # ---- closing

    def report_not_read(self, problem: str) -> None:
        """Report that the file has become unreadable; the scenario in force is shown."""
        said = tr(
            "The file cannot be shown as a form: {problem} The editor shows the scenario currently in use; "
            "saving replaces the file."
        )
        self.notice.say("meanwhile", said.format(problem=as_sentence(problem)), "amber")

    @property
    def unsaved(self) -> bool:
        self.text_page.flush()
        return self.document.changed

    def ask_before_closing(self, said: str = "", then: Callable[[], None] | None = None) -> None:
        """Ask about unsaved changes; ``then`` runs after closing, unless the wizard continues editing."""
        self.after_closing = then
        self.notice.say(
            "closing", said or tr("Your changes are not saved."), "amber",
            (tr("Save"), self._save_and_close), (tr("Discard"), self._throw_away),
            (tr("Continue editing"), self._go_on),
        )  # fmt: skip

    def _go_on(self) -> None:
        self.after_closing = None
        self.notice.take_back("closing")

    def _save_and_close(self) -> None:
        self.notice.take_back("closing")
        self.saving.save_and_close()

    def _throw_away(self) -> None:
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
            Other(tr("{name}, built-in version").format(name=file.stem), partial(text_of, file))
            for file in sorted(layouts_dir().glob("*.yaml"), key=lambda file: (file.name != path.name, file.name))
        ]
        same_name = bool(shipped) and (layouts_dir() / path.name).is_file() and own_file(path) == path
        return [*shipped[:1], saved, *shipped[1:]] if same_name else [saved, *shipped]

    # ---- style

    def _style(self) -> None:
        theme = self._theme
        self._title.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._state.setFont(theme.font(tokens.STATUS_PX))
        self.preview.setFont(theme.font(tokens.STATUS_PX + 1))
        colors = theme.colors
        self.nav.setStyleSheet(
            f"QListWidget {{ border: 2px solid transparent; border-radius: {tokens.PANEL_RADIUS_PX}px; outline: 0; }}"
            f" QListWidget:focus {{ border-color: {colors.blue}; }}"
            f" QListWidget::item {{ border-radius: {tokens.CONTROL_RADIUS_PX}px;"
            f" padding-left: 8px; color: {colors.text}; }} QListWidget::item:hover {{ background: {colors.raised}; }}"
            f" QListWidget::item:selected {{ background: {colors.blue_soft}; color: {colors.text};"
            f" border-left: 3px solid {colors.blue}; }}"
        )
        self.preview.setStyleSheet(
            f"QTextBrowser {{ background: {colors.panel}; border: 1px solid {colors.line};"
            f" border-radius: {tokens.PANEL_RADIUS_PX}px; padding: 6px 4px 6px 10px; }}"
        )
        names = [page.section.icon for page in self.pages] + ["code", "git-diff"]
        for row, name in enumerate(names):
            self.nav.item(row).setIcon(icon(name, theme.color("dim"), 18))
        self._on_changed()
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), self._theme.color("window"))


def _step_words(text: str, step: UndoStep | None) -> str:
    return text.format(what=" › ".join(step.words) or tr("the text")) if step is not None else ""
