"""WebVTT captions (https://www.w3.org/TR/webvtt1/) of each video in video time, and of the session in session time.

Players find the captions of ``video-NAME.mp4`` in ``video-NAME.vtt`` in the same folder.
"""

import re
from collections.abc import Iterable
from pathlib import Path, PurePath

from caris_desktop.recording.session.media_files import moments_words
from caris_desktop.recording.session.session_conversation import SpokenUtterance
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_header import VideoInfo
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.catalog import one_line, plain_text

# Of heard speech, often only the time of recognition is known.
_MOMENT_SHOWN_NS = 2_000_000_000
_SPEAKERS = {"robot": "Robot", "participant": "Participant", "wizard": "Wizard", "": "Somebody"}


def write_vtt(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    utterances = [utterance for utterance in spoken(session) if utterance.said]
    context.progress(0.7)
    last_ns = max([session.ended_ns, *(utterance.end_ns or 0 for utterance in utterances)])
    session_video = VideoInfo("", "", first_stamp_ns=session.started_ns, last_stamp_ns=last_ns)
    paths = [_write(out / "captions.vtt", session, session_video, utterances)]
    for speaker in _SPEAKERS:
        theirs = [utterance for utterance in utterances if utterance.speaker == speaker]
        if theirs:
            paths.append(_write(out / f"captions-{speaker or 'somebody'}.vtt", session, session_video, theirs))
    taken = {path.name for path in paths}
    for video in session.header.videos:
        stem = PurePath(video.file_name).stem
        if stem and video.last_stamp_ns >= video.first_stamp_ns:
            name = f"{stem}.vtt" if f"{stem}.vtt" not in taken else f"video-{stem}.vtt"
            taken.add(name)
            paths.append(_write(out / name, session, video, utterances))
    context.progress(1.0)
    return paths


def _write(path: Path, session: Session, video: VideoInfo, utterances: Iterable[SpokenUtterance]) -> Path:
    name = _line(session.folder.name)
    if video.file_name:
        begins_s = session.clock.session_s(video.first_stamp_ns)
        note = (
            f"Times are relative to the first frame of {_line(video.file_name)}, at second {begins_s:.3f} of {name}. "
            f"{moments_words(video)}"
        )
    else:
        note = f"Times are relative to the start of the session {name}, at {session.clock.utc(session.started_ns)}."
    blocks = ["WEBVTT", f"NOTE {note}"]
    cues = [cue for utterance in utterances if (cue := _cue(utterance, video)) is not None]
    blocks += [text for _, text in sorted(cues, key=lambda cue: cue[0])]
    path.write_text("\n\n".join(blocks) + "\n", encoding="utf-8", newline="\n")
    return path


def _cue(utterance: SpokenUtterance, video: VideoInfo) -> tuple[int, str] | None:
    """Start time and text of a cue; None if the video does not cover it."""
    start_ns, end_ns = utterance.start_ns or 0, utterance.end_ns or utterance.start_ns or 0
    if end_ns == start_ns:
        end_ns = start_ns + _MOMENT_SHOWN_NS
    if end_ns <= video.first_stamp_ns or start_ns > video.last_stamp_ns:
        return None
    start_ms = round(max(0, start_ns - video.first_stamp_ns) / 1e6)
    end_ms = max(start_ms + 1, round((end_ns - video.first_stamp_ns) / 1e6))
    # Interrupted speech gets a class for style sheets; the text stays the intended one.
    cut_short = ".interrupted" if utterance.state == "interrupted" else ""
    identifier = re.sub(r"[^\w.:-]+", "-", plain_text(utterance.utterance_id)).replace("-->", "") or "u"
    speaker = _SPEAKERS.get(utterance.speaker, utterance.speaker.capitalize())
    text = f"<v{cut_short} {_escaped(speaker)}>{_escaped(_line(utterance.text))}"
    note = ""
    if utterance.heard_text is not None:
        note = f"NOTE {identifier} was corrected. Original transcript: {_line(utterance.heard_text)}\n\n"
    return start_ms, f"{note}{identifier}\n{_time(start_ms)} --> {_time(end_ms)}\n{text}"


def _time(milliseconds: int) -> str:
    seconds, milliseconds = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}.{milliseconds:03d}"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _line(text: str) -> str:
    """Single line without characters that break a cue; an empty line would end it."""
    return one_line(text).replace("-->", "->")
