"""Input field of the Speak panel, with completion and dictation, and the choices of its voice."""

import math
import re
from collections.abc import Callable, Iterable, Sequence

from PySide6.QtCore import Property, QMimeData, QPoint, QRect, Qt
from PySide6.QtGui import (
    QFocusEvent,
    QKeyEvent,
    QResizeEvent,
    QTextCursor,
    QTextOption,
)
from PySide6.QtWidgets import QFrame, QPlainTextEdit, QTextEdit

from caris_desktop.domain.events import VoiceOutput
from caris_desktop.domain.intents import SetVoice
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import VoiceStatus
from caris_desktop.ui.menus import SettingChoice
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.labels import ElidedLabel, KeyCap

_OUTPUTS: tuple[tuple[VoiceOutput, str], ...] = (
    ("robot", QT_TR_NOOP("The robot speaks")), ("computer", QT_TR_NOOP("This computer speaks")),
    ("both", QT_TR_NOOP("Both speak at once")),
)  # fmt: skip
_RATES = (
    (0.75, QT_TR_NOOP("Slowly")),
    (1.0, QT_TR_NOOP("At normal speed")),
    (1.25, QT_TR_NOOP("Quickly")),
    (1.5, QT_TR_NOOP("Very quickly")),
)
_ID_OF_NORMAL_SPEED = "At usual speed"  # in the usage history, however it is worded now
_VOLUMES = ((0.25, QT_TR_NOOP("Quietly")), (0.5, QT_TR_NOOP("At half volume")), (1.0, QT_TR_NOOP("At full volume")))


def voice_choices(voice: VoiceStatus) -> list[list[SettingChoice]]:
    """Entries by group; those of this computer's voice only if it is used."""

    def choice(known_as: str, *, text: str = "", chosen: bool, **changes: object) -> SettingChoice:
        now: dict[str, object] = {
            "output": voice.output, "name": voice.name, "language": voice.language, "rate": voice.rate,
            "volume": voice.volume,
        }  # fmt: skip
        intent = SetVoice(**{**now, **changes})  # type: ignore[arg-type]
        return SettingChoice(text or tr(known_as), intent, chosen, id=known_as)

    groups = [[choice(text, chosen=voice.output == output, output=output) for output, text in _OUTPUTS]]
    if voice.output == "robot":
        return groups
    voices = [(f"{_title(name)} · {language}", name, language) for name, language in voice.choices]
    rates = [(_ID_OF_NORMAL_SPEED if rate == 1.0 else text, tr(text), rate) for rate, text in _RATES]
    groups += [
        [
            choice(text, text=text, chosen=name in (voice.name, voice.used), name=name, language=language)
            for text, name, language in voices
        ],
        [choice(known_as, text=text, chosen=voice.rate == rate, rate=rate) for known_as, text, rate in rates],
        [choice(text, chosen=voice.volume == volume, volume=volume) for volume, text in _VOLUMES],
    ]
    return [group for group in groups if group]


def _title(name: str) -> str:
    """Voice title: ``piper:en_US-joe`` becomes ``joe``, ``espeak:german`` becomes ``german (eSpeak)``."""
    engine, _, voice = name.partition(":")
    return f"{voice} (eSpeak)" if engine == "espeak" else voice


LONGEST = 1000
_MOST_LINES = 4
_BORDER_PX = 2  # of a focused field, in the style sheet
_SIDE_PX = 12
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)
_NOT_SENT_WITH = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier


