"""Scenario editor window: sections, form, preview, text, undo and saving."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from PySide6.QtCore import QObject, QSize, Qt, QTimer, QUrl, Signal
from PySide6.QtGui import QAccessible, QCloseEvent, QKeySequence, QPainter, QPaintEvent, QResizeEvent, QShortcut
from PySide6.QtWidgets import (
    QFrame,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QScrollArea,
    QSplitter,
    QStackedWidget,
    QTextBrowser,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.schema_fields import Known
from caris_desktop.domain.schema_paths import value_at
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.translation import tr
from caris_desktop.domain.yaml_source import YamlSourceError
from caris_desktop.live.status import IN_SESSION, SavedScenario
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.document import ScenarioDocument, UndoStep
from caris_desktop.scenario.phrases import LOOK, NOD
from caris_desktop.scenario.scenario_library import own_file, own_file_called
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.announcing import announce
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.icons import icon
from caris_desktop.ui.scenario_editor.compare_page import ComparePage, Other
from caris_desktop.ui.scenario_editor.editing_context import Editing, FormContext, Names
from caris_desktop.ui.scenario_editor.groups import part_for, show_at_once
from caris_desktop.ui.scenario_editor.opened_scenario import Opened, names_of_files, reopened, text_of
from caris_desktop.ui.scenario_editor.preview import preview_page
from caris_desktop.ui.scenario_editor.sections import Section, sections
from caris_desktop.ui.scenario_editor.text_page import TextPage
from caris_desktop.ui.scenario_editor.value_fields import Field, FormPart
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
        self.undo_button = self._button("editor_undo", tr("Undo"), "arrow-u-up-left", self.undo, role="ghost")
        self.redo_button = self._button("editor_redo", tr("Redo"), "arrow-u-up-right", self.redo, role="ghost")
        self.revert_button = self._button(
            "editor_revert", tr("Revert to saved"), "clock-counter-clockwise", self.revert, role="ghost"
        )
        self.save_as_button = self._button("editor_save_as", tr("Save as…"), "copy", self.ask_for_name)
        self.save_button = self._button("editor_save", tr("Save"), "floppy-disk", self.save, role="primary")
        self.save_button.set_key("Ctrl+S")
        self._name_row = QWidget()
        self.name = QLineEdit(placeholderText=tr("Title of the new scenario, for example “Second study”"))
        self.name.setObjectName("editor_name")
        self.name.setAccessibleName(tr("Title of the new scenario"))
        self.name.returnPressed.connect(self.save_as)
        name_row = layouts.hbox(self._name_row, margins_px=(16, 0, 16, 8))
        name_row.addWidget(self.name, 1)
        name_row.addWidget(self._button("editor_name_save", tr("Save under this title"), "check", self.save_as))
        name_row.addWidget(self._button("editor_name_cancel", tr("Cancel"), "x", self.leave_name, role="ghost"))
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
            state_text = tr("Errors: %n · {where}", "", count).format(where=where)
        else:
            state_text = (tr("Not saved · {where}") if document.changed else tr("Saved · {where}")).format(where=where)
        self._state.setText(state_text)
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
        notice = tr("Line {line} of the text: {reason} The form shows the last valid state.").format(
            line=mistake.line, reason=as_sentence(mistake.message)
        )
        self.notice.say(
            "unreadable", notice, "red",
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


_DONE_AT_ONCE = ("button", "toggle")
"""Kinds of controls that a phrase can trigger: others need a value."""


class KnownNames(QObject):
    """Names that fields may reference outside the file: of the connected robot, its face, and existing files.

    Known names for the form of ``editing``; files are listed in a background thread.
    """

    def __init__(self, console: WizardConsole, editing: Editing) -> None:
        super().__init__(editing)
        self._state = console.state
        self._editing = editing
        self._files: dict[Known, tuple[str, ...]] = {}
        read_for(self, console, names_of_files, self._on_read)

    def _on_read(self, files: dict[Known, tuple[str, ...]]) -> None:
        self._files = files
        self._editing.emit_changes()

    def of(self, kind: Known) -> Names:
        state, data = self._state, self._editing.document.data
        if kind == "gestures":
            controls = data.get("controls")
            scenario_names = [
                value_at(each, ("id",))
                for each in (controls if isinstance(controls, list) else ())
                if value_at(each, ("kind",)) in _DONE_AT_ONCE
            ]
            robots = [control.id for control in state.controls.value if control.kind in _DONE_AT_ONCE]
            found = tuple(
                dict.fromkeys(name for name in (NOD, LOOK, *scenario_names, *robots) if isinstance(name, str))
            )
            return Names(found, state.link.value.state == "connected")
        if kind == "expressions":
            return Names(
                state.face.value.expressions, self._editing.document.value(("face", "face")) == state.face.value.face
            )
        # A robot may also be an address.
        return Names(self._files.get(kind, ()), kind == "faces" and kind in self._files)


_TITLE: KeyPath = ("title",)


Answer = tuple[str, Callable[[], None]]


class Notice(QWidget):
    """Message line above the form, with buttons to answer it.

    ``say`` replaces the message. ``what`` identifies it for ``take_back``.
    """

    accessible_role = QAccessible.Role.AlertMessage

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("editor_notice")
        self._theme = theme
        self._topic = ""
        self._role = "blue"
        self.text = QLabel(wordWrap=True)
        self.text.setObjectName("editor_notice_text")
        self.answers: list[ActionButton] = []
        self._row = layouts.hbox(self, margins_px=(26, 8, 18, 8), spacing_px=8)
        self._row.addWidget(self.text, 1)
        theme.changed.connect(self.update)
        self.hide()

    def say(self, topic: str, text: str, role: str, *answers: Answer) -> None:
        if (topic, text) == (self._topic, self.text.text()) and self.isVisible():
            return
        self._topic, self._role = topic, role
        self.text.setText(text)
        self.setAccessibleName(text)
        for button in self.answers:
            self._row.removeWidget(button)
            button.hide()
            button.deleteLater()
        self.answers = [self._answer(words, do) for words, do in answers or ((tr("Dismiss"), self._dismiss),)]
        self.show()
        announce(self, text)
        self.update()

    def _answer(self, words: str, do: Callable[[], None]) -> ActionButton:
        button = ActionButton(self._theme, words, height_px=30)
        button.clicked.connect(do)
        self._row.addWidget(button)
        return button

    def _dismiss(self) -> None:
        self.take_back(self._topic)

    def take_back(self, topic: str) -> None:
        if topic == self._topic:
            self._topic = ""
            self.hide()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(
            self,
            ground=f"{self._role}_soft",
            line=self._role,
            radius_px=tokens.CONTROL_RADIUS_PX,
            line_px=1.4,
            inset_px=(16.7, 2.7),
        )


class Edits(Protocol):
    """The part of the editor window that saving needs."""

    editing: Editing
    notice: Notice
    text_page: TextPage
    compare_page: ComparePage

    @property
    def document(self) -> ScenarioDocument: ...
    @property
    def unsaved(self) -> bool: ...
    def show_mistake(self, number: int) -> None: ...
    def ask_for_name(self) -> None: ...
    def leave_name(self) -> None: ...
    def close(self) -> bool: ...


class Saving(QObject):
    """Saving for one ``editor``, owned by ``parent``. ``opened``: the file from which the document was made; any other
    contents are not overwritten without a question.
    """

    def __init__(self, editor: Edits, console: WizardConsole, opened: Opened, parent: QObject) -> None:
        super().__init__(parent)
        self._editor = editor
        self._console = console
        self._opened = opened
        self._to: Path | None = None
        self._sent = self._title = ""
        self._close_when_saved = False
        self._changed_elsewhere = False
        console.state.saved_scenario.changed.connect(self._on_saved)
        console.state.scenario.changed.connect(self._on_scenario_in_force)

    def save(self) -> None:
        """Save to the scenario's own file, or to the user's copy of a shipped one."""
        if self._editor.unsaved:
            target = own_file(self._editor.document.path)
            self._save_to(target, self._opened.sha256 if target == self._opened.path else "")

    def save_and_close(self) -> None:
        self._close_when_saved = True
        self.save()

    def save_as(self, title: str) -> None:
        """Save under another title, in a new file among the user's scenarios."""
        self._save_to(own_file_called(title), "", title)

    def _save_to(self, path: Path, replaces: str, title: str = "") -> None:
        """Save, optionally with a new ``title``, which the document gets once the file is written."""
        editor = self._editor
        if self._to is not None:
            return
        editor.text_page.flush()
        editor.document.pause()
        if editor.document.mistakes:
            self._close_when_saved = False
            notice = tr("Nothing was saved. Errors to correct first: %n", "", len(editor.document.mistakes))
            editor.notice.say("refused", notice, "red", (tr("Show the first"), lambda: editor.show_mistake(0)))
            editor.show_mistake(0)
            return
        sent = ScenarioDocument(editor.document.text, editor.document.path)
        if title:
            sent.set(_TITLE, title)
        if sent.mistakes:
            editor.notice.say("name", as_sentence(sent.mistakes[0].message), "amber")
            return
        self._to, self._sent, self._title = path, sent.text, title
        refused = self._console.do(intents.SaveScenario(self._sent, path, editor.document.path, replaces))
        if refused:
            self._on_saved(SavedScenario(path, problem=refused))

    def _on_saved(self, saved: SavedScenario | None) -> None:
        if saved is None or saved.path != self._to:
            return
        editor, self._to = self._editor, None
        self._changed_elsewhere &= bool(saved.problem)
        if saved.problem:
            self._on_not_saved(saved)
            return
        self._opened = Opened(saved.path, saved.text, saved.sha256)
        if self._title:
            editor.document.pause()
            editor.document.set(_TITLE, self._title)
        editor.document.note_saved(self._sent, saved.text, saved.path)
        editor.leave_name()
        editor.editing.emit_changes(reshaped=True)
        editor.compare_page.offer_again()
        notice = tr("Saved in {file}.")
        if self._title and self._console.state.recording.value.state in IN_SESSION:
            notice = tr("Saved in {file}. The recording continues with its current scenario; open this one afterwards.")
        editor.notice.say("saved", notice.format(file=saved.path), "green")
        if self._close_when_saved and not editor.document.changed:
            editor.close()
        self._close_when_saved = False

    def _on_not_saved(self, saved: SavedScenario) -> None:
        editor, self._close_when_saved = self._editor, False
        if saved.taken and saved.path == self._opened.path:
            read_for(self, self._console, partial(reopened, saved.path, self._opened), self._on_other_file)
            return
        if self._changed_elsewhere:
            self._on_scenario_in_force(self._console.scenario)
        if saved.taken:
            editor.ask_for_name()
            notice = tr("“{file}” already contains a scenario and was not changed. Choose another title.")
            editor.notice.say("name", notice.format(file=saved.path.name), "amber")
            return
        notice = tr("Not saved: {reason} Your changes are still here.").format(reason=saved.problem)
        editor.notice.say("saving", notice, "red", (tr("Save as…"), editor.ask_for_name))

    def _on_other_file(self, found: Opened | str | None) -> None:
        """Handle a conflict: the file has changed meanwhile and may be unreadable."""
        notice, reason = self._editor.notice, found if isinstance(found, str) else ""
        if isinstance(found, Opened):
            try:
                own_changes = self._rebase(found)
            except ValueError as error:
                reason = _error_text(error)
            else:
                message = tr(
                    "Not saved yet: the file was changed elsewhere and has been reloaded. It includes your "
                        "own changes: %n. Check them on the right, then save again.", "", own_changes,
                )  # fmt: skip
                notice.say("meanwhile", message, "amber")
                return
        message = tr(
            "Not saved: the file was changed elsewhere and cannot be read: {reason} Your changes are still "
            "here. Save again once the file is valid, or choose:"
        ).format(reason=as_sentence(reason))
        answers = [(tr("Save as…"), self._editor.ask_for_name)]
        if isinstance(found, Opened):
            answers.insert(0, (tr("Overwrite"), partial(self._write_over, found)))
        notice.say("saving", message, "red", *answers)

    def _write_over(self, broken: Opened) -> None:
        self._editor.notice.take_back("saving")
        self._save_to(broken.path, broken.sha256)

    # ---- changes from elsewhere

    def _on_scenario_in_force(self, scenario: Scenario | None) -> None:
        """Merge what the console itself wrote to the file meanwhile, for example a place."""
        if scenario is None or scenario.path is None or self._to is not None:
            return
        if scenario.sha256 != self._opened.sha256:
            read_for(self, self._console, partial(reopened, scenario.path, self._opened), self._on_reread)

    def _on_reread(self, found: Opened | str | None) -> None:
        self._changed_elsewhere = found is not None and self._to is not None
        if found is None or self._changed_elsewhere:
            return
        notice, broken = self._editor.notice, tr("The file has changed and cannot be read: {reason}")
        if isinstance(found, str):
            notice.say("meanwhile", broken.format(reason=found), "red")
            return
        try:
            own_changes = self._rebase(found)
        except ValueError as error:
            notice.say("meanwhile", broken.format(reason=_error_text(error)), "red")
            return
        message = tr("The file was changed elsewhere and has been reloaded.")
        if own_changes:
            message = tr(
                "The file was changed elsewhere and has been reloaded. It includes your own changes: %n",
                "",
                own_changes,
            )
        notice.say("meanwhile", message, "blue")

    def _rebase(self, found: Opened) -> int:
        """Rebase the edits onto the file's current contents; returns how many remain. Raises ValueError."""
        own_changes = self._editor.document.rebase(found.text)
        self._opened = found
        self._editor.editing.emit_changes(reshaped=True)
        self._editor.compare_page.offer_again()
        return len(own_changes)


