"""Focus indicator: what a key press does now."""

from collections.abc import Sequence

from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QAccessible, QFontMetricsF, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter, KeyOwner
from caris_desktop.ui.theme import Theme

_HEIGHT_PX = 22
_WORDS: dict[KeyOwner, tuple[str, str, str]] = {
    "driving": (QT_TR_NOOP("Keys drive"), "blue", "game-controller"),
    "typing": (QT_TR_NOOP("You type · Alt drives"), "text", "text-aa"),
    "window": (QT_TR_NOOP("Alt drives"), "dim", "keyboard"),
    "nowhere": (QT_TR_NOOP("Keys inactive: Esc"), "amber", "keyboard"),
    "dialog": (QT_TR_NOOP("No keys: dialog open"), "amber", "keyboard"),
    "menu": (QT_TR_NOOP("No keys: menu open"), "amber", "keyboard"),
    "elsewhere": (QT_TR_NOOP("Keys used elsewhere"), "amber", "keyboard"),
    "off": ("", "dim", "keyboard"),
}

_USUAL: tuple[KeyOwner, ...] = ("driving", "typing", "window")


def owner_words(owner: KeyOwner) -> str:
    """Short label; empty if the scenario does not drive."""
    return tr(_WORDS[owner][0])


def owner_sentence(owner: KeyOwner, caps: Sequence[str]) -> str:
    """Instruction on which keys to press. ``caps``: caps of the four directions in the current layout."""
    keys = " ".join(cap.removeprefix("Alt ").removeprefix("⌥ ") for cap in caps)
    match owner:
        case "driving":
            return tr("Hold {keys} or arrows").format(keys=keys)
        case "typing":
            return tr("Alt+{keys} while you type").format(keys=keys)
        case "window":
            return tr("Hold Alt+{keys}").format(keys=keys)
        case _:
            return owner_words(owner)


class KeyOwnerChip(QWidget):
    """Indicator that follows ``hold.key_owner``."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme, hold: DriveInputFilter) -> None:
        super().__init__()
        self.setObjectName("key_owner")
        self._theme = theme
        self._owner: KeyOwner = "off"
        self._roomy = False
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        self.setToolTip(tr("Shows what the keyboard controls now"))
        theme.changed.connect(self.update)
        hold.key_owner_changed.connect(self.show_owner)
        self.show_owner(hold.key_owner)

    @property
    def text(self) -> str:
        return owner_words(self._owner)

    def show_owner(self, owner: KeyOwner) -> None:
        self._owner = owner
        if not self.text:
            self.hide()
        elif self.parentWidget() is not None:  # without a parent it would be a window
            self.show()
        self.setAccessibleName(self.text)
        self.updateGeometry()
        self.update()

    def sizeHint(self) -> QSize:
        texts = (self.text, *map(owner_words, _USUAL)) if self._roomy else (self.text,)
        return QSize(max(map(self._width_of, texts)), _HEIGHT_PX)

    def set_roomy(self, roomy: bool) -> None:
        """Set whether it is as wide for typing as for driving, so that nothing beside it moves with the focus."""
        if roomy != self._roomy:
            self._roomy = roomy
            self.updateGeometry()

    def _width_of(self, text: str) -> int:
        return round(QFontMetricsF(self._theme.font(tokens.STATUS_PX)).horizontalAdvance(text)) + 42

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        _text, role, icon = _WORDS[self._owner]
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        rect = QRectF(0.5, 0.5, self._width_of(self.text) - 1, self.height() - 1)
        soft = f"{role}_soft" if role in ("blue", "amber") else "raised"
        painter.setPen(QPen(theme.color(role if role in ("blue", "amber") else "line"), 1))
        painter.setBrush(theme.color(soft))
        painter.drawRoundedRect(rect, _HEIGHT_PX / 2, _HEIGHT_PX / 2)
        ink = theme.color("text")
        draw_icon(painter, QRectF(10, self.height() / 2 - 7.5, 15, 15), icon, ink)
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(ink)
        painter.drawText(
            rect.adjusted(31, 0, 0, 0), int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), self.text
        )
