"""Import of annotations: from ELAN files, and from tables.

Tables are CSV with any delimiter, our annotations.csv, ELAN's tab-delimited text, and BORIS. Format of ELAN:
https://www.mpi.nl/tools/elan/EAFv3.0.xsd; older versions with plain vocabularies are read too.
"""

import csv
import io
import json
import logging
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Literal
from urllib.parse import unquote
from xml.etree.ElementTree import Element, ParseError

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.annotation.annotation_editing import (
    LONGEST_NAME,
    LONGEST_VALUE,
    AnnotationError,
    check_document,
    plain_text,
    sorted_document,
    time_text,
    with_moments,
)
from caris_desktop.recording.annotation.annotation_model import (
    DEFAULT_TIER,
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.annotation_store import file_content
from caris_desktop.recording.csv_cells import read_cell
from caris_desktop.recording.session.session_header import AudioInfo, SessionHeader, VideoInfo

_MOST_ROWS = 500_000
_BORIS_HEADED_WITHIN = 50
_SNIFFED_CHARACTERS = 50_000
_LATEST_MS, _BEYOND_MS = 2**32 - 1, 2**32
# Integer lengths below the first are seconds, from the second on milliseconds; in between is ambiguous.
_SECONDS_BELOW, _MILLISECONDS_FROM = 30, 100
_NAMES = {
    "tier": ("tier", "tier name", "tier_name"),
    "value": ("value", "annotation", "text", "label", "annotation value"),
    "coder": ("coder", "annotator"),
    "participant": ("participant",),
    "vocabulary": ("vocabulary",),
}
_START = ("start", "begin", "begin time", "start time", "onset", "session")
_WHOLE_SESSION = "session"
_END = ("end", "end time", "stop", "offset", "end_session")
_CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2})(?:[.,](\d{1,9}))?")
# R and pandas write 5e-05 and 1e+05.
_NUMBER = re.compile(r"\+?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:e[+-]\d\d)?")
_EXCEL_HINT = re.compile(r"\A\"?sep=.\"?\r?\n", re.IGNORECASE)
_HEADING = re.compile(
    r"(?P<base>.+?)(?:\s*-\s*(?P<elan>hh:mm:ss\.ms|ss\.msec|msec)"
    r"|[_ ]?[(\[](?P<bracketed>ms|msec|milliseconds|s|sec|seconds)[)\]]"
    r"|[_ ](?P<unit>ms|msec|milliseconds|s|sec|seconds))?"
)
_FACTORS = {"ms": 1, "msec": 1, "milliseconds": 1, "s": 1000, "sec": 1000, "seconds": 1000, "ss.msec": 1000}
_NO_TIERS = ("begin time", "end time", "duration", "participant", "annotator", "file", "file path", "file name")


def read_csv(
    path: Path,
    *,
    coder: str = "",
    skipped: list[str] | None = None,
    media_spans_ms: Mapping[str, tuple[int, int]] | None = None,
) -> AnnotationDocument:
    """Read tiers and annotations of a table.

    ``coder`` owns the tiers that name no coder; ``skipped`` receives a sentence for each kind of row that was left out,
    and for times that were moved. A BORIS table names the coded media: ``media_spans_ms`` (see
    :func:`media_spans_ms_of`) moves the times of a session's own video to session time.

    A table has a header row with ``start`` and ``end`` (with ``_s`` or ``_ms``, or times as hh:mm:ss.mmm) and
    ``value``; ``tier``, ``coder``, ``participant`` and ``vocabulary`` are optional. ELAN's tab-delimited text is read
    with headers, with one column per tier, and without headers. Numbers without a unit are seconds if they have
    fractions; for integers the unit is inferred from the lengths of the annotations. BORIS tables (aggregated and
    tabular) yield one tier per behaviour and subject. A row without a length is a point event.

    Raises AnnotationError, whose text is for people and names the line.
    """
    content = file_content(path)
    try:
        document, left_out = _document_of_table(_lines(_text(content)), coder, media_spans_ms or {})
    except AnnotationError as error:
        raise AnnotationError(QT_TR_NOOP("{file} cannot be imported. {error}"), file=path.name, error=error) from error
    if skipped is not None:
        skipped += left_out
    return document


class _Line(Value):
    """One row; ``number`` is the number of its last line in the file, from 1."""

    number: int
    cells: list[str]


class _Columns(Value):
    """Column positions. ``factors`` convert the start and end columns to milliseconds.

    ``tiers`` lists columns that hold one tier each, with their names.
    """

    start: int
    end: int
    factors: tuple[int, int]
    value: int | None = None
    tier: int | None = None
    coder: int | None = None
    participant: int | None = None
    vocabulary: int | None = None
    tiers: tuple[tuple[int, str], ...] = ()


