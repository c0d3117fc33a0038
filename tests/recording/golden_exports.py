"""Golden outputs of all export formats for three fixture sessions: a tour, one with every stream, one cut off.

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

import av
import pyarrow.parquet
from mcap.reader import make_reader

from caris_desktop import __version__
from caris_desktop.recording.session_export import FORMATS, ExportContext, export_session
from tests.recording.told_session import tell, tour
from tests.support.recorded_session import make_session

GOLDEN = Path(__file__).parent / "golden"
SESSIONS = ("tour", "whole", "killed")
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
    few = {"beams": 12, "cameras": ("front",), "map_cells": (20, 30), "scans_hz": 2.0, "odometry_hz": 2.0}
    if name == "killed":
        return make_session(folder, seconds=3.0, fps=5.0, mark_every_s=0.5, killed=True, **few).folder
    often = {"photo_every_s": 3.0, "utterance_every_s": 1.5, "llm_every_s": 2.0, "person_every_s": 3.0}
    return make_session(folder, seconds=6.0, fps=6.0, **few, **often).folder


def exported(name: str, work: Path) -> dict[str, str]:
    """Contents of the exports of a fixture session: file name in :data:`GOLDEN` to text."""
    session = make(name, work / name)
    warnings: list[str] = []
    found = {}
    for fmt in FORMATS:
        out = work / f"{name}-{fmt.name}"
        export_session(session, fmt.name, out, ExportContext(warn=warnings.append))
        files = sorted(path for path in out.rglob("*") if path.is_file())
        sections = (f"=== {path.relative_to(out)}\n" + "".join(_content(path)) for path in files)
        found[f"{name}.{fmt.name}.txt"] = "\n".join(sections)
    found[f"{name}.warnings.txt"] = "\n".join([*warnings, ""])
    return found


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
