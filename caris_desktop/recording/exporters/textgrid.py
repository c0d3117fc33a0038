"""The tiers of a session, and those of its coders, as a TextGrid for Praat.

The long text format of https://www.fon.hum.uva.nl/praat/manual/TextGrid_file_formats.html, in UTF-8.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from caris_desktop.recording.annotation.model import AnnotationDocument
from caris_desktop.recording.export import ExportContext
from caris_desktop.recording.exporters.tables import plain_text
from caris_desktop.recording.marks import final_marks
from caris_desktop.recording.session_reader import Session

FILE_NAME = "session.TextGrid"
_MARKS_TIER = "Moments of marks"


@dataclass(frozen=True, slots=True)
class _Interval:
    """A stretch in whole milliseconds of the session."""

    start_ms: int
    end_ms: int
    text: str


def write_textgrid(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the folder ``out`` (it exists and is empty). Raises OSError, SessionError."""
    from caris_desktop.recording.annotation.session_tiers import session_tiers
    from caris_desktop.recording.annotation.store import load_documents

    record = session_tiers(session, lambda fraction: context.progress(0.8 * fraction))
    coded = load_documents(session.folder, on_damaged=context.warn)
    lasted_ms = -(-(session.ended_ns - session.started_ns) // 1_000_000)
    ends_ms = [annotation.end_ms for document in (record, coded) for annotation in document.annotations]
    whole_ms = max(1, lasted_ms, *ends_ms)
    names = _names(record, coded)
    tiers = [
        _interval_tier(
            names[tier.tier_id],
            [_Interval(one.start_ms, one.end_ms, one.value) for one in document.of_tier(tier.tier_id)],
            whole_ms,
        )
        for document in (record, coded)
        for tier in document.tiers
    ]
    moments = _moments(session, whole_ms)
    if moments:
        tiers.append(_point_tier(_MARKS_TIER, moments, whole_ms))
    if not tiers:
        # Praat opens no TextGrid without one.
        tiers.append(_interval_tier("Session", [], whole_ms))
    lines = [
        'File type = "ooTextFile"',
        'Object class = "TextGrid"',
        "",
        "xmin = 0",
        f"xmax = {_seconds(whole_ms)}",
        "tiers? <exists>",
        f"size = {len(tiers)}",
        "item []:",
    ]
    for number, tier in enumerate(tiers, start=1):
        lines += [f"    item [{number}]:", *(f"        {line}" for line in tier)]
    path = out / FILE_NAME
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    context.progress(1.0)
    return [path]


def _names(*documents: AnnotationDocument) -> dict[str, str]:
    """The name of each tier id, with the coder where several tiers are called so."""
    tiers = [tier for document in documents for tier in document.tiers]
    names = [tier.name for tier in tiers]
    return {
        tier.tier_id: f"{tier.name}@{tier.coder}" if names.count(tier.name) > 1 and tier.coder else tier.name
        for tier in tiers
    }


def _moments(session: Session, whole_ms: int) -> list[tuple[int, str]]:
    """The marks that are moments. Praat knows one point at a time: those of one millisecond become one."""
    moments: dict[int, str] = {}
    for mark in final_marks(session):
        if mark.end_ns is None:
            at_ms = min(max(round((mark.start_ns - session.started_ns) / 1e6), 0), whole_ms)
            text = f"{mark.label} ({mark.note})" if mark.note else mark.label
            moments[at_ms] = f"{moments[at_ms]} | {text}" if at_ms in moments else text
    return sorted(moments.items())


def _interval_tier(name: str, intervals: Iterable[_Interval], whole_ms: int) -> list[str]:
    """Its intervals follow one another without gaps, as Praat wants them: empty ones lie between those given."""
    filled: list[_Interval] = []
    at_ms = 0
    for interval in sorted(intervals, key=lambda interval: interval.start_ms):
        start_ms, end_ms = max(interval.start_ms, at_ms), min(interval.end_ms, whole_ms)
        if end_ms <= start_ms:
            continue
        if start_ms > at_ms:
            filled.append(_Interval(at_ms, start_ms, ""))
        filled.append(_Interval(start_ms, end_ms, interval.text))
        at_ms = end_ms
    if at_ms < whole_ms:
        filled.append(_Interval(at_ms, whole_ms, ""))
    lines = [*_head("IntervalTier", name, whole_ms), f"intervals: size = {len(filled)}"]
    for number, interval in enumerate(filled, start=1):
        lines += [
            f"intervals [{number}]:",
            f"    xmin = {_seconds(interval.start_ms)}",
            f"    xmax = {_seconds(interval.end_ms)}",
            f"    text = {_quoted(interval.text)}",
        ]
    return lines


def _point_tier(name: str, points: list[tuple[int, str]], whole_ms: int) -> list[str]:
    lines = [*_head("TextTier", name, whole_ms), f"points: size = {len(points)}"]
    for number, (at_ms, text) in enumerate(points, start=1):
        lines += [f"points [{number}]:", f"    number = {_seconds(at_ms)}", f"    mark = {_quoted(text)}"]
    return lines


def _head(kind: str, name: str, whole_ms: int) -> list[str]:
    return [f'class = "{kind}"', f"name = {_quoted(name)}", "xmin = 0", f"xmax = {_seconds(whole_ms)}"]


def _seconds(milliseconds: int) -> str:
    return f"{milliseconds / 1000:.3f}"


def _quoted(text: str) -> str:
    """In one line, quotes doubled."""
    printable = "".join(character if character.isprintable() else " " for character in plain_text(text))
    return '"' + " ".join(printable.split()).replace('"', '""') + '"'
