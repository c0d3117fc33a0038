"""Items of the timeline: time scale, rows, annotation tracks and sampled signals, and their painting."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QRect, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QFontMetricsF, QImage, QPainter, QPaintEvent, QPixmap, QResizeEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.sound_values import MICROPHONE, ROBOT_MICROPHONE, ROBOT_VOICE, WIZARD_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier, Vocabulary
from caris_desktop.recording.annotation.timeline_overview import SessionOverview, Waveform
from caris_desktop.ui import tokens
from caris_desktop.ui.text_formatting import elapsed
from caris_desktop.ui.theme import Theme, draw_icon

RowKind = Literal["pictures", "sound", "speed", "tier"]
SHORTEST_MS = 40
"""Minimum duration of an annotation made by dragging: one video frame."""

_TICK_STEPS_MS = (
    10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 15_000, 30_000, 60_000, 120_000, 300_000, 600_000, 900_000,
    1_800_000, 3_600_000, 7_200_000,
)  # fmt: skip


class TimeScale(Value):
    """Mapping of time to pixels: ``start_ms`` at pixel 0, ``px_per_ms`` pixels per millisecond."""

    start_ms: float
    px_per_ms: float

    def to_px(self, at_ms: float) -> float:
        return (at_ms - self.start_ms) * self.px_per_ms

    def to_ms(self, x_px: float) -> float:
        return self.start_ms + x_px / self.px_per_ms

    def zoomed(self, factor: float, around_px: float, *, width_px: float, duration_ms: float) -> "TimeScale":
        """Zoom around ``around_px``, within the session."""
        around_ms = self.to_ms(around_px)
        px_per_ms = _bounded_zoom(self.px_per_ms * factor, width_px, duration_ms)
        return TimeScale(around_ms - around_px / px_per_ms, px_per_ms).bounded(width_px, duration_ms)

    def bounded(self, width_px: float, duration_ms: float) -> "TimeScale":
        """Clamp to the session, extended only as needed to fill the width."""
        px_per_ms = _bounded_zoom(self.px_per_ms, width_px, duration_ms)
        latest_ms = max(0.0, duration_ms - width_px / px_per_ms)
        return TimeScale(min(max(0.0, self.start_ms), latest_ms), px_per_ms)


MAX_PX_PER_MS = 2.0


def whole_session(width_px: float, duration_ms: float) -> TimeScale:
    return TimeScale(0.0, max(1.0, width_px) / max(1.0, duration_ms))


def _bounded_zoom(px_per_ms: float, width_px: float, duration_ms: float) -> float:
    smallest = whole_session(width_px, duration_ms).px_per_ms
    return min(max(px_per_ms, smallest), max(MAX_PX_PER_MS, smallest))


def tick_step_ms(px_per_ms: float, apart_px: float) -> int:
    """Smallest round step with ticks at least ``apart_px`` apart."""
    return next((step for step in _TICK_STEPS_MS if step * px_per_ms >= apart_px), _TICK_STEPS_MS[-1])


def picture_step_ms(px_per_ms: float, apart_px: float) -> int:
    """Thumbnail interval: steps grow by half an octave, so that zooming reuses most thumbnails."""
    needed_ms = max(250.0, apart_px / px_per_ms)
    return round(250 * 2 ** (math.ceil(2 * math.log2(needed_ms / 250)) / 2))


class RulerTick(Value):
    at_ms: int
    label: str  # empty for a minor tick


def ruler_ticks(scale: TimeScale, width_px: float) -> list[RulerTick]:
    """Ticks from the last label before the visible part to its end."""
    step = tick_step_ms(scale.px_per_ms, 88.0)
    fine = max(1, step // (4 if step % 4 == 0 and step % 5 else 5))
    first = int(scale.start_ms // step) * step
    last_ms = scale.to_ms(width_px)
    return [
        RulerTick(at, ruler_text(at, step) if at % step == 0 else "")
        for at in range(first, math.ceil(last_ms) + 1, fine)
    ]


def ruler_text(at_ms: int, step_ms: int = 1000) -> str:
    """Ruler label as 2:03, 1:02:03, or 2:03.4 for fine steps."""
    text = elapsed(at_ms // 1000).removeprefix("0")
    if step_ms >= 1000:
        return text
    return f"{text}.{at_ms % 1000 // 100}" if step_ms >= 100 else f"{text}.{at_ms % 1000 // 10:02}"


def exact_text(at_ms: float) -> str:
    """Time as 00:12.340, or 1:02:03.456 from an hour on."""
    seconds, rest_ms = divmod(abs(round(at_ms)), 1000)
    return f"{'-' if round(at_ms) < 0 else ''}{elapsed(seconds)}.{rest_ms:03}"


def length_text(milliseconds: float) -> str:
    """Duration as 0.48 s, 12.3 s, 2 min 5 s."""
    seconds = milliseconds / 1000
    if seconds < 10:
        return f"{seconds:.2f} s"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s"


class Track:
    """Annotations of one tier in order, with binary search by time."""

    def __init__(self, annotations: Sequence[Annotation]) -> None:
        self.annotations = annotations
        self.starts_ms: NDArray[np.float64] = np.array([item.start_ms for item in annotations], np.float64)
        self.ends_ms: NDArray[np.float64] = np.array([item.end_ms for item in annotations], np.float64)
        self._reach_ms = np.maximum.accumulate(self.ends_ms) if len(annotations) else self.ends_ms

    def between(self, first_ms: float, last_ms: float) -> range:
        """Indices of annotations that overlap the interval. Recorded ones may overlap one another, a
        coder's may not.
        """
        first = int(np.searchsorted(self._reach_ms, first_ms, "right"))
        last = int(np.searchsorted(self.starts_ms, last_ms, "left"))
        return range(first, max(first, last))

    def at(self, at_ms: float) -> Annotation | None:
        """Annotation at a time; of several the one with the latest start."""
        for index in reversed(self.between(at_ms, math.nextafter(at_ms, math.inf))):
            if self.annotations[index].start_ms <= at_ms < self.annotations[index].end_ms:
                return self.annotations[index]
        return None

    def neighbour(self, at_ms: float, direction: int) -> Annotation | None:
        """Next annotation that starts after this time, or last one that starts before."""
        if direction > 0:
            index = int(np.searchsorted(self.starts_ms, at_ms, "right"))
        else:
            index = int(np.searchsorted(self.starts_ms, at_ms, "left")) - 1
        return self.annotations[index] if 0 <= index < len(self.annotations) else None


def tracks_of(document: AnnotationDocument, kind: str, before: Mapping[str, Track]) -> dict[str, Track]:
    """Track of each tier by the key of its row, as in "tier ID"; unchanged ones of ``before`` are reused."""
    parts: dict[str, list[Annotation]] = {tier.tier_id: [] for tier in document.tiers}
    for item in document.annotations:
        parts[item.tier_id].append(item)
    tracks = {}
    for tier_id, part in parts.items():
        known = before.get(f"{kind} {tier_id}")
        tracks[f"{kind} {tier_id}"] = known if known is not None and known.annotations == part else Track(part)
    return tracks


class Row(Value):
    """Timeline row. ``key`` identifies it permanently."""

    key: str
    kind: RowKind
    name: str
    source: str = ""  # camera or sound file
    tier: Tier | None = None

    @property
    def coder(self) -> str:
        return "" if self.tier is None else self.tier.coder

    @property
    def own(self) -> bool:
        """Whether a coder made it, so that it is editable."""
        return bool(self.coder)

    @property
    def height_px(self) -> int:
        return 48 if self.kind == "pictures" else 24 if self.kind == "tier" and not self.own else 32


def all_rows(overview: SessionOverview | None, coding: AnnotationDocument) -> list[Row]:
    """All rows: coders' tiers; video, sound and speed; recorded events."""
    rows = [
        Row(f"tier {tier.tier_id}", "tier", tr_filled(tier.title), tier=tier) for tier in coding.tiers if tier.coder
    ]
    if overview is None:
        return rows
    several = len(overview.cameras) > 1
    for camera in overview.cameras:
        title = tr("Video {camera}").format(camera=camera) if several else tr("Video")
        rows.append(Row(f"pictures {camera}", "pictures", title, camera))
    rows += [Row(f"sound {wave.source}", "sound", sound_name(wave.source), wave.source) for wave in overview.waveforms]
    if len(overview.speed):
        rows.append(Row("speed", "speed", tr("Speed")))
    rows += [Row(f"record {tier.tier_id}", "tier", tr(tier.name), tier=tier) for tier in overview.tiers.tiers]
    return rows


