"""Golden outputs of all export formats for three fixture sessions: a tour, one with every stream, one cut off.

For sessions in which definitions of measures differ most easily (slow and rare commands, recognised people, suggested
replies, two scenarios of one title) and for a rehearsal: those of the tables, tiers, texts and statistics. For a study
of several, by two wizards of whom one had practised: the methods sheet.

``python -m tests.recording.golden_exports`` updates them; the diff of the commit shows the changes for readers of
exports. Text files are stored completely; other files as the values that a reader gets.
"""

import json
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import av
import pyarrow.parquet
from mcap.reader import make_reader

from caris_desktop import __version__
from caris_desktop.domain.events import (
    AnswerUsed,
    CommandSent,
    Marked,
    PersonAppeared,
    PersonIdentified,
    PersonLeft,
    PlannedStep,
    PracticeEnded,
    ProtocolOpened,
    RecordingPaused,
    ResponseTimed,
    ScenarioOpened,
    StepEntered,
    SuggestionChanged,
    SuggestionState,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.recording.session_export import FORMATS, ExportContext, ExportRequest, export_all, export_session
from caris_desktop.recording.studies.statistics import study_statistics
from tests.recording.told_session import STEPS, at, drive, exchange, heard, said, tell, tour
from tests.support.recorded_session import make_session

GOLDEN = Path(__file__).parent / "golden"
_REHEARSAL = Path(__file__).parents[2] / "examples" / "study" / "sessions" / "2026-11-27_13-20-36_P01"
_MEASURED = ("creeping", "seldom", "people", "suggestions", "titles", "rehearsal")
_STUDY = "study"
_MEASURED_FORMATS = ("csv", "eaf", "textgrid", "vtt", "html", "methods")
SESSIONS = ("tour", "whole", "killed", *_MEASURED, _STUDY)
# Those of the other sessions show them.
_NOT_MEASURED = ("methods.html", "data_dictionary.csv")
_STYLE = re.compile(r"<style>.*?</style>", re.DOTALL)
_TEXT = {".csv", ".eaf", ".html", ".json", ".jsonl", ".md", ".TextGrid", ".txt", ".vtt", ".yaml"}
# Longer ones are stored as a digest.
_LONGEST_TEXT_BYTES = 45_000
# Export time; sizes and digests of data whose compression depends on library versions.
_CHANGING = (
    (re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:\d\d)"), "MOMENT"),
    (re.compile(r"urn:[\w:/.-]*[0-9a-f-]{36}"), "URN"),
    (re.compile(r"\b[0-9a-f]{64}\b"), "DIGEST"),
    (re.compile(r'("bytes": |"contentSize": "|class="number">)[\d.]+'), r"\1SIZE"),
)


def make(name: str, folder: Path) -> Path:
    """One of the fixture sessions, always the same."""
    if name == "tour":
        return tell(folder, tour(3, minutes=1.0, state_hz=1.0, building=False), lasts_s=60.0)
    if name == "rehearsal":
        shutil.copytree(_REHEARSAL, folder)
        return folder
    if name in _MEASURED:
        return _told(name, folder)
    few = {"beams": 12, "cameras": ("front",), "map_cells": (20, 30), "scans_hz": 2.0, "odometry_hz": 2.0}
    if name == "killed":
        return make_session(folder, seconds=3.0, fps=5.0, mark_every_s=0.5, killed=True, **few).folder
    often = {"photo_every_s": 3.0, "utterance_every_s": 1.5, "llm_every_s": 2.0, "person_every_s": 3.0}
    return make_session(folder, seconds=6.0, fps=6.0, **few, **often).folder


def exported(name: str, work: Path) -> dict[str, str]:
    """Contents of the exports of a fixture session: file name in :data:`GOLDEN` to text."""
    if name == _STUDY:
        return {f"{name}.methods.txt": _methods_of_study(work / name, work / f"{name}-out")}
    session = make(name, work / name)
    warnings: list[str] = []
    found = {}
    for fmt in (
        _MEASURED_FORMATS
        if name in _MEASURED
        else [fmt.name for fmt in FORMATS if fmt.name not in ("tables", "lerobot")]
    ):
        out = work / f"{name}-{fmt}"
        export_session(session, fmt, out, ExportContext(warn=warnings.append))
        for path in map(out.joinpath, _NOT_MEASURED if name in _MEASURED else ()):
            path.unlink(missing_ok=True)
        found[f"{name}.{fmt}.txt"] = _sections(out)
    study, out = work / f"{name}-study", work / f"{name}-statistics"
    shutil.copytree(session, study / name)
    study_statistics(study, out)
    shutil.rmtree(out / "tables")
    for path in (out / "queries.sql", out / "statistics.json", out / "codebook.csv"):
        path.unlink()
    found[f"{name}.statistics.txt"] = _sections(out)
    found[f"{name}.warnings.txt"] = "\n".join([*warnings, ""])
    return found


def _methods_of_study(study: Path, out: Path) -> str:
    ended = PracticeEnded(at(500.0), done=9, steps=10, minutes=8.0, score=78)
    for number, minutes in enumerate((10.0, 5.0)):
        practice = {"wizard": "Mia", "purpose": "practice"}
        tell(study / f"p{number}", [ended], lasts_s=60 * minutes, trial=practice, later_s=3600.0 * number - 7200.0)
    for number, wizard in enumerate(("Mia", "Noor", "")):
        trial = {"wizard": wizard, "participant": f"P{number}" if wizard else "", "condition": "AB"[number % 2]}
        tell(
            study / f"t{number}",
            tour(number + 4, minutes=2.0, state_hz=1.0, building=False),
            lasts_s=120.0,
            trial=trial,
            later_s=7200.0 + 86400.0 * number,
            closed=number < 2,
        )
    for name in ("titles", "suggestions"):
        make(name, study / name)
    request = ExportRequest(tuple(sorted(study.iterdir())), ("methods",), out)
    assert not export_all(request).problems
    return _sections(out)


def _sections(out: Path) -> str:
    files = sorted(path for path in out.rglob("*") if path.is_file())
    return "\n".join(f"=== {path.relative_to(out)}\n" + "".join(_content(path)) for path in files)


def _told(name: str, folder: Path) -> Path:
    values: dict[str, tuple[float, list[Any]]] = {
        "creeping": (20.0, [*drive(4.0, 14.0, 0.015), *_odometry(20.0)]),
        # A command each 0.4 s, without a zero at the end, and one that a pause ends.
        "seldom": (
            30.0,
            [
                *(CommandSent(at(4.0 + n * 0.4), n, Twist2D(0.3, 0.0, 0.2), "keyboard") for n in range(25)),
                CommandSent(at(19.9), 26, Twist2D(0.3), "gamepad"),
                RecordingPaused(at(20.0), True),
                RecordingPaused(at(22.0), False),
                CommandSent(at(22.1), 27, Twist2D(), "none"),
                CommandSent(at(29.8), 28, Twist2D(turn_radps=0.3), "onscreen"),
            ],
        ),
        "people": (60.0, _recognised()),
        "suggestions": (60.0, _suggested()),
        "titles": (60.0, _two_scenarios()),
    }
    lasts_s, told = values[name]
    tell(folder, told, lasts_s=lasts_s)
    if name == "people":
        # As the recorder lists them: visits under their first ids, too.
        seen = [
            ("p-a", 2.0, 20.0),
            ("known-1", 5.0, 20.0),
            ("p-b", 25.0, 40.0),
            ("known-2", 27.0, 40.0),
            ("p-c", 41, 50),
        ]
        rows = [{"person_id": who, "first_seen_s": since_s, "last_seen_s": until_s} for who, since_s, until_s in seen]
        (folder / "people.json").write_text(json.dumps({"people": rows}))
    return folder


def _odometry(lasts_s: float) -> list[Odometry]:
    return [Odometry(at(n / 2), None, Pose2D(0.0075 * n, 0.0, 0.0), Twist2D(0.015)) for n in range(int(2 * lasts_s))]


def _recognised() -> list[Any]:
    """Three people, two of whom were known and recognised."""
    return [
        PersonAppeared(at(2.0), "p-a", 1, 1),
        PersonIdentified(at(5.0), "p-a", "known-1", "console", 0.9),
        PersonLeft(at(21.0), "p-a", 1),
        PersonAppeared(at(25.0), "p-b", 2, 2),
        PersonIdentified(at(27.0), "p-b", "known-2", "wizard", 0.7, actor="wizard"),
        PersonLeft(at(41.0), "known-2", 2),
        PersonAppeared(at(41.5), "p-c", 3, 3),
        *heard(1, 10.0, 12.0, "Hello."),
        *said(1, 12.8, 13.0, 14.0, "Hello, nice to see you again."),
    ]


def _suggested() -> list[Any]:
    """Three turns with suggested replies: one said, one edited, one superseded, one expired; an echo and a filler."""

    def suggestion(number: int, second: float, state: SuggestionState, turn: str, **fields: Any) -> SuggestionChanged:
        told = f"Suggestion {number}."
        return SuggestionChanged(at(second), f"s-{number}", state, turn, 1, number, told, "smollm2-135m", **fields)

    def replies(number: int, asked_s: float, ended_s: float, turn: str) -> Any:
        ended = {"purpose": "replies", "turn_id": turn, "outcome": "cancelled", "detail": "a newer turn"}
        return exchange(number, asked_s, ended_s, "Suggestion", **ended)

    echo = UtteranceChanged(at(15.0), "echo", "participant", "", "heard", "started")
    return [
        *heard(1, 3.0, 5.0, "What is this?"),
        replies(1, 5.1, 7.0, "h-1"),
        suggestion(1, 5.8, "displayed", "h-1", latency_ms=800.0),
        suggestion(2, 6.0, "displayed", "h-1", latency_ms=1000.0),
        suggestion(1, 7.5, "taken", "h-1", utterance_id="u-1", actor="wizard"),
        suggestion(2, 7.5, "superseded", "h-1", actor="console"),
        *said(1, 7.5, 7.8, 9.5, "Suggestion 1.", origin="suggestion"),
        ResponseTimed(at(7.8), "h-1", "u-1", "suggestion", at(5.0), at(5.1), at(5.8), at(7.5), at(7.8)),
        # Its own voice is heard, and told apart later.
        echo,
        UtteranceChanged(at(16.0), "echo", "participant", "", "heard", "failed"),
        *said(2, 16.4, 16.5, 17.0, "And this is a table."),
        *heard(2, 20.0, 22.0, "And that?"),
        replies(2, 22.1, 24.0, "h-2"),
        UtteranceChanged(at(22.6), "u-3", "robot", "Let me think.", "filler", "requested", actor="console"),
        UtteranceChanged(at(22.7), "u-3", "robot", "Let me think.", "filler", "started", actor="console"),
        UtteranceChanged(at(23.4), "u-3", "robot", "Let me think.", "filler", "finished", actor="console"),
        suggestion(3, 23.0, "displayed", "h-2", latency_ms=1000.0),
        suggestion(3, 26.0, "edited", "h-2", utterance_id="u-4", edit_distance=4, actor="wizard"),
        *said(4, 26.0, 26.2, 28.0, "Suggestion three.", origin="suggestion"),
        ResponseTimed(at(26.2), "h-2", "u-4", "edited_suggestion", at(22.0), at(22.1), at(23.0), at(26.0), at(26.2)),
        *heard(3, 40.0, 41.0, "Goodbye."),
        UtteranceCorrected(at(45.0), "h-3", text="Goodbye!", actor="wizard"),
        replies(3, 41.1, 43.0, "h-3"),
        suggestion(4, 42.0, "displayed", "h-3", latency_ms=1000.0),
        exchange(4, 50.0, 51.0, "An arm."),
        AnswerUsed(at(52.0), "x-4", "dismissed", ""),
    ]


def _two_scenarios() -> list[Any]:
    """Two scenarios of one title, with a step of the same id and title in each, and a step of its own in the second."""
    others = (PlannedStep("greet", "Greet", 4.0), PlannedStep("ask", "Ask", 5.0), PlannedStep("bye", "Say goodbye"))

    def scenario(second: float, name: str, sha256_of: str) -> ScenarioOpened:
        return ScenarioOpened(
            at(second), name, "Tour guide", sha256_of * 64, 'format_version: 1\ntitle: "Tour guide"\n'
        )

    return [
        scenario(-1.0, "tour-guide.yaml", "a"),
        ProtocolOpened(at(0.0), STEPS),
        StepEntered(at(1.0), "greet", "Greet", 1, "started", actor="wizard"),
        StepEntered(at(13.0), "ask", "Ask", 2, "next", "greet", actor="wizard"),
        Marked(at(15.0), "Laughs", mark_id="m-1"),
        scenario(30.0, "short-tour.yaml", "b"),
        ProtocolOpened(at(30.0), others),
        StepEntered(at(30.5), "greet", "Greet", 1, "started", actor="wizard"),
        StepEntered(at(33.5), "bye", "Say goodbye", 3, "skipped", "greet", actor="wizard"),
    ]


def _content(path: Path) -> Iterator[str]:
    match path.suffix:
        case ".json" if path.name == "stats.json":
            # Numbers of images depend on how a library decodes and resizes.
            yield from (f"{key}: {', '.join(its)}\n" for key, its in json.loads(path.read_text("utf-8")).items())
        case suffix if suffix in _TEXT:
            text = path.read_text("utf-8")
            for pattern, name in _CHANGING if _is_dated(path) else ():
                text = pattern.sub(name, text)
            text = text.replace(__version__, "VERSION").replace("\r\n", "\n")
            if len(text) > _LONGEST_TEXT_BYTES:
                text = _STYLE.sub("", text)
            if len(text) > _LONGEST_TEXT_BYTES:
                text = f"{len(text.splitlines())} lines, {sha256(text.encode()).hexdigest()}"
            yield f"{text}\n"
        case ".parquet":
            table = pyarrow.parquet.read_table(path)
            yield from (f"{field.name}: {field.type}\n" for field in table.schema)
            yield f"{table.num_rows} rows\n"
        case ".mcap":
            with path.open("rb") as stream:
                counts = Counter(
                    (channel.topic, schema.name) for schema, channel, _ in make_reader(stream).iter_messages()
                )
            yield from (f"{topic} {schema} {count}\n" for (topic, schema), count in sorted(counts.items()))
        case ".mp4":
            with av.open(str(path)) as video:
                yield f"{sum(1 for _ in video.decode(video=0))} frames\n"
        case ".jpg" | ".png" | ".bag":
            yield "present\n"
        case _:
            yield f"{sha256(path.read_bytes()).hexdigest()}\n"


def _is_dated(path: Path) -> bool:
    """True if the file contains its time of writing, or lists other files."""
    listing = path.name in ("manifest-sha256.txt", "session.json")
    return path.suffix == ".eaf" or path.name.startswith("ro-crate") or listing


def main() -> None:
    shutil.rmtree(GOLDEN, ignore_errors=True)
    GOLDEN.mkdir()
    with tempfile.TemporaryDirectory() as work:
        for name in SESSIONS:
            for file, text in exported(name, Path(work)).items():
                (GOLDEN / file).write_text(text, "utf-8")


if __name__ == "__main__":
    sys.exit(main())
