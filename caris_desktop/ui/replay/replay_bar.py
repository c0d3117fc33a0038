"""Replay bar: play, pause, rate, steps, jumps, and a seek slider over the session."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Literal

from PySide6.QtCore import QObject, QPoint, QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAccessible,
    QFontMetricsF,
    QHideEvent,
    QImage,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
)
from PySide6.QtWidgets import QLabel, QSizePolicy, QWidget

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import REPLAY_ACTIONS
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.replay.thumbnails import Thumbnails
from caris_desktop.ui.replay.timeline_model import exact_text
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown

RATES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
_HINT_MS = 2500
_HINT_PX = 20
_NARROWEST_PX = 640


def session_title(session: Session) -> tuple[str, str]:
    """Participant and time of a session, as P07 and 21 Nov 2026 10:14."""
    when = datetime.fromtimestamp(session.clock.anchor.utc_ns_at(session.started_ns) / 1e9, UTC).astimezone()
    return session.trial.get(
        "participant"
    ) or session.folder.name, f"{text_formatting.day_of(when, with_year=True)} {when:%H:%M}"


def rate_text(rate: float) -> str:
    return f"{rate:g}×"


class ReplayBar(QWidget):
    """Playback controls; ``actions`` gets the keys of a replay."""

    accessible_role = QAccessible.Role.Grouping

    def __init__(self, theme: Theme, replay: ReplayControls, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("replay_bar")
        self.setAccessibleName(tr("Replay"))
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._replay = replay
        actions.add_rows(REPLAY_ACTIONS, self)
        self._thumbnails = Thumbnails(replay, self)
        self.scrubber = Scrubber(theme, self._thumbnails, replay.with_names)
        self.scrubber.seek_requested.connect(self._on_seek_requested)
        self._title = ReplayTitle(theme, *session_title(replay.session))
        self._play = ActionButton(theme, tr("Pause"), icon="pause", role="primary", height_px=36)
        self._play.setObjectName("replay_play")
        self._play.bind(actions, "replay_play")
        self._play_shown: tuple[str, bool] | None = None
        self._previous_mark = self._button(actions, "previous_mark", "", "skip-back", tr("Previous mark"))
        self._next_mark = self._button(actions, "next_mark", "", "skip-forward", tr("Next mark"))
        self._previous_utterance = self._button(
            actions, "previous_utterance", "", "caret-double-left", tr("Previous utterance")
        )
        self._next_utterance = self._button(actions, "next_utterance", "", "caret-double-right", tr("Next utterance"))
        self._frame_back = self._button(actions, "frame_back", "", "caret-left", tr("Previous frame"))
        self._frame_on = self._button(actions, "frame_on", "", "caret-right", tr("Next frame"))
        for button in (self._previous_utterance, self._next_utterance):
            button.hide()  # until the width is known
        self._times = ReplayTimes(theme)
        self._rate = DropDown(theme, "replay_rate", tr("Replay speed"))
        self._rate.setToolTip(tr("Replay speed. Slower with <, faster with >"))
        self._rate.setMinimumContentsLength(5)
        for rate in RATES:
            self._rate.addItem(rate_text(rate), rate)
        self._rate.activated.connect(self._on_rate_chosen)
        self._hint = QLabel()
        self._hint.setObjectName("replay_hint")
        self._hint.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self._hint_end = QTimer(self, singleShot=True, interval=_HINT_MS)
        self._hint_end.timeout.connect(self._end_hint)
        self._one_line = False
        left = layouts.hbox(spacing_px=8)
        left.addWidget(self._title)
        left.addWidget(self._hint, 1)
        self._moves = (
            self._previous_mark, self._previous_utterance, self._frame_back, self._play, self._frame_on,
            self._next_utterance, self._next_mark,
        )  # fmt: skip
        middle = layouts.hbox(spacing_px=8)
        for button in self._moves:
            middle.addWidget(button)
        self._right = layouts.hbox(spacing_px=12)
        self._right.addStretch(1)
        self._right.addWidget(self._times)
        self._right.addWidget(self._rate)
        self._left = left
        self._row = layouts.hbox(spacing_px=16)
        self._row.addLayout(left, 1)
        self._row.addLayout(middle)
        self._row.addLayout(self._right, 1)
        self._row.setContentsMargins(8, 0, 8, 0)
        self._column = layouts.vbox(self, margins_px=(8, 4, 8, 8), spacing_px=0)
        self._column.addWidget(self.scrubber)
        self._column.addLayout(self._row)
        replay.playback.changed.connect(self._on_playback_changed)
        replay.overview.changed.connect(self._on_overview_changed)
        theme.restyle_on_change(self._style)
        self._on_playback_changed(replay.playback.value)
        self._on_overview_changed(replay.overview.value)

    def _button(self, actions: Actions, action_id: str, text: str, icon: str, tip: str) -> ActionButton:
        button = ActionButton(self._theme, text, icon=icon, height_px=36)
        button.setObjectName(f"replay_{action_id}")
        button.bind(actions, action_id)
        button.setAccessibleName(tip)
        button.setToolTip(tip)
        return button

    def sizeHint(self) -> QSize:
        return QSize(900, self._height_px())

    def minimumSizeHint(self) -> QSize:
        # Parts that can be hidden must not set the window's minimum width.
        return QSize(_NARROWEST_PX, self._height_px())

    def _height_px(self) -> int:
        if not self._one_line:
            return 84
        return 48 + (_HINT_PX if self._hint.text() else 0)

    def set_one_line(self, one_line: bool) -> None:
        """Use a single line with keys in tooltips; in a small window the video needs the space."""
        if one_line == self._one_line:
            return
        self._one_line = one_line
        self._title.setVisible(not one_line)
        for button in self._moves:
            button.set_key_shown(not one_line)
        if one_line:
            self._row.insertWidget(2, self.scrubber, 1)
            self._column.insertWidget(0, self._hint)
        else:
            self._column.insertWidget(0, self.scrubber)
            self._left.addWidget(self._hint, 1)
        self._row.setStretch(0, 0 if one_line else 1)
        self._row.setStretch(self._row.indexOf(self._right), 0 if one_line else 1)
        self._row.setSpacing(10 if one_line else 16)
        self._column.setContentsMargins(8, 6 if one_line else 4, 8, 6 if one_line else 8)
        self._show_play(playing=self._replay.playback.value.playing)
        self._use_hint()
        self._use_width()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._use_width()

    def _use_width(self) -> None:
        roomy = not self._one_line
        self._times.set_wall_shown(roomy and self.width() >= 1240)
        self._title.set_date_shown(roomy and self.width() >= 1160)
        self._previous_utterance.setVisible(roomy and self.width() >= 1440)
        self._next_utterance.setVisible(roomy and self.width() >= 1440)

    def _use_hint(self) -> None:
        """Show the hint above a single-line bar while there is one."""
        self._hint.setVisible(bool(self._hint.text()) or not self._one_line)
        self.updateGeometry()

    # ---- callbacks of the action table

    def toggle_playing(self) -> None:
        if self._replay.playback.value.playing:
            self._replay.pause()
        else:
            self._replay.play()

    def step(self, frames: int) -> None:
        self._replay.step(frames)

    def jump(self, where: tuple[Literal["mark", "utterance"], Literal[-1, 1]]) -> None:
        kind, direction = where
        if not self._replay.jump(kind, direction):
            if kind == "mark":
                self._say(tr("No later mark") if direction > 0 else tr("No earlier mark"))
            else:
                self._say(tr("No later utterance") if direction > 0 else tr("No earlier utterance"))

    def change_rate(self, direction: int) -> None:
        """Switch to the next faster (1) or slower (-1) rate."""
        rate: float = self._replay.playback.value.rate
        others = [other for other in RATES if (other > rate if direction > 0 else other < rate)]
        if others:
            self._replay.set_rate(min(others) if direction > 0 else max(others))

    # ---- display

    def _say(self, text: str) -> None:
        self._hint.setText(text)
        self._hint.setToolTip(text)
        self._use_hint()
        self._hint_end.start()

    def _end_hint(self) -> None:
        detail = self._replay.playback.value.detail
        self._hint.setText(detail)
        self._hint.setToolTip(detail)
        self._use_hint()

    def _on_seek_requested(self, at_ns: int) -> None:
        self._replay.seek(at_ns)

    def _on_rate_chosen(self, index: int) -> None:
        self._replay.set_rate(RATES[index])

    def _words_of(self, at_ns: int) -> str:
        clock = self._replay.session.clock
        return moment_words(clock.session_s(at_ns) * 1000, clock.wall(at_ns))

    def _on_overview_changed(self, overview: SessionOverview | None) -> None:
        self.scrubber.show_overview(overview, self._words_of)
        kinds = set() if overview is None else {moment.kind for moment in overview.moments}
        wait = tr("Searching for marks") if overview is None else tr("No marks in this session")
        self._previous_mark.setToolTip(tr("Previous mark") if "mark" in kinds else wait)
        self._next_mark.setToolTip(tr("Next mark") if "mark" in kinds else wait)

    def _on_playback_changed(self, playback: PlaybackStatus) -> None:
        self.scrubber.show_session(playback.start_ns, playback.end_ns)
        self.scrubber.show_position(playback.position_ns)
        self._show_play(playing=playback.playing)
        clock = self._replay.session.clock
        self._times.show_times(
            clock.session_s(playback.position_ns),
            clock.session_s(playback.end_ns),
            clock.wall(playback.position_ns)[:8],
        )
        if playback.rate != self._rate.currentData():
            self._show_rate(playback.rate)
        if not self._hint_end.isActive() and playback.detail != self._hint.text():
            self._end_hint()

    def _show_play(self, *, playing: bool) -> None:
        label, icon = (tr("Pause"), "pause") if playing else (tr("Play"), "play")
        if (label, self._one_line) == self._play_shown:
            return
        self._play_shown = label, self._one_line
        self._play.set_label("" if self._one_line else label, icon=icon)
        self._play.setAccessibleName(label)
        self._play.setToolTip(label if self._one_line else "")
        # Fixed width for both texts, so that nothing moves.
        either = ("",) if self._one_line else (tr("Pause"), tr("Play"))
        self._play.setFixedWidth(max(44, *map(self._play.width_with, either)))

    def _show_rate(self, rate: float) -> None:
        index = self._rate.findData(rate)
        while self._rate.count() > len(RATES):
            self._rate.removeItem(len(RATES))
        if index < 0:
            self._rate.addItem(rate_text(rate), rate)
            index = self._rate.count() - 1
        self._rate.setCurrentIndex(index)

    def _style(self) -> None:
        self._theme.style_text(self._hint, "dim", tokens.STATUS_PX)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect(), self._theme.color("panel"))
        painter.setPen(self._theme.color("line"))
        painter.drawLine(0, 0, self.width(), 0)


class ReplayTitle(QWidget):
    """Badge of the replay with participant and time."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme, participant: str, when: str) -> None:
        super().__init__()
        self.setObjectName("replay_title")
        self.setAccessibleName(tr("Replay of {whom}, recorded {when}").format(whom=participant, when=when))
        tip = tr("A recorded session: {whom}, {when}. Nothing here moves the robot.")
        self.setToolTip(tip.format(whom=participant, when=when))
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._participant, self._when = participant, when
        self._date_shown = False  # until the width is known
        theme.changed.connect(self.update)

    @property
    def text(self) -> str:
        parts = (tr("Replay"), text_formatting.shortened(self._participant, 24), self._when if self._date_shown else "")
        return " · ".join(part for part in parts if part)

    def set_date_shown(self, shown: bool) -> None:
        if shown != self._date_shown:
            self._date_shown = shown
            self.updateGeometry()
            self.update()

    def sizeHint(self) -> QSize:
        metrics = QFontMetricsF(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
        return QSize(round(metrics.horizontalAdvance(self.text)) + 44, 32)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(self._theme.color("blue_soft"))
        painter.drawRoundedRect(QRectF(self.rect()), 16, 16)
        draw_icon(painter, QRectF(12, 8, 16, 16), "clock-counter-clockwise", self._theme.color("blue"))
        painter.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
        painter.setPen(self._theme.color("text"))
        flags = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        painter.drawText(QRectF(34, 0, self.width() - 40, self.height()), flags, self.text)


class ReplayTimes(QWidget):
    """Current and total time, and wall-clock time. Digits keep their positions while playing."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("replay_times")
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._now = self._total = self._wall = ""
        self._wall_shown = False
        theme.changed.connect(self.update)

    @property
    def text(self) -> str:
        return tr("{now} of {total} · {wall}").format(now=self._now, total=self._total, wall=self._wall)

    def set_wall_shown(self, shown: bool) -> None:
        if shown != self._wall_shown:
            self._wall_shown = shown
            self.updateGeometry()

    def show_times(self, now_s: float, total_s: float, wall: str) -> None:
        now = f"{text_formatting.elapsed(now_s)}.{int(max(0.0, now_s) * 10) % 10}"
        if total_s >= 3600 and now_s < 3600:
            now = f"0:{now}"
        if (now, text_formatting.elapsed(total_s), wall) == (self._now, self._total, self._wall):
            return
        resized = len(now) != len(self._now) or len(text_formatting.elapsed(total_s)) != len(self._total)
        self._now, self._total, self._wall = now, text_formatting.elapsed(total_s), wall
        name = tr("{now} of {total}, recorded at {wall}")
        self.setAccessibleName(name.format(now=self._now, total=self._total, wall=wall))
        if resized:
            self.updateGeometry()
        self.update()

    def _widths(self) -> tuple[float, float, float]:
        """Widths of current time, total and wall clock, with the widest digits."""
        now = QFontMetricsF(self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        rest = QFontMetricsF(self._theme.font(tokens.STATUS_PX))
        wide = "".join("0" if letter.isdigit() else letter for letter in self._now)
        return (
            now.horizontalAdvance(wide) + 4,
            rest.horizontalAdvance(tr("of {total}").format(total=self._total)) + 4,
            rest.horizontalAdvance(tr("at {wall}").format(wall="00:00:00")) + 4 if self._wall_shown else 0.0,
        )

    def sizeHint(self) -> QSize:
        return QSize(round(sum(self._widths())) + 16, 32)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, painter = self._theme, QPainter(self)
        now, total, wall = self._widths()
        right = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignRight)
        left = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        painter.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        painter.setPen(theme.color("text"))
        painter.drawText(QRectF(0, 0, now, self.height()), right, self._now)
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("dim"))
        painter.drawText(QRectF(now + 6, 1, total, self.height()), left, tr("of {total}").format(total=self._total))
        if wall:
            text = tr("at {wall}").format(wall=self._wall)
            painter.drawText(QRectF(now + total + 14, 1, wall, self.height()), left, text)


SCRUBBER_HEIGHT_PX = 32
_SIDE_PX = 8
_GROOVE_Y = 17.0
_STEP_NS = 5_000_000_000
_PICTURE = QSize(192, 108)
_PROBLEMS = ("problem", "trouble", "gap", "emergency")


class Scrubber(QWidget):
    """Slider over the session; ``seek_requested(at_ns)`` while dragging.

    Marks are flags above the line, utterances strokes on it, problems triangles below: distinguished by shape.
    """

    accessible_role = QAccessible.Role.Slider

    seek_requested = Signal(object)

    def __init__(self, theme: Theme, thumbnails: Thumbnails, named: Callable[[str], str]) -> None:
        super().__init__()
        self.setObjectName("replay_scrubber")
        self.setAccessibleName(tr("Position in the session"))
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)
        self.setFixedHeight(SCRUBBER_HEIGHT_PX)
        self.setMinimumWidth(120)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._thumbnails = thumbnails
        self._named = named
        self._start_ns = self._end_ns = self._position_ns = 0
        self._overview: SessionOverview | None = None
        self._problems_ms: list[int] = []
        self._words: Callable[[int], str] = lambda _at_ns: ""
        self._ticks: QPixmap | None = None
        self._hover_ns: int | None = None
        self._dragging = False
        self._by_key = False
        self._seeks = SeekThrottle(self)
        self._seeks.due.connect(self.seek_requested)
        self._bubble: SeekPreview | None = None
        thumbnails.made.connect(self._on_picture_made)
        theme.changed.connect(self._forget_ticks)

    # ---- display

    def show_session(self, start_ns: int, end_ns: int) -> None:
        if (start_ns, end_ns) != (self._start_ns, self._end_ns):
            self._start_ns, self._end_ns = start_ns, end_ns
            self._forget_ticks()

    def show_position(self, position_ns: int) -> None:
        """Set the replay's position; during a drag the handle stays at the pointer."""
        if position_ns != self._position_ns:
            before = self.x_of(self._position_ns)
            self._position_ns = position_ns
            if round(before * 2) != round(self.x_of(position_ns) * 2) and not self._dragging:
                self.update()
            if self._by_key:
                # Announce a jump by key, not every position of a playing replay.
                self._by_key = False
                self.setAccessibleDescription(self.accessible_words())

    def show_overview(self, overview: SessionOverview | None, words: Callable[[int], str]) -> None:
        """Set the events to show; ``words`` formats a time."""
        self._overview, self._words = overview, words
        self._problems_ms = []
        if overview is not None:
            problems = {
                tier.tier_id for tier in overview.tiers.tiers if any(word in tier.name.casefold() for word in _PROBLEMS)
            }
            self._problems_ms = [item.start_ms for item in overview.tiers.annotations if item.tier_id in problems]
        self._forget_ticks()

    def _forget_ticks(self) -> None:
        self._ticks = None
        self.update()

    @property
    def shown_ns(self) -> int:
        """Position of the handle."""
        return self._hover_ns if self._dragging and self._hover_ns is not None else self._position_ns

    def accessible_words(self) -> str:
        return self._words(self._position_ns)

    def x_of(self, at_ns: int) -> float:
        room = max(1, self.width() - 2 * _SIDE_PX)
        length = max(1, self._end_ns - self._start_ns)
        return _SIDE_PX + room * min(1.0, max(0.0, (at_ns - self._start_ns) / length))

    def moment_at(self, x_px: float) -> int:
        room = max(1, self.width() - 2 * _SIDE_PX)
        fraction = min(1.0, max(0.0, (x_px - _SIDE_PX) / room))
        return self._start_ns + round(fraction * (self._end_ns - self._start_ns))

    # ---- pointer and keys

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._dragging = True
            self._point_at(event.position().x())
            self._seeks.want(self.moment_at(event.position().x()))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._point_at(event.position().x())
        if self._dragging:
            self._seeks.want(self.moment_at(event.position().x()))

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._dragging:
            self._dragging = False
            self._position_ns = self.moment_at(event.position().x())
            self._seeks.want(self._position_ns)
            self.update()
            if not self.rect().contains(event.position().toPoint()):
                self._put_away()

    def leaveEvent(self, _event: object) -> None:
        if not self._dragging:
            self._put_away()

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self._put_away()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        steps = {
            Qt.Key.Key_Left: -1, Qt.Key.Key_Down: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Up: 1,
            Qt.Key.Key_PageDown: -6, Qt.Key.Key_PageUp: 6,
        }  # fmt: skip
        key = Qt.Key(event.key())
        self._by_key = key in steps or key in (Qt.Key.Key_Home, Qt.Key.Key_End)
        if event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            super().keyPressEvent(event)
        elif key in steps:
            self.seek_requested.emit(self._bounded(self._position_ns + steps[key] * _STEP_NS))
        elif key == Qt.Key.Key_Home:
            self.seek_requested.emit(self._start_ns)
        elif key == Qt.Key.Key_End:
            self.seek_requested.emit(self._end_ns)
        else:
            super().keyPressEvent(event)

    def _bounded(self, at_ns: int) -> int:
        return min(max(self._start_ns, at_ns), self._end_ns)

    def _point_at(self, x_px: float) -> None:
        self._hover_ns = self.moment_at(x_px)
        self._show_bubble()
        self.update()

    def _put_away(self) -> None:
        self._hover_ns = None
        if self._bubble is not None:
            self._bubble.hide()
        self.update()

    # ---- preview

    def _picture_moment(self, at_ns: int) -> int:
        """Time rounded to the preview grid, so that small pointer moves reuse the image."""
        grain_ns = max(500_000_000, (self._end_ns - self._start_ns) // 400)
        return self._start_ns + (at_ns - self._start_ns) // grain_ns * grain_ns

    def _show_bubble(self) -> None:
        if self._hover_ns is None or self._end_ns <= self._start_ns:
            return
        window = self.window()
        if self._bubble is None or self._bubble.parent() is not window:
            self._bubble = SeekPreview(self._theme, window)
        cameras = () if self._overview is None else self._overview.cameras
        picture = None
        if cameras:
            moment = self._picture_moment(self._hover_ns)
            picture = self._thumbnails.picture(cameras[0], moment)
            if picture is None:
                self._thumbnails.want(cameras[0], moment)
        at = self.mapTo(window, QPoint(round(self.x_of(self._hover_ns)), 0))
        self._bubble.show_moment(at, self._words(self._hover_ns), self._nearby(), picture, with_picture=bool(cameras))

    def _nearby(self) -> str:
        """Events at the pointer, as text."""
        if self._overview is None or self._hover_ns is None:
            return ""
        at_px = self.x_of(self._hover_ns)
        near = [moment for moment in self._overview.moments if abs(self.x_of(moment.at_ns) - at_px) <= 4]
        if not near:
            return ""
        nearest = min(near, key=lambda moment: (moment.kind != "mark", abs(self.x_of(moment.at_ns) - at_px)))
        if nearest.kind == "utterance":
            return self._named(tr_filled(nearest.text))
        return tr("Mark: {label}").format(label=tr_filled(nearest.text)) if nearest.text else tr("Mark: no label")

    def _on_picture_made(self, _camera: str, _at_ns: object) -> None:
        if self._bubble is not None and self._bubble.isVisible():
            self._show_bubble()

    # ---- drawing

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._ticks = None

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        groove = QRectF(_SIDE_PX, _GROOVE_Y - 2, self.width() - 2 * _SIDE_PX, 4)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(theme.color("line_strong"))
        painter.drawRoundedRect(groove, 2, 2)
        x = self.x_of(self.shown_ns)
        painter.setBrush(theme.color("blue"))
        painter.drawRoundedRect(QRectF(groove.left(), groove.top(), x - groove.left(), 4), 2, 2)
        if self._ticks is None:
            self._ticks = self._draw_ticks()
        painter.drawPixmap(0, 0, self._ticks)
        if self._hover_ns is not None and not self._dragging:
            painter.setPen(QPen(theme.color("dim"), 1))
            over = self.x_of(self._hover_ns)
            painter.drawLine(QPointF(over, 6), QPointF(over, SCRUBBER_HEIGHT_PX - 4))
        painter.setPen(QPen(theme.color("blue"), 2))
        painter.setBrush(theme.color("panel"))
        painter.drawEllipse(QPointF(x, _GROOVE_Y), 7, 7)
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(
                QRectF(self.rect()).adjusted(1, 1, -1, -1), tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX
            )

    def _draw_ticks(self) -> QPixmap:
        theme, ratio = self._theme, self.devicePixelRatioF()
        pixmap = QPixmap(round(self.width() * ratio), round(SCRUBBER_HEIGHT_PX * ratio))
        pixmap.setDevicePixelRatio(ratio)
        pixmap.fill(Qt.GlobalColor.transparent)
        if self._overview is None or self._end_ns <= self._start_ns:
            return pixmap
        painter = QPainter(pixmap)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        utterances = {round(self.x_of(item.at_ns)) for item in self._overview.moments if item.kind == "utterance"}
        painter.setPen(QPen(theme.color("dim"), 1))
        for x in utterances:
            painter.drawLine(QPointF(x + 0.5, _GROOVE_Y + 5), QPointF(x + 0.5, _GROOVE_Y + 10))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(theme.color("amber"))
        for x in {round(self.x_of(self._start_ns + at_ms * 1_000_000)) for at_ms in self._problems_ms}:
            painter.drawPolygon(QPolygonF([QPointF(x, _GROOVE_Y + 4), QPointF(x - 4, 28), QPointF(x + 4, 28)]))
        painter.setBrush(theme.color("blue"))
        for x in {round(self.x_of(item.at_ns)) for item in self._overview.moments if item.kind == "mark"}:
            painter.drawRect(QRectF(x - 0.75, 3, 1.5, _GROOVE_Y - 5))
            painter.drawPolygon(QPolygonF([QPointF(x, 3), QPointF(x + 8, 6), QPointF(x, 9)]))
        painter.end()
        return pixmap


class SeekPreview(QWidget):
    """Seek preview: image and time above the pointed position. Transparent to the mouse."""

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(window)
        self.setObjectName("moment_bubble")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._theme = theme
        self._time = ""
        self._text = ""
        self._picture: QImage | None = None
        self._with_picture = False
        self.hide()

    @property
    def shown_picture(self) -> QImage | None:
        return self._picture

    @property
    def text(self) -> str:
        """Text of the speech or mark at that time."""
        return self._text

    @property
    def time_text(self) -> str:
        return self._time

    def show_moment(
        self, above: QPoint, time_text: str, text: str, picture: QImage | None, *, with_picture: bool
    ) -> None:
        self._time, self._text, self._picture, self._with_picture = time_text, text, picture, with_picture
        metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX))
        width = max(metrics.horizontalAdvance(time_text), min(metrics.horizontalAdvance(text), 260.0)) + 24
        if with_picture:
            width = max(width, _PICTURE.width() + 16)
        height = 28 + (20 if text else 0) + (_PICTURE.height() + 8 if with_picture else 0)
        self.resize(round(width), round(height))
        room = self.window().width()
        left = min(max(8, above.x() - self.width() // 2), room - self.width() - 8)
        self.move(left, max(8, above.y() - self.height() - 4))
        self.show()
        self.raise_()
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = theme.paint_box(self, ground="panel", line="line_strong", radius_px=8)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        top = 8.0
        if self._with_picture:
            place = QRectF((self.width() - _PICTURE.width()) / 2, top, _PICTURE.width(), _PICTURE.height())
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("video_ground"))
            painter.drawRoundedRect(place, 4, 4)
            if self._picture is not None and not self._picture.isNull():
                size = self._picture.size().scaled(_PICTURE, Qt.AspectRatioMode.KeepAspectRatio)
                target = QRectF(0, 0, size.width(), size.height())
                target.moveCenter(place.center())
                painter.drawImage(target, self._picture)
            top += _PICTURE.height() + 4
        painter.setFont(theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM))
        painter.setPen(theme.color("text"))
        painter.drawText(QRectF(8, top, self.width() - 16, 20), Qt.AlignmentFlag.AlignCenter, self._time)
        if self._text:
            painter.setFont(theme.font(tokens.STATUS_PX))
            painter.setPen(theme.color("dim"))
            metrics = QFontMetricsF(painter.font())
            elided = metrics.elidedText(self._text, Qt.TextElideMode.ElideRight, self.width() - 16)
            painter.drawText(QRectF(8, top + 20, self.width() - 16, 18), Qt.AlignmentFlag.AlignCenter, elided)


def moment_words(at_ms: float, wall: str) -> str:
    """Session time and wall-clock time, as 12:34.500 · 10:26:36."""
    return f"{exact_text(at_ms)[:-2]} · {wall[:8]}"


SEEK_EVERY_MS = 40


class SeekThrottle(QObject):
    """Throttle for seeking while dragging: the newest position wins, at a rate that can be displayed.

    ``due(at_ns)`` at once for the first position, then for the newest one per interval.
    """

    due = Signal(object)

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._pending_ns: int | None = None
        self._pause = QTimer(self, singleShot=True, interval=SEEK_EVERY_MS)
        self._pause.timeout.connect(self._send)

    def want(self, at_ns: int) -> None:
        self._pending_ns = at_ns
        if not self._pause.isActive():
            self._send()

    def _send(self) -> None:
        if self._pending_ns is not None:
            position_ns, self._pending_ns = self._pending_ns, None
            self._pause.start()
            self.due.emit(position_ns)
