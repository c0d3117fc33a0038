"""Erasure of a person named in a rehearsal: no data remains in study, home or temporary folder."""

import hashlib
import os
import re
import sqlite3
import subprocess
import sys
import wave
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from caris_desktop.people.people_store import PeopleStore
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_reader import open_session

NAME = "Philippa Quartermaine"
_VOICE_SAMPLES = 400
_LOUD = 1_000
_DIGEST = re.compile(rb"[0-9a-f]{64}")


def _run(environment: dict[str, str], *words: str | Path, timeout_s: float = 600.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *words], capture_output=True, text=True, env=environment, timeout=timeout_s, check=False
    )


def _bytes_in(folders: list[Path]) -> Iterator[tuple[str, bytes]]:
    """Names and contents of all files, and decompressed data of recordings."""
    for path in (path for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()):
        yield f"the name of {path}", str(path).encode()
        content = path.read_bytes()
        yield str(path), content
        if content.startswith(b"\x89MCAP"):
            with path.open("rb") as file:
                yield f"messages of {path}", b"\n".join(m.data for _, _, m in make_reader(file).iter_messages())


def _found(folders: list[Path], terms: dict[str, list[bytes]]) -> set[tuple[str, str]]:
    return {
        (what, where)
        for where, content in _bytes_in(folders)
        for what, pieces in terms.items()
        for piece in pieces
        if piece in content
    }


def _voice(folder: Path) -> list[bytes]:
    """Loud parts of participants' speech."""
    session = open_session(folder)
    pieces = []
    for path in folder.glob("audio-*.wav"):
        with wave.open(str(path)) as file:
            samples, rate_hz = np.frombuffer(file.readframes(file.getnframes()), "<i2"), file.getframerate()
        if "voice" in path.name:
            continue
        for one in (one for one in spoken(session) if one.speaker == "participant" and one.end_ns is not None):
            first = round((one.start_ns - session.started_ns) * rate_hz / 1e9)
            for at in range(max(0, first), min(first + 4 * rate_hz, len(samples) - _VOICE_SAMPLES), 4_000):
                piece = samples[at : at + _VOICE_SAMPLES]
                if np.abs(piece).max() > _LOUD:
                    pieces.append(piece.tobytes())
    return pieces


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_no_byte_of_who_was_forgotten_is_left_after_a_rehearsal(tmp_path: Path) -> None:
    home, temporary, out = tmp_path / "home", tmp_path / "tmp", tmp_path / "out"
    home.mkdir()
    temporary.mkdir()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("XDG_")}
    environment |= {"HOME": str(home), "TMPDIR": str(temporary)}
    late = "tests.support.run_module"
    done = _run(environment, late, "tests.app.naming_rehearsal", NAME, "tour-guide", "--out", out)
    assert done.returncode == 0, done.stdout + done.stderr
    study = out / "study"
    (folder,) = (study / "sessions").iterdir()
    with closing(PeopleStore(study / "people.sqlite")) as store:
        (person,) = (each for each in store.everybody() if each.about.name == NAME)
        portrait = store.portrait(person.person_id)
        assert portrait is not None
        looks = [row.tobytes() for each in store.embeddings(person_id=person.person_id) for row in each.vectors]
    with closing(sqlite3.connect(study / "people.sqlite")) as database:
        query = "SELECT jpeg FROM portraits WHERE person_id = ?"
        (sealed,) = database.execute(query, (person.person_id,)).fetchone()
    sentences = [
        one.text for one in spoken(open_session(folder)) if one.speaker == "participant" and len(one.text) > 12
    ]
    terms = {
        "name": [part.encode(code) for part in (NAME, *NAME.split()) for code in ("utf-8", "utf-16-le", "utf-16-be")],
        "portrait": [portrait[at : at + 32] for at in range(len(portrait) // 3, len(portrait) - 32, 200)],
        "sealed portrait": [sealed[at : at + 32] for at in range(0, len(sealed) - 32, 200)],
        "looks": [look[:32] for look in looks],
        "sentence": [text.encode() for text in sentences],
        "voice": _voice(folder),
    }
    found = {what: len(pieces) for what, pieces in terms.items()}
    assert found["name"] and found["sentence"] and found["voice"] and found["portrait"], found
    terms = {what: pieces for what, pieces in terms.items() if pieces}
    everywhere = [study, home, temporary]  # exports to other folders are out of reach
    before = _found(everywhere, terms)
    there = {what for what, _where in before}
    assert there >= {"name", "sentence", "voice", "sealed portrait"}, "there is something to find"
    assert "portrait" not in there, "it is only stored encrypted"

    program = "caris_desktop"
    done = _run(environment, program, "forget", study, NAME, "--text", "redact", "--yes")
    reviews = list((study / "forgotten").glob("review-*.txt"))
    for review in reviews:
        decided = re.sub(r"^\?", "redact", review.read_text("utf-8"), flags=re.MULTILINE)
        review.write_text(decided, "utf-8")
        done = _run(environment, program, "forget", study, person.person_id, "--yes", "--review", review)
    assert done.returncode == 0, done.stdout + done.stderr
    assert _found(everywhere, terms) == set()

    left = b"\n".join(content for _where, content in _bytes_in(everywhere))
    digests = set(_DIGEST.findall(left))
    assert digests, "those of what is there now"
    guesses = [NAME, *NAME.split(), *(f"Guess {number}" for number in range(10_000))]
    texts = ("{}", "{}\n", '"{}"', "Nice to meet you, {}.", "{} came by bicycle.", '"Nice to meet you, {}."\n')
    for guess in guesses:
        for text in texts:
            assert hashlib.sha256(text.format(guess).encode()).hexdigest().encode() not in digests, guess
