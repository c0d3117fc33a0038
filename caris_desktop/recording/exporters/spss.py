"""SPSS files of tables, with labels of variables and values, and measurement levels."""

import importlib.util
import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.recording.data_dictionary import allowed_values
from caris_desktop.recording.tables.catalog import Column, Table

_MOST_TEXT_BYTES = 4_000
"""Longer texts are cut off: all cells of a column have the width of its longest one."""
_MOST_LABEL_BYTES = 255
_NOTE_LINE = 70
_RESERVED = frozenset(["all", "and", "by", "eq", "ge", "gt", "le", "lt", "ne", "not", "or", "to", "with"])
_NUMBERS = ("integer", "number")


def write_tables(parquet: Path, out: Path, tables: Iterable[Table], notify: Callable[[str], None]) -> bool:
    """Write one file for each of these tables, from its Parquet file; False if the packages for it are missing.

    Raises OSError.
    """
    if not all(map(importlib.util.find_spec, ("pyreadstat", "pandas"))):
        notify(
            QT_TR_NOOP(
                "The study tables have no SPSS files: the packages pyreadstat and pandas are not installed. Install "
                "them with pip install 'caris-desktop[spss]', and export again. CSV and Parquet files are complete."
            )
        )
        return False
    import pyreadstat

    out.mkdir()
    for table in tables:
        columns = table.columns
        pyreadstat.write_sav(
            _frame(parquet / f"{table.name}.parquet", columns),
            out / f"{table.name}.sav",
            file_label=table.name,
            note=textwrap.wrap(table.description, _NOTE_LINE),
            row_compress=True,
            column_labels={_name(column): _label(column) for column in columns},
            variable_value_labels={
                _name(column): {code: value for value, code in codes.items()}
                for column in columns
                if (codes := _codes(column))
            },
            variable_measure={_name(column): _level(column) for column in columns},
        )
    return True


def about(column: Column) -> dict[str, Any]:
    """Name, codes and measurement level of the variable that a column becomes."""
    return {"name": _name(column), "codes": _codes(column), "level": _level(column)}


def _name(column: Column) -> str:
    """Name that SPSS accepts: it reserves some words."""
    return f"{column.name}_" if column.name.casefold() in _RESERVED else column.name


def _label(column: Column) -> str:
    unit = f" [{column.unit}]" if column.unit else ""
    text = column.description.encode()[: _MOST_LABEL_BYTES - len(unit.encode())].decode(errors="ignore")
    return f"{text}{unit}"


def _codes(column: Column) -> dict[str, float]:
    """Number of each allowed value; true is 1, false is 0. Numbers are their own."""
    if column.kind in _NUMBERS:
        return {value: float(value) for value in column.values}
    if column.kind == "true or false":
        return {"false": 0.0, "true": 1.0}
    return {value: float(code) for code, value in enumerate(allowed_values(column), start=1)}


def _level(column: Column) -> str:
    return "scale" if column.kind in (*_NUMBERS, "utc") else "nominal"


def _frame(path: Path, columns: tuple[Column, ...]) -> Any:
    import pandas as pd
    import pyarrow.parquet as pq

    rows = pq.read_table(path)
    cells = {}
    for column in columns:
        values = rows.column(column.name)
        if column.kind == "utc":
            cells[_name(column)] = values.to_pandas().dt.tz_localize(None)
        elif column.kind in _NUMBERS:
            cells[_name(column)] = values.to_pandas().astype("float64")
        elif codes := _codes(column):
            coded = (codes.get(_text(value)) for value in values.to_pylist())
            cells[_name(column)] = pd.Series(list(coded), dtype="float64")
        else:
            texts = [_text(value).encode()[:_MOST_TEXT_BYTES].decode(errors="ignore") for value in values.to_pylist()]
            cells[_name(column)] = pd.Series(texts, dtype="object")
    return pd.DataFrame(cells)


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return (
        ";".join(map(str, value)) if isinstance(value, list) else str(value).replace("\0", "\N{REPLACEMENT CHARACTER}")
    )