_SOUNDS = {
    MICROPHONE: QT_TR_NOOP("Microphone"),
    ROBOT_MICROPHONE: QT_TR_NOOP("Robot microphone"),
    WIZARD_MICROPHONE: QT_TR_NOOP("Wizard microphone"),
    ROBOT_VOICE: QT_TR_NOOP("Robot voice"),
}


def sound_name(source: str) -> str:
    """Name of a sound: ``audio-microphone.wav`` and ``microphone`` become Microphone; others keep their file name."""
    name = source.rsplit("/", 1)[-1].rsplit(".", 1)[0].removeprefix("audio-").replace("_", " ").replace("-", " ")
    return tr(_SOUNDS[name]) if name in _SOUNDS else name.capitalize() or tr("Sound")


def arranged(rows: Iterable[Row], order: Sequence[str], hidden: Collection[str], words: str) -> list[Row]:
    """Visible rows: in the user's order, without hidden ones, filtered by ``words``.

    A row missing in ``order`` follows its default predecessor.
    """
    by_key = {row.key: row for row in rows}
    keys = [key for key in order if key in by_key]
    before = ""
    for key in by_key:
        if key not in keys:
            keys.insert(keys.index(before) + 1 if before in keys else 0, key)
        before = key
    query_words = words.casefold().split()
    return [
        row
        for row in (by_key[key] for key in keys)
        if row.key not in hidden and all(word in f"{row.name} {row.coder}".casefold() for word in query_words)
    ]