def _text(content: bytes) -> str:
    for encoding in ("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            if "\0" not in (text := content.decode(encoding)):
                return text
    raise AnnotationError(QT_TR_NOOP("The file is not a text file. Save the table as CSV in UTF-8."))


def _lines(text: str) -> list[_Line]:
    text = _EXCEL_HINT.sub("\n", text)
    head = "\n".join(text[:_SNIFFED_CHARACTERS].splitlines()[:20])
    delimiter = max("\t;,", key=lambda candidate: _most_alike(head, candidate))
    lines = _parsed(text, delimiter, csv.QUOTE_MINIMAL)
    if delimiter == "\t" and any("\n" in cell and "\t" in cell for line in lines for cell in line.cells):
        # ELAN does not quote: an annotation that begins with a quotation mark swallowed the lines after it.
        lines = _parsed(text, delimiter, csv.QUOTE_NONE)
    if not lines:
        raise AnnotationError(QT_TR_NOOP("The file is empty."))
    return lines


def _parsed(text: str, delimiter: str, quoting: Literal[0, 3]) -> list[_Line]:
    rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, quoting=quoting)
    lines: list[_Line] = []
    try:
        for cells in rows:
            if any(cell.strip() for cell in cells) and not (cells[0].startswith(("#", '"#')) and len(cells) == 1):
                lines.append(_Line(rows.line_num, [read_cell(cell.strip()) for cell in cells]))
            if len(lines) > _MOST_ROWS:
                raise AnnotationError(QT_TR_NOOP("The file has more than %n rows.", "", _MOST_ROWS))
    except csv.Error as error:
        raise AnnotationError(QT_TR_NOOP("Line {number}: {error}."), number=rows.line_num, error=error) from error
    return lines


def _most_alike(head: str, delimiter: str) -> tuple[int, int]:
    """Number of rows as wide as the first one (0 if that has a single cell), then that width."""
    rows = [row for row in csv.reader(io.StringIO(head, newline=""), delimiter=delimiter) if row]
    width = len(rows[0]) if rows else 0
    return (sum(len(row) == width for row in rows), width) if width > 1 else (0, 0)


class _Row(Value):
    """One annotation of a table."""

    number: int
    tier: str
    value: str
    start_ms: int
    end_ms: int
    coder: str = ""
    vocabulary: str = ""
    participant: str = ""


def _document_of_table(
    lines: list[_Line], coder: str, media: Mapping[str, tuple[int, int]]
) -> tuple[AnnotationDocument, list[str]]:
    """Document and sentences on rows that were left out."""
    of_boris = _rows_of_boris(lines, media)
    rows, skipped = of_boris if of_boris is not None else (_rows(lines), [])
    tiers: dict[tuple[str, str, str], Tier] = {}
    annotations: list[Annotation] = []
    lines_of: dict[str, int] = {}
    for row in rows:
        if row.end_ms < row.start_ms:
            raise AnnotationError(
                QT_TR_NOOP("Line {number}: the annotation ends ({end_ms} ms) before it starts ({start_ms} ms)."),
                number=row.number,
                end_ms=row.end_ms,
                start_ms=row.start_ms,
            )
        if row.end_ms > _LATEST_MS:
            raise AnnotationError(
                QT_TR_NOOP("Line {number}: {end_ms} ms is out of range for a session."),
                number=row.number,
                end_ms=row.end_ms,
            )
        if len(row.tier) > LONGEST_NAME or len(row.value) > LONGEST_VALUE:
            raise AnnotationError(QT_TR_NOOP("Line {number}: a text is too long."), number=row.number)
        whose = row.coder or coder
        tier = tiers.setdefault(
            (whose, row.tier, row.participant if of_boris else ""),
            Tier(f"csv-{len(tiers) + 1}", row.tier, whose, row.vocabulary, row.participant),
        )
        annotation_id = f"csv-{len(annotations) + 1}"
        annotations.append(Annotation(annotation_id, tier.tier_id, row.start_ms, row.end_ms, row.value))
        lines_of[annotation_id] = row.number
    document = sorted_document(AnnotationDocument(tuple(tiers.values()), annotations=tuple(with_moments(annotations))))
    for earlier, item in pairwise(document.annotations):
        if earlier.tier_id == item.tier_id and item.start_ms < earlier.end_ms:
            raise AnnotationError(
                QT_TR_NOOP(
                    "Line {number} overlaps line {earlier} on the tier “{tier}”. Annotations on the same "
                    "tier must not overlap: change one of them, or move it to another tier."
                ),
                number=lines_of[item.annotation_id],
                earlier=lines_of[earlier.annotation_id],
                tier=next(tier.title for tier in tiers.values() if tier.tier_id == item.tier_id),
            )
    vocabularies = (
        Vocabulary(name, tuple(map(VocabularyEntry, sorted(values)))) for name, values in document.values_used().items()
    )
    document = replace(document, vocabularies=tuple(vocabularies))
    check_document(document)
    return document, skipped


