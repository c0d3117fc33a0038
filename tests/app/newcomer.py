"""Simulated new user who has read the first page of the README and sees only the window.

The visible content comes from the accessibility interface: names, positions and focus. Actions use mouse and keyboard.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from PySide6.QtCore import QCoreApplication, QRect, Qt
from PySide6.QtGui import QAccessible, QAccessibleInterface, QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

_LOOKS_EVERY_S = 0.05


@dataclass(frozen=True)
class Seen:
    """Visible element of the window with its name and position."""

    name: str
    role: QAccessible.Role
    place: QRect


class Newcomer:
    """User of ``window``. An element not found within ``patience_s`` is a fault of the window."""

    def __init__(self, window: QWidget, *, patience_s: float = 60.0) -> None:
        self.window = window
        self.patience_s = patience_s
        self.log: list[str] = []

    # Perception

    def everything(self) -> Iterator[Seen]:
        root = QAccessible.queryAccessibleInterface(self.window)
        if root is not None:
            yield from self._below(root)

    def _below(self, node: QAccessibleInterface) -> Iterator[Seen]:
        for number in range(node.childCount()):
            child = node.child(number)
            if child is None or not child.isValid():
                continue
            state = child.state()
            if state.invisible or state.offscreen:
                continue
            rect = child.rect()
            place = QRect(self.window.mapFromGlobal(rect.topLeft()), rect.size())
            if place.isValid() and self.window.rect().intersects(place):
                name = child.text(QAccessible.Text.Name) or child.text(QAccessible.Text.Value)
                # The current item of a list over the window has the focus.
                for words in (name, child.text(QAccessible.Text.Description)):
                    if words:
                        yield Seen(words, child.role(), place)
            yield from self._below(child)

    def sees(self, words: str, *roles: QAccessible.Role) -> Seen | None:
        """Element with exactly this name, else with the shortest name that contains the words."""
        wanted = words.casefold()
        found = [seen for seen in self.everything() if not roles or seen.role in roles]
        found = [seen for seen in found if wanted in seen.name.casefold()]
        return min(found, key=lambda seen: (seen.name.casefold() != wanted, len(seen.name)), default=None)

    def waits_for(self, observe: Callable[[], object], what: str) -> object:
        until_s = time.monotonic() + self.patience_s
        while time.monotonic() < until_s:
            QCoreApplication.processEvents()
            observed = observe()
            if observed:
                return observed
            time.sleep(_LOOKS_EVERY_S)
        shown = sorted({seen.name for seen in self.everything()})
        raise AssertionError(f"nothing of this came about: {what}. {self.log[-3:]} In the window: {shown}")

    def finds(self, words: str, *roles: QAccessible.Role) -> Seen:
        found = self.waits_for(lambda: self.sees(words, *roles), f"something called {words!r}")
        assert isinstance(found, Seen)
        return found

    # Actions

    def clicks(self, words: str, *roles: QAccessible.Role) -> None:
        where = self.finds(words, *roles).place.center()
        self.log.append(f"clicks {words!r}")
        target = self.window.childAt(where) or self.window
        QTest.mouseClick(target, Qt.MouseButton.LeftButton, pos=target.mapFrom(self.window, where))
        QCoreApplication.processEvents()

    def presses(self, keys: str) -> None:
        """Press keys in the notation of a manual: Ctrl+K, F1, Esc."""
        self.log.append(f"presses {keys}")
        chord = QKeySequence(keys)[0]  # type: ignore[index]
        QTest.keyClick(self._hands(), chord.key(), chord.keyboardModifiers())
        QCoreApplication.processEvents()

    def types(self, text: str) -> None:
        self.log.append(f"types {text!r}")
        QTest.keyClicks(self._hands(), text)
        QCoreApplication.processEvents()

    def holds(
        self, key: Qt.Key, until: Callable[[], object], what: str, modifiers: Qt.KeyboardModifier | None = None
    ) -> None:
        """Hold a key until a condition is true."""
        self.log.append(f"holds {key.name}")
        chord = modifiers or Qt.KeyboardModifier.NoModifier
        QTest.keyPress(self._hands(), key, chord)
        try:
            self.waits_for(until, what)
        finally:
            QTest.keyRelease(self._hands(), key, chord)
            QCoreApplication.processEvents()

    def rests(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            QCoreApplication.processEvents()
            time.sleep(0.01)

    def _hands(self) -> QWidget:
        return QApplication.focusWidget() or self.window


def drives_a_metre(newcomer: Newcomer, driven_m: Callable[[], float], metres: float = 1.0) -> None:
    """Drive as the README says: hold W while the video has the focus. Turns away from obstacles first."""
    newcomer.finds("Still")
    newcomer.clicks("Front camera")
    began_m = driven_m()

    def there() -> bool:
        return driven_m() - began_m > metres

    for _ in range(20):
        newcomer.holds(Qt.Key.Key_W, lambda: there() or newcomer.sees("Something is in the way"), "the robot drives")
        if there():
            return
        newcomer.holds(Qt.Key.Key_A, lambda: newcomer.rests(1.0) or True, "it turns away")
    raise AssertionError("it never drove so far")


def practises(newcomer: Newcomer, driven_m: Callable[[], float]) -> list[str]:
    """Follow the steps of the practice strip; returns their titles."""
    newcomer.presses("Ctrl+K")
    newcomer.types("practise")
    newcomer.finds("Practise on the simulated robot")
    newcomer.presses("Return")
    did: list[str] = []
    while True:
        seen = newcomer.waits_for(
            lambda: newcomer.sees("Practice ended") or _next_step(newcomer, did), "what to do next"
        )
        assert isinstance(seen, Seen)
        if seen.name.startswith("Practice ended"):
            return did
        title = seen.name.partition(" · ")[2]
        did.append(title)
        _DOES[title](newcomer, driven_m)
        newcomer.waits_for(
            lambda title=title: title not in {one.name.partition(" · ")[2] for one in newcomer.everything()},
            f"the tick of “{title}”",
        )


def _next_step(newcomer: Newcomer, did: list[str]) -> Seen | None:
    seen = newcomer.sees(" of 10 · ")
    return seen if seen is not None and seen.name.partition(" · ")[2] not in did else None


def _types_while_driving(newcomer: Newcomer, _driven_m: Callable[[], float]) -> None:
    newcomer.presses("Ctrl+L")
    newcomer.types("Here I come")
    alt = Qt.KeyboardModifier.AltModifier

    def sent_while_it_turns() -> bool:
        if newcomer.sees("Moving") is None:
            return False
        QTest.keyClick(QApplication.focusWidget() or newcomer.window, Qt.Key.Key_Return, alt)
        return True

    newcomer.holds(Qt.Key.Key_Left, sent_while_it_turns, "it moves while one types", alt)


def _names_somebody(newcomer: Newcomer, _driven_m: Callable[[], float]) -> None:
    newcomer.finds(" here")
    newcomer.presses("Ctrl+I")
    newcomer.types("Luis")
    newcomer.presses("Return")


def _asks_the_assistant(newcomer: Newcomer, _driven_m: Callable[[], float]) -> None:
    newcomer.clicks("Assistant", QAccessible.Role.PageTab)
    newcomer.clicks("Ask the assistant", QAccessible.Role.EditableText)
    newcomer.types("What can I ask a visitor?")
    newcomer.presses("Return")


def _takes_a_suggestion(newcomer: Newcomer, _driven_m: Callable[[], float]) -> None:
    newcomer.finds("Suggestion 1")
    newcomer.rests(0.5)
    newcomer.presses("Ctrl+1")


def _recovers_the_link(newcomer: Newcomer, driven_m: Callable[[], float]) -> None:
    newcomer.finds("No link")
    newcomer.waits_for(lambda: newcomer.sees("No link") is None, "the link is back")
    newcomer.finds("Still")
    drives_a_metre(newcomer, driven_m, 0.4)


def _stops_in_an_emergency(newcomer: Newcomer, _driven_m: Callable[[], float]) -> None:
    newcomer.presses("Esc")
    newcomer.presses("Esc")
    newcomer.clicks("Release emergency stop")


_DOES: dict[str, Callable[[Newcomer, Callable[[], float]], None]] = {
    "Drive one metre": drives_a_metre,
    "Type while driving": _types_while_driving,
    "Say a phrase": lambda newcomer, _driven_m: newcomer.presses("F1"),
    "Name a person": _names_somebody,
    "Take a photo": lambda newcomer, _driven_m: newcomer.presses("Ctrl+P"),
    "Ask the assistant": _asks_the_assistant,
    "Use a suggestion": _takes_a_suggestion,
    "Mark a moment": lambda newcomer, _driven_m: newcomer.presses("Ctrl+M"),
    "Recover from a lost connection": _recovers_the_link,
    "Stop in an emergency": _stops_in_an_emergency,
}
"""Steps as in the README and its screenshots."""
