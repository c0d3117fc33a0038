"""``caris-desktop transcribe-again``: what participants said, transcribed by another model from the recorded sound."""

import argparse
import functools
import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.engines import LocalEngine, NoEngineError
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.resampling import resampled
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES
from caris_desktop.live.study_jobs import JobError, add_session_arguments, run_over_sessions
from caris_desktop.recording.csv_cells import SHOWN
from caris_desktop.recording.session.media_files import wav_layout
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_header import AudioInfo, SessionError, inside
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import Progress
from caris_desktop.recording.table_files import transcripts_folder

_RATE_HZ = 16_000
_AROUND_NS = 300_000_000  # the ends of a turn cut off its first and last sounds
_COLUMNS = ("utterance_id", "session_s", "end_session_s", "recorded_text", "text", "confidence")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session_arguments(parser)
    parser.add_argument("--model", metavar="FOLDER", type=Path, help="faster-whisper model (default: the console's)")
    parser.add_argument(
        "--language", metavar="CODE", default="", help="language of the participants (default: heard by the model)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print a JSON object per session on standard output; exit status 1 if any failed."""
    return run_over_sessions(_transcribe_or_explain, arguments)


def _transcribe_or_explain(arguments: argparse.Namespace, folder: Path, progress: Progress) -> dict[str, object]:
    try:
        return _transcribe(arguments, open_session(folder, repair=False), progress)
    except SessionError as error:
        raise JobError(str(error)) from error
    except NoEngineError as error:
        raise JobError(f"{error} {error.advice}") from error
    except OSError as error:
        raise JobError(f"the transcript could not be made: {error.strerror or error}. Nothing was saved.") from error


_open_engine = functools.lru_cache(maxsize=1)(LocalEngine)  # for all sessions of a process


def _transcribe(arguments: argparse.Namespace, session: Session, progress: Progress) -> dict[str, object]:
    model = "" if arguments.model is None else str(arguments.model.absolute())
    engine = _open_engine(
        RecogniserSettings(model=model, language=arguments.language, threads=arguments.threads, allow_download=False)
    )
    name = re.sub(r"[^A-Za-z0-9.-]+", "-", f"{engine.model}-{engine.language}").strip(".-")
    target = transcripts_folder(session.folder) / f"{name}.csv"
    about: dict[str, object] = {"session": session.folder.name, "model": engine.model, "file": str(target)}
    if target.exists():
        return {**about, "made_before": True}
    heard = [one for one in spoken(session) if one.origin == "heard" and one.said and one.end_ns is not None]
    text = io.StringIO(newline="")
    writer, transcribed = SHOWN.writer(text), 0
    writer.writerow(_COLUMNS)
    for number, utterance in enumerate(heard):
        progress(number / len(heard), session.folder.name)
        start_ns, end_ns = utterance.start_ns or 0, utterance.end_ns or 0
        if (sound := _sound(session, start_ns - _AROUND_NS, end_ns + _AROUND_NS)) is None:
            continue
        words = engine.transcribe(sound, "", careful=True, voice_s=len(sound) / _RATE_HZ).words
        writer.writerow(
            (
                utterance.utterance_id,
                round(session.clock.session_s(start_ns), 3),
                round(session.clock.session_s(end_ns), 3),
                utterance.text if utterance.heard_text is None else utterance.heard_text,
                " ".join(word.text for word in words),
                round(float(np.mean([word.probability for word in words])), 3) if words else "",
            )
        )
        transcribed += 1
    if not transcribed:
        raise JobError("the session has no recorded speech of participants.")
    target.parent.mkdir(parents=True, exist_ok=True)
    replace_file(target, text.getvalue().encode(), durable=False)
    return {**about, "utterances": len(heard), "without_sound": len(heard) - transcribed}


def _sound(session: Session, start_ns: int, end_ns: int) -> NDArray[np.float32] | None:
    """Sound of the participant's microphone, 16 kHz mono; None if it was not recorded."""
    for source in PARTICIPANT_SOURCES:
        for audio in session.header.audio:
            covers = audio.source == source and audio.first_stamp_ns < end_ns and start_ns < audio.last_stamp_ns
            if covers and inside(session.folder, audio.file_name) and (session.folder / audio.file_name).is_file():
                return _part(session.folder / audio.file_name, audio, start_ns, end_ns)
    return None


def _part(path: Path, audio: AudioInfo, start_ns: int, end_ns: int) -> NDArray[np.float32] | None:
    with path.open("rb") as file:
        try:
            wav = wav_layout(file)
        except ValueError:
            return None
        first, last = (
            max(0, round((at - audio.first_stamp_ns) * wav.sample_rate_hz / 1e9)) for at in (start_ns, end_ns)
        )
        file.seek(wav.offset_bytes + first * wav.frame_bytes)
        data = file.read((last - first) * wav.frame_bytes)
    samples = np.frombuffer(data[: len(data) // wav.frame_bytes * wav.frame_bytes], "<i2").reshape(-1, wav.channels)
    mono = (samples.mean(axis=1) / 32768).astype(np.float32)
    return resampled(mono, wav.sample_rate_hz, _RATE_HZ) if len(mono) else None
