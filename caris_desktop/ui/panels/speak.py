"""Speak: what the robot says. One large field, phrases one key away, and what is being said now."""

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QKeyEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QLineEdit, QScrollArea, QSizePolicy, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.live.status import SpeechStatus
from caris_desktop.ui import tokens, words
from caris_desktop.ui.actions import PHRASE_COUNT
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.people.shown_people import as_permitted
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.key_cap import KeyCap, draw_key_cap, key_cap_width

_HISTORY = 50
_HINT = "Type what the robot says…"
_CHIP_SIZES = ((40, tokens.BODY_PX + 1, 8), (32, tokens.BODY_PX, 6), (28, tokens.BODY_PX - 1, 5))


class SpeakPanel(Panel):
    """Enter says the line and empties the field; the arrow keys bring earlier lines back."""

    title = "Speak"

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("speak_panel")
        self.field = SpeakField(self.theme)
        self.field.setObjectName("speak_field")
        self.field.said.connect(self._on_said)
        self._silence = ActionButton(self.theme, "Silence", icon="speaker-slash", height_px=30)
        self._silence.setObjectName("silence_button")
        self._silence.bind(self.table, "silence")
        self._row = FlowRow(gap_px=6)
        self._chips: list[ActionButton] = []
        for action_id in (*(f"phrase_{number}" for number in range(1, PHRASE_COUNT + 1)), "filler"):
            spec = self.table.spec(action_id)
            if spec is None:
                continue
            chip = ActionButton(self.theme, spec.text, key_first=True, height_px=32, may_shrink=True)
            chip.setObjectName(action_id)
            chip.bind(self.table, action_id)
            chip.setToolTip(spec.text)
            self._row.add(chip)
            self._chips.append(chip)
        self._queue = QLabel()
        self._queue.setTextFormat(Qt.TextFormat.PlainText)
        self._queue.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._queue.setObjectName("speak_queue")
        self._hints = QWidget()
        hints = QHBoxLayout(self._hints)
        hints.setContentsMargins(0, 0, 0, 0)
        hints.setSpacing(8)
        self._hint_labels: list[QLabel] = []
        for cap, text in (("↑", "earlier lines"),):
            hints.addWidget(KeyCap(self.theme, cap))
            self._hint_labels.append(QLabel(text))
            hints.addWidget(self._hint_labels[-1])
        self._back_cap = KeyCap(self.theme, self.table.key_text("focus_driving"))
        self._back = QLabel("back to driving")
        self._hint_labels.append(self._back)
        if self.table.spec("focus_driving") is not None:
            hints.addSpacing(8)
            hints.addWidget(self._back_cap)
            hints.addWidget(self._back)
        hints.addStretch(1)
        body = QWidget()
        column = QVBoxLayout(body)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(10)
        column.addWidget(self._row)
        column.addWidget(self._queue)
        column.addStretch(1)
        scroll = QScrollArea()
        scroll.setWidgetResizable(True)
        scroll.setWidget(body)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        layout = self._column = QVBoxLayout(self)
        layout.setContentsMargins(14, 10, 14, 6)
        layout.setSpacing(8)
        layout.addWidget(self.field)
        layout.addWidget(scroll, 1)
        layout.addWidget(self._hints)
        self.state.speech.changed.connect(self._on_speech_changed)
        self.state.selected_person.changed.connect(self._say_to_whom)
        self.state.persons.changed.connect(self._say_to_whom)
        self.theme.changed.connect(self._style)
        self._style()
        self._on_speech_changed(self.state.speech.value)

    def title_widgets(self) -> list[QWidget]:
        return [self._silence]

    def focus_target(self) -> QWidget:
        return self.field

    def sizeHint(self) -> QSize:
        return QSize(600, 220)

    def minimumSizeHint(self) -> QSize:
        return QSize(270, 130)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        # Every phrase in view is worth more than air: the largest size at which none must be scrolled for.
        for chip_px, text_px, gap_px in _CHIP_SIZES:
            smallest = chip_px == _CHIP_SIZES[-1][0]
            self._row.set_gap(gap_px)
            for chip in self._chips:
                chip.set_size(height_px=chip_px, text_px=text_px)
            self.field.setMinimumHeight(40 if smallest else 48)
            self._column.setContentsMargins(14, 7 if smallest else 10, 14, 4 if smallest else 6)
            self._column.setSpacing(6 if smallest else 8)
            self._hints.setVisible(not smallest)
            if self._row.heightForWidth(self.width() - 36) <= self.height() - 106:
                break

    def _style(self) -> None:
        for label in (self._queue, *self._hint_labels):
            label.setFont(self.theme.font(tokens.STATUS_PX + 1))
            self.theme.color_text(label, "dim")

    def _on_said(self, text: str) -> None:
        self.console.do(intents.Say(text, "typed"))

    def catch_up(self) -> None:
        self._on_speech_changed(self.state.speech.value)
        self._say_to_whom()

    def _say_to_whom(self, _value: object = None) -> None:
        """The empty field names whom the wizard selected: what is said goes into that person's history."""
        if self.in_view:
            meant = self.state.selected_person.value
            naming = self.console.scenario.permissions.naming_people
            persons = as_permitted(self.state.persons.value, naming=naming)
            name = next((words.person_name(row) for row in persons if row.person_id == meant), "")
            self.field.setPlaceholderText(f"Type what the robot says to {name}…" if name else _HINT)

    def _on_speech_changed(self, speech: SpeechStatus) -> None:
        if not self.in_view:
            return
        if speech.now is not None:
            self.set_fact(f"now saying “{words.shortened(speech.now.text, 60)}”", "blue")
        elif not speech.ready and self.state.present.live:
            self.set_fact(speech.detail or "the voice is getting ready", "amber" if speech.detail else "dim")
        else:
            self.set_fact("quiet")
        waiting = " · ".join(f"“{words.shortened(utterance.text, 60)}”" for utterance in speech.waiting[:3])
        more = f" and {len(speech.waiting) - 3} more" if len(speech.waiting) > 3 else ""
        self._queue.setText(f"Next: {waiting}{more}")
        self._queue.setVisible(bool(speech.waiting))


