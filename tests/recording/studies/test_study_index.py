"""Search for sessions by header and by transcript, with any state of the index."""

import argparse
import json
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from caris_desktop.domain.events import ChatMessage, Marked, Problem, UtteranceChanged
from caris_desktop.domain.translation import tr
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.session.folder_lock import hold
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.studies import sessions_command, study_index
from caris_desktop.recording.studies.study_index import DATABASE_NAME, StudyIndex, content_signature
from caris_desktop.recording.studies.study_query import SessionEntry, SessionQuery
from tests.benchmarks.study_search import answers, make_study
from tests.recording.told_session import TRIAL, at, exchange, heard, said, tell
from tests.support.translated_messages import untranslated_part


def session(folder: Path, *texts: str, closed: bool = True, later_s: float = 0.0, **trial: str) -> Path:
    """A session in which a participant says these texts."""
    values = [
        value for number, text in enumerate(texts) for value in heard(number, 10 * number + 1, 10 * number + 3, text)
    ]
    return tell(folder, values, lasts_s=60, trial={**TRIAL, **trial}, closed=closed, later_s=later_s)  # fmt: skip


@pytest.fixture
def study(tmp_path: Path) -> Path:
    sessions_dir = tmp_path / "study" / "sessions"
    session(sessions_dir / "a", "Where is the kitchen?", participant="P1", condition="humour", later_s=0)
    session(sessions_dir / "b", "The Küche, please", participant="P10", condition="neutral", later_s=3600)
    session(
        sessions_dir / "c", 'He said "stop" AND ran', participant="P2", condition="Humour", purpose="practice",
        later_s=7200,
    )  # fmt: skip
    return tmp_path / "study"


def names(entries: tuple[SessionEntry, ...]) -> list[str]:
    return [entry.folder.name for entry in entries]


@pytest.fixture
def index(study: Path) -> StudyIndex:
    index = StudyIndex.of_study(study)
    index.update()
    return index


def test_the_list_shows_what_heads_each_session(index: StudyIndex, study: Path) -> None:
    newest, _, oldest = index.sessions()
    assert names(index.sessions()) == ["c", "b", "a"]
    assert oldest.folder == study / "sessions" / "a"
    assert (oldest.participant, oldest.condition, oldest.trial, oldest.wizard) == ("P1", "humour", "3", "Mia")
    assert (oldest.scenario, newest.purpose) == ("Tour guide", "practice")
    assert oldest.duration_s == pytest.approx(60)
    assert oldest.started_utc < newest.started_utc
    assert oldest.size_bytes == sum(path.stat().st_size for path in oldest.folder.iterdir())
    assert (oldest.utterances, oldest.marks, oldest.problems) == (1, 0, 0)
    assert (study / DATABASE_NAME).exists()
    assert index.message == ""
    same = StudyIndex.of_study(study / "sessions")
    same.update()
    assert same.sessions() == index.sessions()
    assert [path.name for path in (study / "sessions").iterdir() if path.is_file()] == []


def test_filters_compare_whole_fields_in_any_case(index: StudyIndex) -> None:
    assert names(index.sessions(SessionQuery(participant="p1"))) == ["a"]
    assert names(index.sessions(SessionQuery(participant="P1*"))) == ["b", "a"]
    assert names(index.sessions(SessionQuery(condition="humour"))) == ["c", "a"]
    assert names(index.sessions(SessionQuery(condition="humour", purpose="practice"))) == ["c"]
    assert names(index.sessions(SessionQuery(scenario="tour*", wizard="mia"))) == ["c", "b", "a"]
    assert names(index.sessions(SessionQuery(participant="P[1]"))) == []
    assert names(index.sessions(SessionQuery(text="kitchen", condition="neutral"))) == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("kitchen", ["a"]),
        ("KITCH", ["a"]),
        ("is where", ["a"]),
        ("kuche", ["b"]),
        ("Küche", ["b"]),
        ('"stop"', ["c"]),
        ('"', []),
        ("AND", ["c"]),
        ("the", ["b", "a"]),
        ("stop OR kitchen", []),
        ("NEAR(kitchen", []),
        ("-kitchen", ["a"]),
        ("text:kitchen", []),
        ("*", []),
        ("'; DROP TABLE session; --", []),
        ("P10", ["b"]),
        ("\ud800kitchen", ["a"]),
        ("kit\0chen", []),
        ("kitchen " * 300, ["a"]),
    ],
)
def test_plain_words_find_utterances(index: StudyIndex, text: str, found: list[str]) -> None:
    hits = index.search(SessionQuery(text=text))
    assert list(dict.fromkeys(hit.folder.name for hit in hits)) == found
    assert names(index.sessions(SessionQuery(text=text))) == found


