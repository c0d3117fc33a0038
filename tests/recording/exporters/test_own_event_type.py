"""An event type declared only in the stream table is recorded, read and exported."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pyarrow.parquet as pq
import pytest

from caris_desktop.domain import streams
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from tests.recording.minute import make_session


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer in a questionnaire."""

    item: str
    points: int | None


@dataclass(frozen=True, slots=True)
class QuestionnaireFilled:
    """A completed questionnaire. ``condition`` is also a column name of the exports."""

    stamp_ns: int
    title: str
    mood: Literal["good", "bad"]
    took_s: float
    condition: str
    begun_ns: int
    answers: tuple[Answer, ...]
    tags: tuple[str, ...] = ()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A session with two of them."""
    spec = streams.StreamSpec("event/questionnaire_filled", QuestionnaireFilled, streams.Delivery.LOSSLESS)
    monkeypatch.setitem(streams.BY_TYPE, QuestionnaireFilled, spec)
    monkeypatch.setitem(streams.BY_NAME, spec.name, spec)
    make_session(
        tmp_path / "s",
        lambda begin_ns: [
            QuestionnaireFilled(
                begin_ns + 2_000_000_000,
                "SUS",
                "good",
                31.5,
                "alone",
                begin_ns + 1_000_000_000,
                (Answer("easy", 4), Answer("complex", None)),
                ("a;", "b"),
            ),
            QuestionnaireFilled(begin_ns + 3_000_000_000, "NASA-TLX", "bad", 12.0, "", begin_ns, ()),
        ],
    )
    return tmp_path / "s"


def test_it_comes_back_from_the_record(folder: Path) -> None:
    first, second = (value for _, value in open_session(folder).values("event/questionnaire_filled"))
    assert first.answers == (Answer("easy", 4), Answer("complex", None))
    assert (first.tags, second.title) == (("a;", "b"), "NASA-TLX")


def test_it_is_a_table_in_csv(folder: Path, tmp_path: Path) -> None:
    export_session(folder, "csv", tmp_path / "csv")
    with (tmp_path / "csv" / "event_questionnaire_filled.csv").open(encoding="utf-8", newline="") as file:
        first, second = csv.DictReader(file)
    assert (first["title"], first["mood"], first["took_s"], first["value_condition"]) == (
        "SUS",
        "good",
        "31.5",
        "alone",
    )
    assert (first["session_s"], first["begun_session_s"], first["tags"]) == (
        "2.0",
        "1.0",
        '["a;", "b"]',
    )
    assert (first["answers_count"], second["answers_count"]) == ("2", "0")
    with (tmp_path / "csv" / "event_questionnaire_filled_answers.csv").open(encoding="utf-8", newline="") as file:
        assert [(row["number"], row["item"], row["points"]) for row in csv.DictReader(file)] == [
            ("1", "easy", "4"),
            ("2", "complex", ""),
        ]
    with (tmp_path / "csv" / "data_dictionary.csv").open(encoding="utf-8", newline="") as file:
        described = {(row["table"], row["column"]): row for row in csv.DictReader(file)}
    assert described["event_questionnaire_filled", "took_s"]["unit"] == "s"
    mood = described["event_questionnaire_filled", "mood"]
    assert (mood["description"], mood["values"], mood["empty"]) == ("Mood.", "good; bad", "Never empty.")
    assert described["event_questionnaire_filled_answers", "points"]["empty"] == "Not recorded."


def test_it_is_a_typed_table_in_parquet(folder: Path, tmp_path: Path) -> None:
    export_session(folder, "parquet", tmp_path / "parquet")
    first, _ = pq.read_table(tmp_path / "parquet" / "event_questionnaire_filled.parquet").to_pylist()
    assert (first["took_s"], first["tags"], first["condition"], first["value_condition"]) == (
        31.5,
        ["a;", "b"],
        "B",
        "alone",
    )
    answers = pq.read_table(tmp_path / "parquet" / "event_questionnaire_filled_answers.parquet").to_pylist()
    assert [(row["item"], row["points"]) for row in answers] == [("easy", 4), ("complex", None)]
