"""Speech history: what the wizard typed over the sessions of a study, in a file of this user. GUI thread."""

import json
import logging
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from caris_desktop.domain.failure import UserFacingError, reported
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.state import LiveState

_log = logging.getLogger(__name__)
AT_MOST = 500


class SpeechHistory:
    """Maintains ``state.speech_history``, unique and oldest first, and the file ``path``.

    Sentences with a name known to the study are not saved: they last for this run, and at most until any person is
    erased.
    """

    def __init__(
        self, state: LiveState, path: Path, slow_work: BackgroundWorker, names: Callable[[], Iterable[str]]
    ) -> None:
        self._state = state
        self._path = path
        self._slow_work = slow_work
        self._names = names
        self._name_parts: set[str] = set()
        state.everybody.changed.connect(self._on_everybody_changed)

    def read(self) -> None:
        """Load the history of earlier sessions."""
        self._slow_work.do(lambda: _read(self._path), self._on_read, _notify)

    def add(self, sentence: str) -> None:
        self._state.speech_history.set(_newest((*self._state.speech_history.value, sentence)))
        self.write()

    def write(self) -> None:
        """Save again, since the study may know new names."""
        text = "".join(
            f"{json.dumps(sentence, ensure_ascii=False)}\n"
            for sentence in self._nameless(self._state.speech_history.value)
        )
        self._slow_work.do(lambda: _write(self._path, text), lambda _done: None, _notify)

    def forget(self) -> None:
        """Remove every sentence with a name, since after an erasure it is unknown whose name it is."""
        self._state.speech_history.set(self._nameless(self._state.speech_history.value))
        self.write()

    def _nameless(self, sentences: Iterable[str]) -> tuple[str, ...]:
        # An erased name must not return with the next sentence.
        self._name_parts |= parts_of(self._names())
        return without_names(sentences, self._name_parts)

    def _on_everybody_changed(self, _everybody: object) -> None:
        self._name_parts |= parts_of(self._names())

    def _on_read(self, sentences: tuple[str, ...]) -> None:
        self._state.speech_history.set(_newest((*sentences, *self._state.speech_history.value)))


def parts_of(names: Iterable[str]) -> set[str]:
    """Case-folded words of names."""
    return {part for name in names for part in re.findall(r"\w{2,}", name.casefold())}


def without_names(sentences: Iterable[str], names: Iterable[str]) -> tuple[str, ...]:
    """Sentences that contain no name or part of one."""
    parts = parts_of(names)
    return tuple(sentence for sentence in sentences if not parts.intersection(re.findall(r"\w+", sentence.casefold())))


def _newest(sentences: Iterable[str]) -> tuple[str, ...]:
    newest = list(dict.fromkeys(reversed(tuple(sentences))))[:AT_MOST]
    return tuple(reversed(newest))


def _read(path: Path) -> tuple[str, ...]:  # background thread
    if not path.exists():
        return ()
    with reported((OSError, ValueError), tr("The speech history could not be read."), ""):
        lines = path.read_text(encoding="utf-8").splitlines()
        sentences = [parse_json(line) for line in lines[-AT_MOST:]]
    return tuple(sentence for sentence in sentences if isinstance(sentence, str))


def _write(path: Path, text: str) -> None:  # background thread
    with reported(OSError, tr("The speech history could not be saved."), ""):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode(), durable=False)


def _notify(failure: UserFacingError) -> None:
    # No session data is lost: the log suffices.
    _log.warning("%s %s", failure.what, failure.meaning)
