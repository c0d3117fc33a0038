"""Exports inside a study's folder, and which of them show or name a person."""

from collections.abc import Collection, Iterable
from pathlib import Path

_OF_SESSION = "export-"
# The study's own folders next to the sessions.
_OWN = ("sessions", "photos", "forgotten")
_STATISTICS = "statistics"
# A folder with one of these files is an export, with all its content.
_MARKS = (
    "ro-crate-metadata.json", "data_dictionary.csv", "data_dictionary.parquet", "report.html", "methods.html",
    "captions.vtt", "session.TextGrid", "session.bag", "media.txt", "data.yaml", "boxes.csv", "episodes.jsonl",
    "turns.jsonl",
)  # fmt: skip
# Types that exporters write; scripts and notes next to them are the user's.
_WRITTEN = (
    ".csv", ".parquet", ".json", ".jsonl", ".md", ".html", ".eaf", ".pfsx", ".textgrid", ".vtt", ".bag", ".mcap",
    ".yaml", ".ini", ".txt", ".sql", ".duckdb", ".jpg", ".png", ".mp4", ".wav",
)  # fmt: skip
_SHOWS = (".png", ".jpg", ".mp4", ".wav", ".bag", ".mcap", ".html")


class Exports:
    """Exports of one study. ``sessions`` are the names of its session folders."""

    def __init__(self, study: Path, sessions: Collection[str]) -> None:
        self._study = study
        self._sessions = frozenset(sessions)
        self._known: dict[Path, bool] = {}

    def of(self, path: Path) -> Path | None:
        """Export folder that ``path`` belongs to; None if it is not part of one."""
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
        """Exports to remove: those with a file among ``named``, or with images or audio of sessions in which the person
        was seen.
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
        """Sessions that the export may show: its own if its path names one, else all."""
        parts = export.relative_to(self._study).parts
        return frozenset(parts) & self._sessions or self._sessions

    def _is_export(self, folder: Path) -> bool:
        if folder not in self._known:
            self._known[folder] = any((folder / mark).is_file() for mark in _MARKS)
        return self._known[folder]
