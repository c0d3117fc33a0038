"""Study of 200 ten-minute sessions: first tables, statistics afterwards, opening, search.

A rehearsal of examples/ is repeated until it lasts ten minutes, with shifted times and new ids; all sessions share its
event log as a hard link, and differ in their headers. Prints one JSON object. Targets: ``tables_cpu_s_per_minute``
0.15, summed over the processes; ``statistics_again_s`` 5; ``open_ms`` 2000, ``search_ms`` 100 (p95); ``peak_mb`` 1000.
``all_tables_cpu_s_per_minute`` is that of an export of one session, with its imports and the tables that no measure
reads. Where pandas is installed, 0.03 of it is its import: pyarrow imports it before it makes its first array.
"""

import argparse
import json
import os
import re
import resource
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer

from caris_desktop.live.study_jobs import Workers, run_jobs
from caris_desktop.recording.session.manifest import write_manifest
from caris_desktop.recording.session_export import export_session
from caris_desktop.recording.studies.statistics import study_statistics
from caris_desktop.recording.studies.study_index import StudyIndex, session_folders
from caris_desktop.recording.studies.study_query import SessionQuery
from tests.benchmarks.screen_and_statistics import percentiles

_REHEARSALS = Path(__file__).parents[2] / "examples" / "study" / "sessions"
_STAMP = re.compile(rb'("\w*_ns": ?)(\d+)')
_ID = re.compile(rb'("(?:utterance|turn|reply|exchange|mark|goal|suggestion|alarm)_id": ?")([^"]+)')
_QUERIES = ("robot", "exhibit", "what", "the", "hello")


def make_study(sessions_dir: Path, count: int, *, minutes: float, rehearsal: Path) -> None:
    header = json.loads((rehearsal / "session.json").read_bytes())
    lasts_ns = header["ended_ns"] - header["started_ns"]
    times = max(1, round(minutes * 60e9 / lasts_ns))
    log = sessions_dir / "events.mcap"
    sessions_dir.mkdir(parents=True)
    _repeat(rehearsal / "events.mcap", log, times, lasts_ns)
    for number in range(count):
        folder = sessions_dir / f"session-{number:04d}"
        folder.mkdir()
        (folder / "events.mcap").hardlink_to(log)
        trial = {
            **header["trial"],
            "participant": f"P{number // 2:03d}",
            "condition": "AB"[number % 2],
            "trial": str(number % 2 + 1),
        }
        clock = {**header["clock"], "utc_ns": header["clock"]["utc_ns"] + number * 3_600_000_000_000}
        data = {**header, "trial": trial, "clock": clock, "ended_ns": header["started_ns"] + times * lasts_ns}
        del data["files"], data["counts"]
        (folder / "session.json").write_text(json.dumps(data), encoding="utf-8")
        write_manifest(folder)
    log.unlink()


def _repeat(source: Path, target: Path, times: int, lasts_ns: int) -> None:
    with target.open("wb") as written, source.open("rb") as read:
        reader, writer = make_reader(read), Writer(written)
        writer.start(library="caris-desktop")
        channels: dict[int, int] = {}
        messages = list(reader.iter_messages(log_time_order=False))
        for number in range(times):
            shift_ns = number * lasts_ns

            def moved(match: re.Match[bytes], shift_ns: int = shift_ns) -> bytes:
                return match[1] + str(int(match[2]) + shift_ns).encode()

            for schema, channel, message in messages:
                if channel.id not in channels:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                    channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
                if channel.topic.startswith("/event/session_"):
                    continue
                data = _STAMP.sub(moved, message.data)
                writer.add_message(
                    channels[channel.id],
                    message.log_time + shift_ns,
                    _ID.sub(rb"\g<1>\g<2>-" + str(number).encode(), data),
                    message.publish_time + shift_ns,
                    message.sequence,
                )
        writer.finish()


def cpu_s() -> float:
    """CPU time of this process and its ended children."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def measure(folder: Path, *, sessions: int, minutes: float, workers: int) -> dict[str, Any]:
    rehearsal = sorted(_REHEARSALS.iterdir())[0]
    make_study(folder / "sessions", sessions, minutes=minutes, rehearsal=rehearsal)
    run = partial(run_jobs, workers=Workers(workers))
    began_s, began_cpu_s = time.perf_counter(), cpu_s()
    first = study_statistics(folder, folder / "statistics", run=run)
    first_s, first_cpu_s = time.perf_counter() - began_s, cpu_s() - began_cpu_s
    recorded_min = sum(row["recorded_s"] for row in first.measures) / 60
    began_cpu_s = cpu_s()
    session = session_folders(folder / "sessions")[0]
    export_session(session, "parquet", folder / "export")
    all_tables_cpu_s = cpu_s() - began_cpu_s
    began_s = time.perf_counter()
    again = study_statistics(folder, folder / "statistics", run=run)
    again_s = time.perf_counter() - began_s
    began_s = time.perf_counter()
    index = StudyIndex.of_study(folder)
    index.update()
    indexed_s = time.perf_counter() - began_s
    index.close()
    open_ms, search_ms = [], []
    for _ in range(5):
        began_s = time.perf_counter()
        index = StudyIndex.of_study(folder)
        index.update()
        index.sessions()
        open_ms.append((time.perf_counter() - began_s) * 1000)
        for text in _QUERIES:
            began_s = time.perf_counter()
            index.search(SessionQuery(text=text))
            search_ms.append((time.perf_counter() - began_s) * 1000)
        index.close()
    peak_kb = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    stored = sum(path.stat().st_size for path in session.glob("derived/tables/*/*"))
    return {
        "sessions": first.sessions,
        "recorded_minutes": round(recorded_min, 1),
        "workers": workers,
        "load": round(os.getloadavg()[0], 1),
        "tables_s": round(first_s, 1),
        "tables_cpu_s_per_minute": round(first_cpu_s / recorded_min, 3),
        "all_tables_cpu_s_per_minute": round(all_tables_cpu_s * sessions / recorded_min, 3),
        "tables_mb_per_session": round(stored / 1e6, 2),
        "statistics_again_s": round(again_s, 2),
        "newly_read_again": again.exported,
        "index_s": round(indexed_s, 1),
        "open_ms": percentiles(open_ms),
        "search_ms": percentiles(search_ms),
        "peak_mb": round(peak_kb / 1024),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(Path(folder), sessions=args.sessions, minutes=args.minutes, workers=args.workers)
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
