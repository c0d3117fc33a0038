"""What the wizard typed for the robot to say, over the sessions of a study: a file of this user. GUI thread."""

import json
import logging
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.translation import tr
from caris_desktop.live.slow_work import SlowWork
from caris_desktop.live.state import LiveState

_log = logging.getLogger(__name__)
AT_MOST = 500


class SaidBefore:
    """Keeps ``state.said_before``, oldest first and each sentence once, and the file ``path`` beside it.

    The file has no sentence with a name that the study knows or knew during this run: such a sentence is there as long
    as this run only, and no longer than anybody is forgotten.
    """

    def __init__(self, state: LiveState, path: Path, slow_work: SlowWork, names: Callable[[], Iterable[str]]) -> None:
        self._state = state
        self._path = path
        self._slow_work = slow_work
        self._names = names
        self._name_parts: set[str] = set()
        state.everybody.changed.connect(self._on_everybody_changed)

    def read(self) -> None:
        """Bring in what the sessions before have left."""
        self._slow_work.do(lambda: _read(self._path), self._on_read, _tell)

    def add(self, sentence: str) -> None:
        self._state.said_before.set(_newest((*self._state.said_before.value, sentence)))
        self.write()

    def write(self) -> None:
        """Once more, as the study may know another name by now."""
        text = "".join(
            f"{json.dumps(sentence, ensure_ascii=False)}\n"
            for sentence in self._nameless(self._state.said_before.value)
        )
        self._slow_work.do(lambda: _write(self._path, text), lambda _done: None, _tell)

    def forget(self) -> None:
        """Drop each sentence with a name. Whose it is nobody can tell once the study has forgotten the person."""
        self._state.said_before.set(self._nameless(self._state.said_before.value))
        self.write()

    def _nameless(self, sentences: Iterable[str]) -> tuple[str, ...]:
        # A name that was forgotten meanwhile must not come back with the next sentence.
        self._name_parts |= parts_of(self._names())
        return without_names(sentences, self._name_parts)

    def _on_everybody_changed(self, _everybody: object) -> None:
        self._name_parts |= parts_of(self._names())

    def _on_read(self, sentences: tuple[str, ...]) -> None:
        self._state.said_before.set(_newest((*sentences, *self._state.said_before.value)))


def parts_of(names: Iterable[str]) -> set[str]:
    """The words of which names consist, folded."""
    return {part for name in names for part in re.findall(r"\w{2,}", name.casefold())}


def without_names(sentences: Iterable[str], names: Iterable[str]) -> tuple[str, ...]:
    """The sentences that hold none of the names, nor a part of one."""
    parts = parts_of(names)
    return tuple(sentence for sentence in sentences if not parts.intersection(re.findall(r"\w+", sentence.casefold())))


def _newest(sentences: Iterable[str]) -> tuple[str, ...]:
    kept = list(dict.fromkeys(reversed(tuple(sentences))))[:AT_MOST]
    return tuple(reversed(kept))


def _read(path: Path) -> tuple[str, ...]:  # in the thread for slow work
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        sentences = [parse_json(line) for line in lines[-AT_MOST:]]
    except FileNotFoundError:
        return ()
    except (OSError, ValueError) as error:
        raise ToldFailure(tr("What was said before could not be read."), str(error), "") from error
    return tuple(sentence for sentence in sentences if isinstance(sentence, str))


def _write(path: Path, text: str) -> None:  # in the thread for slow work
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode(), durable=False)
    except OSError as error:
        raise ToldFailure(tr("What was said could not be kept."), str(error), "") from error


def _tell(failure: ToldFailure) -> None:
    # Nothing of the session is lost with it: the log is enough.
    _log.warning("%s %s", failure.what, failure.meaning)
