"""Exports that lie in a study's folder: which of them show or name somebody."""

from collections.abc import Collection, Iterable
from pathlib import Path

_OF_SESSION = "export-"
# What lies beside the sessions and is the study's own.
_OWN = ("sessions", "photos", "forgotten")
_STATISTICS = "statistics"
# By one of these a folder is known as an export, with all that is in it.
_MARKS = (
    "ro-crate-metadata.json", "data_dictionary.csv", "data_dictionary.parquet", "report.html", "methods.html",
    "captions.vtt", "session.TextGrid", "session.bag", "media.txt", "data.yaml", "boxes.csv", "episodes.jsonl",
    "turns.jsonl",
)  # fmt: skip
# What exporters write; scripts and writings that somebody keeps beside that are theirs.
_WRITTEN = (
    ".csv", ".parquet", ".json", ".jsonl", ".md", ".html", ".eaf", ".pfsx", ".textgrid", ".vtt", ".bag", ".mcap",
    ".yaml", ".ini", ".txt", ".sql", ".duckdb", ".jpg", ".png", ".mp4", ".wav",
)  # fmt: skip
_SHOWS = (".png", ".jpg", ".mp4", ".wav", ".bag", ".mcap", ".html")


class Exports:
    """Those in one study. ``sessions`` are the names of its session folders."""

    def __init__(self, study: Path, sessions: Collection[str]) -> None:
        self._study = study
        self._sessions = frozenset(sessions)
        self._known: dict[Path, bool] = {}

    def of(self, path: Path) -> Path | None:
        """The folder of the export that ``path`` was written for; None for what is no part of one."""
        parts = path.relative_to(self._study).parts
        if parts[0] == "sessions":
            inside = len(parts) > 3 and parts[2].startswith(_OF_SESSION)
            return self._study.joinpath(*parts[:3]) if inside else None
        if parts[0] in _OWN or path.suffix.lower() not in _WRITTEN:
            return None
        for count in range(1, len(parts)):
            folder = self._study.joinpath(*parts[:count])
            if parts[:count] == (_STATISTICS,) or self._is_export(folder):
                return folder
        return None

    def concerned(self, files: Iterable[Path], named: Collection[Path], seen_in: Collection[str]) -> list[Path]:
        """What is to go: exports with a file that is among ``named``, or with pictures or sound of sessions that the
        person was seen in.
        """
        found: dict[Path, None] = {}
        for path in files:
            export = self.of(path)
            if export is None or export in found:
                continue
            shows = path.suffix.lower() in _SHOWS and bool(self.shown_in(export) & frozenset(seen_in))
            if path in named or shows:
                found[export] = None
        return list(found)

    def shown_in(self, export: Path) -> frozenset[str]:
        """Which sessions it may show: its own where its place is named after one, else any."""
        parts = export.relative_to(self._study).parts
        return frozenset(parts) & self._sessions or self._sessions

    def _is_export(self, folder: Path) -> bool:
        if folder not in self._known:
            self._known[folder] = any((folder / mark).is_file() for mark in _MARKS)
        return self._known[folder]