def moved_key(keys: Sequence[str], key: str, position: int) -> list[str]:
    """Keys with one of them moved to index ``position`` among the others."""
    others = [other for other in keys if other != key]
    others.insert(min(max(0, position), len(others)), key)
    return others


def _reduced(
    values: NDArray[np.float32], lows: NDArray[np.int64], highs: NDArray[np.int64], reduce: np.ufunc
) -> NDArray[np.float32]:
    """``reduce`` of each ``values[low:high]``."""
    # reduceat needs pairs of edges inside the array, so a row follows the last one; results between two pairs are
    # discarded.
    pairs = np.column_stack((lows, highs)).ravel()
    reduced: NDArray[np.float32] = reduce.reduceat(np.append(values, values[-1:], axis=0), pairs, axis=0)[0::2]
    return reduced


def wave_columns(wave: Waveform, *, first_ns: int, ns_per_px: float, width_px: int) -> NDArray[np.float32]:
    """Minimum and maximum per pixel column from ``first_ns`` on, shape (width, 2); NaN without sound."""
    columns = np.full((width_px, 2), np.nan, np.float32)
    edges = (first_ns + np.arange(width_px + 1) * ns_per_px - wave.first_ns) / wave.bucket_ns
    lows = np.floor(edges[:-1]).astype(np.int64)
    highs = np.maximum(np.ceil(edges[1:]).astype(np.int64), lows + 1)
    inside = (highs > 0) & (lows < len(wave.peaks))
    if inside.any():
        lows, highs = np.clip(lows[inside], 0, len(wave.peaks) - 1), np.clip(highs[inside], 1, len(wave.peaks))
        columns[inside, 0] = _reduced(wave.peaks[:, 0], lows, highs, np.minimum)
        columns[inside, 1] = _reduced(wave.peaks[:, 1], lows, highs, np.maximum)
    return columns


