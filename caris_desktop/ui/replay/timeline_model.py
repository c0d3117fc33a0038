"""Timeline as plain values: rows, time scale, annotation tracks, and sampled signals."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sound_values import MICROPHONE, ROBOT_MICROPHONE, ROBOT_VOICE, WIZARD_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, tr, tr_filled
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier, Vocabulary
from caris_desktop.recording.annotation.timeline_overview import SessionOverview, Waveform

RowKind = Literal["pictures", "sound", "speed", "tier"]
ROW_HEIGHTS_PX: Mapping[RowKind, int] = {"pictures": 48, "sound": 32, "speed": 32, "tier": 32}
RECORD_ROW_PX = 24
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
    minutes, rest_ms = divmod(at_ms, 60_000)
    hours, minutes = divmod(minutes, 60)
    text = f"{hours}:{minutes:02}:{rest_ms // 1000:02}" if hours else f"{minutes}:{rest_ms // 1000:02}"
    if step_ms >= 1000:
        return text
    return f"{text}.{rest_ms % 1000 // 100}" if step_ms >= 100 else f"{text}.{rest_ms % 1000 // 10:02}"


def exact_text(at_ms: float) -> str:
    """Time as 00:12.340, or 1:02:03.456 from an hour on."""
    rounded_ms = round(at_ms)
    sign, rounded_ms = ("-", -rounded_ms) if rounded_ms < 0 else ("", rounded_ms)
    minutes, rest_ms = divmod(rounded_ms, 60_000)
    hours, minutes = divmod(minutes, 60)
    text = f"{hours}:{minutes:02}" if hours else f"{minutes:02}"
    return f"{sign}{text}:{rest_ms // 1000:02}.{rest_ms % 1000:03}"


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


def tracks_of(document: AnnotationDocument, before: Mapping[str, Track] | None = None) -> dict[str, Track]:
    """Track of each tier; unchanged ones of ``before`` are reused."""
    parts: dict[str, list[Annotation]] = {tier.tier_id: [] for tier in document.tiers}
    for item in document.annotations:
        parts[item.tier_id].append(item)
    known = before or {}
    return {
        tier_id: known[tier_id] if tier_id in known and known[tier_id].annotations == part else Track(part)
        for tier_id, part in parts.items()
    }


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
        return RECORD_ROW_PX if self.kind == "tier" and not self.own else ROW_HEIGHTS_PX[self.kind]


def all_rows(overview: SessionOverview | None, coding: AnnotationDocument) -> list[Row]:
    """All rows: coders' tiers; video, sound and speed; recorded events."""
    rows = [
        Row(f"tier {tier.tier_id}", "tier", tr_filled(tier.title), tier=tier) for tier in coding.tiers if tier.coder
    ]
    if overview is None:
        return rows
    several = len(overview.cameras) > 1
    for camera in overview.cameras:
        rows.append(
            Row(
                f"pictures {camera}",
                "pictures",
                tr("Video {camera}").format(camera=camera) if several else tr("Video"),
                camera,
            )
        )
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


def wave_columns(wave: Waveform, *, first_ns: int, ns_per_px: float, width_px: int) -> NDArray[np.float32]:
    """Minimum and maximum per pixel column from ``first_ns`` on, shape (width, 2); NaN without sound."""
    columns = np.full((width_px, 2), np.nan, np.float32)
    if not len(wave.peaks) or width_px <= 0:
        return columns
    edges = (first_ns + np.arange(width_px + 1) * ns_per_px - wave.first_ns) / wave.bucket_ns
    lows = np.floor(edges[:-1]).astype(np.int64)
    highs = np.maximum(np.ceil(edges[1:]).astype(np.int64), lows + 1)
    inside = (highs > 0) & (lows < len(wave.peaks))
    if not inside.any():
        return columns
    lows, highs = np.clip(lows[inside], 0, len(wave.peaks) - 1), np.clip(highs[inside], 1, len(wave.peaks))
    smallest, largest = np.minimum.reduceat, np.maximum.reduceat
    # reduceat needs pairs of edges; results between two pairs are discarded.
    pairs = np.empty(2 * len(lows), np.int64)
    pairs[0::2], pairs[1::2] = lows, np.minimum(highs, len(wave.peaks) - 1)
    columns[inside, 0] = smallest(wave.peaks[:, 0], pairs)[0::2]
    columns[inside, 1] = largest(wave.peaks[:, 1], pairs)[0::2]
    return columns


def speed_columns(speed: NDArray[np.float32], scale: TimeScale, width_px: int) -> NDArray[np.float32]:
    """Maximum speed in m/s and turning speed in rad/s per pixel column, shape (width, 2); NaN without data."""
    columns = np.full((width_px, 2), np.nan, np.float32)
    if not len(speed) or width_px <= 0:
        return columns
    edges = np.searchsorted(speed[:, 0], (scale.start_ms + np.arange(width_px + 1) / scale.px_per_ms) / 1000.0)
    values = np.abs(speed[:, 1:])
    filled = edges[1:] > edges[:-1]
    if filled.any():
        pairs = np.empty(2 * int(filled.sum()), np.int64)
        pairs[0::2], pairs[1::2] = edges[:-1][filled], np.minimum(edges[1:][filled], len(speed) - 1)
        columns[filled] = np.maximum.reduceat(values, pairs, axis=0)[0::2]
    # Between close measurements the last one holds.
    held = np.clip(edges[:-1] - 1, 0, len(speed) - 1)
    lasting = ~filled & (edges[:-1] > 0) & (edges[:-1] < len(speed))
    columns[lasting] = values[held[lasting]]
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