def _rows(lines: list[_Line]) -> list[_Row]:
    headings = [heading.strip().lower() for heading in lines[0].cells]
    columns = _by_headings(headings, lines)
    if columns is not None:
        lines = lines[1:]
    else:
        columns = _without_headings(lines)
    rows = []
    for line in lines:
        start_ms = _time_of(line, columns.start, columns.factors[0], start=True)
        end_ms = _time_of(line, columns.end, columns.factors[1], start=False)
        whose, vocabulary, participant = (
            plain_text(_cell(line, column)) for column in (columns.coder, columns.vocabulary, columns.participant)
        )
        rows += [
            _Row(line.number, name, value, start_ms, end_ms, whose, vocabulary, participant)
            for name, value in _values(line, columns)
        ]
    return rows


# BORIS


def _rows_of_boris(lines: list[_Line], media: Mapping[str, tuple[int, int]]) -> tuple[list[_Row], list[str]] | None:
    """Rows of a BORIS table and what was left out of it; None for other tables.

    See its user guide, "Export events": aggregated events have a start and a stop; tabular ones have a row for each,
    and older versions precede them with lines on the observation.
    """
    for at, line in enumerate(lines[:_BORIS_HEADED_WITHIN]):
        where = {cell.strip().lower(): column for column, cell in reversed([*enumerate(line.cells)])}
        start, stop, kind = (
            next((where[name] for name in names if name in where), None)
            for names in (("start (s)", "start"), ("stop (s)", "stop"), ("behavior type", "status", "type"))
        )
        if start is None or stop is None:
            start, stop = where.get("time"), None
        if {"behavior", "subject"} <= where.keys() and start is not None and (stop is not None or kind is not None):
            return _of_boris(lines[at + 1 :], where, media, _boris_events(lines[at + 1 :], where, start, stop, kind))
    return None


def _boris_events(
    lines: list[_Line], where: dict[str, int], start: int, stop: int | None, kind: int | None
) -> Iterator[tuple[_Line, int, int] | str]:
    """Events of the first observation with their times, or why a row is none. Without the column ``stop``, starts and
    stops are rows of their own.
    """
    observation = where.get("observation id")
    first = next(filter(None, (_cell(line, observation) for line in lines)), "")
    same = [where["subject"], where["behavior"], *_modifier_columns(where)]
    begun: dict[tuple[str, ...], list[tuple[_Line, int]]] = {}
    unfinished = QT_TR_NOOP("with a start but no stop")
    for line in lines:
        at_ms, status = _milliseconds(_cell(line, start), 1000), _cell(line, kind).upper()
        waiting = begun.setdefault(tuple(_cell(line, column) for column in same), [])
        if _cell(line, observation) != first:
            yield QT_TR_NOOP("of another observation")
        elif at_ms is None:
            yield QT_TR_NOOP("without a time")
        elif stop is not None:
            end_ms = _milliseconds(_cell(line, stop), 1000)
            if end_ms is None and status == "STATE":
                yield unfinished
            else:
                yield line, at_ms, at_ms if end_ms is None else end_ms
        elif status == "START":
            waiting.append((line, at_ms))
        elif status == "STOP":
            yield (*waiting.pop(0), at_ms) if waiting else QT_TR_NOOP("with a stop but no start")
        elif status == "POINT":
            yield line, at_ms, at_ms
        else:
            yield QT_TR_NOOP("that are neither start, stop nor point")
    yield from (unfinished for waiting in begun.values() for _ in waiting)


def _modifier_columns(where: dict[str, int]) -> list[int]:
    return sorted(column for name, column in where.items() if name.startswith("modifier"))


def _of_boris(
    lines: list[_Line],
    where: dict[str, int],
    media: Mapping[str, tuple[int, int]],
    events: Iterator[tuple[_Line, int, int] | str],
) -> tuple[list[_Row], list[str]]:
    subjects = {_cell(line, where["subject"]) for line in lines}
    file_name, moved_ms = _coded_media(lines, where, media)
    rows: list[tuple[_Row, str]] = []
    left_out: Counter[str] = Counter()
    for event in events:
        if isinstance(event, str):
            left_out[event] += 1
            continue
        line, start_ms, end_ms = event
        behaviour, subject = (plain_text(_cell(line, where[name])) for name in ("behavior", "subject"))
        modifiers = [_cell(line, column) for column in _modifier_columns(where)]
        modifiers = [plain_text(modifier) for modifier in modifiers if modifier not in ("", "None")]
        modified = f" ({', '.join(modifiers)})" if modifiers else ""
        tier = f"{subject}: {behaviour}" if len(subjects) > 1 and subject else behaviour
        times_ms = (start_ms + moved_ms, end_ms + moved_ms)
        row = _Row(line.number, tier or DEFAULT_TIER, behaviour + modified, *times_ms, participant=subject)
        rows.append((row, modified))
    if not rows:
        raise AnnotationError(QT_TR_NOOP("This BORIS table contains no event with a time."))
    notes: list[str] = [
        localized(QT_TR_NOOP("Skipped rows {why}: {count}."), why=localized(reason), count=count)
        for reason, count in left_out.items()
    ]
    if moved_ms:
        moved = QT_TR_NOOP("The times were moved by {seconds} s: {file} begins that much later than the session.")
        notes.append(localized(moved, seconds=f"{moved_ms / 1000:.3f}", file=file_name))
    return _apart(rows), notes


