"""Speech history over the sessions of a study."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QCoreApplication
from pytestqt.qtbot import QtBot

from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.speech_history import AT_MOST, SpeechHistory, without_names
from caris_desktop.live.state import LiveState


@pytest.fixture
def slow_work(qtbot: QtBot) -> Iterator[BackgroundWorker]:
    work = BackgroundWorker()
    yield work
    work.finish(lambda _what, wait: wait())


def settle(slow_work: BackgroundWorker, qtbot: QtBot) -> None:
    done: list[None] = []
    slow_work.do(lambda: None, done.append, pytest.fail)
    qtbot.waitUntil(lambda: bool(done))


def run(
    path: Path, slow_work: BackgroundWorker, qtbot: QtBot, *sentences: str, names: tuple[str, ...] = ()
) -> list[str]:
    """Say the sentences in one run of the program, and return its history."""
    state = LiveState()
    said = SpeechHistory(state, path, slow_work, lambda: names)
    said.read()
    settle(slow_work, qtbot)
    for sentence in sentences:
        said.add(sentence)
    settle(slow_work, qtbot)
    kept = list(state.speech_history.value)
    state.deleteLater()
    QCoreApplication.processEvents()
    return kept


def test_the_next_session_has_what_was_typed_before(tmp_path: Path, slow_work: BackgroundWorker, qtbot: QtBot) -> None:
    path = tmp_path / "said" / "a.jsonl"
    assert run(path, slow_work, qtbot, "One", "Zwei, schön", "One") == ["Zwei, schön", "One"]
    assert run(path, slow_work, qtbot, "Three") == ["Zwei, schön", "One", "Three"]


def test_a_sentence_with_a_known_name_stays_for_this_run_only(
    tmp_path: Path, slow_work: BackgroundWorker, qtbot: QtBot
) -> None:
    path = tmp_path / "a.jsonl"
    run(path, slow_work, qtbot, "Is that you, Ada?", "Fine.")
    assert run(path, slow_work, qtbot, "Hello, Ana.", names=("Ana Torres", "Ada")) == [
        "Is that you, Ada?", "Fine.", "Hello, Ana.",
    ]  # fmt: skip
    assert "Ada" not in path.read_text() and "Ana" not in path.read_text()
    assert run(path, slow_work, qtbot) == ["Fine."]


def test_a_name_is_found_as_a_word_and_in_part() -> None:
    assert without_names(("Banana", "ANA!", "Dear Ms Torres"), ["Ana Torres"]) == ("Banana",)


def test_only_the_newest_are_retained(tmp_path: Path, slow_work: BackgroundWorker, qtbot: QtBot) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text("".join(f'"{number}"\n' for number in range(AT_MOST + 20)))
    kept = run(path, slow_work, qtbot, "new")
    assert (len(kept), kept[0], kept[-1]) == (AT_MOST, "21", "new")


@pytest.mark.logs(r"live\.speech_history: ")
def test_a_broken_file_costs_nothing_else(tmp_path: Path, slow_work: BackgroundWorker, qtbot: QtBot) -> None:
    path = tmp_path / "a.jsonl"
    path.write_bytes(b"\xff no json")
    assert run(path, slow_work, qtbot, "new") == ["new"]
    assert path.read_text() == '"new"\n'


def test_a_forgotten_name_is_not_written_by_the_next_sentence(
    tmp_path: Path, slow_work: BackgroundWorker, qtbot: QtBot
) -> None:
    path = tmp_path / "a.jsonl"
    known = ["Zoë Quillfeather", "Basil"]
    state = LiveState()
    said = SpeechHistory(state, path, slow_work, lambda: known)
    for sentence in ("Hello, Zoë.", "Fine."):
        said.add(sentence)
    known.remove("Zoë Quillfeather")
    said.add("And now the arm.")
    settle(slow_work, qtbot)
    assert path.read_text(encoding="utf-8").splitlines() == ['"Fine."', '"And now the arm."']
    said.forget()
    assert state.speech_history.value == ("Fine.", "And now the arm.")
    # The same sentence again in the same run.
    said.add("Quillfeather was here.")
    settle(slow_work, qtbot)
    assert "Quillfeather" not in path.read_text(encoding="utf-8")
    state.deleteLater()
    QCoreApplication.processEvents()


def test_a_name_known_before_the_first_utterance_is_not_written_after_erasure(
    tmp_path: Path, slow_work: BackgroundWorker, qtbot: QtBot
) -> None:
    path = tmp_path / "a.jsonl"
    known = ["Zoë"]
    state = LiveState()
    said = SpeechHistory(state, path, slow_work, lambda: known)
    state.everybody.set(("a row",))
    known.clear()
    state.everybody.set(())
    said.add("Zoë was here.")
    settle(slow_work, qtbot)
    assert path.read_text(encoding="utf-8") == ""
    state.deleteLater()
    QCoreApplication.processEvents()
