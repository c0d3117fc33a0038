"""Use of exchanges for suggested replies: in the table answers, in measures, and by model and function."""

import csv
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.events import AnswerUsed, SuggestionChanged
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from caris_desktop.recording.studies.statistics import study_statistics
from tests.recording.told_session import at, exchange, heard, said, silenced, tell


def _replies(number: int, asked_s: float, ended_s: float, turn: str, revision: int = 1, **fields: Any) -> Any:
    about = {"purpose": "replies", "turn_id": turn, "revision": revision, "outcome": "cancelled", **fields}
    return exchange(number, asked_s, ended_s, "Suggestion", **about)


def _suggestion(number: int, second: float, state: Any, turn: str, revision: int = 1, **fields: Any) -> Any:
    text = f"Suggestion {number}."
    return SuggestionChanged(at(second), f"s-{number}", state, turn, revision, number, text, "a model", **fields)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A reply said, one edited, one superseded, one expired, one that was silenced, one exchange that showed none, and
    a question.
    """
    return tell(
        tmp_path / "study" / "s",
        [
            *heard(1, 3.0, 5.0, "What is this?"),
            _replies(1, 4.1, 4.5, "h-1", 1),
            _suggestion(1, 4.4, "displayed", "h-1", 1, latency_ms=300.0),
            _suggestion(1, 5.2, "superseded", "h-1", 1, actor="console"),
            _replies(2, 5.1, 7.0, "h-1", 2),
            _suggestion(2, 5.8, "displayed", "h-1", 2, latency_ms=800.0),
            _suggestion(3, 6.0, "displayed", "h-1", 2, latency_ms=1000.0),
            _suggestion(2, 7.5, "taken", "h-1", 2, utterance_id="u-1", actor="wizard"),
            _suggestion(3, 7.5, "superseded", "h-1", 2, actor="console"),
            *said(1, 7.5, 7.8, 9.5, "Suggestion 2.", origin="suggestion"),
            *heard(2, 20.0, 22.0, "And that?"),
            _replies(3, 22.1, 24.0, "h-2"),
            _suggestion(4, 23.0, "displayed", "h-2", latency_ms=1200.0),
            _suggestion(4, 26.0, "edited", "h-2", utterance_id="u-2", edit_distance=4, actor="wizard"),
            *said(2, 26.0, 26.2, 28.0, "Suggestion four.", origin="suggestion"),
            *heard(3, 40.0, 41.0, "Goodbye."),
            _replies(4, 41.1, 43.0, "h-3"),
            _suggestion(5, 42.0, "displayed", "h-3", latency_ms=1000.0),
            _replies(5, 44.0, 44.5, "h-3", 2),
            _replies(6, 45.0, 46.0, "h-3", 3, outcome="answered"),
            exchange(7, 50.0, 51.0, "An arm."),
            AnswerUsed(at(52.0), "x-7", "dismissed", ""),
        ],
        lasts_s=60.0,
    )


def test_each_exchange_says_what_became_of_its_replies(session: Path, tmp_path: Path) -> None:
    export_session(session, "csv", tmp_path / "out")
    with (tmp_path / "out" / "answers.csv").open(encoding="utf-8", newline="") as file:
        rows = [
            (row["exchange_id"], row["purpose"], row["use"], row["shown"], row["latency_ms"], row["edit_distance"])
            for row in csv.DictReader(file)
        ]
    assert rows == [
        ("x-1", "replies", "superseded", "1", "300.0", ""),
        ("x-2", "replies", "said", "2", "800.0", ""),
        ("x-3", "replies", "edited", "1", "1200.0", "4"),
        ("x-4", "replies", "expired", "1", "1000.0", ""),
        ("x-5", "replies", "", "0", "", ""),
        ("x-6", "replies", "unused", "0", "", ""),
        ("x-7", "question", "dismissed", "", "", ""),
    ]


def test_the_measures_count_replies_apart_from_questions(session: Path) -> None:
    values = measure(read_facts(open_session(session))).values
    assert (values["llm_exchanges"], values["llm_accepted_fraction"]) == (1, 0.0)
    assert (values["reply_exchanges"], values["reply_used_fraction"]) == (6, 0.5)
    assert (values["suggestions_shown"], values["suggestions_said"], values["suggestions_edited"]) == (5, 1, 1)
    assert (values["suggestion_latency_ms"], values["suggestion_edit_distance"]) == (1000.0, 4.0)


def test_statistics_list_the_use_by_model_and_function(session: Path, tmp_path: Path) -> None:
    out = study_statistics(session.parent, tmp_path / "statistics").out
    with (out / "model_functions.csv").open(encoding="utf-8", newline="") as file:
        question, replies = csv.DictReader(file)
    assert (question["purpose"], question["asked"], question["dismissed"]) == ("question", "1", "1")
    assert (replies["purpose"], replies["asked"], replies["said"], replies["edited"]) == ("replies", "6", "1", "1")
    assert (replies["superseded"], replies["expired"], replies["unused"]) == ("1", "1", "1")
    assert (replies["latency_ms"], replies["edit_distance"]) == ("900.0", "4.0")


def test_a_reply_that_was_silenced_at_once_is_unused(tmp_path: Path) -> None:
    folder = tell(
        tmp_path / "s",
        [
            *heard(1, 3.0, 5.0, "What is this?"),
            # As recorded before exchanges had revisions.
            _replies(1, 5.1, 7.0, "h-1", 0),
            _suggestion(1, 5.8, "displayed", "h-1", 2),
            _suggestion(1, 7.5, "taken", "h-1", 2, utterance_id="u-1", actor="wizard"),
            *silenced(1, 7.5, "Suggestion 1.", origin="suggestion"),
        ],
        lasts_s=20.0,
    )
    (answer,) = read_facts(open_session(folder)).exchanges
    assert (answer.use, answer.shown) == ("unused", 1)