def _coded_media(lines: list[_Line], where: dict[str, int], media: Mapping[str, tuple[int, int]]) -> tuple[str, int]:
    """File of the session that was coded, and the start of its times in the session in ms; 0 for other files."""

    def cells(*names: str) -> dict[str, None]:
        columns = [where[name] for name in names if name in where]
        return dict.fromkeys(_cell(line, column) for line in lines for column in columns)

    files = cells("media file name", "media file", "media file path", "source")
    name = next((one for file in files for one in media if re.search(rf"(?:^|[/\\:]){re.escape(one)}$", file)), "")
    if not name or any(_milliseconds(offset, 1000) for offset in cells("time offset (s)")):
        return name, 0  # a coder who sets an offset has aligned the times
    began_ms, ended_ms = media[name]
    lengths = (_milliseconds(length, 1000) for length in cells("total length", "media duration (s)"))
    length_ms = next(filter(None, lengths), None)
    # Copies that this program exports begin with the session.
    exported = length_ms is not None and 2 * (length_ms - (ended_ms - began_ms)) > began_ms
    return name, 0 if exported and ended_ms > began_ms else began_ms


def _apart(rows: list[tuple[_Row, str]]) -> list[_Row]:
    """Rows, given with their modifiers, on a tier per modifier where those of one behaviour overlap."""
    ends_ms: dict[str, int] = {}
    overlapping = set()
    for row, _ in sorted(rows, key=lambda one: one[0].start_ms):
        if row.start_ms < ends_ms.get(row.tier, 0):
            overlapping.add(row.tier)
        ends_ms[row.tier] = max(row.end_ms, ends_ms.get(row.tier, 0))
    return [replace(row, tier=row.tier + modified) if row.tier in overlapping else row for row, modified in rows]


def _values(line: _Line, columns: _Columns) -> list[tuple[str, str]]:
    """(tier, value) of each annotation of the row."""
    if columns.tiers:
        cells = [(name, plain_text(_cell(line, column))) for column, name in columns.tiers]
        return [(name, value) for name, value in cells if value]
    name = plain_text(_cell(line, columns.tier)) or DEFAULT_TIER
    return [(name, plain_text(_cell(line, columns.value)))]


def _by_headings(headings: list[str], lines: list[_Line]) -> _Columns | None:
    """Columns from a header row; None if the first row is none. Raises AnnotationError if headings are missing."""
    parsed = [_HEADING.fullmatch(heading) for heading in headings]
    bases = [match["base"] if match else "" for match in parsed]
    units = [(match["elan"] or match["bracketed"] or match["unit"] or "") if match else "" for match in parsed]
    if _WHOLE_SESSION in headings:
        # A table of this program: these columns repeat the session and its participant in every row.
        bases[headings.index(_WHOLE_SESSION)] = ""
    start, end = _time_column(bases, units, _START), _time_column(bases, units, _END)
    where = {
        what: next((headings.index(name) for name in names if name in headings), None) for what, names in _NAMES.items()
    }
    if _WHOLE_SESSION in headings:
        where["participant"] = None
    if start is None and end is None and where["value"] is None:
        return None
    if start is None or end is None:
        no_start = QT_TR_NOOP(
            "Line {number}: the header has no column for the start of the annotations. Name the columns start_s "
            "and end_s, or start_ms and end_ms."
        )
        no_end = QT_TR_NOOP(
            "Line {number}: the header has no column for the end of the annotations. Name the columns start_s and "
            "end_s, or start_ms and end_ms."
        )
        raise AnnotationError(no_start if start is None else no_end, number=lines[0].number)
    tiers: tuple[tuple[int, str], ...] = ()
    if where["value"] is None:
        names = lines[0].cells
        others = [column for column, base in enumerate(bases) if base not in (*_NO_TIERS, *_START, *_END) and base]
        tiers = tuple(
            (column, plain_text(names[column])[:LONGEST_NAME]) for column in others if column != where["tier"]
        )
        if where["tier"] is not None or not tiers:
            raise AnnotationError(
                QT_TR_NOOP("Line {number}: the header has no column for the value. Name that column value."),
                number=lines[0].number,
            )
    factors = _factors_of(lines[1:], start, end, units[start], units[end])
    return _Columns(start, end, factors, tiers=tiers, **where)