class SpeakField(QPlainTextEdit):
    """Enter says the text; it stays if ``say`` returns False. Shift+Enter begins a new line. Up and Down step through
    the history.

    ``earlier``: history, oldest first; ``sentences``: candidates for completion. Tab accepts a visible completion,
    otherwise it moves the focus.
    """

    def __init__(
        self,
        theme: Theme,
        say: Callable[[str], bool],
        *,
        earlier: Callable[[], Sequence[str]],
        sentences: Callable[[], Sequence[str]],
    ) -> None:
        super().__init__()
        self._theme = theme
        self._say = say
        self._earlier = earlier
        self._sentences = sentences
        self._back = 0
        self._draft = ""
        self._rest = ElidedLabel(tone="dim", objectName="completion", parent=self.viewport())
        self._rest.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.completion = ""
        self._line_px = 48
        self._dictated_id = ""
        self._dictated: QTextCursor | None = None
        self.was_dictated = False
        """Whether some of the text was dictated."""
        self._enter = KeyCap("Enter", self)
        self.setAccessibleName(tr("What the robot says next"))
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setTabChangesFocus(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setWordWrapMode(QTextOption.WrapMode.WrapAtWordBoundaryOrAnywhere)
        self.document().setDocumentMargin(0)
        # A trailing space overhangs the edge and must not scroll the text.
        self.horizontalScrollBar().valueChanged.connect(lambda _value: self.horizontalScrollBar().setValue(0))
        self.textChanged.connect(self._on_changed)
        self.cursorPositionChanged.connect(self._complete)
        theme.changed.connect(self._fit)

    text = Property(str, lambda self: self.toPlainText(), lambda self, text: self.setPlainText(text))

    def set_line_height(self, height_px: int) -> None:
        """Set the height for a single line."""
        if height_px != self._line_px:
            self._line_px = height_px
            self._fit()

    def bring(self, text: str) -> None:
        """Insert ``text`` for editing. Down restores the former text."""
        standing = self.toPlainText()
        self._back = 0
        self._put(text)
        if standing.strip() and standing != text:
            self._draft = standing
            self._back = -1

    def dictate(self, utterance_id: str, committed: str, tentative: str) -> None:
        """Insert the current dictation at the position where it began."""
        if utterance_id != self._dictated_id:
            self._dictated_id = utterance_id
            self._dictated = None
            self.setExtraSelections([])
        words = " ".join(f"{committed} {tentative}".split())
        if not utterance_id or (not words and self._dictated is None):
            return
        if self._dictated is None:
            self._dictated = self.textCursor()
            self._dictated.clearSelection()
            self.was_dictated = True
        cursor = self._dictated
        start, end = cursor.selectionStart(), cursor.selectionEnd()
        follows = start <= self.textCursor().position() <= end
        before = self.toPlainText()[:start]
        text = f" {words}" if before and not before[-1].isspace() else words
        cursor.insertText(text)
        cursor.setPosition(start)
        cursor.setPosition(start + len(text), QTextCursor.MoveMode.KeepAnchor)
        # Text typed after it is not part of it.
        cursor.setKeepPositionOnInsert(True)
        if follows:
            after = QTextCursor(self.document())
            after.setPosition(start + len(text))
            self.setTextCursor(after)
        self._show_as_tentative(start + len(text), len(" ".join(tentative.split())))

    def _show_as_tentative(self, end: int, length: int) -> None:
        unsure = QTextEdit.ExtraSelection()
        unsure.cursor = QTextCursor(self.document())
        unsure.cursor.setPosition(end - length)
        unsure.cursor.setPosition(end, QTextCursor.MoveMode.KeepAnchor)
        unsure.format.setForeground(self._theme.color("dim"))
        self.setExtraSelections([unsure] if length else [])

    # ---- keyboard

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in _ENTER and not event.modifiers() & _NOT_SENT_WITH:
            if not event.isAutoRepeat():
                self._send()
        elif event.key() == Qt.Key.Key_Up and self._stands_in_line(first=True) and not event.modifiers() & _WITH:
            self._recall(1)
        elif event.key() == Qt.Key.Key_Down and self._stands_in_line(first=False) and not event.modifiers() & _WITH:
            self._recall(-1)
        else:
            super().keyPressEvent(event)

    def focusNextPrevChild(self, forward: bool) -> bool:
        if forward and self.completion and self.hasFocus():
            self.textCursor().insertText(self.completion)
            return True
        return super().focusNextPrevChild(forward)

    def insertFromMimeData(self, source: QMimeData) -> None:
        self.textCursor().insertText(" ".join(source.text().split("\n")))

    def _send(self) -> None:
        text = " ".join(self.toPlainText().split())
        if text and self._say(text):
            self.let_go()

    def let_go(self) -> None:
        """Clear for the next text."""
        self._back, self._draft = 0, ""
        self._dictated = None
        self.setExtraSelections([])
        self.clear()

    def _recall(self, step: int) -> None:
        earlier = self._earlier()
        back = min(max(min(0, self._back), self._back + step), len(earlier))
        if back == self._back:
            return
        if self._back == 0:
            self._draft = self.toPlainText()
        self._back = back
        self._put(self._draft if back <= 0 else earlier[-back])

    def _put(self, text: str) -> None:
        self.setPlainText(text)
        self.moveCursor(QTextCursor.MoveOperation.End)

    def _stands_in_line(self, *, first: bool) -> bool:
        """Whether the cursor is in the first or last visual line."""
        cursor = self.textCursor()
        move = QTextCursor.MoveOperation.Up if first else QTextCursor.MoveOperation.Down
        return not cursor.movePosition(move)

    # ---- completion

    def _on_changed(self) -> None:
        text = self.toPlainText()
        self.was_dictated = self.was_dictated and bool(text)
        if len(text) > LONGEST:
            self._put(text[:LONGEST])
            return
        self._fit()
        self._complete()

    @property
    def completion(self) -> str:
        """Completion shown behind the cursor, accepted with Tab."""
        return self._rest.text()

    @completion.setter
    def completion(self, rest: str) -> None:
        self._rest.setText(rest)
        self._rest.setVisible(bool(rest))

    def _complete(self) -> None:
        cursor, text = self.textCursor(), self.toPlainText()
        at_end = cursor.atEnd() and not cursor.hasSelection()
        rest = completion(text, self._sentences()) if text and at_end and self.hasFocus() else ""
        self.completion = rest
        if rest:
            at = self.cursorRect()
            left = at.right() + 1
            self._rest.setGeometry(left, at.top(), self.viewport().width() - left, self.fontMetrics().height())

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self._complete()

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self._complete()

    # ---- layout

    def _fit(self) -> None:
        """Fit the height to the text, up to a few lines; a single line is centred vertically."""
        block, count = self.document().firstBlock(), 0
        while block.isValid():
            count += max(1, block.layout().lineCount())
            block = block.next()
        # The layout rounds each line up.
        first = self.document().firstBlock()
        line_px = math.ceil(self.blockBoundingRect(first).height() / max(1, first.layout().lineCount()))
        # If a line is cut by a pixel, Qt scrolls the first line away to show the last one.
        above_px = max(0, (self._line_px - line_px) // 2 - _BORDER_PX)
        right_px = self._enter.sizeHint().width() + 2 * _SIDE_PX
        self.setViewportMargins(_SIDE_PX, above_px, right_px, above_px)
        self.setFixedHeight(self._line_px + (min(count, _MOST_LINES) - 1) * line_px)
        if count <= _MOST_LINES:
            self.verticalScrollBar().setValue(0)
        else:
            self.ensureCursorVisible()
        cap = self._enter.sizeHint()
        bottom_px = (self._line_px - cap.height()) // 2
        at = QPoint(self.width() - cap.width() - _SIDE_PX, self.height() - cap.height() - bottom_px)
        self._enter.setGeometry(QRect(at, cap))

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit()
        self._complete()


_WITH = Qt.KeyboardModifier.ShiftModifier | Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier


_LEAST = 2
_LEAST_WITHIN = 6
_MOST_WORDS = 8
_LOOKED_AT = 120
_WORD_STARTS = re.compile(r"\b\w")


def completion(text: str, sentences: Iterable[str]) -> str:
    """Completion of a partial sentence from phrases and earlier utterances.

    Continuation of ``text``; empty if none. The first match in ``sentences`` wins.

    Sentences that begin with the text precede those that contain its last words.
    """
    written = text.casefold()
    if len(written.strip()) < _LEAST:
        return ""
    folded = [(sentence.casefold(), sentence) for sentence in sentences]
    # Case folding may change the length, which would shift positions.
    candidates = [(lower, sentence) for lower, sentence in folded if len(lower) == len(sentence)]
    for lower, sentence in candidates:
        if lower.startswith(written) and len(sentence) > len(text):
            return sentence[len(text) :]
    tails = _tails(written)
    # A longer tail contains the shortest one: this filter keeps completion fast enough for typing.
    candidates = [(lower, sentence) for lower, sentence in candidates if tails and tails[-1] in lower]
    for tail in tails:
        for lower, sentence in candidates:
            at = _within(tail, lower)
            if at and at < len(sentence):
                return sentence[at:]
    return ""


def _tails(written: str) -> list[str]:
    """Last words, longest sequence first; never a single word, which is too ambiguous."""
    starts = [match.start() for match in _WORD_STARTS.finditer(written, max(0, len(written) - _LOOKED_AT))]
    tails = [written[start:] for start in starts[-_MOST_WORDS:-1]]
    return [tail for tail in tails if len(tail) >= _LEAST_WITHIN]


def _within(tail: str, sentence: str) -> int:
    """Position after these words in the sentence; 0 if not found."""
    at = sentence.find(tail)
    while at > 0 and sentence[at - 1].isalnum():
        at = sentence.find(tail, at + 1)
    return at + len(tail) if at >= 0 else 0
