"""Painting of the timeline's static content: row names, ruler, and the visible part of the rows.

Annotation boxes are written as pixels of one image per row, however many there are; only legible labels are drawn
individually.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRect, QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QImage, QPainter, QPixmap, QStaticText

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.replay.thumbnails import Moment, Thumbnails
from caris_desktop.ui.replay.timeline_model import (
    Row,
    TimeScale,
    Track,
    initials,
    picture_step_ms,
    ruler_ticks,
    speed_columns,
    vocabulary_title,
    wave_columns,
)
from caris_desktop.ui.theme import Theme

NAMES_PX = 208
RULER_PX = 28
MENU_PX = 28
PAD_PX = 3
TEXT_FROM_PX = 22.0
_LABEL_FROM_PX = 34
_NARROW_PX = 3
_ROOMY_PX = 90
_BESIDE_PX = 240
_PICTURE_SHAPE = 16 / 9
_LABELS_KEPT = 20_000
_EMPTY_TRACK = Track(())
_LEFT = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
_RECORD_ICONS = (
    ("speech", "chat-text"), ("motion", "navigation-arrow"), ("driv", "game-controller"), ("goal", "flag"),
    ("people", "users"), ("person", "user"), ("error", "warning"), ("mark", "bookmark-simple"), ("note", "note"),
    ("problem", "warning"), ("trouble", "wifi-slash"), ("gap", "warning"), ("emergency", "hand-palm"),
    ("guard", "shield-check"), ("pause", "pause"), ("llm", "sparkle"), ("scenario", "map-trifold"),
    ("layout", "layout"), ("robot", "robot"), ("participant", "user"),
)  # fmt: skip


@dataclass(slots=True)
class TimelineState:
    """Timeline state: rows with scroll offsets, ruler scale and playhead."""

    rows: list[Row] = field(default_factory=list)
    tops: list[int] = field(default_factory=lambda: [0])
    tracks: Mapping[str, Track] = field(default_factory=dict)
    coders: Sequence[str] = ()
    overview: SessionOverview | None = None
    loudest: dict[str, float] = field(default_factory=dict)
    fastest_mps: float = 0.1
    started_ns: int = 0
    duration_ms: float = 1.0
    scale: TimeScale = field(default_factory=lambda: TimeScale(0.0, 0.01))
    scroll_y: int = 0
    position_ms: float = 0.0
    active: str = ""
    words: str = ""
    width_px: int = NAMES_PX + 1
    height_px: int = RULER_PX + 1

    @property
    def room_px(self) -> int:
        """Width of the part below the ruler."""
        return max(1, self.width_px - NAMES_PX)

    def show_overview(self, overview: SessionOverview | None) -> None:
        self.overview = overview
        waves = () if overview is None else overview.waveforms
        self.loudest = {wave.source: max(0.1, float(np.abs(wave.peaks).max(initial=0.0))) for wave in waves}
        speed = np.zeros(0) if overview is None else np.abs(overview.speed[:, 1])
        self.fastest_mps = max(0.1, float(speed.max(initial=0.0)))

    def row_top(self, index: int) -> int:
        """Top of the row in the widget."""
        return RULER_PX + self.tops[index] - self.scroll_y

    def visible_rows(self) -> Iterator[int]:
        for index, row in enumerate(self.rows):
            top = self.row_top(index)
            if top + row.height_px > RULER_PX and top < self.height_px:
                yield index

    def track_of(self, row: Row) -> Track:
        return self.tracks.get(row.key, _EMPTY_TRACK)


class TimelineDrawing:
    """Draws the two layers of the canvas and requests missing thumbnails.

    ``named`` translates a label.
    """

    def __init__(self, theme: Theme, thumbnails: Thumbnails, named: Callable[[str], str]) -> None:
        self._theme = theme
        self._thumbnails = thumbnails
        self._named = named
        self._labels: dict[tuple[str, int, bool], QStaticText] = {}

    def color_of(self, state: TimelineState, coder: str) -> QColor:
        colors = self._theme.colors.coders
        return QColor(colors[state.coders.index(coder) % len(colors)] if coder in state.coders else colors[0])

    def _empty(self, width_px: int, height_px: int, ratio: float, ground: str) -> QPixmap:
        layer = QPixmap(max(1, round(width_px * ratio)), max(1, round(height_px * ratio)))
        layer.setDevicePixelRatio(ratio)
        layer.fill(self._theme.color(ground))
        return layer

    # ---- row names

    def names(self, state: TimelineState, ratio: float) -> QPixmap:
        """Layer of row names, including the corner above."""
        theme = self._theme
        layer = self._empty(NAMES_PX, state.height_px, ratio, "panel")
        painter = QPainter(layer)
        painter.setClipRect(0, RULER_PX, NAMES_PX, state.height_px - RULER_PX)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for index in state.visible_rows():
            self._draw_name(painter, state, index)
        painter.setClipping(False)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        painter.setPen(theme.color("line"))
        painter.drawLine(NAMES_PX - 1, 0, NAMES_PX - 1, state.height_px)
        painter.drawLine(0, RULER_PX - 1, NAMES_PX, RULER_PX - 1)
        painter.end()
        return layer

    def _draw_name(self, painter: QPainter, state: TimelineState, index: int) -> None:
        theme, row, top = self._theme, state.rows[index], state.row_top(index)
        rect = QRectF(0, top, NAMES_PX - 1, row.height_px)
        if row.key == state.active:
            painter.fillRect(rect, theme.color("blue_soft"))
            painter.fillRect(QRectF(0, top, 3, row.height_px), theme.color("blue"))
        painter.fillRect(QRectF(0, rect.bottom() - 1, NAMES_PX, 1), theme.color("line"))
        chip = QRectF(12, rect.center().y() - 9, 18, 18)
        if row.own:
            letters = initials(row.coder)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self.color_of(state, row.coder))
            painter.drawEllipse(chip)
            painter.setPen(theme.color("panel"))
            painter.setFont(theme.font(9 if len(letters) > 1 else 11, tokens.WEIGHT_SEMIBOLD))
            painter.drawText(chip, int(Qt.AlignmentFlag.AlignCenter), letters)
        else:
            draw_icon(painter, chip.adjusted(2, 2, -2, -2), _row_icon(row), theme.color("dim"))
        left, room = 38.0, NAMES_PX - 38.0 - MENU_PX
        font = theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM if row.own else tokens.WEIGHT_NORMAL)
        metrics = QFontMetricsF(font)
        name = metrics.elidedText(row.name, Qt.TextElideMode.ElideRight, room)
        painter.setFont(font)
        painter.setPen(theme.color("text" if row.own else "dim"))
        painter.drawText(QRectF(left, top, room, row.height_px), _LEFT, name)
        used = metrics.horizontalAdvance(name) + 8
        detail = _detail_of(state, row)
        if detail and room - used > TEXT_FROM_PX:
            small = theme.font(tokens.KEY_CAP_PX)
            painter.setFont(small)
            painter.setPen(theme.color("dim"))
            cut = QFontMetricsF(small).elidedText(detail, Qt.TextElideMode.ElideRight, room - used)
            painter.drawText(QRectF(left + used, top, room - used, row.height_px), _LEFT, cut)

    # ---- rows

    def rows(self, state: TimelineState, ratio: float) -> QPixmap:
        """Layer of ruler and rows, without row names."""
        theme, room = self._theme, state.room_px
        layer = self._empty(room, state.height_px, ratio, "window")
        painter = QPainter(layer)
        ticks = ruler_ticks(state.scale, room)
        xs = [round(state.scale.to_px(tick.at_ms)) for tick in ticks]
        painter.setPen(theme.color("line"))
        for tick, x in zip(ticks, xs, strict=True):
            if tick.label:
                painter.drawLine(x, RULER_PX, x, state.height_px)
        moments: list[Moment] = []
        for index in state.visible_rows():
            self._draw_row(painter, state, index, moments)
        if not state.rows and state.words:
            place = QRect(0, RULER_PX, room, state.height_px - RULER_PX)
            painter.setFont(theme.font())
            painter.setPen(theme.color("dim"))
            painter.drawText(place, int(Qt.AlignmentFlag.AlignCenter), state.words)
        painter.fillRect(0, 0, room, RULER_PX, theme.color("panel"))
        painter.setFont(theme.font(tokens.KEY_CAP_PX))
        for tick, x in zip(ticks, xs, strict=True):
            painter.setPen(theme.color("line_strong"))
            painter.drawLine(x, RULER_PX - (10 if tick.label else 5), x, RULER_PX - 2)
            if tick.label:
                painter.setPen(theme.color("dim"))
                painter.drawText(x + 5, RULER_PX - 9, tick.label)
        painter.setPen(theme.color("line"))
        painter.drawLine(0, RULER_PX - 1, room, RULER_PX - 1)
        painter.end()
        self._thumbnails.want_shown(moments)
        return layer

    def _draw_row(self, painter: QPainter, state: TimelineState, index: int, moments: list[Moment]) -> None:
        row, top, theme = state.rows[index], state.row_top(index), self._theme
        if row.key == state.active:
            painter.fillRect(QRect(0, top, state.room_px, row.height_px), theme.color("panel"))
        painter.fillRect(QRect(0, top + row.height_px - 1, state.room_px, 1), theme.color("line"))
        match row.kind:
            case "pictures":
                self._draw_pictures(painter, state, row, top, moments)
            case "sound":
                self._draw_sound(painter, state, row, top)
            case "speed":
                self._draw_speed(painter, state, row, top)
            case _:
                self._draw_annotations(painter, state, row, top)

    def _draw_pictures(
        self, painter: QPainter, state: TimelineState, row: Row, top: int, moments: list[Moment]
    ) -> None:
        height = row.height_px - 5
        width = height * _PICTURE_SHAPE
        step_ms = picture_step_ms(state.scale.px_per_ms, width + 2)
        first = int(state.scale.start_ms // step_ms) * step_ms
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        ground = self._theme.color("raised")
        for at_ms in range(first, int(min(state.scale.to_ms(state.room_px), state.duration_ms)) + 1, step_ms):
            middle_ms = min(at_ms + step_ms // 2, int(state.duration_ms))
            moment = (row.source, state.started_ns + middle_ms * 1_000_000)
            place = QRectF(state.scale.to_px(at_ms), top + 2, width, height)
            picture = self._thumbnails.picture(*moment)
            if picture is None:
                moments.append(moment)
            if picture is None or picture.isNull():
                painter.fillRect(place, ground)
            else:
                size = picture.size().toSizeF().scaled(place.size(), Qt.AspectRatioMode.KeepAspectRatio)
                painter.drawImage(QRectF(place.topLeft(), size), picture)

    def _draw_sound(self, painter: QPainter, state: TimelineState, row: Row, top: int) -> None:
        waves = () if state.overview is None else state.overview.waveforms
        wave = next((wave for wave in waves if wave.source == row.source), None)
        if wave is None:
            return
        columns = wave_columns(
            wave,
            first_ns=state.started_ns + round(state.scale.start_ms * 1e6),
            ns_per_px=1e6 / state.scale.px_per_ms,
            width_px=state.room_px,
        )
        half, loudest = (row.height_px - 7) / 2, state.loudest[row.source]
        tops, bottoms = half + 3 - columns[:, 1] / loudest * half, half + 3 - columns[:, 0] / loudest * half
        strokes = columns_image(tops, np.maximum(bottoms, tops + 1), row.height_px - 1, self._theme.color("green"))
        painter.drawImage(0, top, strokes)

    def _draw_speed(self, painter: QPainter, state: TimelineState, row: Row, top: int) -> None:
        if state.overview is None:
            return
        columns = speed_columns(state.overview.speed, state.scale, state.room_px)
        height = row.height_px - 1
        tops = height - columns[:, 0] / state.fastest_mps * (height - 4)
        ground = self._theme.color("blue")
        ground.setAlpha(120)
        painter.drawImage(0, top, columns_image(tops, np.full(len(columns), height, np.float32), height, ground))
        painter.drawImage(0, top, columns_image(tops - 1, tops + 0.6, height, self._theme.color("blue")))

    def _draw_annotations(self, painter: QPainter, state: TimelineState, row: Row, top: int) -> None:
        track, scale, room = state.track_of(row), state.scale, state.room_px
        found = track.between(scale.start_ms, scale.to_ms(room))
        if not found:
            return
        theme, part = self._theme, slice(found.start, found.stop)
        lefts = ((track.starts_ms[part] - scale.start_ms) * scale.px_per_ms).astype(np.int64)
        # A pixel of space separates adjacent boxes.
        rights = np.maximum(((track.ends_ms[part] - scale.start_ms) * scale.px_per_ms).astype(np.int64) - 1, lefts + 1)
        line = self.color_of(state, row.coder) if row.own else theme.color("line_strong")
        ground = QColor(line) if row.own else theme.color("line")
        if row.own:
            ground.setAlpha(70)
        height = row.height_px - 2 * PAD_PX
        narrow = line if row.own else theme.color("dim")
        boxes = outlines_image(lefts, rights, room, height, line=line, ground=ground, narrow=narrow)
        painter.drawImage(0, top + PAD_PX, boxes)
        painter.setFont(theme.font(tokens.STATUS_PX if row.own else tokens.KEY_CAP_PX))
        painter.setPen(theme.color("text"))
        metrics = QFontMetricsF(painter.font())
        y = top + (row.height_px - metrics.height()) / 2
        # A long interval that starts before the visible part still shows its label; a short one may use the space up to
        # the next.
        widths, following = rights - lefts, np.append(lefts[1:], room)
        cut_short = (widths < _ROOMY_PX) & (following - rights > 2 * widths) & (not row.own)
        beside = (widths < _LABEL_FROM_PX) | cut_short
        starts = np.where(beside, rights + 4, np.maximum(lefts, 0) + 6)
        ends = np.where(beside, np.minimum(following - 2, starts + _BESIDE_PX), rights - 3)
        for number in np.flatnonzero(ends - starts >= TEXT_FROM_PX).tolist():
            value = tr_filled(track.annotations[found.start + number].value)
            if value:
                label = self._label(value, int(ends[number] - starts[number]), metrics, small=not row.own)
                painter.drawStaticText(QPointF(float(starts[number]), y), label)

    def _label(self, value: str, room_px: int, metrics: QFontMetricsF, *, small: bool) -> QStaticText:
        """Elided label, laid out once."""
        key = (value, room_px // 3, small)
        label = self._labels.get(key)
        if label is None:
            if len(self._labels) > _LABELS_KEPT:
                self._labels.clear()
            text = metrics.elidedText(
                " ".join(self._named(value[:400]).split()), Qt.TextElideMode.ElideRight, room_px // 3 * 3
            )
            label = QStaticText(text)
            label.setTextFormat(Qt.TextFormat.PlainText)
            self._labels[key] = label
        return label


def columns_image(tops: NDArray[np.floating], bottoms: NDArray[np.floating], height_px: int, color: QColor) -> QImage:
    """Image of one vertical stroke per column, from ``tops`` to ``bottoms`` in px; none where NaN."""
    ys = np.arange(height_px, dtype=np.float32)[:, None]
    with np.errstate(invalid="ignore"):
        filled = (ys >= np.floor(tops)[None, :]) & (ys < np.ceil(bottoms)[None, :])
    return _image(np.where(filled, _premultiplied(color), np.uint32(0)))


def outlines_image(
    lefts: NDArray[np.int64],
    rights: NDArray[np.int64],
    width_px: int,
    height_px: int,
    *,
    line: QColor,
    ground: QColor,
    narrow: QColor,
) -> QImage:
    """Image of outlined boxes in one row; ``rights`` are exclusive.

    Boxes too narrow for an outline are filled with ``narrow``.
    """
    covered = _covered(lefts, rights, width_px)
    column = np.where(covered, _premultiplied(ground), np.uint32(0))
    edge = np.where(covered, _premultiplied(line), np.uint32(0))
    pixels = np.broadcast_to(column, (height_px, width_px)).copy()
    pixels[0] = pixels[-1] = edge
    for sides in (lefts, rights - 1):
        pixels[:, sides[(sides >= 0) & (sides < width_px)]] = _premultiplied(line)
    tiny = rights - lefts <= _NARROW_PX
    pixels[:, _covered(lefts[tiny], rights[tiny], width_px)] = _premultiplied(narrow)
    return _image(pixels)


def _covered(lefts: NDArray[np.int64], rights: NDArray[np.int64], width_px: int) -> NDArray[np.bool_]:
    """Mask of pixels covered by any interval."""
    steps = np.zeros(width_px + 1, np.int64)
    np.add.at(steps, np.clip(lefts, 0, width_px), 1)
    np.add.at(steps, np.clip(rights, 0, width_px), -1)
    return np.cumsum(steps[:-1]) > 0


def _premultiplied(color: QColor) -> np.uint32:
    alpha = color.alpha() / 255
    red, green, blue = (round(part * alpha) for part in (color.red(), color.green(), color.blue()))
    return np.uint32((color.alpha() << 24) | (red << 16) | (green << 8) | blue)


def _image(pixels: NDArray[np.uint32]) -> QImage:
    height, width = pixels.shape
    image = QImage(pixels.data, width, height, 4 * width, QImage.Format.Format_ARGB32_Premultiplied)
    return image.copy()


def _detail_of(state: TimelineState, row: Row) -> str:
    """Detail shown next to a row's name."""
    if row.own and row.tier is not None:
        same = row.tier.vocabulary.casefold() in ("", row.tier.name.casefold())
        return row.coder if same else f"{row.coder} · {vocabulary_title(row.tier.vocabulary)}"
    if row.kind != "speed":
        return ""
    return tr("up to {speed} m/s").format(speed=f"{state.fastest_mps:.1f}")


def _row_icon(row: Row) -> str:
    match row.kind:
        case "pictures":
            return "film-strip"
        case "sound":
            return "speaker-high"
        case "speed":
            return "gauge"
        case _:
            name = (row.name if row.tier is None else row.tier.name).casefold()  # untranslated, as recorded
            return next((icon for word, icon in _RECORD_ICONS if word in name), "rows")
