"""TextGrid export for Praat: derived tiers and coders' tiers.

The long text format of https://www.fon.hum.uva.nl/praat/manual/TextGrid_file_formats.html, in UTF-8.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path, PurePath

from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import shown_names
from caris_desktop.recording.session.session_data import SessionData, read_data
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.catalog import plain_text

FILE_NAME = "session.TextGrid"
_MARKS_TIER = "Moments of marks"


class _Interval(Value):
    """Interval in whole microseconds."""

    start_us: int
    end_us: int
    text: str


class _Tiers(Value):
    """All tiers to write, in microseconds from the session start."""

    intervals: tuple[tuple[str, list[_Interval]], ...]
    moments: list[tuple[int, str]]


class _Span(Value):
    """Time range of one TextGrid: ``whole_us`` from ``first_us`` of the session."""

    file_name: str
    first_us: int
    whole_us: int


def write_textgrid(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``: the session in its own time, and each audio file in file time.

    Praat shows a TextGrid below a sound if both cover the same time. Raises OSError, SessionError.
    """
    from caris_desktop.recording.annotation.session_tiers import tiers_of, types_of_tiers
    from caris_desktop.recording.pseudonyms import coding_of

    data = read_data(session, types_of_tiers(), lambda fraction: context.progress(0.8 * fraction))
    record = tiers_of(data)
    coded = coding_of(session, on_damaged=context.warn)
    names = shown_names((*record.tiers, *coded.tiers))
    tiers = _Tiers(
        tuple(
            (
                names[tier.tier_id],
                [
                    _Interval(one.start_ms * 1000, one.end_ms * 1000, one.value)
                    for one in document.of_tier(tier.tier_id)
                ],
            )
            for document in (record, coded)
            for tier in document.tiers
        ),
        _moments(data),
    )
    ends_us = [interval.end_us for _, intervals in tiers.intervals for interval in intervals]
    lasted_us = -(-(session.ended_ns - session.started_ns) // 1000)
    spans = [_Span(FILE_NAME, 0, max(1, lasted_us, *ends_us)), *_sounds(session)]
    for span in spans:
        (out / span.file_name).write_text(_grid(tiers, span), encoding="utf-8", newline="\n")
    context.progress(1.0)
    return [out / span.file_name for span in spans]


def _sounds(session: Session) -> Iterator[_Span]:
    taken = {FILE_NAME.casefold()}
    for sound in session.header.audio:
        name = f"{PurePath(sound.file_name).stem}.TextGrid"
        first_us = (sound.first_stamp_ns - session.started_ns) // 1000
        whole_us = sound.samples * 1_000_000 // max(1, sound.sample_rate_hz)
        if whole_us > 0 and name.casefold() not in taken:
            taken.add(name.casefold())
            yield _Span(name, first_us, whole_us)


def _grid(tiers: _Tiers, span: _Span) -> str:
    whole_us = span.whole_us
    written = [
        _interval_tier(
            name,
            [_Interval(one.start_us - span.first_us, one.end_us - span.first_us, one.text) for one in intervals],
            whole_us,
        )
        for name, intervals in tiers.intervals
    ]
    moments = [(at_us - span.first_us, text) for at_us, text in tiers.moments]
    moments = [(at_us, text) for at_us, text in moments if 0 <= at_us <= whole_us]
    if moments:
        written.append(_moments_tier(moments, whole_us))
    if not written:
        # Praat opens no TextGrid without a tier.
        written.append(_interval_tier("Session", [], whole_us))
    lines = [
        'File type = "ooTextFile"',
        'Object class = "TextGrid"',
        "",
        "xmin = 0",
        f"xmax = {_seconds(whole_us)}",
        "tiers? <exists>",
        f"size = {len(written)}",
        "item []:",
    ]
    for number, tier in enumerate(written, start=1):
        lines += [f"    item [{number}]:", *(f"        {line}" for line in tier)]
    return "\n".join(lines) + "\n"


def _moments(data: SessionData) -> list[tuple[int, str]]:
    """Point marks. Praat allows one point per time: those of one millisecond are merged."""
    moments: dict[int, str] = {}
    session = data.session
    last_us = (session.ended_ns - session.started_ns) // 1000
    for mark in data.marks:
        if mark.end_ns is None:
            at_us = min(max(round((mark.start_ns - session.started_ns) / 1e6) * 1000, 0), last_us)
            text = f"{mark.label} ({mark.note})" if mark.note else mark.label
            moments[at_us] = f"{moments[at_us]} | {text}" if at_us in moments else text
    return sorted(moments.items())


def _interval_tier(name: str, intervals: Iterable[_Interval], whole_us: int) -> list[str]:
    """Interval tier without gaps, as Praat requires: empty intervals fill them."""
    filled: list[_Interval] = []
    at_us = 0
    for interval in sorted(intervals, key=lambda interval: interval.start_us):
        start_us, end_us = max(interval.start_us, at_us), min(interval.end_us, whole_us)
        if end_us <= start_us:
            continue
        if start_us > at_us:
            filled.append(_Interval(at_us, start_us, ""))
        filled.append(_Interval(start_us, end_us, interval.text))
        at_us = end_us
    if at_us < whole_us:
        filled.append(_Interval(at_us, whole_us, ""))
    lines = [*_head("IntervalTier", name, whole_us), f"intervals: size = {len(filled)}"]
    for number, interval in enumerate(filled, start=1):
        lines += [
            f"intervals [{number}]:",
            f"    xmin = {_seconds(interval.start_us)}",
            f"    xmax = {_seconds(interval.end_us)}",
            f"    text = {_quoted(interval.text)}",
        ]
    return lines


def _moments_tier(points: list[tuple[int, str]], whole_us: int) -> list[str]:
    lines = [*_head("TextTier", _MARKS_TIER, whole_us), f"points: size = {len(points)}"]
    for number, (at_us, text) in enumerate(points, start=1):
        lines += [f"points [{number}]:", f"    number = {_seconds(at_us)}", f"    mark = {_quoted(text)}"]
    return lines


def _head(kind: str, name: str, whole_us: int) -> list[str]:
    return [f'class = "{kind}"', f"name = {_quoted(name)}", "xmin = 0", f"xmax = {_seconds(whole_us)}"]


def _seconds(microseconds: int) -> str:
    return f"{microseconds / 1e6:.6f}".rstrip("0").rstrip(".")


def _quoted(text: str) -> str:
    """Quoted single line with doubled quotes."""
    printable = "".join(character if character.isprintable() else " " for character in plain_text(text))
    return '"' + " ".join(printable.split()).replace('"', '""') + '"'
