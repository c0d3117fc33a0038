"""Replay bar: play, pause, rate, steps, jumps, and a seek slider over the session."""

from collections import OrderedDict
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QPoint, QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAccessible,
    QHideEvent,
    QImage,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPixmap,
    QPolygonF,
    QResizeEvent,
)  # fmt: skip
from PySide6.QtWidgets import QFrame, QLabel, QSizePolicy, QSlider, QStyle, QWidget

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.live.replay_console import ReplayConsole
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.ui import layouts, text_formatting
from caris_desktop.ui.accessibility import has_role
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import REPLAY_ACTIONS
from caris_desktop.ui.replay.timeline_items import exact_text
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import label, named

RATES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
_HINT_MS = 2500
_HINT_PX = 20
_NARROWEST_PX = 640
_MOVES = {
    "previous_mark": "skip-back", "previous_utterance": "caret-double-left", "frame_back": "caret-left",
    "replay_play": "pause", "frame_on": "caret-right", "next_utterance": "caret-double-right",
    "next_mark": "skip-forward",
}  # fmt: skip


def session_title(session: Session) -> tuple[str, str]:
    """Participant and time of a session, as P07 and 21 Nov 2026 10:14."""
    when = datetime.fromtimestamp(session.clock.anchor.utc_ns_at(session.started_ns) / 1e9, UTC).astimezone()
    participant = session.trial.get("participant") or session.folder.name
    return participant, f"{text_formatting.day_of(when, with_year=True)} {when:%H:%M}"


