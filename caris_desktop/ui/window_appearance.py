"""Appearance preferences: theme, size, language."""

from caris_desktop.domain.translation import tr
from caris_desktop.ui.language import ENGLISH, LANGUAGE_KEY, languages
from caris_desktop.ui.theme import SCALE_KEY, SCALES, THEME_KEY, Theme, ThemeChoice
from caris_desktop.ui.window_place import Settings


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

    def languages(self) -> tuple[str, ...]:
        return languages()

    def _persist(self, key: str, value: str) -> None:
        if self._settings is not None:
            self._settings.setValue(key, value)


def scale_words(scale: str) -> str:
    if not scale:
        return tr("Size: same as system")
    return tr("Size: {percent} % after a restart").format(percent=percent_of(scale))


def percent_of(scale: str) -> int:
    return round(float(scale) * 100)