def test_utterances_notes_and_marks_are_found_at_their_times(tmp_path: Path) -> None:
    long = "and so on " * 30
    folder = tell(
        tmp_path / "sessions" / "s",
        [
            *said(1, 1.0, 2.0, 4.0, "Robots like bananas"),
            *heard(2, 5.0, 6.5, f"{long} pineapple {long}"),
            exchange(3, 7.0, 9.0, "Cherries are red."),
            Marked(at(12), "Interested", mark_id="m", note="in damsons", start_ns=at(10)),
            Marked(at(13), "Interested", mark_id="w", state="open"),
            Marked(at(14), "elderberry", mark_id="w", state="withdrawn"),
            Problem(at(15), "warning", "No figs.", "Nothing to eat.", "Buy some."),
            UtteranceChanged(at(16), "u-9", "robot", "grapes, never said", "typed", "requested"),
            *heard(4, 20.0, 21.0, "我喜欢橘子"),
        ],
        lasts_s=30,
    )
    coded = AnnotationDocument((Tier("t", "Gaze", "Ann"),), (), (Annotation("x", "t", 2500, 3000, "honeydew"),))
    save_coder(folder, coded, "Ann")
    index = StudyIndex.of_study(tmp_path)
    index.update()
    found = {
        text: [(hit.kind, hit.session_s) for hit in index.search(SessionQuery(text=text))]
        for text in ("banana", "pineapple", "cherries", "damson", "elderberry", "figs", "grapes", "honeydew", "橘子")
    }
    assert found == {
        "banana": [("robot", 2.0)],
        "pineapple": [("participant", 5.0)],
        "cherries": [("assistant", 7.0)],
        "damson": [("mark", 10.0)],
        "elderberry": [],
        "figs": [("problem", 15.0)],
        "grapes": [],
        "honeydew": [("annotation", 2.5)],
        "橘子": [("participant", 20.0)],
    }
    (hit,) = index.search(SessionQuery(text="pineapple"))
    assert hit.at_ns == at(5.0)
    assert "pineapple" in hit.snippet
    assert hit.snippet.startswith("…")
    assert hit.snippet.endswith("…")
    assert len(hit.snippet) < 170
    (entry,) = index.sessions()
    assert (entry.utterances, entry.marks, entry.problems) == (3, 1, 1)


def test_only_what_changed_is_read_again(index: StudyIndex, study: Path) -> None:
    steps: list[float] = []
    index.update(steps.append)
    assert steps == [0.0, 1.0]
    session(study / "sessions" / "d", "Something new", later_s=9000)
    shutil.rmtree(study / "sessions" / "a")
    shutil.rmtree(study / "sessions" / "b")
    session(study / "sessions" / "b", "Something else", later_s=3600)
    steps.clear()
    index.update(steps.append)
    assert steps == [0.0, 0.5, 1.0, 1.0]
    assert names(index.sessions()) == ["d", "c", "b"]
    assert names(index.sessions(SessionQuery(text="something"))) == ["d", "b"]
    assert index.search(SessionQuery(text="kitchen kuche")) == ()


def test_a_session_that_is_being_recorded_is_read_when_new_and_when_it_has_ended(study: Path) -> None:
    folder = session(study / "sessions" / "now", "Before", closed=False, later_s=9000)
    with hold(folder):
        index = StudyIndex.of_study(study)
        index.update()
        assert names(index.sessions(SessionQuery(text="before"))) == ["now"]
        longer = session(study / "longer", "Before", "After", closed=False, later_s=9000)
        (folder / "events.mcap").write_bytes((longer / "events.mcap").read_bytes())
        index.update()
        assert index.sessions(SessionQuery(text="after")) == ()
    index.update()
    assert names(index.sessions(SessionQuery(text="after"))) == ["now"]