def _time_column(bases: list[str], units: list[str], names: Sequence[str]) -> int | None:
    """Column whose heading comes first in ``names``; of several units, the most exact."""
    exactness = {"ms": 0, "msec": 0, "milliseconds": 0, "hh:mm:ss.ms": 1}
    found = [
        (names.index(base), exactness.get(units[column], 2), column)
        for column, base in enumerate(bases)
        if base in names
    ]
    return min(found)[2] if found else None


def _factors_of(lines: list[_Line], start: int, end: int, start_unit: str, end_unit: str) -> tuple[int, int]:
    """Time factors from the headings, else from the numbers. Raises AnnotationError if they are ambiguous."""
    if start_unit in _FACTORS and end_unit in _FACTORS:
        return _FACTORS[start_unit], _FACTORS[end_unit]
    pairs = [(_cell(line, start), _cell(line, end)) for line in lines]
    numbers = [pair for pair in pairs if _NUMBER.fullmatch(pair[0]) and _NUMBER.fullmatch(pair[1])]
    if not all(text.isdecimal() for pair in numbers for text in pair) or not numbers:
        return 1000, 1000
    length = median(int(until) - int(begin) for begin, until in numbers)
    if _SECONDS_BELOW <= length < _MILLISECONDS_FROM:
        raise AnnotationError(
            QT_TR_NOOP(
                "The times could be in seconds or milliseconds. Name the columns start_s and end_s, or "
                "start_ms and end_ms."
            )
        )
    return (1000, 1000) if length < _SECONDS_BELOW else (1, 1)


def _without_headings(lines: list[_Line]) -> _Columns:
    """Columns of ELAN's export without headers: tier, participant, then begin, end and duration in one to three formats
    each, then the value.
    """
    width = max(len(line.cells) for line in lines)
    timely = [all(_milliseconds(_cell(line, column), 1) is not None for line in lines) for column in range(width)]
    begin = timely.index(True) if True in timely else width
    count = next((n for n, is_time in enumerate(timely[begin:]) if not is_time), width - begin)
    for groups in (3, 2):
        for forms in (3, 2, 1):
            if groups * forms > count:
                continue
            columns = [begin + group * forms for group in range(groups)]
            # ELAN writes seconds with a fraction and milliseconds without
            factors = [1000 if any({".", ","} & {*_cell(line, column)} for line in lines) else 1 for column in columns]
            if all(_adds_up(line, columns, factors) for line in lines):
                return _Columns(
                    columns[0],
                    columns[1],
                    (factors[0], factors[1]),
                    value=begin + groups * forms,
                    tier=0 if begin >= 1 else None,
                    participant=1 if begin >= 2 else None,
                )
    reason = QT_TR_NOOP(
        "Line {number}: there is no header row, and no column contains times. Start with a header row: "
        "tier, start_s, end_s, value."
    )
    headed, *rest = [any(_milliseconds(cell, 1) is not None for cell in line.cells) for line in lines]
    if lines[0].cells[0].startswith("File type"):
        reason = QT_TR_NOOP("The file is a TextGrid of Praat. Export it as an ELAN file or as a table.")
    elif not headed and all(rest) and rest:
        reason = QT_TR_NOOP(
            "Line {number}: the header names no column for the start and the end of the annotations. Name the columns "
            "start_s and end_s, or start_ms and end_ms."
        )
    raise AnnotationError(reason, number=lines[0].number)


def _adds_up(line: _Line, columns: list[int], factors: list[int]) -> bool:
    times = [_milliseconds(_cell(line, column), factor) for column, factor in zip(columns, factors, strict=True)]
    start_ms, end_ms, *duration_ms = times
    if start_ms is None or end_ms is None or end_ms < start_ms:
        return False
    return not duration_ms or (duration_ms[0] is not None and abs(end_ms - start_ms - duration_ms[0]) <= 2)


def _milliseconds(text: str, factor: int) -> int | None:
    """Time in milliseconds, None if it is not a time. A clock time ignores the column's unit."""
    if len(text) > 30:
        return None
    if clock := _CLOCK.fullmatch(text):
        hours, minutes, seconds, fraction = clock.groups()
        total_s = (int(hours or 0) * 60 + int(minutes)) * 60 + int(seconds)
        return total_s * 1000 + round(float(f"0.{fraction or 0}") * 1000)
    if _NUMBER.fullmatch(text):
        return min(round(float(text.replace(",", ".")) * factor), _BEYOND_MS)
    return None


