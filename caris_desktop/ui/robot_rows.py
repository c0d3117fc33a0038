"""Rows of the robot dialog: function, ROS name, stream check and note."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QAccessible, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QLabel, QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.robot.profile_proposal import FieldProposal
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.drop_down import DropDown

if TYPE_CHECKING:  # importing its sockets takes 0.25 s and would delay the first window
    from caris_desktop.robot.discovery import StreamCheck

NOT_USED = QT_TR_NOOP("– not used –")
_CHECK_LOOKS = {
    "good": ("check-circle", "green", QT_TR_NOOP("active")),
    "slow": ("warning", "amber", QT_TR_NOOP("update rate too low")),
    "quiet": ("minus-circle", "dim", QT_TR_NOOP("no data now, which is normal")),
    "nothing": ("x-circle", "red", QT_TR_NOOP("no data")),
    "wrong": ("x-circle", "red", QT_TR_NOOP("does not match")),
}
_SHORT_LIST = 12


def rate_words(check: "StreamCheck") -> str:
    """Text of a stream check, such as "comes, 10.0 Hz, 0.1 s old · 720 beams over 360 degrees"."""
    if check.detail and check.age_s is None:
        return tr(check.detail)  # nothing was counted: the sentence is complete
    parts = [tr(_CHECK_LOOKS[check.state][2])]
    if check.rate_hz is not None:
        parts.append(f"{check.rate_hz:.1f} Hz")
    if check.age_s is not None:
        parts.append(tr("{age} old").format(age=text_formatting.age(check.age_s)))
    line = ", ".join(parts)
    return f"{line} · {tr(check.detail)}" if check.detail else line


class NoteLine(QWidget):
    """Message with its icon; height follows the text."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._role, self._icon = "dim", ""
        self._label = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        row = layouts.hbox(self, margins_px=(28, 2, 0, 2))
        row.addWidget(self._label)
        theme.changed.connect(self._style)
        self.hide()

    @property
    def text(self) -> str:
        return self._label.text()

    def show_note(self, role: str, icon: str, text: str) -> None:
        self._role, self._icon = role, icon
        self._label.setText(" ".join(text.split()))
        self.setAccessibleName(text)
        self.setVisible(bool(text))
        self._style()

    def _style(self) -> None:
        self._theme.color_text(self._label, "text")
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._icon:
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            draw_icon(painter, _icon_rect(4), self._icon, self._theme.color(self._role))


class MappingRow(QWidget):
    """Mapping of one function to a ROS name, with the stream check."""

    def __init__(
        self, theme: Theme, field: str, label: str, proposal: FieldProposal | None, *, topic: str = ""
    ) -> None:
        super().__init__()
        self.setObjectName(f"mapping_{field}")
        self._theme = theme
        self.proposal = proposal
        self._check: StreamCheck | None = None
        self._words = ""
        label = tr(label)
        name = QLabel(label, wordWrap=True)
        name.setFixedWidth(170)
        self._verdict = QLabel(textFormat=Qt.TextFormat.PlainText)
        self._verdict.setObjectName("mapping_verdict")
        self._verdict.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.box = DropDown(theme, f"mapping_{field}_box", label)
        self.box.setFixedWidth(270)
        self.box.setMaxVisibleItems(_SHORT_LIST)
        row = layouts.hbox(self, margins_px=(0, 1, 0, 1), spacing_px=8)
        row.addWidget(name)
        if proposal is None:
            fixed = QLabel(topic)
            fixed.setFixedWidth(270)
            fixed.setToolTip(topic)
            row.addWidget(fixed)
            self.box.hide()
            self.box.setParent(self)
        else:
            self.box.addItem(tr(NOT_USED), "")
            for candidate in proposal.candidates:
                self.box.addItem(candidate.value, candidate.value)
                self.box.setItemData(
                    self.box.count() - 1, f"{candidate.type}\n{tr(candidate.why)}".strip(), Qt.ItemDataRole.ToolTipRole
                )
            self.box.setCurrentIndex(max(0, self.box.findData(proposal.value)))
            self.box.setEnabled(bool(proposal.candidates))
            self.box.activated.connect(self._on_chosen)
            row.addWidget(self.box)
        row.addSpacing(24)
        row.addWidget(self._verdict, 1)
        theme.restyle_on_change(self._show)

    @property
    def value(self) -> str:
        """Selected ROS name; empty for none."""
        return str(self.box.currentData() or "")

    @property
    def verdict_text(self) -> str:
        return self._words

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._elide()

    def _elide(self) -> None:
        room = self._verdict.width()
        self._verdict.setText(self._verdict.fontMetrics().elidedText(self._words, Qt.TextElideMode.ElideRight, room))

    def show_check(self, check: "StreamCheck | None") -> None:
        self._check = check
        self._show()

    def _on_chosen(self, _index: int) -> None:
        self._check = None
        self._show()

    def _show(self) -> None:
        self._verdict.setFont(self._theme.font(tokens.STATUS_PX))
        if self._check is not None:
            text = rate_words(self._check)
        elif self.proposal is None:
            text = ""
        elif not self.proposal.candidates:
            text = tr("the robot offers nothing suitable")
        else:
            chosen = next((each for each in self.proposal.candidates if each.value == self.value), None)
            text = (
                tr(chosen.why)
                if chosen is not None
                else tr("left out")
                if self.proposal.value
                else tr(self.proposal.why)
            )
        self._words = text
        self._elide()
        self._verdict.setToolTip(text)
        self._theme.color_text(self._verdict, "text" if self._check is not None else "dim")
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._check is not None:
            icon, role, _ = _CHECK_LOOKS[self._check.state]
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            rect = _icon_rect((self.height() - 18) / 2)
            rect.moveLeft(self._verdict.x() - 26)
            draw_icon(painter, rect, icon, self._theme.color(role))


def _icon_rect(top: float) -> QRectF:
    return QRectF(2, top, 18, 18)
