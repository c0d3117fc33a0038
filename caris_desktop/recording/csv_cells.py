"""CSV cells that spreadsheets display and never execute: recorded speech may begin like a formula."""

import argparse
import csv
import re
from collections.abc import Iterable
from typing import IO, Any

from caris_desktop.domain.value_class import Value

_FORMULA = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""As OWASP lists it ("CSV injection"), full width too; apostrophes before it, so that one can be taken off again."""
_NUMBER = r"[+-]?(\d+\.?\d*([eE][+-]?\d+)?|inf|nan)"
_NUMBERS = re.compile(rf"{_NUMBER}([; ]{_NUMBER})*")


def shown_cell(text: str) -> str:
    """Prefix ``text`` with an apostrophe if a spreadsheet would run it as a formula. Numbers stay numbers."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBERS.fullmatch(text) else text


def read_cell(cell: str) -> str:
    """Inverse of :func:`shown_cell`."""
    return cell[1:] if cell[:1] == "'" and _FORMULA.match(cell[1:]) else cell


class CsvStyle(Value):
    """Format of CSV files. ``plain``: cells unescaped, for programs. ``byte_order_mark``: for spreadsheets that do not
    assume UTF-8.
    """

    plain: bool = False
    byte_order_mark: bool = False

    @property
    def encoding(self) -> str:
        return "utf-8-sig" if self.byte_order_mark else "utf-8"

    def writer(self, file: IO[str]) -> "CsvWriter":
        return CsvWriter(file, self)


SHOWN = CsvStyle()
"""Default style, for spreadsheets."""


class CsvWriter:
    """Writer of one CSV file."""

    def __init__(self, file: IO[str], style: CsvStyle) -> None:
        self._rows = csv.writer(file)
        self._plain = style.plain

    def writerow(self, cells: Iterable[Any]) -> None:
        self.writerows([cells])

    def writerows(self, rows: Iterable[Iterable[Any]]) -> None:
        if not self._plain:
            rows = ([shown_cell(cell) if isinstance(cell, str) else cell for cell in row] for row in rows)
        self._rows.writerows(rows)


def add_csv_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that all CSV-writing commands share."""
    parser.add_argument(
        "--plain-csv",
        action="store_true",
        help=(
            "write CSV cells unchanged, for programs; otherwise text that starts like a formula is preceded by "
            "an apostrophe, so that spreadsheets show it"
        ),
    )
    parser.add_argument("--csv-bom", action="store_true", help="start CSV files with a UTF-8 byte order mark")


def csv_style_of(args: argparse.Namespace) -> CsvStyle:
    return CsvStyle(args.plain_csv, args.csv_bom)
