"""Erasure of a person's speech, and of unattributed speech during the presence."""

import re
import wave
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.recording.forgetting.erasure_files import OwnFiles
from caris_desktop.recording.forgetting.person_tracks import messages_of
from caris_desktop.recording.forgetting.study_erasure import ForgetRequest, Forgotten, forget_person, receipt_words
from caris_desktop.recording.forgetting.text_erasure import FORGOTTEN, Sentences, read_review
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import ExportRequest, export_all
from tests.recording.forgetting.test_study_erasure import receipt_of, sessions_of
from tests.support import recorded_session
from tests.support.recorded_session import SessionPlan, make_session

LONG, SHORT = "My grandmother had a parrot of that colour.", "Yes."
ROBOT = "What would you like to see?"
UTTERANCES = (("participant", LONG), ("robot", ROBOT), ("participant", SHORT))


def make(folder: Path, *, people: int, seed: int = 1) -> Path:
    plan = SessionPlan(
        seconds=13.0, cameras=("front",), fps=3.0, size_px=(160, 90), scans_hz=1.0, beams=10, odometry_hz=2.0,
        people=people, people_hz=5.0, utterance_every_s=2.5, person_every_s=0.0, photo_every_s=0.0, map_cells=(5, 5),
        llm_every_s=4.0, seed=seed,
    )  # fmt: skip
    with mock.patch.object(recorded_session, "UTTERANCES", UTTERANCES):
        make_session(folder, plan)
    return folder


@pytest.fixture
def alone(tmp_path: Path) -> Path:
    study = tmp_path / "study"
    make(study / "sessions" / "2026-11-20_10-00-00_P01", people=1)
    return study


@pytest.fixture
def two(tmp_path: Path) -> Path:
    study = tmp_path / "study"
    make(study / "sessions" / "2026-11-20_10-00-00_P01", people=2)
    return study


def forget(study: Path, **fields: object) -> Forgotten:
    return forget_person(ForgetRequest(study, ("p-1",), **fields), lambda: None)  # type: ignore[arg-type]


def decide(study: Path, review: Path, decision: str) -> Forgotten:
    review.write_text(
        re.sub(r"^\?", decision, review.read_text(encoding="utf-8"), flags=re.MULTILINE), encoding="utf-8"
    )
    decided = read_review(review)
    return forget(study, decisions=decided.decisions, only_texts=True, review=review)


def samples(folder: Path, source: str = "microphone") -> NDArray[np.int16]:
    with wave.open(str(folder / f"audio-{source}.wav")) as file:
        return np.frombuffer(file.readframes(file.getnframes()), "<i2")


def texts_in(folder: Path) -> str:
    events = b"\n".join(data for _, data in messages_of(folder / "events.mcap", lambda _topic: True))
    plain = [path for path in folder.rglob("*") if path.suffix in (".txt", ".json", ".csv")]
    return events.decode() + "\n".join(path.read_text(encoding="utf-8") for path in plain)


def participants(session: Session) -> list[str]:
    return [one.text for one in spoken(session) if one.speaker == "participant"]


def test_voice_and_words_of_who_was_alone_there_are_gone(alone: Path) -> None:
    (folder,) = sessions_of(alone)
    before, session = samples(folder), open_session(folder)
    assert {one.person_id for one in spoken(session) if one.speaker == "participant"} == {"p-1"}
    assert LONG in texts_in(folder)
    assert forget(alone).complete
    after = samples(folder)
    assert len(after) == len(before)
    assert np.abs(before).max() > 1000
    assert not after.any()
    robot = samples(folder, "robot-voice")
    assert np.abs(robot).max() > 1000
    left = texts_in(folder)
    assert LONG not in left
    assert f": {SHORT}  [" not in left
    assert f'"{SHORT}"' not in left
    assert ROBOT in left
    session = open_session(folder)
    assert set(participants(session)) == {FORGOTTEN}
    assert session.losses == ()
    assert verify_manifest(folder) == []
    told = receipt_of(alone)["utterances"]
    assert told["theirs_removed"] == len(participants(session))
    assert told["nobodys_waiting"] == 0
    assert "utterances by this person" in receipt_words(alone / "forgotten" / "RECEIPT.json")