def test_a_cancelled_update_keeps_what_was_read(study: Path) -> None:
    index = StudyIndex.of_study(study)

    class Cancelled(Exception):  # noqa: N818 - like KeyboardInterrupt
        pass

    def cancel(fraction: float) -> None:
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        index.update(cancel)
    assert names(index.sessions()) == ["b", "a"]
    index.update()
    assert names(index.sessions()) == ["c", "b", "a"]


@pytest.mark.logs(r"session\.session_header: ")
def test_sessions_that_cannot_be_read_are_reported_and_no_session_is_touched(study: Path) -> None:
    sessions_dir = study / "sessions"
    session(sessions_dir / "cut", "Cut off here", closed=False)
    (sessions_dir / "broken").mkdir()
    (sessions_dir / "broken" / "session.json").write_text("{")
    (sessions_dir / "empty").mkdir()
    (sessions_dir / "file").write_text("")
    before = {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in sessions_dir.rglob("*")}
    index = StudyIndex.of_study(study)
    index.update()
    index.rebuild()
    assert {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in sessions_dir.rglob("*")} == before
    (cut,) = [entry for entry in index.sessions() if entry.folder.name == "cut"]
    assert not cut.closed_properly
    assert names(index.sessions(SessionQuery(text="cut off"))) == ["cut"]
    (broken,) = index.unreadable()
    assert broken.folder.name == "broken"
    assert "damaged" in broken.trouble
    with pytest.raises(OSError, match="nowhere"):
        StudyIndex(study / "nowhere", study / "other.sqlite").update()


def overwrite(path: Path) -> None:
    path.write_bytes(b"no database at all" * 1000)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])


def scribble(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096:] = os.urandom(len(content) - 4096)
    path.write_bytes(content)


def make_older(path: Path) -> None:
    with sqlite3.connect(path) as database:
        database.execute("DROP TABLE item")
        database.execute("PRAGMA user_version = 0")


@pytest.mark.logs(r"studies\.study_index: ")
@pytest.mark.parametrize("damage", [overwrite, cut, scribble, make_older])
def test_a_damaged_or_older_index_is_made_again(index: StudyIndex, study: Path, damage: Callable[[Path], None]) -> None:
    before = answers(index)
    index.close()
    damage(study / DATABASE_NAME)
    index = StudyIndex.of_study(study)
    index.update()
    assert answers(index) == before
    index.close()
    again = StudyIndex.of_study(study)
    assert (again.message, answers(again)) == ("", before)


@pytest.mark.usefixtures("trial_language")
@pytest.mark.logs(r"studies\.study_index: ")
def test_a_database_of_something_else_is_left_alone(study: Path) -> None:
    path = study / DATABASE_NAME
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE people (name TEXT)")
    database.close()
    before = path.read_bytes()
    index = StudyIndex.of_study(study)
    index.update()
    assert len(index.sessions()) == 3
    assert "cannot be saved in" in index.message
    assert untranslated_part(lambda: tr(index.message)) == []
    assert path.read_bytes() == before


@pytest.mark.logs(r"studies\.study_index: ")
def test_a_locked_index_does_not_keep_anybody_from_finding(
    index: StudyIndex, study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("caris_desktop.recording.studies.study_index._BUSY_MS", 50)
    with sqlite3.connect(study / DATABASE_NAME, isolation_level=None) as other:
        other.execute("BEGIN EXCLUSIVE")
        second = StudyIndex.of_study(study)
        second.update()
        assert names(second.sessions(SessionQuery(text="kitchen"))) == ["a"]
        assert "locked" in second.message
        other.execute("ROLLBACK")
    assert names(index.sessions(SessionQuery(text="kitchen"))) == ["a"]


_FIND = """
import sys
from pathlib import Path
from caris_desktop.recording.studies.study_query import SessionQuery
from caris_desktop.recording.studies.study_index import StudyIndex
index = StudyIndex.of_study(Path(sys.argv[1]))
index.update()
print(len(index.sessions()), len(index.search(SessionQuery(text="kitchen"))), index.message)
"""


@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="mounts a read-only disk, which needs root")
@pytest.mark.parametrize("indexed", [False, True])
def test_a_read_only_study_is_searched_all_the_same(study: Path, *, indexed: bool) -> None:
    if indexed:
        index = StudyIndex.of_study(study)
        index.update()
        index.close()
        session(study / "sessions" / "d", "Another kitchen", later_s=9000)
    script = f'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" && exec "{sys.executable}" -c "$2" "$1"'
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", script, "sh", str(study), _FIND], capture_output=True, text=True, check=False
    )
    if "unshare" in done.stderr or "mount" in done.stderr.partition("\n")[0]:
        pytest.skip(f"no mount namespace here: {done.stderr}")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("4 2" if indexed else "3 1")
    assert "Choose a writable study folder" in done.stdout


