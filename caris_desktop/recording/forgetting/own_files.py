"""The user's files outside of any study: typed sentences, settings, logs, caches."""

from collections.abc import Iterator
from dataclasses import field
from pathlib import Path

from caris_desktop.domain.value_class import Value
from caris_desktop.recording.forgetting.search_terms import PersonNames
from caris_desktop.recording.forgetting.speech_erasure import Sentences


class OwnFiles(Value):
    """Their locations. ``histories`` contain typed sentences, ``logs`` may be written at any time.

    ``voices`` contain robot speech audio left by a killed program. ``others`` are treated like study files, except for
    ``excepted``.
    """

    histories: Path | None = None
    logs: Path | None = None
    voices: tuple[Path, ...] = ()
    others: tuple[Path, ...] = ()
    excepted: tuple[Path, ...] = field(default=())

    def files(self) -> list[Path]:
        """All files except the audio. Raises OSError."""
        folders = [folder for folder in (self.histories, self.logs, *self.others) if folder is not None]
        found = {path for folder in folders for path in _files_in(folder)}
        return sorted(path for path in found if not any(path.is_relative_to(folder) for folder in self.excepted))

    def is_history(self, path: Path) -> bool:
        return self.histories is not None and path.is_relative_to(self.histories)

    def is_log(self, path: Path) -> bool:
        return self.logs is not None and path.is_relative_to(self.logs)

    def sounds(self) -> list[Path]:
        return sorted(path for folder in self.voices for path in _files_in(folder))


def _files_in(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if not path.is_symlink() and path.is_file())


def without_lines(path: Path, words: PersonNames, target: Path) -> int:
    """Rewrite a file without the lines that name the person; return their number. Raises OSError."""
    dropped = 0
    with target.open("wb") as written:
        for line in path.read_bytes().splitlines(keepends=True):
            if next(words.spans(line.decode("utf-8", "surrogateescape")), None) is None:
                written.write(line)
            else:
                dropped += 1
    return dropped


def blot_out(path: Path, words: PersonNames, sentences: Sentences) -> int:
    """Overwrite names and sentences in a log in place, since a running program appends to this very file.

    Returns their number. Raises OSError.
    """
    count, at = 0, 0
    with path.open("r+b") as file:
        for line in file.read().splitlines(keepends=True):
            text = line.decode("utf-8", "surrogateescape")
            for start, end in (*words.spans(text), *sentences.spans(text)):
                before, name = (part.encode("utf-8", "surrogateescape") for part in (text[:start], text[start:end]))
                file.seek(at + len(before))
                file.write(b"-" * len(name))
                count += 1
            at += len(line)
    return count
