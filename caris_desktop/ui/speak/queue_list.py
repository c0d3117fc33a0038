"""Speech queue list, edited by mouse or keyboard."""

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QAccessible, QFocusEvent, QKeyEvent, QKeySequence, QMouseEvent
from PySide6.QtWidgets import QFrame, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.person_marks import mark_of
from caris_desktop.domain.translation import tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, text_formatting
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import QUEUE_GROUP
from caris_desktop.ui.focus_widget import focused_widget
from caris_desktop.ui.key_choices import normalized
from caris_desktop.ui.people.shown_people import name_of
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import ElidedLabel, KeyCap, label, restyle
from caris_desktop.ui.widgets.rows import show_rows

ROW_PX = 30


class QueueList(QWidget):
    """Row per queued utterance. While focused it handles the keys of rows ``within`` the queue."""

    accessible_role = QAccessible.Role.List

    left_over = Signal(str)  # edited text of an utterance that is already being spoken
    emptied = Signal()  # the last row was removed while focused
    row_chosen = Signal(QWidget)

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self._theme = theme
        self._console = console
        self._actions = actions
        self._rows: dict[str, _QueueRow] = {}
        self._chosen = ""
        self.setObjectName("speak_queue")
        self.setAccessibleName(tr("Speech queue"))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._column = layouts.vbox(self, margins_px=0, spacing_px=0)
        actions.answer_for(QUEUE_GROUP, self)
        self.setVisible(False)

    @property
    def count(self) -> int:
        return len(self._rows)

    @property
    def texts(self) -> list[str]:
        """Displayed texts, in order."""
        return [row.label.text() for row in self._rows.values()]

    def show_waiting(self, waiting: tuple[UtteranceChanged, ...]) -> None:
        """Update the rows for ``waiting``, which have unique ids."""
        row_ids = list(self._rows)
        focused = focused_widget()
        had_focus = focused is not None and (focused is self or self.isAncestorOf(focused))
        keys = [utterance.utterance_id for utterance in waiting]
        left_over = [row.changed_text for key, row in self._rows.items() if key not in keys]
        show_rows(self._column, self._rows, keys, self._new_row)
        for text in filter(None, left_over):
            self.left_over.emit(text)
        for number, utterance in enumerate(waiting, start=1):
            spoken = text_formatting.with_names(utterance.text, lambda person_id: name_of(self._console, person_id))
            self._rows[utterance.utterance_id].show_utterance(number, len(waiting), spoken, utterance)
        self._choose(self._chosen if self._chosen in self._rows else self._nearest(row_ids))
        self.setVisible(bool(waiting))
        if had_focus and not waiting:
            self.emptied.emit()

    def _nearest(self, row_ids: list[str]) -> str:
        """Replacement for a removed selected row: the next one, else the previous one."""
        at = row_ids.index(self._chosen) if self._chosen in row_ids else 0
        near = (*row_ids[at + 1 :], *reversed(row_ids[:at]), *self._rows)
        return next((each for each in near if each in self._rows), "")

    def _new_row(self, utterance_id: str) -> "_QueueRow":
        row = _QueueRow(self._theme, self._actions.key_text("focus_queue"))
        row.action_requested.connect(lambda act: self._act_on(utterance_id, act))
        row.written.connect(lambda text: self._change(utterance_id, text))
        row.pressed.connect(lambda: self._choose(utterance_id))
        row.given_up.connect(lambda: self.setFocus(Qt.FocusReason.OtherFocusReason))
        return row

    def _act_on(self, utterance_id: str, act: str) -> None:
        self._choose(utterance_id)
        if act == "queued_edit":
            self.edit()
            return
        row = self._actions.spec(act)
        intent = None if row is None else self._actions.intent_of(row)
        if intent is not None:
            self._actions.ask(intent)

    def _change(self, utterance_id: str, text: str) -> None:
        if self._console.do(intents.EditQueued(utterance_id, text)):
            self.left_over.emit(text)

    def give_up_edit(self) -> None:
        """Cancel editing."""
        for row in self._rows.values():
            row.end_edit()

    # ---- callbacks of the action table

    def go_up(self) -> None:
        self._go(-1)

    def go_down(self) -> None:
        self._go(1)

    def edit(self) -> None:
        row = self._rows.get(self._chosen)
        if row is not None:
            row.begin_edit()

    def _go(self, step: int) -> None:
        ids = list(self._rows)
        if ids:
            at = ids.index(self._chosen) if self._chosen in ids else 0
            self._choose(ids[min(max(0, at + step), len(ids) - 1)])

    def _choose(self, utterance_id: str) -> None:
        self._chosen = utterance_id
        self._console.state.chosen_utterance.set(utterance_id)
        for each, row in self._rows.items():
            restyle(row, current=each == utterance_id and self.hasFocus())
        if utterance_id in self._rows and self.hasFocus():
            self.row_chosen.emit(self._rows[utterance_id])

    # ---- keyboard

    def keyPressEvent(self, event: QKeyEvent) -> None:
        pressed = _spelled(event)
        rows = self._actions.listening_in("queue")
        row = next((row for row in rows if pressed in map(normalized, row.keys)), None)
        if row is not None:
            self._actions.run(row.id)
        else:
            super().keyPressEvent(event)

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self._choose(self._chosen)
        self._actions.set_focused_part("queue")

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self._choose(self._chosen)
        self._actions.set_focused_part("")