class ReplayBar(QWidget):
    """Playback controls; ``actions`` gets the keys of a replay."""

    accessible_role = QAccessible.Role.Grouping

    def __init__(self, theme: Theme, replay: ReplayConsole, actions: Actions) -> None:
        super().__init__()
        named(self, "replay_bar", tr("Replay"))
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setMinimumWidth(_NARROWEST_PX)  # parts that can be hidden must not set it
        self._replay = replay
        actions.add_rows(REPLAY_ACTIONS, self)
        self.scrubber = Scrubber(theme, Thumbnails(replay, self), replay.with_names)
        self.scrubber.seek_requested.connect(replay.seek)
        self._participant, self._when = session_title(replay.session)
        self._title = label(textFormat=Qt.TextFormat.PlainText, objectName="replay_title")
        recorded = {"whom": self._participant, "when": self._when}
        self._title.setAccessibleName(tr("Replay of {whom}, recorded {when}").format(**recorded))
        tip = tr("A recorded session: {whom}, {when}. Nothing here moves the robot.")
        self._title.setToolTip(tip.format(**recorded))
        self._buttons: dict[str, ActionButton] = {}
        for action_id, icon in _MOVES.items():
            play = action_id == "replay_play"
            tip = actions.standard_row(action_id).text
            button = ActionButton(theme, icon=icon, role="primary" if play else "plain", height_px=36, toolTip=tip)
            button.setObjectName(action_id if play else f"replay_{action_id}")
            button.bind(actions, action_id)
            self._buttons[action_id] = button
        self._times = ReplayTimes()
        self._rate = DropDown(theme, "replay_rate", tr("Replay speed"), minimumContentsLength=5)
        self._rate.setToolTip(tr("Replay speed. Slower with <, faster with >"))
        self._rate.activated.connect(lambda index: replay.set_rate(self._rate.itemData(index)))
        self._hint = label("", "note", objectName="replay_hint")
        self._hint.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self._hint_end = QTimer(self, singleShot=True, interval=_HINT_MS)
        self._hint_end.timeout.connect(lambda: self._show_hint(self._replay.playback.value.detail))
        self._one_line = False
        self._play_shown: tuple[str, bool] | None = None
        self._left = layouts.hbox(None, self._title, spacing_px=8)
        middle = layouts.hbox(None, *self._buttons.values(), spacing_px=8)
        self._right = layouts.hbox(None, 1, self._times, self._rate, spacing_px=12)
        self._row = layouts.hbox(None, self._left, middle, self._right, margins_px=(8, 0, 8, 0))
        self._column = layouts.vbox(self, self._row, spacing_px=0)
        self._arrange()
        replay.playback.follow(self._on_playback_changed)
        replay.overview.follow(self._on_overview_changed)

    def set_one_line(self, one_line: bool) -> None:
        """Use a single line with keys in tooltips; in a small window the video needs the space."""
        if one_line != self._one_line:
            self._one_line = one_line
            self._arrange()

    def _arrange(self) -> None:
        one_line = self._one_line
        self._title.setVisible(not one_line)
        for button in self._buttons.values():
            button.set_key_shown(not one_line)
        if one_line:
            self._row.insertWidget(2, self.scrubber, 1)
            self._column.insertWidget(0, self._hint)
        else:
            self._column.insertWidget(0, self.scrubber)
            self._left.addWidget(self._hint, 1)
        for part in (self._left, self._right):
            self._row.setStretchFactor(part, 0 if one_line else 1)
        self._row.setSpacing(10 if one_line else 16)
        self._column.setContentsMargins(8, 6 if one_line else 4, 8, 6 if one_line else 8)
        self._show_play(playing=self._replay.playback.value.playing)
        self._show_hint(self._hint.text())
        self._use_width()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._use_width()

    def _use_width(self) -> None:
        width = 0 if self._one_line else self.width()
        self._times.wall.setVisible(width >= 1240)
        participant = text_formatting.shortened(self._participant, 24)
        parts = (tr("Replay"), participant, self._when if width >= 1160 else "")
        self._title.setText(" · ".join(part for part in parts if part))
        for action_id in ("previous_utterance", "next_utterance"):
            self._buttons[action_id].setVisible(width >= 1440)

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
                words = tr("No later mark") if direction > 0 else tr("No earlier mark")
            else:
                words = tr("No later utterance") if direction > 0 else tr("No earlier utterance")
            self._show_hint(words)
            self._hint_end.start()

    def change_rate(self, direction: int) -> None:
        """Switch to the next faster (1) or slower (-1) rate."""
        rate: float = self._replay.playback.value.rate
        others = [other for other in RATES if (other > rate if direction > 0 else other < rate)]
        if others:
            self._replay.set_rate(min(others) if direction > 0 else max(others))

    # ---- display

    def _show_hint(self, text: str) -> None:
        """Show the hint; above a single-line bar while there is one."""
        self._hint.setText(text)
        self._hint.setToolTip(text)
        self._hint.setVisible(bool(text) or not self._one_line)
        self.setFixedHeight(48 + _HINT_PX * bool(text) if self._one_line else 84)

    def _time_words(self, at_ns: int) -> str:
        """Session time and wall-clock time, as 12:34.5 · 10:26:36."""
        clock = self._replay.session.clock
        return f"{exact_text(clock.session_s(at_ns) * 1000)[:-2]} · {clock.wall(at_ns)[:8]}"

    def _on_overview_changed(self, overview: SessionOverview | None) -> None:
        self.scrubber.show_overview(overview, self._time_words)
        missing = tr("Searching for marks") if overview is None else tr("No marks in this session")
        there = overview is not None and any(moment.kind == "mark" for moment in overview.moments)
        for action_id in ("previous_mark", "next_mark"):
            button = self._buttons[action_id]
            button.setToolTip(button.accessibleName() if there else missing)

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
            rates = dict.fromkeys((*RATES, playback.rate))
            self._rate.fill([(f"{rate:g}×", rate) for rate in rates], playback.rate)
        if not self._hint_end.isActive() and playback.detail != self._hint.text():
            self._show_hint(playback.detail)

    def _show_play(self, *, playing: bool) -> None:
        button, words = self._buttons["replay_play"], (tr("Pause"), tr("Play"))
        label = words[0] if playing else words[1]
        if (label, self._one_line) == self._play_shown:
            return
        self._play_shown = label, self._one_line
        text, tip = ("", label) if self._one_line else (label, "")
        button.set_label(text, icon="pause" if playing else "play", name=label, tip=tip)
        # Fixed width for both texts, so that nothing moves.
        button.setFixedWidth(max(44, *map(button.width_with, ("", "") if self._one_line else words)))