def speed_columns(speed: NDArray[np.float32], scale: TimeScale, width_px: int) -> NDArray[np.float32]:
    """Maximum speed in m/s and turning speed in rad/s per pixel column, shape (width, 2); NaN without data."""
    columns = np.full((width_px, 2), np.nan, np.float32)
    if not len(speed):
        return columns
    edges = np.searchsorted(speed[:, 0], (scale.start_ms + np.arange(width_px + 1) / scale.px_per_ms) / 1000.0)
    values = np.abs(speed[:, 1:])
    filled = edges[1:] > edges[:-1]
    if filled.any():
        columns[filled] = _reduced(values, edges[:-1][filled], edges[1:][filled], np.maximum)
    # Between close measurements the last one holds.
    lasting = ~filled & (edges[:-1] > 0) & (edges[:-1] < len(speed))
    columns[lasting] = values[edges[:-1][lasting] - 1]
    return columns


def snapped(at_ms: float, moments_ms: Iterable[float], *, within_ms: float) -> float:
    """The nearest time within reach, else the time itself."""
    nearest = min(moments_ms, key=lambda moment: abs(moment - at_ms), default=None)
    return nearest if nearest is not None and abs(nearest - at_ms) <= within_ms else at_ms


def vocabulary_named(coding: AnnotationDocument, name: str) -> Vocabulary | None:
    return next((vocabulary for vocabulary in coding.vocabularies if vocabulary.name == name), None)


SCENARIO_LABELS = QT_TR_NOOP("Labels of the scenario")
"""Name of this vocabulary in documents, independent of language."""


def vocabulary_title(name: str) -> str:
    """Translated name of the scenario's vocabulary; a coder's own name unchanged."""
    return tr(SCENARIO_LABELS) if name == SCENARIO_LABELS else name


def initials(coder: str) -> str:
    """One or two letters for the coder's badge."""
    parts = coder.split()
    return "".join(part[0] for part in parts[:2]).upper() if len(parts) > 1 else coder[:1].upper()


NAMES_PX = 208
RULER_PX = 28
MENU_PX = 28
PAD_PX = 3
TEXT_FROM_PX = 22.0
LEFT = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
CENTER = int(Qt.AlignmentFlag.AlignCenter)
_LABEL_FROM_PX = 34
_NARROW_PX = 3
_ROOMY_PX = 90
_BESIDE_PX = 240
_PICTURE_SHAPE = 16 / 9
_EMPTY_TRACK = Track(())
_ICONS = {"pictures": "film-strip", "sound": "speaker-high", "speed": "gauge"}
_RECORD_ICONS = (
    ("speech", "chat-text"), ("motion", "navigation-arrow"), ("driv", "game-controller"), ("goal", "flag"),
    ("people", "users"), ("person", "user"), ("error", "warning"), ("mark", "bookmark-simple"), ("note", "note"),
    ("problem", "warning"), ("trouble", "wifi-slash"), ("gap", "warning"), ("emergency", "hand-palm"),
    ("guard", "shield-check"), ("pause", "pause"), ("llm", "sparkle"), ("scenario", "map-trifold"),
    ("layout", "layout"), ("robot", "robot"), ("participant", "user"),
)  # fmt: skip


GetPicture = Callable[[str, int], QImage | None]
"""Thumbnail of a camera at a time in ns; None until it is there, a null image if there is none."""