@pytest.mark.usefixtures("trial_language")
def test_gaps_of_a_session_can_be_reported_in_another_language(study: Path) -> None:
    """Header and index contain plain English."""
    folder = study / "sessions" / "a"
    head = folder / "session.json"
    kept = "video-front.mp4 is missing: all 189 frames of camera front."
    head.write_text(json.dumps({**json.loads(head.read_text("utf-8")), "losses": [kept]}), "utf-8")
    for _ in range(2):  # from the folder, and then from the index
        index = StudyIndex.of_study(study)
        index.update()
        (found,) = (entry for entry in index.sessions() if entry.folder == folder)
        index.close()
        assert found.losses == (kept,)
        assert tr(found.losses[0]).startswith("[video-front.mp4 îš mîššîñğ: àll 189 fŕàméš")


def test_the_rebuilt_index_gives_the_same_answers(tmp_path: Path) -> None:
    make_study(tmp_path / "sessions", 12, minutes=1.5)
    index = StudyIndex.of_study(tmp_path)
    index.update()
    before = answers(index)
    assert len(before[0]) == 12
    assert any(before[1:])
    index.rebuild()
    assert answers(index) == before
    index.close()
    for path in tmp_path.glob(f"{DATABASE_NAME}*"):
        path.unlink()
    fresh = StudyIndex.of_study(tmp_path)
    fresh.update()
    assert answers(fresh) == before