def _time_of(line: _Line, column: int, factor: int, *, start: bool) -> int:
    text = _cell(line, column)
    at_ms = _milliseconds(text, factor)
    if at_ms is None:
        invalid, missing = _NO_START if start else _NO_END
        raise AnnotationError(invalid if text else missing, number=line.number, word=text[:40])
    return at_ms


_NO_START = (
    QT_TR_NOOP("Line {number}, start: “{word}” is not a valid time. Use seconds or hh:mm:ss.mmm."),
    QT_TR_NOOP("Line {number}, start: the time is missing. Use seconds or hh:mm:ss.mmm."),
)
_NO_END = (
    QT_TR_NOOP("Line {number}, end: “{word}” is not a valid time. Use seconds or hh:mm:ss.mmm."),
    QT_TR_NOOP("Line {number}, end: the time is missing. Use seconds or hh:mm:ss.mmm."),
)


def _cell(line: _Line, column: int | None) -> str:
    return line.cells[column] if column is not None and column < len(line.cells) else ""


PROPERTY = "caris-desktop"  # property with the exporter's notes on data that ELAN has no field for
_MOST_ELEMENTS = 2_000_000
_log = logging.getLogger(__name__)


def read_eaf(
    path: Path, *, coder: str = "", media_spans_ms: Mapping[str, tuple[int, int]] | None = None
) -> AnnotationDocument:
    """Read tiers, vocabularies and annotations of an .eaf, in milliseconds of the document.

    The coded media may be a session's own video rather than our export: ``media_spans_ms`` (see
    :func:`media_spans_ms_of`) gives the start of each media file, and the times are shifted to session time.

    ``coder`` owns the tiers without an annotator; tiers that this program derived from the recording stay without a
    coder. Time slots without a value are spread evenly between known ones, and annotations that refer to others share
    their time. Values that a vocabulary lacks are added to it, as ELAN displays them too.

    Raises AnnotationError if the file cannot be read or breaks the rules of annotations; the text is for people.
    """
    content = file_content(path)
    try:
        root = _parse(content)
        return _document_of_eaf(root, coder, _moved_ms(root, media_spans_ms or {}))
    except AnnotationError as error:
        raise AnnotationError(QT_TR_NOOP("{file} cannot be imported. {error}"), file=path.name, error=error) from error


def media_spans_ms_of(header: SessionHeader) -> dict[str, tuple[int, int]]:
    """Start and end of each video and audio file of a session by name, in ms from the session start."""
    began_ns = header.started_ns
    media: tuple[VideoInfo | AudioInfo, ...] = (*header.videos, *header.audio)
    return {
        one.file_name: (round((one.first_stamp_ns - began_ns) / 1e6), round((one.last_stamp_ns - began_ns) / 1e6))
        for one in media
    }


class _Ours(Value):
    """Notes of our exporter: the duration, (tier id, name) per TIER_ID, our id per ANNOTATION_ID."""

    duration_ms: int
    tiers: dict[str, tuple[str, str]]
    annotations: dict[str, str]


@dataclass(slots=True)
class _Item:
    """One annotation of the file: either its slots or the annotation that it refers to is known."""

    xml_id: str
    tier_name: str
    value: str
    slots: tuple[str, str] | None = None
    parent: str = ""
    previous: str = ""


def _parse(content: bytes) -> Element:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(content, forbid_dtd=True)
    except ParseError as error:
        raise AnnotationError(
            QT_TR_NOOP("The file is not valid XML, or is truncated: {error}."), error=error
        ) from error
    except (DefusedXmlException, ValueError, LookupError, RecursionError) as error:
        raise AnnotationError(
            QT_TR_NOOP("The file contains XML that is not allowed in an ELAN file ({kind}), so it was not read."),
            kind=type(error).__name__,
        ) from error
    if root.tag != "ANNOTATION_DOCUMENT":
        raise AnnotationError(QT_TR_NOOP("The file is not an ELAN file: it starts with “{tag}”."), tag=root.tag[:40])
    if sum(1 for _ in root.iter()) > _MOST_ELEMENTS:
        raise AnnotationError(QT_TR_NOOP("The file contains too many elements."))
    return root


def _moved_ms(root: Element, media_spans_ms: Mapping[str, tuple[int, int]]) -> int:
    """Offset from document time to session time in ms, by the first linked media file that belongs to the session."""
    if any(item.get("NAME") == PROPERTY for item in root.iterfind("HEADER/PROPERTY")):
        return 0  # our export, already in session time
    for media in root.iterfind("HEADER/MEDIA_DESCRIPTOR"):
        name = unquote(media.get("MEDIA_URL", "")).replace("\\", "/").rpartition("/")[2]
        origin = media.get("TIME_ORIGIN", "0")
        if name in media_spans_ms and re.fullmatch(r"-?[0-9]{1,10}", origin):
            return media_spans_ms[name][0] + int(origin)
    return 0