def _error_text(error: ValueError) -> str:
    if isinstance(error, YamlSourceError):
        return tr("line {line}: {message}").format(line=error.line, message=error)
    return str(error)


def as_sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."


_WIDEST_PX, _LEAST_WORDS_PX, _SIDE_PX = 900, 200, 24


class SectionPage(QScrollArea):
    """Form page of one section, built when first shown.

    Form page; refreshes only while visible.
    """

    def __init__(self, context: FormContext, section: Section) -> None:
        super().__init__()
        self.section = section
        self._context = context
        self.parts: list[FormPart] = []
        self._column: QVBoxLayout | None = None
        self._stale = False
        self._next = QTimer(self, singleShot=True, interval=0)
        self._next.timeout.connect(self._make_next)
        self.setObjectName("section_page")
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        context.theme.changed.connect(self._style)
        context.editing.changed.connect(self._on_changed)

    def build(self) -> None:
        """Create all fields now."""
        self._begin()
        while len(self.parts) < len(self.section.keys):
            self._make_next()
        if self._stale:
            self.refresh()

    def _begin(self) -> None:
        if self._column is not None:
            return
        holder = QWidget()
        holder.setObjectName("section_holder")
        column = layouts.vbox(holder, margins_px=(_SIDE_PX, 16, _SIDE_PX, 24), spacing_px=20)
        self._title = QLabel(tr(self.section.title))
        self._words = QLabel(tr(self.section.words), wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        column.addWidget(self._title)
        if self.section.words:
            column.addWidget(self._words)
        column.addStretch(1)
        self._column = column
        self.setWidget(holder)
        self._style()

    def _make_next(self) -> None:
        """Create one field per event loop turn, so that keys are still handled."""
        if len(self.parts) == len(self.section.keys) or self._column is None:
            return
        key = self.section.keys[len(self.parts)]
        part = part_for(self._context, (key.name,), key)
        part.setMaximumWidth(_WIDEST_PX)
        self.parts.append(part)
        self._column.insertWidget(self._column.count() - 1, part)
        show_at_once(part)
        part.refresh()
        if len(self.parts) < len(self.section.keys):
            self._next.start()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self._column is not None:
            self._fit_words()

    def _fit_words(self) -> None:
        """Fit the explanation to the visible width, however wide the lists are."""
        room_px = max(_LEAST_WORDS_PX, self.viewport().width() - 2 * _SIDE_PX)
        self._words.setMaximumWidth(room_px)
        self._words.setMinimumHeight(self._words.heightForWidth(room_px))

    def refresh(self) -> None:
        self._stale = False
        for part in self.parts:
            part.refresh()
        self.setEnabled(self._context.editing.document.unreadable is None)

    def _on_changed(self) -> None:
        self._stale = True
        if self.isVisible():
            self.refresh()

    def showEvent(self, event: object) -> None:
        self._begin()
        self._next.start()
        if self._stale:
            self.refresh()
        super().showEvent(event)  # type: ignore[arg-type]

    def reveal(self, path: KeyPath) -> Field | None:
        """Field of a path, or of the closest enclosing one."""
        self.build()
        for cut in range(len(path), 0, -1):
            for part in self.parts:
                if path[:1] == part.path:
                    field = part.reveal(path[:cut])
                    if field is not None:
                        return field
        return None

    def _style(self) -> None:
        if self._column is not None:
            theme = self._context.theme
            self._title.setFont(theme.font(tokens.SPEECH_PX + 2, tokens.WEIGHT_SEMIBOLD))
            theme.style_text(self._words, "dim", tokens.BODY_PX)
            self._fit_words()
