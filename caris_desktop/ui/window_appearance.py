"""Appearance preferences: theme, size, language (an installed translation, or the pseudo-language for tests)."""

import logging
import re
from pathlib import Path

from PySide6.QtCore import QCoreApplication, QTranslator

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import tr, use_translator
from caris_desktop.ui.theme import SCALE_KEY, SCALES, THEME_KEY, Theme, ThemeChoice
from caris_desktop.ui.window_place import Settings

_log = logging.getLogger(__name__)
LANGUAGE_KEY = "appearance/language"
ENGLISH, TRIAL = "en", "trial"
"""The pseudo-language is readable English, 40 % longer: it reveals untranslated texts and layouts that
are too narrow.
"""
_LONGER = 0.4
_ACCENTS = str.maketrans("aceginorsuyzACEGINORSUYZ", "àçéğîñöŕšûýžÀÇÉĞÎÑÖŔŠÛÝŽ")
_KEPT = re.compile(r"(\{[^{}]*\}|%n|<[^<>]*>)")
_FILL = ("ēx", "ìpsum", "lörem", "dölor", "sît")


def translations_dir() -> Path:
    return resources_dir() / "translations"


def languages() -> tuple[str, ...]:
    """English, and each installed translation, such as ``de`` or ``pt_BR``."""
    found = sorted(path.stem.removeprefix("caris_desktop_") for path in translations_dir().glob("caris_desktop_*.qm"))
    return (ENGLISH, *found)


class Language:
    """Installs a translator; texts already on screen do not change."""

    def __init__(self) -> None:
        self._translator: QTranslator | None = None

    def use(self, name: str) -> None:
        """Switch to a language. A missing translation falls back to English, with a log entry."""
        self._forget()
        if name == TRIAL:
            use_translator(in_trial_language)
        elif name != ENGLISH:
            self._load(name)

    def _load(self, name: str) -> None:
        translator = QTranslator()
        if name not in languages() or not translator.load(str(translations_dir() / f"caris_desktop_{name}.qm")):
            _log.warning("there is no translation into %r; the window speaks English", name)
            return
        self._translator = translator
        QCoreApplication.installTranslator(translator)
        use_translator(lambda text, meant, number: QCoreApplication.translate("", text, meant or None, number))

    def _forget(self) -> None:
        use_translator(None)
        if self._translator is not None:
            QCoreApplication.removeTranslator(self._translator)
            self._translator = None


def in_trial_language(text: str, _meant: str = "", number: int = -1) -> str:
    """``text`` with accents, 40 % longer, in brackets: ``[Šàvé ēx]``. Placeholders and already translated texts stay
    unchanged.
    """
    if not text.strip() or (text.startswith("[") and text.endswith("]")):
        return text
    parts = [part if _KEPT.fullmatch(part) else part.translate(_ACCENTS) for part in _KEPT.split(text)]
    fill, more = "", round(_LONGER * len(text))
    for count in range(more):
        if len(fill) >= more - 2:
            break
        fill += f" {_FILL[count % len(_FILL)]}"
    longer = f"[{''.join(parts)}{fill[:more] if more > 2 else ''}]"
    return longer.replace("%n", str(number)) if number >= 0 else longer


class Appearance:
    """Appearance preferences of the user. Size and language take effect at the next start; existing widgets are not
    rebuilt.
    """

    def __init__(self, theme: Theme, settings: Settings | None) -> None:
        self.theme = theme
        self._settings = settings

    def choose_theme(self, choice: ThemeChoice) -> None:
        self.theme.set_choice(choice)
        self._persist(THEME_KEY, choice)

    @property
    def scale(self) -> str:
        """One of SCALES, or empty."""
        stored = str(self._settings.value(SCALE_KEY, "")) if self._settings is not None else ""
        return stored if stored in SCALES else ""

    def choose_scale(self, scale: str) -> None:
        self._persist(SCALE_KEY, scale)

    @property
    def language(self) -> str:
        return str(self._settings.value(LANGUAGE_KEY, ENGLISH)) if self._settings is not None else ENGLISH

    def choose_language(self, name: str) -> None:
        self._persist(LANGUAGE_KEY, name)

    def _persist(self, key: str, value: str) -> None:
        if self._settings is not None:
            self._settings.setValue(key, value)


def scale_words(scale: str) -> str:
    if not scale:
        return tr("Size: Same as system")
    return tr("Size: {percent} % after a restart").format(percent=percent_of(scale))


def percent_of(scale: str) -> int:
    return round(float(scale) * 100)