def _document_of_eaf(root: Element, coder: str, moved_ms: int) -> AnnotationDocument:
    ours = _noted(root)
    declared = {vocabulary.name: vocabulary for vocabulary in map(_vocabulary, root.iter("CONTROLLED_VOCABULARY"))}
    vocabulary_of_type = {
        kind.get("LINGUISTIC_TYPE_ID", ""): plain_text(kind.get("CONTROLLED_VOCABULARY_REF", ""))
        for kind in root.iter("LINGUISTIC_TYPE")
    }
    tiers: dict[str, Tier] = {}
    for element in root.findall("TIER"):
        xml_name = element.get("TIER_ID", "")
        if not xml_name or xml_name in tiers:
            duplicate, missing = QT_TR_NOOP("Duplicate tier name “{tier}”."), QT_TR_NOOP("A tier has no name.")
            raise AnnotationError(duplicate if xml_name else missing, tier=xml_name)
        tier_id, name = ours.tiers.get(xml_name, ("", ""))
        whose = plain_text(element.get("ANNOTATOR", "")).strip()
        named = vocabulary_of_type.get(element.get("LINGUISTIC_TYPE_REF", ""), "")
        tiers[xml_name] = Tier(
            tier_id=tier_id or f"eaf-{len(tiers) + 1}",
            name=name or plain_text(xml_name)[:LONGEST_NAME],
            # One of our tiers without a coder was derived from the recording.
            coder=whose or ("" if tier_id else coder),
            vocabulary=named if named in declared else "",
            participant=plain_text(element.get("PARTICIPANT", "")),
        )
    items = {item.xml_id: item for item in _items(root)}
    spans = _spans(items, _slot_times(root, items))
    annotations = []
    for item in items.values():
        tier = tiers[item.tier_name]
        start_ms, end_ms = (at_ms + moved_ms for at_ms in spans[item.xml_id])
        if end_ms < start_ms:
            raise AnnotationError(
                QT_TR_NOOP("An annotation on the tier “{tier}” at {time} ends before it starts."),
                tier=tier.name,
                time=time_text(start_ms),
            )
        annotation_id = ours.annotations.get(item.xml_id, item.xml_id)
        annotations.append(Annotation(annotation_id, tier.tier_id, start_ms, end_ms, item.value))
    document = sorted_document(
        AnnotationDocument(
            tuple(tiers.values()), tuple(declared.values()), tuple(with_moments(annotations)), ours.duration_ms
        )
    )
    used = document.values_used()
    vocabularies = []
    for vocabulary in document.vocabularies:
        known = {entry.value for entry in vocabulary.entries}
        added = tuple(VocabularyEntry(value) for value in used.get(vocabulary.name, {}) if value not in known)
        vocabularies.append(replace(vocabulary, entries=(*vocabulary.entries, *added)))
    document = replace(document, vocabularies=tuple(vocabularies))
    check_document(document)
    return document


