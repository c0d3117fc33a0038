"""Status indicators of the observer window, readable from two metres: motion, speech, recording, listening."""

import math
from collections.abc import Mapping
from typing import Literal

from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QAccessible, QFontMetricsF, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveState
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.robot_motion import MOTION_SIGNS, RobotMotion, Sign
from caris_desktop.ui.theme import Theme

SignName = Literal["moving", "speaking", "recording", "listening"]
_SIDE_PX, _GAP_PX, _BETWEEN_PX = 12, 8, 8

_SIGNS: Mapping[tuple[SignName, str], Sign] = {
    **{("moving", kind): sign for kind, sign in MOTION_SIGNS.items()},
    ("speaking", "yes"): Sign("on", "speaker-high", QT_TR_NOOP("Speaking")),
    ("speaking", "no"): Sign("off", "speaker-slash", QT_TR_NOOP("Silent")),
    ("recording", "yes"): Sign("on", "record", QT_TR_NOOP("Recording")),
    ("recording", "paused"): Sign("half", "pause-circle", QT_TR_NOOP("Paused")),
    ("recording", "no"): Sign("off", "circle-dashed", QT_TR_NOOP("Not recorded")),
    ("listening", "yes"): Sign("on", "ear", QT_TR_NOOP("Listening")),
    ("listening", "no"): Sign("off", "ear-slash", QT_TR_NOOP("Not listening")),
}
_COLORS: Mapping[SignName, str] = {"moving": "blue", "speaking": "blue", "recording": "green", "listening": "green"}


def signs_of(state: LiveState, moving: Sign) -> dict[SignName, Sign]:
    """The four indicators."""
    speaks = state.speech.value.now is not None or state.sound.value.talking == "robot"
    recorded = {"recording": "yes", "paused": "paused"}.get(state.recording.value.state, "no")
    return {
        "moving": moving,
        "speaking": _SIGNS["speaking", "yes" if speaks else "no"],
        "recording": _SIGNS["recording", recorded],
        "listening": _SIGNS["listening", "yes" if state.microphone.value.state == "on" else "no"],
    }


class StatusIndicators(QWidget):
    """Status indicators with icon and word at fixed positions; repainted only on a change."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme, state: LiveState) -> None:
        super().__init__()
        self.setObjectName("glance")
        self._theme = theme
        self._state = state
        self._compact = False
        self._named = True
        self._motion = RobotMotion(state, self)
        self._signs: dict[SignName, Sign] = {}
        self._widths: list[int] = []
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self._motion.changed.connect(self._on_changed)
        for value in (state.speech, state.sound, state.recording, state.microphone):
            value.changed.connect(self._on_changed)
        theme.restyle_on_change(self._measure)
        self._on_changed()

    @property
    def signs(self) -> Mapping[SignName, Sign]:
        return self._signs

    def use_room(self, room_px: int, *, compact: bool) -> None:
        """Shrink the words, or hide them where there is still no room: tooltip and accessible name have them. Icon size
        stays.
        """
        named = not compact or sum(self._widths_with(tokens.BODY_PX)) + _BETWEEN_PX * (len(_COLORS) - 1) <= room_px
        if (compact, named) != (self._compact, self._named):
            self._compact, self._named = compact, named
            self._measure()

    def sizeHint(self) -> QSize:
        return QSize(sum(self._widths) + _BETWEEN_PX * (len(self._widths) - 1), 34)

    def minimumSizeHint(self) -> QSize:
        return self.sizeHint()

    def _on_changed(self, _value: object = None) -> None:
        signs = signs_of(self._state, self._motion.sign)
        if signs != self._signs:
            self._signs = signs
            self.setAccessibleName(tr("Robot status: {signs}").format(signs=", ".join(map(_word, signs.values()))))
            self.setToolTip(self.accessibleName())
            self.update()

    def _font_px(self) -> int:
        return tokens.BODY_PX if self._compact else tokens.GLANCE_PX

    def _measure(self) -> None:
        around_px = 2 * _SIDE_PX + tokens.GLANCE_ICON_PX
        self._widths = self._widths_with(self._font_px()) if self._named else [around_px] * len(_COLORS)
        self.setFixedWidth(self.sizeHint().width())
        self.update()

    def _widths_with(self, font_px: int) -> list[int]:
        """Widths for the longest word of each indicator, so that nothing shifts on a change."""
        metrics = QFontMetricsF(self._theme.font(font_px, tokens.WEIGHT_SEMIBOLD))
        around_px = 2 * _SIDE_PX + tokens.GLANCE_ICON_PX + _GAP_PX
        return [
            math.ceil(max(metrics.horizontalAdvance(_word(sign)) for (each, _), sign in _SIGNS.items() if each == name))
            + around_px
            for name in _COLORS
        ]

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        left = 0.0
        for (name, sign), width in zip(self._signs.items(), self._widths, strict=True):
            self._paint_sign(painter, QRectF(left, 0, width, self.height()), sign, _COLORS[name])
            left += width + _BETWEEN_PX

    def _paint_sign(self, painter: QPainter, rect: QRectF, sign: Sign, role: str) -> None:
        theme = self._theme
        color = theme.color(role)
        match sign.lit:
            case "on":
                painter.setPen(Qt.PenStyle.NoPen)
                painter.setBrush(color)
                ink = theme.color("panel")
            case "half":
                painter.setPen(QPen(theme.color("amber"), 2, Qt.PenStyle.DashLine))
                painter.setBrush(theme.color("amber_soft"))
                ink = theme.color("text")
            case _:
                painter.setPen(QPen(theme.color("line"), 1))
                painter.setBrush(Qt.BrushStyle.NoBrush)
                ink = theme.color("dim")
        radius = tokens.CONTROL_RADIUS_PX
        painter.drawRoundedRect(rect.adjusted(1, 1, -1, -1), radius, radius)
        icon_px = tokens.GLANCE_ICON_PX
        place = QRectF(rect.left() + _SIDE_PX, rect.center().y() - icon_px / 2, icon_px, icon_px)
        draw_icon(painter, place, sign.icon, ink)
        if not self._named:
            return
        painter.setFont(theme.font(self._font_px(), tokens.WEIGHT_SEMIBOLD))
        painter.setPen(ink)
        words = rect.adjusted(_SIDE_PX + icon_px + _GAP_PX, 0, 0, 0)
        painter.drawText(words, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), _word(sign))


def _word(sign: Sign) -> str:
    return tr(sign.word)