def test_the_command_lists_and_searches(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    sessions_command.add_arguments(parser)

    def run(*words: str) -> tuple[int, str]:
        status = sessions_command.run(parser.parse_args([str(study), *words]))
        return status, capsys.readouterr().out

    status, out = run()
    assert status == 0
    assert "3 sessions" in out
    assert out.splitlines()[1].split()[2:4] == ["c", "P2"]
    status, out = run("--search", "kitchen")
    assert status == 0
    assert "0:01  participant: Where is the kitchen?" in out
    assert "1 place in 1 session" in out
    assert run("--participant", "P99") == (1, "No session matches.\n")
    assert run("--rebuild", "--condition", "neutral")[0] == 0
    assert sessions_command.run(parser.parse_args([str(study / "nowhere")])) == 1


def test_annotations_and_repairs_change_the_signature(study: Path) -> None:
    folder = study / "sessions" / "a"
    before = content_signature(folder)
    assert content_signature(folder) == before
    save_coder(folder, AnnotationDocument((Tier("t", "Gaze", "Ann"),)), "Ann")
    annotated = content_signature(folder)
    assert annotated != before
    head = json.loads((folder / "session.json").read_text())
    (folder / "session.json").write_text(json.dumps({**head, "reason": "recovered"}))
    assert content_signature(folder) != annotated


@pytest.mark.logs(r"studies\.study_index: ", r"session\.session_reader: ")
def test_one_tampered_session_is_the_trouble_of_that_session_alone(study: Path) -> None:
    asked = exchange(1, 1.0, 2.0, "the answer")
    tell(
        study / "sessions" / "bent", [replace(asked, parameters=cast("Any", "x")), *heard(1, 3, 4, "hello")], lasts_s=9
    )
    endless = session(study / "sessions" / "endless", "hello") / "session.json"
    head = json.loads(endless.read_text())
    head["clock"]["monotonic_ns"] += 2**70
    endless.write_text(json.dumps({**head, "started_ns": head["started_ns"] + 2**70}))
    listing = session(study / "sessions" / "listing", "hello") / "session.json"
    listing.write_text(json.dumps({**json.loads(listing.read_text()), "trial": {"participant": ["P", {}]}}))
    if sys.platform == "linux":
        shutil.copytree(study / "sessions" / "a", study / "sessions" / os.fsdecode(b"no\xfftext"))
    index = StudyIndex.of_study(study)
    index.update()
    assert sorted(names(index.sessions())) == ["a", "b", "bent", "c", "listing"]
    assert [one.folder.name for one in index.unreadable()] == ["endless"]
    assert {hit.folder.name for hit in index.search(SessionQuery("hello"))} == {"bent", "listing"}
    index.update()
    index.close()


@pytest.mark.logs(r"studies\.study_index: ")
def test_any_error_of_a_reader_leaves_the_rest_of_the_study(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(folder: Path, *, repair: bool) -> Any:
        if folder.name == "b":
            raise AttributeError("no such thing \ud800")
        return open_session(folder, repair=repair)

    monkeypatch.setattr(study_index, "open_session", read)
    index = StudyIndex.of_study(study)
    index.update()
    assert names(index.sessions()) == ["c", "a"]
    (trouble,) = index.unreadable()
    assert trouble.folder.name == "b"
    assert "See the log for details" in trouble.trouble
    index.close()


def test_all_places_are_counted_paged_and_reported_by_session(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sessions_dir = tmp_path / "study" / "sessions"
    for number, later_s in (("a", 0), ("b", 3600)):
        events = [
            value
            for turn in range(400)
            for value in heard(turn, turn * 0.1 + 1.0, turn * 0.1 + 1.05, f"The robot says {turn}")
        ]
        tell(sessions_dir / number, events, lasts_s=60, trial={**TRIAL}, later_s=later_s)
    session(sessions_dir / "c", "Nothing of it", later_s=7200)
    index = StudyIndex.of_study(tmp_path / "study")
    index.update()
    query = SessionQuery(text="robot")
    assert index.places(query) == {sessions_dir / "b": 400, sessions_dir / "a": 400}
    pages = [index.search(query), index.search(query, after=500)]
    assert [len(page) for page in pages] == [500, 300]
    assert len({(hit.folder, hit.at_ns) for page in pages for hit in page}) == 800
    assert len(index.search(replace(query, places=1000))) == 800
    index.close()
    parser = argparse.ArgumentParser()
    sessions_command.add_arguments(parser)
    assert sessions_command.run(parser.parse_args([str(tmp_path / "study"), "--search", "robot"])) == 0
    first = capsys.readouterr().out.splitlines()
    assert first[-1] == "800 places in 2 sessions; places 1 to 500 are shown (--page 1 of 2)"
    assert [line.split("  ")[0] for line in first if not line.startswith(" ")][:2] == ["b", "a"]
    assert any(line.startswith("a") and line.endswith(": 400 places, from page 1") for line in first)
    assert sessions_command.run(parser.parse_args([str(tmp_path / "study"), "--search", "robot", "--page", "2"])) == 0
    second = capsys.readouterr().out.splitlines()
    assert second[-1] == "800 places in 2 sessions; places 501 to 800 are shown (--page 2 of 2)"
    assert any(line.startswith("b") and line.endswith(": 400 places, from page 1") for line in second)


def test_a_prompt_that_quotes_a_sentence_is_folded_into_it(tmp_path: Path) -> None:
    asked = "Participant: Do you like bananas?\nAnswer to: We said: Do you like bananas? is a question of cherries."
    prompts = [
        replace(exchange(number, 7.0 + number, 9.0 + number, "Yes, and figs."), messages=(ChatMessage("user", asked),))
        for number in range(3)
    ]
    tell(tmp_path / "sessions" / "s", [*heard(1, 2.0, 4.0, "Do you like  bananas?"), *prompts], lasts_s=30)
    index = StudyIndex.of_study(tmp_path)
    index.update()
    (hit,) = index.search(SessionQuery(text="like bananas"))
    assert (hit.kind, hit.quoted) == ("participant", 3)
    assert len(index.search(SessionQuery(text="cherries"))) == 3, "what else is asked is found"
    assert len(index.search(SessionQuery(text="figs"))) == 3
    index.close()