def _spelled(event: QKeyEvent) -> str:
    combination = event.keyCombination()
    bare = combination.keyboardModifiers() & ~Qt.KeyboardModifier.KeypadModifier
    return QKeySequence(bare.value | int(combination.key())).toString(QKeySequence.SequenceFormat.PortableText)


class _QueueRow(QFrame):
    """Row with number, text and buttons."""

    action_requested = Signal(str)
    written = Signal(str)
    given_up = Signal()
    pressed = Signal()

    def __init__(self, theme: Theme, key_text: str) -> None:
        super().__init__()
        self.setObjectName("queue_row")
        self._key_text = key_text
        self._key = KeyCap(key_text)
        self._template = ""
        self.setFixedHeight(ROW_PX)
        self._number = label("", "fine")
        self.label = ElidedLabel(role="fine")
        self._editor = SubmitLineEdit(objectName="queue_editor", accessibleName=tr("Replacement text"), maxLength=1000)
        self._editor.hide()
        self._editor.returnPressed.connect(self._on_return)
        row = layouts.hbox(self, self._number, margins_px=(5, 0, 1, 0), spacing_px=4)
        row.addSpacing(4)
        row.addWidget(self.label, 1)
        row.addWidget(self._editor, 1)
        row.addWidget(self._key)
        self._movers: list[ActionButton] = []
        for act, icon, tip in (
            ("queued_earlier", "arrow-up", tr("Move earlier")), ("queued_later", "arrow-down", tr("Move later")),
            ("queued_edit", "pencil-simple", tr("Edit the text")), ("queued_cancel", "x", tr("Remove from queue")),
        ):  # fmt: skip
            button = ActionButton(theme, icon=icon, role="ghost", height_px=26, objectName=act, toolTip=tip)
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            button.clicked.connect(lambda _checked=False, act=act: self.action_requested.emit(act))
            row.addWidget(button)
            if act in ("queued_earlier", "queued_later"):
                self._movers.append(button)

    @property
    def changed_text(self) -> str:
        """Edited text that was not submitted; empty if none."""
        text = " ".join(self._editor.text().split())
        return text if self._editor.isVisible() and text != self._template else ""

    def show_utterance(self, number: int, count: int, spoken: str, utterance: UtteranceChanged) -> None:
        self._number.setText(tr("Next") if count == 1 else tr("{number} of {count}").format(number=number, count=count))
        self._key.setVisible(number == 1 and bool(self._key_text))
        self.label.setText(f"“{spoken}”")
        # Template, to be filled again when it is spoken.
        self._template = utterance.text.replace(mark_of(utterance.person_id), "{name}")
        for button in self._movers:
            button.setVisible(count > 1)

    def begin_edit(self) -> None:
        self._editor.setText(self._template)
        self.label.hide()
        self._editor.show()
        self._editor.setFocus(Qt.FocusReason.OtherFocusReason)
        self._editor.selectAll()

    def end_edit(self) -> None:
        if self._editor.isVisible():
            had_focus = self._editor.hasFocus()
            self._editor.hide()
            self.label.show()
            if had_focus:
                self.given_up.emit()

    def _on_return(self) -> None:
        text = " ".join(self._editor.text().split())
        self.end_edit()
        if text != self._template:
            self.written.emit(text)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.pressed.emit()
        event.ignore()

    def mouseDoubleClickEvent(self, _event: QMouseEvent) -> None:
        self.action_requested.emit("queued_edit")
