"""Reads annotations from tables: CSV with any delimiter, our own annotations.csv, ELAN's tab-delimited export."""

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from caris_desktop.domain.translation import QT_TR_NOOP, filled
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.annotation.editing import (
    LONGEST_NAME,
    LONGEST_VALUE,
    AnnotationError,
    check_document,
    plain_text,
    sorted_document,
)
from caris_desktop.recording.annotation.model import (
    DEFAULT_TIER,
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.store import file_content
from caris_desktop.recording.csv_cells import read_cell

_MOST_ROWS = 500_000
_SNIFFED_CHARACTERS = 50_000
_LATEST_MS = 2**32 - 1
# Lengths of whole numbers below are seconds, from the second on milliseconds; in between nobody can tell.
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
_NUMBER = re.compile(r"\d+(?:[.,]\d+)?")
_HEADING = re.compile(
    r"(?P<base>.+?)(?:\s*-\s*(?P<elan>hh:mm:ss\.ms|ss\.msec|msec)"
    r"|[_ ]?[(\[](?P<bracketed>ms|msec|milliseconds|s|sec|seconds)[)\]]"
    r"|[_ ](?P<unit>ms|msec|milliseconds|s|sec|seconds))?"
)
_FACTORS = {"ms": 1, "msec": 1, "milliseconds": 1, "s": 1000, "sec": 1000, "seconds": 1000, "ss.msec": 1000}
_NO_TIERS = ("begin time", "end time", "duration", "participant", "annotator", "file", "file path", "file name")


def read_csv(path: Path, *, coder: str = "") -> AnnotationDocument:
    """Tiers and annotations of a table. ``coder`` is whose the tiers are that name none.

    A table has a row of headings with ``start`` and ``end`` (with ``_s`` or ``_ms``, or times as hh:mm:ss.mmm), and
    ``value``; ``tier``, ``coder``, ``participant`` and ``vocabulary`` where it has them. ELAN's tab-delimited text is
    read with its headings, with a column for each tier, and without headings. Numbers without a unit are seconds if
    they have fractions; whole ones are told by how long the annotations are.

    Raises
    ------
    AnnotationError
        For people; names the line.
    """
    content = file_content(path)
    try:
        return _document(_lines(_text(content)), coder)
    except AnnotationError as error:
        raise AnnotationError(
            QT_TR_NOOP("{file} cannot be taken over. {error}"), file=path.name, error=error
        ) from error


@dataclass(frozen=True, slots=True)
class _Line:
    """One row; ``number`` is that of the line in the file where it ends, from 1."""

    number: int
    cells: list[str]


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where things are. ``factors`` turn numbers of the start and end columns into milliseconds.

    ``tiers`` has the columns that are tiers by themselves, with their names.
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
    encodings = ["utf-8-sig"]
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    for encoding in (*encodings, "cp1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" in text:
            break
        return text
    raise AnnotationError(QT_TR_NOOP("It is no text. Save the table as CSV in UTF-8."))


def _lines(text: str) -> list[_Line]:
    head = "\n".join(text[:_SNIFFED_CHARACTERS].splitlines()[:20])
    delimiter = max("\t;,", key=lambda candidate: _most_alike(head, candidate))
    rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    lines: list[_Line] = []
    try:
        for cells in rows:
            if any(cell.strip() for cell in cells) and not (cells[0].startswith(("#", '"#')) and len(cells) == 1):
                lines.append(_Line(rows.line_num, [read_cell(cell.strip()) for cell in cells]))
            if len(lines) > _MOST_ROWS:
                raise AnnotationError(QT_TR_NOOP("It has more than %n rows.", "", _MOST_ROWS))
    except csv.Error as error:
        raise AnnotationError(QT_TR_NOOP("Line {number}: {error}."), number=rows.line_num, error=error) from error
    if not lines:
        raise AnnotationError(QT_TR_NOOP("There is nothing in it."))
    return lines


def _most_alike(head: str, delimiter: str) -> tuple[int, int]:
    """How many rows have as many cells as the first one, where that is more than one; then how many cells."""
    rows = [row for row in csv.reader(io.StringIO(head, newline=""), delimiter=delimiter) if row]
    width = len(rows[0]) if rows else 0
    return (sum(len(row) == width for row in rows), width) if width > 1 else (0, 0)


def _document(lines: list[_Line], coder: str) -> AnnotationDocument:
    headings = [heading.strip().lower() for heading in lines[0].cells]
    columns = _by_headings(headings, lines)
    if columns is not None:
        lines = lines[1:]
    else:
        columns = _without_headings(lines)
    tiers: dict[tuple[str, str], Tier] = {}
    annotations: list[Annotation] = []
    lines_of: dict[str, int] = {}
    for line in lines:
        start_ms = _time_of(line, columns.start, columns.factors[0], start=True)
        end_ms = _time_of(line, columns.end, columns.factors[1], start=False)
        if end_ms <= start_ms:
            raise AnnotationError(
                QT_TR_NOOP("Line {number}: it ends ({end_ms} ms) before or when it starts ({start_ms} ms)."),
                number=line.number,
                end_ms=end_ms,
                start_ms=start_ms,
            )
        if end_ms > _LATEST_MS:
            raise AnnotationError(
                QT_TR_NOOP("Line {number}: {end_ms} ms is no time of a session."), number=line.number, end_ms=end_ms
            )
        for name, value in _values(line, columns):
            whose = plain_text(_cell(line, columns.coder)) or coder
            if len(name) > LONGEST_NAME or len(value) > LONGEST_VALUE:
                raise AnnotationError(QT_TR_NOOP("Line {number}: a text is too long."), number=line.number)
            tier = tiers.setdefault(
                (whose, name),
                Tier(
                    f"csv-{len(tiers) + 1}",
                    name,
                    whose,
                    plain_text(_cell(line, columns.vocabulary)),
                    plain_text(_cell(line, columns.participant)),
                ),
            )
            annotation = Annotation(f"csv-{len(annotations) + 1}", tier.tier_id, start_ms, end_ms, value)
            annotations.append(annotation)
            lines_of[annotation.annotation_id] = line.number
    _refuse_overlaps(annotations, {tier.tier_id: tier.title for tier in tiers.values()}, lines_of)
    vocabularies = _vocabularies(tuple(tiers.values()), annotations)
    document = sorted_document(AnnotationDocument(tuple(tiers.values()), vocabularies, tuple(annotations)))
    check_document(document)
    return document


def _values(line: _Line, columns: _Columns) -> list[tuple[str, str]]:
    """(tier, value) of each annotation of the row."""
    if columns.tiers:
        cells = [(name, plain_text(_cell(line, column))) for column, name in columns.tiers]
        return [(name, value) for name, value in cells if value]
    name = plain_text(_cell(line, columns.tier)) or DEFAULT_TIER
    return [(name, plain_text(_cell(line, columns.value)))]


def _refuse_overlaps(annotations: Sequence[Annotation], names: dict[str, str], lines_of: dict[str, int]) -> None:
    before: dict[str, Annotation] = {}
    for item in sorted(annotations, key=lambda item: item.start_ms):
        earlier = before.get(item.tier_id)
        if earlier is not None and item.start_ms < earlier.end_ms:
            raise AnnotationError(
                QT_TR_NOOP(
                    "Line {number} overlaps line {earlier} on the tier “{tier}”. Annotations of one tier do"
                    " not overlap: change one of them, or give it another tier."
                ),
                number=lines_of[item.annotation_id],
                earlier=lines_of[earlier.annotation_id],
                tier=names[item.tier_id],
            )
        before[item.tier_id] = item


def _vocabularies(tiers: Sequence[Tier], annotations: Sequence[Annotation]) -> tuple[Vocabulary, ...]:
    """Those that the tiers name, with the values that are used."""
    values: dict[str, dict[str, None]] = {tier.vocabulary: {} for tier in tiers if tier.vocabulary}
    vocabulary_of_tier = {tier.tier_id: tier.vocabulary for tier in tiers}
    for item in annotations:
        if item.value and vocabulary_of_tier[item.tier_id]:
            values[vocabulary_of_tier[item.tier_id]][item.value] = None
    return tuple(
        Vocabulary(name, tuple(VocabularyEntry(value) for value in sorted(entries))) for name, entries in values.items()
    )


def _by_headings(headings: list[str], lines: list[_Line]) -> _Columns | None:
    """None where the first row is none of headings. Raises AnnotationError for headings that are not enough."""
    parsed = [_HEADING.fullmatch(heading) for heading in headings]
    bases = [match["base"] if match else "" for match in parsed]
    units = [(match["elan"] or match["bracketed"] or match["unit"] or "") if match else "" for match in parsed]
    if _WHOLE_SESSION in headings:
        # A table of this program: these columns say of every row which session it is of, and who took part in that.
        bases[headings.index(_WHOLE_SESSION)] = ""
    start, end = _time_column(bases, units, _START), _time_column(bases, units, _END)
    where = {
        what: next((headings.index(name) for name in names if name in headings), None) for what, names in _NAMES.items()
    }
    if _WHOLE_SESSION in headings:
        where["participant"] = None
    if start is None or end is None:
        if start is None and end is None and where["value"] is None:
            return None
        raise AnnotationError(
            filled(
                QT_TR_NOOP(
                    "Line {number}: the headings name no start of the annotations. Call the columns start_s"
                    " and end_s, or start_ms and end_ms."
                ),
                number=lines[0].number,
            )
            if start is None
            else filled(
                QT_TR_NOOP(
                    "Line {number}: the headings name no end of the annotations. Call the columns start_s"
                    " and end_s, or start_ms and end_ms."
                ),
                number=lines[0].number,
            )
        )
    tiers: tuple[tuple[int, str], ...] = ()
    if where["value"] is None:
        names = lines[0].cells
        others = [column for column, base in enumerate(bases) if base not in (*_NO_TIERS, *_START, *_END) and base]
        tiers = tuple(
            (column, plain_text(names[column])[:LONGEST_NAME]) for column in others if column != where["tier"]
        )
        if where["tier"] is not None or not tiers:
            raise AnnotationError(
                QT_TR_NOOP("Line {number}: the headings name no value. Call that column value."), number=lines[0].number
            )
    data = lines[1:]
    factors = _factors_of(data, start, end, units[start], units[end])
    return _Columns(start, end, factors, tiers=tiers, **where)


def _time_column(bases: list[str], units: list[str], names: Sequence[str]) -> int | None:
    """The column whose heading is earliest in ``names``, of several units the most exact one."""
    exactness = {"ms": 0, "msec": 0, "milliseconds": 0, "hh:mm:ss.ms": 1}
    found = [
        (names.index(base), exactness.get(units[column], 2), column)
        for column, base in enumerate(bases)
        if base in names
    ]
    return min(found)[2] if found else None


def _factors_of(lines: list[_Line], start: int, end: int, start_unit: str, end_unit: str) -> tuple[int, int]:
    """From the headings, else from the numbers themselves. Raises AnnotationError where they do not tell."""
    if start_unit in _FACTORS and end_unit in _FACTORS:
        return _FACTORS[start_unit], _FACTORS[end_unit]
    pairs = [(_cell(line, start), _cell(line, end)) for line in lines]
    numbers = [pair for pair in pairs if _NUMBER.fullmatch(pair[0]) and _NUMBER.fullmatch(pair[1])]
    if not numbers or any("." in text or "," in text for pair in numbers for text in pair):
        return 1000, 1000
    length = median(int(until) - int(begin) for begin, until in numbers)
    if _SECONDS_BELOW <= length < _MILLISECONDS_FROM:
        raise AnnotationError(
            QT_TR_NOOP(
                "Its times may be seconds or milliseconds. Call the columns start_s and end_s, or start_ms and end_ms."
            )
        )
    return (1000, 1000) if length < _SECONDS_BELOW else (1, 1)


def _without_headings(lines: list[_Line]) -> _Columns:
    """As ELAN exports: tier, participant, then begin, end and duration in one to three forms each, then the value."""
    width = max(len(line.cells) for line in lines)
    timely = [all(_is_time(_cell(line, column)) for line in lines) for column in range(width)]
    begin = timely.index(True) if True in timely else width
    count = next((n for n, is_time in enumerate(timely[begin:]) if not is_time), width - begin)
    for groups in (3, 2):
        for forms in (3, 2, 1):
            if groups * forms > count:
                continue
            columns = [begin + group * forms for group in range(groups)]
            factors = [_factor_of_column(lines, column) for column in columns]
            if all(_adds_up(line, columns, factors) for line in lines):
                return _Columns(
                    columns[0],
                    columns[1],
                    (factors[0], factors[1]),
                    value=begin + groups * forms,
                    tier=0 if begin >= 1 else None,
                    participant=1 if begin >= 2 else None,
                )
    raise AnnotationError(
        QT_TR_NOOP(
            "Line {number}: there are no headings, and no columns that are times. Begin with a row"
            " of headings: tier, start_s, end_s, value."
        ),
        number=lines[0].number,
    )


def _adds_up(line: _Line, columns: list[int], factors: list[int]) -> bool:
    times = [_milliseconds(_cell(line, column), factor) for column, factor in zip(columns, factors, strict=True)]
    start_ms, end_ms, *duration_ms = times
    if start_ms is None or end_ms is None or end_ms <= start_ms:
        return False
    return not duration_ms or (duration_ms[0] is not None and abs(end_ms - start_ms - duration_ms[0]) <= 2)


def _factor_of_column(lines: list[_Line], column: int) -> int:
    """ELAN's seconds have a fraction, its milliseconds none."""
    return 1000 if any("." in _cell(line, column) or "," in _cell(line, column) for line in lines) else 1


def _is_time(text: str) -> bool:
    return bool(_NUMBER.fullmatch(text) or _CLOCK.fullmatch(text))


def _milliseconds(text: str, factor: int) -> int | None:
    """None for what is no time. A clock time is that whatever the column's unit."""
    if len(text) > 30:
        return None
    if clock := _CLOCK.fullmatch(text):
        hours, minutes, seconds, fraction = clock.groups()
        whole_s = (int(hours or 0) * 60 + int(minutes)) * 60 + int(seconds)
        return whole_s * 1000 + round(float(f"0.{fraction or 0}") * 1000)
    if _NUMBER.fullmatch(text):
        return round(float(text.replace(",", ".")) * factor)
    return None


def _time_of(line: _Line, column: int, factor: int, *, start: bool) -> int:
    text = _cell(line, column)
    at_ms = _milliseconds(text, factor)
    if at_ms is None:
        raise AnnotationError(_no_time(start=start, told=bool(text)), number=line.number, word=text[:40])
    return at_ms


def _no_time(*, start: bool, told: bool) -> str:
    """Of a start or an end that something is told of, or nothing."""
    if told and start:
        return QT_TR_NOOP("Line {number}, start: “{word}” is no time. Write seconds, or hh:mm:ss.mmm.")
    if told:
        return QT_TR_NOOP("Line {number}, end: “{word}” is no time. Write seconds, or hh:mm:ss.mmm.")
    if start:
        return QT_TR_NOOP("Line {number}, start: there is no time. Write seconds, or hh:mm:ss.mmm.")
    return QT_TR_NOOP("Line {number}, end: there is no time. Write seconds, or hh:mm:ss.mmm.")


def _cell(line: _Line, column: int | None) -> str:
    return line.cells[column] if column is not None and column < len(line.cells) else ""
