"""Data dictionary: every column of the tables and every measure, the same for all exports and the guide."""

from collections.abc import Iterable

from caris_desktop.recording.measures.measure_definitions import (
    MEASURES,
    THRESHOLDS,
    Measure,
    Threshold,
    thresholds_in,
)
from caris_desktop.recording.tables.build import DERIVED_TABLES
from caris_desktop.recording.tables.catalog import Column, Table
from caris_desktop.recording.tables.meanings import empty_in

_NEVER = "Never empty."
MEASURES_TABLE, THRESHOLDS_TABLE = "measures", "thresholds"


def dictionary_columns(tables: Iterable[Table], whose: tuple[Column, ...] = ()) -> list[list[str]]:
    """Cells of DICTIONARY_TABLE for these tables, by column; ``whose`` are their common leading columns.

    Derived tables come first.
    """
    number = {table.name: number for number, table in enumerate(DERIVED_TABLES)}
    rows: list[tuple[str, ...]] = []
    for table in sorted(tables, key=lambda table: number.get(table.name, len(number))):
        rows.append((table.name, "", "", "table", "", "", "", "", "", table.description))
        rows += [_row(table, column) for column in (*whose, *table.columns)]
    return [list(cells) for cells in zip(*rows, strict=True)]


def measure_rows(others: Iterable[Measure] = ()) -> list[dict[str, str]]:
    """The dictionary's entries of the measures and of ``others``, with formula and reference, and of the thresholds."""
    names = (*(column.name for column in DICTIONARY_TABLE.columns), "formula", "reference")
    rows = [
        (
            MEASURES_TABLE, one.name, one.unit, "number", "", "; ".join(one.values),
            one.empty or empty_in(one.description) or _NEVER,
            written_thresholds(thresholds_in(one.description, one.formula)), "", one.description, one.formula,
            one.reference,
        )
        for one in (*MEASURES, *others)
    ]  # fmt: skip
    rows += [
        (THRESHOLDS_TABLE, one.name, one.unit, "number", "", "", _NEVER, f"{one.value:g}", "", one.description, "", "")
        for one in THRESHOLDS
    ]
    return [dict(zip(names, row, strict=True)) for row in rows]


def empty_of(column: Column) -> str:
    """Meaning of an empty cell, as a sentence."""
    return column.empty or _NEVER


def allowed_values(column: Column) -> tuple[str, ...]:
    return ("true", "false") if column.kind == "true or false" else column.values


def written_thresholds(thresholds: Iterable[Threshold]) -> str:
    return "; ".join(f"{one.name} = {one.value:g} {one.unit}".rstrip() for one in thresholds)


def column_thresholds(table: Table, column: Column) -> tuple[Threshold, ...]:
    """Thresholds that apply to a column: named by its description or formula, or by the table's for all columns."""
    formulas = (one.formula for one in MEASURES if table.name == MEASURES_TABLE and one.name == column.name)
    return thresholds_in(column.description, *formulas, table.description if column in table.own_columns else "")


def _row(table: Table, column: Column) -> tuple[str, ...]:
    return (
        table.name, column.name, column.unit, column.kind, column.clock, "; ".join(allowed_values(column)),
        empty_of(column), written_thresholds(column_thresholds(table, column)), column.field, column.description,
    )  # fmt: skip


DICTIONARY_TABLE = Table(
    "data_dictionary",
    "Every table and every column.",
    tuple(
        Column(name, "", "text", description, lambda row: row, empty=empty)
        for name, description, empty in (
            ("table", "Name of the table that has the column.", ""),
            ("column", "Name in the first line of the table.", "The row describes the table itself."),
            ("unit", "SI symbol of the unit; 0-1 for shares and probabilities.", "There is none."),
            (
                "type",
                (
                    "How values are written. In CSV files, utc is ISO 8601, texts are JSON, and numbers are "
                    "separated by semicolons. An apostrophe precedes text that spreadsheets would read as a "
                    "formula (not with --plain-csv)."
                ),
                "",
            ),
            (
                "clock",
                "Which clock gave a time: session (monotonic), UTC (of this computer at the start), or robot.",
                "The column is no time.",
            ),
            ("values", "All allowed values, separated by semicolons.", "They are not limited to a list."),
            ("empty", "What it means that a cell has no value.", "The row describes a table."),
            ("threshold", "Thresholds by which the numbers were computed, with their values.", "None applies."),
            (
                "field",
                "Field of the messages in events.mcap that has the same value.",
                "The column was computed, or messages hold it in another form.",
            ),
            ("description", "Meaning, as a sentence.", ""),
        )
    ),
)