class SpeakField(QLineEdit):
    """The line that the robot says next, with its Enter key drawn at the end."""

    said = Signal(str)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._history: list[str] = []
        self._position = 0
        self._draft = ""
        self.setPlaceholderText(_HINT)
        self.setAccessibleName("What the robot says next")
        self.setMinimumHeight(48)
        self.setMaxLength(1000)
        self.returnPressed.connect(self._on_return)
        theme.changed.connect(self.update)

    def _on_return(self) -> None:
        text = " ".join(self.text().split())
        if not text:
            return
        if not self._history or self._history[-1] != text:
            self._history = [*self._history, text][-_HISTORY:]
        self._position = len(self._history)
        self._draft = ""
        self.clear()
        self.said.emit(text)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_Up:
            self._recall(-1)
        elif event.key() == Qt.Key.Key_Down:
            self._recall(1)
        else:
            super().keyPressEvent(event)

    def _recall(self, step: int) -> None:
        position = min(max(0, self._position + step), len(self._history))
        if position == self._position:
            return
        if self._position == len(self._history):
            self._draft = self.text()
        self._position = position
        self.setText(self._draft if position == len(self._history) else self._history[position])

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.setTextMargins(0, 0, round(key_cap_width(self._theme, "Enter")) + 10, 0)

    def paintEvent(self, event: QPaintEvent) -> None:
        super().paintEvent(event)
        painter = QPainter(self)
        width = key_cap_width(self._theme, "Enter")
        draw_key_cap(painter, self._theme, "Enter", self.width() - width - 14, self.height() / 2)