def test_an_utterance_of_unknown_speaker_waits_for_a_decision(two: Path) -> None:
    (folder,) = sessions_of(two)
    before = samples(folder)
    outcome = forget(two)
    assert not outcome.complete
    assert outcome.review is not None
    listed = outcome.review.read_text(encoding="utf-8")
    assert LONG in listed
    assert SHORT in listed
    said = receipt_of(two)["utterances"]
    assert said["nobodys_waiting"] == outcome.waiting == len(participants(open_session(folder)))
    # Until then they are audible, and nothing else from the time of the presence.
    after = samples(folder)
    assert 0.2 < (after != before).mean() < 0.9
    assert np.abs(after).max() > 1000
    assert decide(two, outcome.review, "redact").complete
    assert not samples(folder).any()
    assert LONG not in texts_in(folder)
    assert set(participants(open_session(folder))) == {FORGOTTEN}


@pytest.mark.long
def test_speech_of_others_stays(two: Path) -> None:
    (folder,) = sessions_of(two)
    outcome = forget(two)
    before = texts_in(folder)
    assert outcome.review is not None
    assert decide(two, outcome.review, "keep").complete
    assert LONG in before
    assert LONG in texts_in(folder)
    assert np.abs(samples(folder)).max() > 1000
    assert receipt_of(two)["utterances"]["nobodys_kept"] > 0


def test_sentences_leave_exports_notes_logs_and_other_files(alone: Path) -> None:
    folder = sessions_of(alone)[0]
    stranger = make(alone / "sessions" / "2026-12-20_10-00-00_P02", people=0, seed=2)
    export_all(
        ExportRequest((folder,), ("csv", "vtt", "eaf"), alone / "exports" / folder.name, folder_per_session=False)
    )
    (alone / "notes.txt").write_text(f"They said: {LONG}\nGood.\n", encoding="utf-8")
    own = alone.parent / "own"
    own.mkdir()
    log = own / "console.log"
    log.write_text(f"INFO heard {LONG}\n", encoding="utf-8")
    theirs = texts_in(stranger)
    outcome = forget(alone, own_files=OwnFiles(logs=own, others=(own,)))
    assert outcome.left == ()
    left = [path.relative_to(alone).as_posix() for path in (alone / "exports").rglob("*") if path.is_file()]
    assert left == []
    assert (alone / "notes.txt").read_text(encoding="utf-8") == f"They said: {FORGOTTEN}\nGood.\n"
    assert LONG not in log.read_text(encoding="utf-8")
    # Another person said the same in another session.
    assert LONG in theirs
    assert texts_in(stranger) == theirs
    assert receipt_of(alone)["search_after"]["sentences"] == 0


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ('{"text":"Yes.","who":"x"}', '{"text":"[forgotten]","who":"x"}'),
        ("12:00 participant: Yes.  [heard]\n", "12:00 participant: [forgotten]  [heard]\n"),
        ("Yes. But not here.\n", "Yes. But not here.\n"),
        ("a,Yes.,b\n", "a,[forgotten],b\n"),
        ("Yes.\n", "[forgotten]\n"),
        ("Schöne Grüße an alle!", "[forgotten]!"),
        ('"Sch\\u00f6ne Gr\\u00fc\\u00dfe an alle"', '"[forgotten]"'),
        ("Sch\u00f6ne\nGrüße an  alle", "[forgotten]"),
    ],
)
def test_a_short_sentence_goes_where_it_stands_alone_and_a_long_one_everywhere(text: str, left: str) -> None:
    changed = text
    for start, end in reversed(list(Sentences(("Yes.", "Schöne Grüße an alle")).spans(text))):
        changed = changed[:start] + FORGOTTEN + changed[end:]
    assert changed == left
