"""Review file of an erasure: a list of places that may name the person, in which the user enters decisions."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import get_args

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.forgetting.search_terms import ErasureStoppedError
from caris_desktop.recording.forgetting.text_erasure import Decision, Passage

_HEAD = """\
# Texts and files that may name or show the person to be erased. Replace each ? with a decision:
#   redact   replace the name or the utterance with [forgotten], and silence its audio
#   keep     leave it unchanged, because it does not name the person, or another person said it
#   remove   remove the whole file; for files that cannot be edited or searched
# Then run the same command again with --review THIS_FILE. This file contains the name: it is deleted when all
# decisions are made.
"""
_PERSON, _NAMES = "# person: ", "# names: "
_ESCAPED = re.compile(r"\\u([0-9a-fA-F]{4})")
_MAX_BYTES = 64 << 20
_DECISIONS = tuple(decision for decision in get_args(Decision) if decision)


class Review(Value):
    """Decisions by key of place; ``names`` are the search terms."""

    person_id: str
    names: tuple[str, ...]
    decisions: Mapping[str, Decision]


def write_review(path: Path, person_id: str, names: Iterable[str], places: Iterable[Passage]) -> None:
    """Write the review file. Raises OSError."""
    lines = [_HEAD, f"{_PERSON}{person_id}\n", f"{_NAMES}{' | '.join(names)}\n"]
    file = None
    for place in places:
        if place.file != file:
            file = place.file
            lines.append(f"\n# {_plain(file)}\n")
        often = f" ({place.count} times)" if place.count > 1 else ""
        words = f"{_plain(place.before)}»{_plain(place.name)}«{_plain(place.behind)}"
        allowed = "  [the whole file: keep or remove]" if place.kind in ("file", "unexamined") else ""
        lines.append(f"?  {place.key}  {place.where}{often}: {words}{allowed}\n")
    replace_file(path, "".join(lines).encode("utf-8", "replace"), durable=True)


def read_review(path: Path) -> Review:
    """Read the decisions. Raises ErasureStoppedError for an unreadable file or an invalid line."""
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES).decode("utf-8", "replace")
    except OSError as error:
        raise ErasureStoppedError(
            localized(QT_TR_NOOP("{path} cannot be read: {why}."), path=path, why=error.strerror or error),
            QT_TR_NOOP("Nothing was changed."),
            QT_TR_NOOP("Enter the path of the list of texts again."),
        ) from error
    person_id = ""
    names: tuple[str, ...] = ()
    decisions: dict[str, Decision] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith(_NAMES):
            names = tuple(name.strip() for name in line.removeprefix(_NAMES).split(" | ") if name.strip())
        if line.startswith(_PERSON):
            person_id = line.removeprefix(_PERSON).strip()
        words = line.split(maxsplit=2)
        if not words or line.startswith(("#", "?")):
            continue
        if len(words) < 2 or words[0] not in _DECISIONS:
            raise ErasureStoppedError(
                localized(
                    QT_TR_NOOP("Line {number} of {path} starts with {word}, which is not a decision."),
                    number=number,
                    path=path,
                    word=repr(words[0]),
                ),
                QT_TR_NOOP("Nothing was changed."),
                localized(
                    QT_TR_NOOP("Enter one of {words} there, or leave the ? for later."), words=", ".join(_DECISIONS)
                ),
            )
        decisions[words[1]] = words[0]  # type: ignore[assignment]
    return Review(person_id, names, decisions)


def _plain(text: str) -> str:
    """Single line with JSON escapes resolved."""
    text = _ESCAPED.sub(lambda found: chr(int(found[1], 16)), text)
    return "".join(letter if letter.isprintable() else " " for letter in text)
