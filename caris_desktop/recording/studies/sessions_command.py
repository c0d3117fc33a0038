"""``caris-desktop sessions``: list of a study's sessions, and full-text search in them."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from caris_desktop.recording.session.session_header import clock_text
from caris_desktop.recording.studies.study_index import StudyIndex
from caris_desktop.recording.studies.study_query import PLACES_A_PAGE, SearchHit, SessionEntry, SessionQuery
from caris_desktop.recording.terminal import ProgressLine, aligned, reporting

_FILTERS = (
    ("participant", "sessions of this participant"),
    ("condition", "sessions of this condition"),
    ("wizard", "sessions of this wizard"),
    ("scenario", "sessions with this scenario (its title)"),
    ("purpose", "sessions for this purpose, such as practice"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", type=Path, help="study folder, or folder of its sessions")
    parser.add_argument(
        "--search",
        default="",
        metavar="TEXT",
        help="words said, noted or marked; the first letters of words are enough",
    )
    for name, meaning in _FILTERS:
        parser.add_argument(f"--{name}", default="", metavar="NAME", help=f"{meaning}; * matches anything")
    parser.add_argument(
        "--page",
        type=int,
        default=1,
        metavar="N",
        help=f"page of the --search results, with {PLACES_A_PAGE} places each",
    )
    parser.add_argument("--rebuild", action="store_true", help="discard the index and read every session again")


@reporting(cancelled="Cancelled. The sessions read so far are saved for the next time.")
def run(args: argparse.Namespace) -> int:
    """Exit status: 0 if something was found, 1 if not or if the study cannot be read, 130 cancelled."""
    if not args.study.is_dir():
        print(f"{args.study} is not a folder.", file=sys.stderr)
        return 1
    query = SessionQuery(text=args.search, **{name: getattr(args, name) for name, _ in _FILTERS})
    index = StudyIndex.of_study(args.study)
    try:
        with ProgressLine() as line:
            (index.rebuild if args.rebuild else index.update)(lambda fraction: line.show(fraction, "reading sessions"))
        entries = index.sessions(query)
        hits = index.search(query, after=PLACES_A_PAGE * (max(1, args.page) - 1)) if args.search else ()
        places = index.places(query) if args.search else {}
        unreadable = index.unreadable()
    except OSError as error:
        print(f"{args.study} cannot be read: {error.strerror or error}.", file=sys.stderr)
        return 1
    finally:
        index.close()
    if index.message:
        print(index.message, file=sys.stderr)
    for broken in unreadable:
        print(broken.trouble, file=sys.stderr)
    if not entries:
        print(
            "No session matches." if args.search or query != SessionQuery() else f"{args.study} contains no sessions."
        )
        return 1
    print("\n".join(_hits(entries, hits, places, max(1, args.page)) if args.search else _list(entries)))
    return 0


def _list(entries: Sequence[SessionEntry]) -> list[str]:
    rows = [("started (UTC)", "session", "participant", "condition", "trial", "wizard", "scenario", "length", "said",
             "marks", "problems", "size", "")]  # fmt: skip
    rows += [
        (
            entry.started_utc[:16].replace("T", " "),
            entry.folder.name,
            entry.participant,
            entry.condition,
            entry.trial,
            entry.wizard,
            entry.scenario,
            clock_text(entry.duration_s),
            str(entry.utterances),
            str(entry.marks),
            str(entry.problems),
            f"{entry.size_bytes / 1e6:.1f} MB",
            ", ".join(word for word in _states(entry) if word),
        )
        for entry in entries
    ]
    lines = aligned(rows, to_the_right=lambda column: 7 <= column <= 11)
    count = len(entries)
    losses = [f"{entry.folder.name}: {loss}" for entry in entries for loss in entry.losses]
    return [*lines, f"{count} session{'' if count == 1 else 's'}", *losses]


def _states(entry: SessionEntry) -> tuple[str, ...]:
    return (
        entry.purpose,
        "" if entry.closed_properly else "not closed properly",
        "incomplete" if entry.losses else "",
        f"copy of {entry.copy_of}" if entry.copy_of else "",
    )


def _hits(
    entries: Sequence[SessionEntry], hits: Sequence[SearchHit], places: Mapping[Path, int], page: int
) -> list[str]:
    """Hits by session in the order of ``entries``; sessions on other pages are named."""
    by_folder: dict[Path, list[SearchHit]] = {}
    for hit in hits:
        by_folder.setdefault(hit.folder, []).append(hit)
    lines = []
    before = 0
    for entry in entries:
        count = places.get(entry.folder, 0)
        its_page, before = before // PLACES_A_PAGE + 1, before + count
        about = ", ".join(part for part in (entry.participant, entry.condition, entry.wizard) if part)
        here = by_folder.get(entry.folder, [])
        elsewhere = f": {_places(count)}, from page {its_page}" if len(here) < count else "" if count else ": no place"
        lines.append(f"{entry.folder.name}{f'  ({about})' if about else ''}{elsewhere}")
        lines += [
            f"  {clock_text(hit.session_s):>8}  {hit.kind.replace('_', ' ')}: {hit.snippet}"
            + (f"  (in {hit.quoted} prompt{'s' * (hit.quoted != 1)})" if hit.quoted else "")
            for hit in here
        ]
    found, with_places = sum(places.values()), sum(bool(places.get(entry.folder)) for entry in entries)
    last = f"{_places(found)} in {with_places} session{'' if with_places == 1 else 's'}"
    if len(hits) < found:
        first = PLACES_A_PAGE * (page - 1) + 1
        range_text = f"places {first} to {first + len(hits) - 1} are shown" if hits else "none are on this page"
        last += f"; {range_text} (--page {page} of {-(-found // PLACES_A_PAGE)})"
    return [*lines, last]


def _places(count: int) -> str:
    return f"{count} place{'' if count == 1 else 's'}"
