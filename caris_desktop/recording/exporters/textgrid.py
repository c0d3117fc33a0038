"""TextGrid export for Praat: derived tiers and coders' tiers.

The long text format of https://www.fon.hum.uva.nl/praat/manual/TextGrid_file_formats.html, in UTF-8.
"""

import itertools
from collections.abc import Iterator, Sequence
from operator import itemgetter
from pathlib import Path, PurePath

from caris_desktop.recording.annotation.annotation_model import shown_names
from caris_desktop.recording.session.session_data import SessionData, read_data
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.catalog import one_line

FILE_NAME = "session.TextGrid"
_MARKS_TIER = "Moments of marks"
_Interval = tuple[int, int, str]
"""Start and end in whole microseconds, and the text."""


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
    tiers = [
        (names[tier.tier_id], [(item.start_ms * 1000, item.end_ms * 1000, item.value) for item in items])
        for document in (record, coded)
        for tier in document.tiers
        for items in (document.of_tier(tier.tier_id),)
    ]
    moments = _moments(data)
    ends_us = [end_us for _, intervals in tiers for _, end_us, _ in intervals]
    lasted_us = -(-(session.ended_ns - session.started_ns) // 1000)
    paths = []
    for name, first_us, whole_us in ((FILE_NAME, 0, max(1, lasted_us, *ends_us)), *_sounds(session)):
        paths.append(out / name)
        paths[-1].write_text(_grid(tiers, moments, first_us, whole_us), encoding="utf-8", newline="\n")
    context.progress(1.0)
    return paths


def _sounds(session: Session) -> Iterator[tuple[str, int, int]]:
    """Name of the TextGrid of each audio file, its start in session time and its duration in microseconds."""
    taken = {FILE_NAME.casefold()}
    for sound in session.header.audio:
        name = f"{PurePath(sound.file_name).stem}.TextGrid"
        first_us = (sound.first_stamp_ns - session.started_ns) // 1000
        whole_us = sound.samples * 1_000_000 // max(1, sound.sample_rate_hz)
        if whole_us > 0 and name.casefold() not in taken:
            taken.add(name.casefold())
            yield name, first_us, whole_us


def _grid(
    tiers: Sequence[tuple[str, Sequence[_Interval]]], moments: Sequence[tuple[int, str]], first_us: int, whole_us: int
) -> str:
    """TextGrid of ``whole_us`` from ``first_us`` of the session."""
    written = [
        _interval_tier(
            name, [(start_us - first_us, end_us - first_us, text) for start_us, end_us, text in intervals], whole_us
        )
        for name, intervals in tiers
    ]
    inside = [(at_us - first_us, text) for at_us, text in moments if 0 <= at_us - first_us <= whole_us]
    if inside:
        points = [
            [f"points [{number}]:", f"    number = {_seconds(at_us)}", f"    mark = {_quoted(text)}"]
            for number, (at_us, text) in enumerate(inside, start=1)
        ]
        written.append(_tier("TextTier", _MARKS_TIER, whole_us, "points", points))
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


def _interval_tier(name: str, intervals: Sequence[_Interval], whole_us: int) -> list[str]:
    """Interval tier without gaps, as Praat requires: empty intervals fill them."""
    filled: list[_Interval] = []
    at_us = 0
    for start_us, end_us, text in sorted(intervals, key=itemgetter(0)):
        start_us, end_us = max(start_us, at_us), min(end_us, whole_us)  # noqa: PLW2901 - the part that is written
        if end_us <= start_us:
            continue
        if start_us > at_us:
            filled.append((at_us, start_us, ""))
        filled.append((start_us, end_us, text))
        at_us = end_us
    if at_us < whole_us:
        filled.append((at_us, whole_us, ""))
    entries = [
        [
            f"intervals [{number}]:",
            f"    xmin = {_seconds(start_us)}",
            f"    xmax = {_seconds(end_us)}",
            f"    text = {_quoted(text)}",
        ]
        for number, (start_us, end_us, text) in enumerate(filled, start=1)
    ]
    return _tier("IntervalTier", name, whole_us, "intervals", entries)


def _tier(kind: str, name: str, whole_us: int, what: str, entries: Sequence[Sequence[str]]) -> list[str]:
    head = [f'class = "{kind}"', f"name = {_quoted(name)}", "xmin = 0", f"xmax = {_seconds(whole_us)}"]
    return [*head, f"{what}: size = {len(entries)}", *itertools.chain(*entries)]


def _seconds(microseconds: int) -> str:
    return f"{microseconds / 1e6:.6f}".rstrip("0").rstrip(".")


def _quoted(text: str) -> str:
    """Quoted single line with doubled quotes."""
    return '"' + one_line(text).replace('"', '""') + '"'
