"""Verification of a new recording: read back, replayed and exported to every format."""

from collections import Counter
from pathlib import Path

from caris_desktop.domain.streams import BY_NAME, STATE_STREAMS, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_reader import Session, SessionError, open_session
from caris_desktop.recording.session_export import FORMATS, ExportContext, ExportError, export_session

_OF_FORMAT = QT_TR_NOOP("Export as {format}: {told}")


class ReadBack(Value):
    """Sentences: results ``found``, and ``problems``; without problems the session is complete."""

    found: tuple[str, ...]
    problems: tuple[str, ...]


def read_back(folder: Path, exports: Path) -> ReadBack:
    """Read the closed session in ``folder`` in every supported way; each format has a folder in ``exports``."""
    found: list[str] = []
    problems: list[str] = []
    try:
        session = open_session(folder)
        read = Counter(spec.name for spec, _ in session.values())
        problems += [*session.notices, *session.losses, *_missing(session, read), *_not_replayed(session, read)]
    except SessionError as error:
        return ReadBack((), (str(error),))
    found.append(f"{read.total()} values from {len(read)} streams read back, {session.duration_s:.0f} s replayed.")
    written: list[str] = []
    for each in FORMATS:
        notes: list[str] = []
        try:
            export_session(folder, each.name, exports / each.name, ExportContext(warn=notes.append))
            written.append(each.name)
        except ExportError as error:
            problems.append(localized(_OF_FORMAT, format=each.name, told=localized(str(error))))
        found += [localized(_OF_FORMAT, format=each.name, told=note) for note in dict.fromkeys(notes)]
    return ReadBack((*found, f"Exported formats: {', '.join(written) or 'none'}."), tuple(problems))


def _missing(session: Session, read: Counter[str]) -> list[str]:
    """Streams with more or fewer values in the record than the recorder counted."""
    counted = Counter({name: count for name, count in session.header.counts.items() if name in BY_NAME})
    if not counted:
        return ["The recorder counted no values, so it is unknown whether the recording is complete."]
    return [
        f"{read[name]} of {counted[name]} values of {name} can be read."
        for name in sorted(counted | read)
        if counted[name] != read[name]
    ]


def _not_replayed(session: Session, read: Counter[str]) -> list[str]:
    with SessionTimeline(session) as timeline:
        shown_types = {type(value) for value in timeline.state_at(timeline.end_ns)}
    expected = [spec for spec in STATE_STREAMS if spec.delivery is Delivery.LATEST and read[spec.name]]
    lost = [spec.name for spec in expected if spec.value_type not in shown_types]
    return [f"Missing in the replay: {', '.join(lost)}."] if lost else []