def _noted(root: Element) -> _Ours:
    """Exporter notes; if they are absent, changed or damaged, only the ids are lost."""
    nothing = _Ours(0, {}, {})
    texts = [item.text or "" for item in root.iterfind("HEADER/PROPERTY") if item.get("NAME") == PROPERTY]
    if not texts:
        return nothing
    try:
        data = json.loads(texts[0])
        tiers = {str(name): (str(tier_id), str(own)) for name, (tier_id, own) in data["tiers"].items()}
        annotations = {str(xml_id): str(own) for xml_id, own in data["annotations"].items()}
        duration_ms = int(data["duration_ms"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        _log.warning("notes of the exporter are left out: %r", error)
        return nothing
    latest = max((int(slot.get("TIME_VALUE", "0")) for slot in root.iter("TIME_SLOT") if _is_time(slot)), default=0)
    # ELAN has no session end: annotations added there may lie later.
    return _Ours(duration_ms if duration_ms >= latest else 0, tiers, annotations)


def _is_time(slot: Element) -> bool:
    text = slot.get("TIME_VALUE", "")
    return text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= _LATEST_MS


def _vocabulary(element: Element) -> Vocabulary:
    entries: dict[str, VocabularyEntry] = {}
    for entry in element:
        # Several languages: the first one; before version 2.8 there was one and no CVE_VALUE.
        value = entry.find("CVE_VALUE") if entry.tag == "CV_ENTRY_ML" else entry if entry.tag == "CV_ENTRY" else None
        if value is not None and (text := plain_text(value.text or "")):
            entries.setdefault(text, VocabularyEntry(text, plain_text(value.get("DESCRIPTION", ""))))
    described = element.find("DESCRIPTION")
    description = element.get("DESCRIPTION", "") if described is None else described.text or ""
    return Vocabulary(plain_text(element.get("CV_ID", "")), tuple(entries.values()), plain_text(description))


def _items(root: Element) -> Iterator[_Item]:
    seen: set[str] = set()
    for tier in root.findall("TIER"):
        for element in (child for annotation in tier.findall("ANNOTATION") for child in annotation):
            xml_id = element.get("ANNOTATION_ID", "")
            value = plain_text(element.findtext("ANNOTATION_VALUE") or "")
            name = tier.get("TIER_ID", "")
            if not xml_id or xml_id in seen:
                raise AnnotationError(
                    QT_TR_NOOP("Annotations on the tier “{name}” have a missing or duplicate id (“{id}”)."),
                    name=name,
                    id=xml_id[:40],
                )
            if len(value) > LONGEST_VALUE:
                raise AnnotationError(
                    QT_TR_NOOP("A text on the tier “{tier}” has %n characters; the maximum is {most}.", "", len(value)),
                    tier=name,
                    most=LONGEST_VALUE,
                )
            seen.add(xml_id)
            if element.tag == "ALIGNABLE_ANNOTATION":
                slots = (element.get("TIME_SLOT_REF1", ""), element.get("TIME_SLOT_REF2", ""))
                yield _Item(xml_id, name, value, slots=slots)
            elif element.tag == "REF_ANNOTATION":
                parent, previous = element.get("ANNOTATION_REF", ""), element.get("PREVIOUS_ANNOTATION", "")
                yield _Item(xml_id, name, value, parent=parent, previous=previous)


def _slot_times(root: Element, items: dict[str, _Item]) -> dict[str, int]:
    """Time of each slot; slots without a value are spread evenly along their chain of annotations."""
    times: dict[str, int] = {}
    unknown: set[str] = set()
    for slot in root.iterfind("TIME_ORDER/TIME_SLOT"):
        name = slot.get("TIME_SLOT_ID", "")
        if _is_time(slot):
            times[name] = int(slot.get("TIME_VALUE", ""))
        elif slot.get("TIME_VALUE") is None:
            unknown.add(name)
        else:
            raise AnnotationError(QT_TR_NOOP("The time slot “{name}” has no valid time."), name=name[:40])
    following = {item.slots[0]: item for item in items.values() if item.slots is not None and item.slots[1] in unknown}
    ends = {item.slots[0]: item.slots[1] for item in items.values() if item.slots is not None}
    for start in list(following):
        if start not in times:
            continue
        chain = [start]
        while chain[-1] in ends and ends[chain[-1]] in unknown and ends[chain[-1]] not in times:
            chain.append(ends[chain[-1]])
            if len(chain) > len(items) + 1:
                raise AnnotationError(QT_TR_NOOP("The sequence of annotations forms a loop."))
        last = ends.get(chain[-1], "")
        if last in times:
            for number, name in enumerate(chain[1:], start=1):
                times[name] = times[start] + (times[last] - times[start]) * number // len(chain)
    return times


def _spans(items: dict[str, _Item], times: dict[str, int]) -> dict[str, tuple[int, int]]:
    """Start and end of each annotation."""
    spans: dict[str, tuple[int, int]] = {}
    waiting: dict[tuple[str, str], list[_Item]] = {}
    for item in items.values():
        if item.slots is None:
            waiting.setdefault((item.parent, item.tier_name), []).append(item)
        elif item.slots[0] not in times or item.slots[1] not in times:
            raise AnnotationError(
                QT_TR_NOOP("An annotation on the tier “{tier}” has no time (“{value}”)."),
                tier=item.tier_name,
                value=item.value[:40],
            )
        else:
            spans[item.xml_id] = (times[item.slots[0]], times[item.slots[1]])
    while waiting:
        ready = [key for key in waiting if key[0] in spans]
        if not ready:
            _, name = next(iter(waiting))
            raise AnnotationError(
                QT_TR_NOOP("Annotations on the tier “{name}” refer to a missing annotation, or form a loop."), name=name
            )
        for key in ready:
            start_ms, end_ms = spans[key[0]]
            parts = _in_sequence(waiting.pop(key))
            for number, item in enumerate(parts):
                spans[item.xml_id] = (
                    start_ms + (end_ms - start_ms) * number // len(parts),
                    start_ms + (end_ms - start_ms) * (number + 1) // len(parts),
                )
    return spans


def _in_sequence(parts: list[_Item]) -> list[_Item]:
    """Parts sorted by their previous-annotation references; in file order if these are incomplete."""
    following = {item.previous: item for item in parts if item.previous}
    ordered: list[_Item] = []
    at = next((item for item in parts if not item.previous), None)
    while at is not None and len(ordered) < len(parts):
        ordered.append(at)
        at = following.get(at.xml_id)
    return ordered if len({item.xml_id for item in ordered}) == len(parts) else parts