class ReplayTimes(QWidget):
    """Current and total time, and wall-clock time. Digits keep their positions while playing."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("replay_times")
        has_role(self, QAccessible.Role.StaticText)
        self.now, self.total, self.wall = QLabel(), QLabel(), QLabel()
        self.now.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        for part, role in ((self.now, "time"), (self.total, "note"), (self.wall, "note")):
            part.setProperty("role", role)
        layouts.hbox(self, self.now, self.total, self.wall, margins_px=0, spacing_px=8)

    def show_times(self, now_s: float, total_s: float, wall: str) -> None:
        now = f"{text_formatting.elapsed(now_s)}.{int(max(0.0, now_s) * 10) % 10}"
        total = text_formatting.elapsed(total_s)
        if total_s >= 3600 and now_s < 3600:
            now = f"0:{now}"
        texts = (now, tr("of {total}").format(total=total), tr("at {wall}").format(wall=wall))
        for part, text in zip((self.now, self.total, self.wall), texts, strict=True):
            if text != part.text():
                part.setText(text)
                part.ensurePolished()
                widest = "".join("0" if letter.isdigit() else letter for letter in text)
                part.setMinimumWidth(part.fontMetrics().horizontalAdvance(widest) + 4)
        name = tr("{now} of {total}, recorded at {wall}").format(now=now, total=total, wall=wall)
        if name != self.accessibleName():
            self.setAccessibleName(name)


_KEPT = 400
_REQUESTED_AT_ONCE = 150
"""Below the number of requests that a replay holds; older ones are dropped there without an answer."""


class Thumbnails(QObject):
    """Thumbnail cache; ``made`` reports a new image. The replay makes the newest request first."""

    made = Signal()

    def __init__(self, replay: ReplayConsole, parent: QObject) -> None:
        super().__init__(parent)
        self._replay = replay
        self._cache: OrderedDict[tuple[str, int], QImage] = OrderedDict()
        self._requested: set[tuple[str, int]] = set()
        replay.thumbnail_made.connect(self._on_made)

    def picture(self, camera: str, at_ns: int) -> QImage | None:
        """The thumbnail if cached, else requested; a null image if there was none."""
        key = (camera, at_ns)
        if key in self._cache:
            self._cache.move_to_end(key)
        elif key not in self._requested:
            if len(self._requested) >= _REQUESTED_AT_ONCE:
                self._requested.clear()
            self._requested.add(key)
            self._replay.request_thumbnail(camera, at_ns)
        return self._cache.get(key)

    def _on_made(self, camera: str, at_ns: int, image_bgr: NDArray[np.uint8] | None) -> None:
        image = QImage()
        if image_bgr is not None and image_bgr.size:
            height, width = image_bgr.shape[:2]
            # QImage does not copy the array, which may be freed.
            rows = np.ascontiguousarray(image_bgr)
            image = QImage(rows.data, width, height, 3 * width, QImage.Format.Format_BGR888).copy()
        self._requested.discard((camera, int(at_ns)))
        self._cache[camera, int(at_ns)] = image
        while len(self._cache) > _KEPT:
            self._cache.popitem(last=False)
        self.made.emit()


_SIDE_PX = 8
_HEIGHT_PX, _MIDDLE_PX = 32, 16.5
_NS_PER_MS = 1_000_000
_PICTURE = QSize(192, 108)
_PROBLEMS = ("problem", "trouble", "gap", "emergency")


class Scrubber(QSlider):
    """Slider over the session in ms; ``seek_requested(at_ns)`` while dragging.

    Marks are flags above the line, utterances strokes on it, problems triangles below: distinguished by shape. It
    tracks its position only, not the value: screen readers announce a changed value, and playback is no announcement.
    """

    accessible_role = QAccessible.Role.Slider

    seek_requested = Signal(object)

    def __init__(self, theme: Theme, thumbnails: Thumbnails, named: Callable[[str], str]) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self.setTracking(False)
        self.setSingleStep(5000)
        self.setPageStep(30_000)
        self.setObjectName("replay_scrubber")
        self.setAccessibleName(tr("Position in the session"))
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)
        self.setFixedHeight(_HEIGHT_PX)
        self.setMinimumWidth(120)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._thumbnails = thumbnails
        self._named = named
        self._start_ns = 0
        self._overview: SessionOverview | None = None
        self._words: Callable[[int], str] = lambda _at_ns: ""
        self._ticks: QPixmap | None = None
        self._hover_ns: int | None = None
        self._by_key = False
        self._seeks = SeekThrottle(self)
        self._seeks.due.connect(self.seek_requested)
        self._preview: SeekPreview | None = None
        self.actionTriggered.connect(self._on_action)
        thumbnails.made.connect(self._on_picture_made)
        theme.changed.connect(self._forget_ticks)

    # ---- display

    def show_session(self, start_ns: int, end_ns: int) -> None:
        end_ms = max(0, end_ns - start_ns) // _NS_PER_MS
        if (start_ns, end_ms) != (self._start_ns, self.maximum()):
            self._start_ns = start_ns
            self.setMaximum(end_ms)
            self._forget_ticks()

    def show_position(self, position_ns: int) -> None:
        """Set the replay's position; during a drag the handle stays at the pointer."""
        position_ms = round((position_ns - self._start_ns) / _NS_PER_MS)
        if position_ms != self.sliderPosition() and not self.isSliderDown():
            self.setSliderPosition(position_ms)
        if self._by_key:
            # Announce a jump by key, not every position of a playing replay.
            self._by_key = False
            self.setAccessibleDescription(self.accessible_words())

    def show_overview(self, overview: SessionOverview | None, words: Callable[[int], str]) -> None:
        """Set the events to show; ``words`` formats a time."""
        self._overview, self._words = overview, words
        self._forget_ticks()

    def _forget_ticks(self) -> None:
        self._ticks = None
        self.update()

    @property
    def shown_ns(self) -> int:
        """Position of the handle."""
        return self._start_ns + self.sliderPosition() * _NS_PER_MS

    def accessible_words(self) -> str:
        return self._words(self.shown_ns)

    def x_of(self, at_ns: int) -> int:
        at_ms, room_px = (at_ns - self._start_ns) // _NS_PER_MS, self.width() - 2 * _SIDE_PX
        return _SIDE_PX + QStyle.sliderPositionFromValue(0, self.maximum(), at_ms, room_px)

    def moment_at(self, x_px: float) -> int:
        x, room_px = round(x_px) - _SIDE_PX, self.width() - 2 * _SIDE_PX
        return self._start_ns + QStyle.sliderValueFromPosition(0, self.maximum(), x, room_px) * _NS_PER_MS

    # ---- pointer and keys

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self.setSliderDown(True)
            self.mouseMoveEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._hover_ns = self.moment_at(event.position().x())
        if self.isSliderDown():
            self.setSliderPosition((self._hover_ns - self._start_ns) // _NS_PER_MS)
            self._seeks.want(self._hover_ns)
        self._show_preview()
        self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self.isSliderDown():
            self.mouseMoveEvent(event)
            self.setSliderDown(False)
            if not self.rect().contains(event.position().toPoint()):
                self._hide_preview()

    def leaveEvent(self, _event: object) -> None:
        if not self.isSliderDown():
            self._hide_preview()

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self._hide_preview()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            event.ignore()
        else:
            self.setValue(self.sliderPosition())  # keys step from the value
            super().keyPressEvent(event)

    def _on_action(self, action: int) -> None:
        if action != QSlider.SliderAction.SliderMove.value:
            self._by_key = True
            self.seek_requested.emit(self.shown_ns)

    # ---- preview

    def _show_preview(self) -> None:
        if self._hover_ns is None or not self.maximum():
            return
        window = self.window()
        if self._preview is None or self._preview.parent() is not window:
            self._preview = SeekPreview(window)
        picture = None
        if self._overview is not None and self._overview.cameras:
            # Rounded, so that small pointer moves reuse the image.
            grain_ns = max(500, self.maximum() // 400) * _NS_PER_MS
            grained_ns = self._start_ns + (self._hover_ns - self._start_ns) // grain_ns * grain_ns
            picture = self._thumbnails.picture(self._overview.cameras[0], grained_ns) or QImage()
        at = self.mapTo(window, QPoint(self.x_of(self._hover_ns), 0))
        self._preview.show_moment(at, self._words(self._hover_ns), self._nearby(self._hover_ns), picture)

    def _hide_preview(self) -> None:
        self._hover_ns = None
        if self._preview is not None:
            self._preview.hide()
        self.update()

    def _nearby(self, at_ns: int) -> str:
        """Events at the pointer, as text."""
        moments = () if self._overview is None else self._overview.moments
        far_px = {moment: abs(self.x_of(moment.at_ns) - self.x_of(at_ns)) for moment in moments}
        near = [moment for moment in moments if far_px[moment] <= 4]
        if not near:
            return ""
        nearest = min(near, key=lambda moment: (moment.kind != "mark", far_px[moment]))
        text = tr_filled(nearest.text)
        if nearest.kind == "utterance":
            return self._named(text)
        return tr("Mark: {label}").format(label=text) if text else tr("Mark: no label")

    def _on_picture_made(self) -> None:
        if self._preview is not None and self._preview.isVisible():
            self._show_preview()

    # ---- drawing

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._ticks = None

    def paintEvent(self, event: QPaintEvent) -> None:
        painter = QPainter(self)
        if self._ticks is None:
            self._ticks = self._draw_ticks()
        painter.drawPixmap(0, 0, self._ticks)
        if self._hover_ns is not None and not self.isSliderDown():
            x = self.x_of(self._hover_ns)
            painter.fillRect(x, 6, 1, _HEIGHT_PX - 10, self._theme.color("dim"))
        painter.end()
        super().paintEvent(event)

    def _draw_ticks(self) -> QPixmap:
        theme, ratio, overview = self._theme, self.devicePixelRatioF(), self._overview
        pixmap = QPixmap(round(self.width() * ratio), round(_HEIGHT_PX * ratio))
        pixmap.setDevicePixelRatio(ratio)
        pixmap.fill(Qt.GlobalColor.transparent)
        if overview is None or not self.maximum():
            return pixmap
        painter = QPainter(pixmap)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        tiers = {
            tier.tier_id for tier in overview.tiers.tiers if any(word in tier.name.casefold() for word in _PROBLEMS)
        }
        problems_ms = [item.start_ms for item in overview.tiers.annotations if item.tier_id in tiers]
        for x in {self.x_of(item.at_ns) for item in overview.moments if item.kind == "utterance"}:
            painter.fillRect(QRectF(x, _MIDDLE_PX + 5, 1, 5), theme.color("dim"))
        painter.setBrush(theme.color("amber"))
        for x in {self.x_of(self._start_ns + at_ms * _NS_PER_MS) for at_ms in problems_ms}:
            painter.drawPolygon(QPolygonF([QPointF(x, _MIDDLE_PX + 4), QPointF(x - 4, 28), QPointF(x + 4, 28)]))
        painter.setBrush(theme.color("blue"))
        for x in {self.x_of(item.at_ns) for item in overview.moments if item.kind == "mark"}:
            painter.drawRect(QRectF(x - 0.75, 3, 1.5, _MIDDLE_PX - 5))
            painter.drawPolygon(QPolygonF([QPointF(x, 3), QPointF(x + 8, 6), QPointF(x, 9)]))
        painter.end()
        return pixmap


class SeekPreview(QFrame):
    """Image, time and event of the pointed position, above it. Transparent to the mouse."""

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self.hide()
        self.setObjectName("moment_bubble")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.picture, self.time, self.words = (QLabel(textFormat=Qt.TextFormat.PlainText) for _ in range(3))
        self.picture.setObjectName("moment_picture")
        self.picture.setFixedSize(_PICTURE)
        self.words.setProperty("role", "note")
        self.time.setProperty("role", "moment")
        column = layouts.vbox(self, margins_px=8, spacing_px=4)
        for part in (self.picture, self.time, self.words):
            part.setAlignment(Qt.AlignmentFlag.AlignCenter)
            column.addWidget(part, 0, Qt.AlignmentFlag.AlignCenter)

    def show_moment(self, above: QPoint, time_text: str, text: str, picture: QImage | None) -> None:
        """``picture``: None without video, a null image until it is there."""
        self.picture.setVisible(picture is not None)
        if picture is not None and not picture.isNull():
            smooth = Qt.TransformationMode.SmoothTransformation
            picture = picture.scaled(_PICTURE, Qt.AspectRatioMode.KeepAspectRatio, smooth)
        self.picture.setPixmap(QPixmap.fromImage(picture or QImage()))
        self.time.setText(time_text)
        self.words.setText(text_formatting.shortened(text, 44))
        self.words.setVisible(bool(text))
        self.show()
        self.adjustSize()
        left = min(max(8, above.x() - self.width() // 2), self.window().width() - self.width() - 8)
        self.move(left, max(8, above.y() - self.height() - 4))
        self.raise_()


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