class TimelineItems(QWidget):
    """Timeline without input: rows with their names below a ruler, zoomed and scrolled. Does not store annotations.

    The content is painted once into a layer, which a moving playhead does not change. ``named`` replaces recorded ids
    in a label by names.
    """

    view_changed = Signal()  # zoom or scroll

    def __init__(self, theme: Theme, picture: GetPicture, named: Callable[[str], str]) -> None:
        super().__init__()
        self._theme = theme
        self._picture = picture
        self._named = named
        self.rows: Sequence[Row] = ()
        self.tracks: Mapping[str, Track] = {}
        self.scale = TimeScale(0.0, 0.01)
        self.scroll_y = 0
        self.position_ms = 0.0
        self._tops = [0]
        self._coders: Sequence[str] = ()
        self._words = ""
        self._active = ""
        self._overview: SessionOverview | None = None
        self._loudest: dict[str, float] = {}
        self._fastest_mps = 0.1
        self._started_ns = 0
        self._duration_ms = 1.0
        self._fits = True
        self._layer: QPixmap | None = None
        self.setMinimumSize(NAMES_PX + 160, RULER_PX + 32)
        theme.changed.connect(self._repaint)

    # ---- content

    def show_session(self, started_ns: int, duration_ms: float) -> None:
        self._started_ns, self._duration_ms = started_ns, max(1.0, duration_ms)
        self._refit()

    def show_rows(self, rows: Sequence[Row], coders: Sequence[str], *, words: str = "") -> None:
        """Set the rows, in order; ``words``: text shown if there are none."""
        self.rows, self._coders, self._words = rows, coders, words
        self._tops = [0, *accumulate(row.height_px for row in rows)]
        self.scroll_to(self.scroll_y)
        self._repaint()

    def show_overview(self, overview: SessionOverview | None) -> None:
        self._overview = overview
        waves = () if overview is None else overview.waveforms
        self._loudest = {wave.source: max(0.1, float(np.abs(wave.peaks).max(initial=0.0))) for wave in waves}
        speed = np.zeros(0) if overview is None else np.abs(overview.speed[:, 1])
        self._fastest_mps = max(0.1, float(speed.max(initial=0.0)))
        self._repaint()

    def refresh_pictures(self) -> None:
        if any(row.kind == "pictures" for row in self.rows):
            self._repaint()

    def _repaint(self) -> None:
        self._layer = None
        self.update()

    def track_of(self, row: Row) -> Track:
        return self.tracks.get(row.key, _EMPTY_TRACK)

    def index_of(self, key: str) -> int | None:
        return next((number for number, row in enumerate(self.rows) if row.key == key), None)

    # ---- zoom and scroll

    @property
    def room_px(self) -> int:
        """Width of the part below the ruler."""
        return max(1, self.width() - NAMES_PX)

    @property
    def rows_height_px(self) -> int:
        return self._tops[-1]

    def row_top(self, index: int) -> int:
        """Top of the row in the widget."""
        return RULER_PX + self._tops[index] - self.scroll_y

    def set_scale(self, scale: TimeScale) -> None:
        scale = scale.bounded(self.room_px, self._duration_ms)
        self._fits = scale.px_per_ms <= whole_session(self.room_px, self._duration_ms).px_per_ms * 1.0001
        if scale != self.scale:
            self.scale = scale
            self._repaint()
        self.view_changed.emit()

    def zoom(self, factor: float, around_px: float | None = None) -> None:
        """Zoom around a pixel of the rows; without one around the playhead, if visible."""
        if around_px is None:
            playhead = self.scale.to_px(self.position_ms)
            around_px = playhead if 0 <= playhead <= self.room_px else self.room_px / 2
        self.set_scale(self.scale.zoomed(factor, around_px, width_px=self.room_px, duration_ms=self._duration_ms))

    def fit(self) -> None:
        self.set_scale(whole_session(self.room_px, self._duration_ms))

    def _refit(self) -> None:
        self.set_scale(whole_session(self.room_px, self._duration_ms) if self._fits else self.scale)

    def scroll_across_to(self, start_ms: float) -> None:
        """Set the start of the visible part."""
        self.set_scale(replace(self.scale, start_ms=start_ms))

    def scroll_to(self, y: int) -> None:
        y = min(max(0, y), max(0, self.rows_height_px - (self.height() - RULER_PX)))
        if y != self.scroll_y:
            self.scroll_y = y
            self._repaint()
        self.view_changed.emit()

    def show_row(self, key: str) -> None:
        """Scroll to the row."""
        index = self.index_of(key)
        if index is not None:
            hidden_px = self._tops[index + 1] - (self.height() - RULER_PX)
            self.scroll_to(min(self._tops[index], max(self.scroll_y, hidden_px)))

    def show_interval(self, start_ms: float, end_ms: float) -> None:
        """Scroll to the interval."""
        if not 0 <= self.scale.to_px(start_ms) <= self.room_px - 40 or self.scale.to_px(end_ms) > self.room_px:
            self.scroll_across_to(start_ms - 0.2 * self.room_px / self.scale.px_per_ms)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._repaint()
        self._refit()
        self.scroll_to(self.scroll_y)

    # ---- painting

    def _color_of(self, coder: str) -> QColor:
        colors = self._theme.colors.coders
        return QColor(colors[self._coders.index(coder) % len(colors)] if coder in self._coders else colors[0])

    def paintEvent(self, _event: QPaintEvent) -> None:
        ratio = self.devicePixelRatioF()
        if self._layer is None:
            self._layer = QPixmap(max(1, round(self.width() * ratio)), max(1, round(self.height() * ratio)))
            self._layer.setDevicePixelRatio(ratio)
            self._layer.fill(self._theme.color("window"))
            painter = QPainter(self._layer)
            painter.translate(NAMES_PX, 0)
            self._draw_rows(painter)
            painter.resetTransform()
            painter.fillRect(0, 0, NAMES_PX, self.height(), self._theme.color("panel"))
            painter.setClipRect(0, RULER_PX, NAMES_PX, self.height() - RULER_PX)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            for row, top in self._visible_rows():
                self._draw_name(painter, row, top)
            painter.setClipping(False)
            line = self._theme.color("line")
            painter.fillRect(NAMES_PX - 1, 0, 1, self.height(), line)
            painter.fillRect(0, RULER_PX - 1, NAMES_PX, 1, line)
            painter.end()
        QPainter(self).drawPixmap(0, 0, self._layer)

    def _visible_rows(self) -> Iterator[tuple[Row, int]]:
        """Visible rows with their tops."""
        for index, row in enumerate(self.rows):
            top = self.row_top(index)
            if top + row.height_px > RULER_PX and top < self.height():
                yield row, top

    def _draw_name(self, painter: QPainter, row: Row, top: int) -> None:
        theme = self._theme
        rect = QRectF(0, top, NAMES_PX - 1, row.height_px)
        if row.key == self._active:
            painter.fillRect(rect, theme.color("blue_soft"))
            painter.fillRect(QRectF(0, top, 3, row.height_px), theme.color("blue"))
        painter.fillRect(QRectF(0, rect.bottom() - 1, NAMES_PX, 1), theme.color("line"))
        chip = QRectF(12, rect.center().y() - 9, 18, 18)
        if row.own:
            letters = initials(row.coder)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._color_of(row.coder))
            painter.drawEllipse(chip)
            painter.setPen(theme.color("panel"))
            painter.setFont(theme.font(9 if len(letters) > 1 else 11, tokens.WEIGHT_SEMIBOLD))
            painter.drawText(chip, CENTER, letters)
        else:
            name = (row.name if row.tier is None else row.tier.name).casefold()  # untranslated, as recorded
            of_record = next((icon for word, icon in _RECORD_ICONS if word in name), "rows")
            draw_icon(painter, chip.adjusted(2, 2, -2, -2), _ICONS.get(row.kind, of_record), theme.color("dim"))
        place = QRectF(38, top, NAMES_PX - 38 - MENU_PX, row.height_px)
        painter.setFont(theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM if row.own else tokens.WEIGHT_NORMAL))
        painter.setPen(theme.color("text" if row.own else "dim"))
        _draw_elided(painter, place, row.name)
        detail = self._detail_of(row)
        place.setLeft(place.left() + QFontMetricsF(painter.font()).horizontalAdvance(row.name) + 8)
        if detail and place.width() > TEXT_FROM_PX:
            painter.setFont(theme.font(tokens.KEY_CAP_PX))
            painter.setPen(theme.color("dim"))
            _draw_elided(painter, place, detail)

    def _detail_of(self, row: Row) -> str:
        """Detail shown next to a row's name."""
        if row.tier is not None and row.own:
            same = row.tier.vocabulary.casefold() in ("", row.tier.name.casefold())
            return row.coder if same else f"{row.coder} · {vocabulary_title(row.tier.vocabulary)}"
        return tr("up to {speed} m/s").format(speed=f"{self._fastest_mps:.1f}") if row.kind == "speed" else ""

    def _draw_rows(self, painter: QPainter) -> None:
        theme, room = self._theme, self.room_px
        ticks = [(round(self.scale.to_px(tick.at_ms)), tick.label) for tick in ruler_ticks(self.scale, room)]
        for x, label in ticks:
            if label:
                painter.fillRect(x, RULER_PX, 1, self.height() - RULER_PX, theme.color("line"))
        draw = {"pictures": self._draw_pictures, "sound": self._draw_sound, "speed": self._draw_speed}
        for row, top in self._visible_rows():
            if row.key == self._active:
                painter.fillRect(0, top, room, row.height_px, theme.color("panel"))
            painter.fillRect(0, top + row.height_px - 1, room, 1, theme.color("line"))
            draw.get(row.kind, self._draw_annotations)(painter, row, top)
        if not self.rows and self._words:
            painter.setFont(theme.font())
            painter.setPen(theme.color("dim"))
            painter.drawText(QRect(0, RULER_PX, room, self.height() - RULER_PX), CENTER, self._words)
        painter.fillRect(0, 0, room, RULER_PX, theme.color("panel"))
        painter.setFont(theme.font(tokens.KEY_CAP_PX))
        painter.setPen(theme.color("dim"))
        for x, label in ticks:
            high_px = 10 if label else 5
            painter.fillRect(x, RULER_PX - high_px, 1, high_px - 1, theme.color("line_strong"))
            painter.drawText(x + 5, RULER_PX - 9, label)
        painter.fillRect(0, RULER_PX - 1, room, 1, theme.color("line"))

    def _draw_pictures(self, painter: QPainter, row: Row, top: int) -> None:
        height = row.height_px - 5
        width = height * _PICTURE_SHAPE
        step_ms = picture_step_ms(self.scale.px_per_ms, width + 2)
        first = int(self.scale.start_ms // step_ms) * step_ms
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        visible = range(first, int(min(self.scale.to_ms(self.room_px), self._duration_ms)) + 1, step_ms)
        for at_ms in reversed(visible):  # the newest request is answered first
            middle_ms = min(at_ms + step_ms // 2, int(self._duration_ms))
            place = QRectF(self.scale.to_px(at_ms), top + 2, width, height)
            picture = self._picture(row.source, self._started_ns + middle_ms * 1_000_000)
            if picture is None or picture.isNull():
                painter.fillRect(place, self._theme.color("raised"))
            else:
                size = picture.size().toSizeF().scaled(place.size(), Qt.AspectRatioMode.KeepAspectRatio)
                painter.drawImage(QRectF(place.topLeft(), size), picture)

    def _draw_sound(self, painter: QPainter, row: Row, top: int) -> None:
        for wave in () if self._overview is None else self._overview.waveforms:
            if wave.source == row.source:
                columns = wave_columns(
                    wave,
                    first_ns=self._started_ns + round(self.scale.start_ms * 1e6),
                    ns_per_px=1e6 / self.scale.px_per_ms,
                    width_px=self.room_px,
                )
                half = (row.height_px - 7) / 2
                tops, bottoms = (half + 3 - columns[:, side] / self._loudest[row.source] * half for side in (1, 0))
                strokes = _between(tops, np.maximum(bottoms, tops + 1), row.height_px - 1)
                _draw_pixels(painter, top, strokes, self._theme.color("green"))

    def _draw_speed(self, painter: QPainter, row: Row, top: int) -> None:
        if self._overview is None:
            return
        columns = speed_columns(self._overview.speed, self.scale, self.room_px)
        height = row.height_px - 1
        tops = height - columns[:, 0] / self._fastest_mps * (height - 4)
        ground = self._theme.color("blue")
        ground.setAlpha(120)
        _draw_pixels(painter, top, _between(tops, np.full_like(tops, height), height), ground)
        _draw_pixels(painter, top, _between(tops - 1, tops + 0.6, height), self._theme.color("blue"))

    def _draw_annotations(self, painter: QPainter, row: Row, top: int) -> None:
        track, scale, room = self.track_of(row), self.scale, self.room_px
        found = track.between(scale.start_ms, scale.to_ms(room))
        if not found:
            return
        theme, part = self._theme, slice(found.start, found.stop)
        lefts = ((track.starts_ms[part] - scale.start_ms) * scale.px_per_ms).astype(np.int64)
        # A pixel of space separates adjacent boxes.
        rights = np.maximum(((track.ends_ms[part] - scale.start_ms) * scale.px_per_ms).astype(np.int64) - 1, lefts + 1)
        widths = rights - lefts
        line = self._color_of(row.coder) if row.own else theme.color("line_strong")
        ground = QColor(line) if row.own else theme.color("line")
        if row.own:
            ground.setAlpha(70)
        shape = (row.height_px - 2 * PAD_PX, room)
        boxes = np.broadcast_to(_covered(lefts, rights, room), shape)
        edges = boxes.copy()
        edges[1:-1] = False
        for sides in (lefts, rights - 1):
            edges[:, sides[(sides >= 0) & (sides < room)]] = True
        narrow = widths <= _NARROW_PX  # no room for an outline
        tiny = np.broadcast_to(_covered(lefts[narrow], rights[narrow], room), shape)
        for pixels, color in ((boxes, ground), (edges, line), (tiny, line if row.own else theme.color("dim"))):
            _draw_pixels(painter, top + PAD_PX, pixels, color)
        painter.setFont(theme.font(tokens.STATUS_PX if row.own else tokens.KEY_CAP_PX))
        painter.setPen(theme.color("text"))
        # A long interval that starts before the visible part still shows its label; a short one may use the space up to
        # the next.
        following = np.append(lefts[1:], room)
        cut_short = (widths < _ROOMY_PX) & (following - rights > 2 * widths) & (not row.own)
        beside = (widths < _LABEL_FROM_PX) | cut_short
        starts = np.where(beside, rights + 4, np.maximum(lefts, 0) + 6)
        ends = np.where(beside, np.minimum(following - 2, starts + _BESIDE_PX), rights - 3)
        for number in np.flatnonzero(ends - starts >= TEXT_FROM_PX).tolist():
            value = tr_filled(track.annotations[found.start + number].value)
            place = QRectF(float(starts[number]), top, float(ends[number] - starts[number]), row.height_px)
            _draw_elided(painter, place, " ".join(self._named(value[:400]).split()))


def _draw_elided(painter: QPainter, place: QRectF, text: str) -> None:
    elided = QFontMetricsF(painter.font()).elidedText(text, Qt.TextElideMode.ElideRight, place.width())
    painter.drawText(place, LEFT, elided)


def _draw_pixels(painter: QPainter, y: int, filled: NDArray[np.bool_], color: QColor) -> None:
    """Colour the pixels of an area from the left edge and ``y`` on; a thousand rectangles cost ten times as much."""
    height, width = filled.shape
    pixels = np.where(filled, np.uint32(int(color.name(QColor.NameFormat.HexArgb)[1:], 16)), np.uint32(0))
    painter.drawImage(0, y, QImage(pixels.data, width, height, 4 * width, QImage.Format.Format_ARGB32))


def _covered(lefts: NDArray[np.int64], rights: NDArray[np.int64], width_px: int) -> NDArray[np.bool_]:
    """Pixel columns covered by any interval; ``rights`` are exclusive."""
    steps = np.zeros(width_px + 1, np.int64)
    np.add.at(steps, np.clip(lefts, 0, width_px), 1)
    np.add.at(steps, np.clip(rights, 0, width_px), -1)
    covered: NDArray[np.bool_] = np.cumsum(steps[:-1]) > 0
    return covered


def _between(tops: NDArray[np.floating], bottoms: NDArray[np.floating], height_px: int) -> NDArray[np.bool_]:
    """Pixels of one vertical stroke per column, from ``tops`` to ``bottoms``; none where NaN."""
    ys = np.arange(height_px, dtype=np.float32)[:, None]
    with np.errstate(invalid="ignore"):
        filled: NDArray[np.bool_] = (ys >= np.floor(tops)) & (ys < np.ceil(bottoms))
    return filled
