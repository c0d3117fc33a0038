"""Exports that lie in a study's folder: which of them show or name somebody."""

from collections.abc import Collection, Iterable
from pathlib import Path

_OF_SESSION = "export-"
# What lies beside the sessions and is the study's own.
_OWN = ("sessions", "photos", "forgotten")
_STATISTICS = "statistics"
# By one of these a folder is known as an export.
_MARKS = (
    "ro-crate-metadata.json", "data_dictionary.csv", "report.html", "methods.html", "captions.vtt", "session.TextGrid",
    "session.bag", "episodes.jsonl", "boxes.csv", "turns.jsonl", "media.txt", "session.eaf",
)  # fmt: skip
# What is only ever made from something else: it can be made again.
_DERIVED = (
    ".zip", ".gz", ".tgz", ".tar", ".bz2", ".xz", ".zst", ".parquet", ".bag", ".db3", ".eaf", ".pfsx", ".textgrid",
    ".vtt", ".srt", ".html",
)  # fmt: skip
_SHOWS = (".png", ".jpg", ".jpeg", ".mp4", ".wav", ".flac", ".bag", ".mcap", ".db3", ".html", ".zip")


class Exports:
    """Those in one study. ``sessions`` are the names of its session folders."""

    def __init__(self, study: Path, sessions: Collection[str]) -> None:
        self._study = study
        self._sessions = frozenset(sessions)
        self._known: dict[Path, bool] = {}

    def of(self, path: Path) -> Path | None:
        """The folder or file that goes as a whole where ``path`` shows somebody; None for what is no export."""
        parts = path.relative_to(self._study).parts
        if parts[0] == "sessions":
            inside = len(parts) > 2 and parts[2].startswith(_OF_SESSION)
            return self._study.joinpath(*parts[:3]) if inside else None
        if parts[0] in _OWN:
            return None
        top = self._study / parts[0]
        if len(parts) == 1 or not (parts[0] == _STATISTICS or self._is_export(top)):
            return path if path.suffix.lower() in _DERIVED else None
        for count, part in enumerate(parts[1:-1], start=2):
            if part in self._sessions:
                return self._study.joinpath(*parts[:count])
        of_each = any((top / name).is_dir() for name in self._sessions)
        return top / parts[1] if of_each else top

    def concerned(self, files: Iterable[Path], named: Collection[Path], seen_in: Collection[str]) -> list[Path]:
        """What is to go: exports with a file that is among ``named``, or with pictures or sound of sessions that the
        person was seen in.
        """
        found: dict[Path, None] = {}
        for path in files:
            export = self.of(path)
            if export is None or export in found:
                continue
            shows = path.suffix.lower() in _SHOWS and bool(self._of_sessions(export) & frozenset(seen_in))
            if path in named or shows:
                found[export] = None
        return list(found)

    def _of_sessions(self, export: Path) -> frozenset[str]:
        """Which sessions it may show: its own where it is named after one, else any."""
        parts = export.relative_to(self._study).parts
        return frozenset(parts) & self._sessions or self._sessions

    def _is_export(self, top: Path) -> bool:
        if top not in self._known:
            self._known[top] = any(path.name in _MARKS for path in top.rglob("*"))
        return self._known[top]
