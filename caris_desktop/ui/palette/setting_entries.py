"""Palette items for settings: appearance, sound, autonomy levels, wizard."""

from functools import partial

from PySide6.QtCore import QLocale

from caris_desktop.domain import intents
from caris_desktop.domain.events import AssistanceLevel
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import DriveStatus
from caris_desktop.scenario.scenario_model import levels_up_to
from caris_desktop.ui import event_messages
from caris_desktop.ui.app_context import THEME_WORDS, AppContext
from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.sound_menu import sound_choices
from caris_desktop.ui.speak.voice_choices import voice_choices
from caris_desktop.ui.theme import SCALES, ThemeChoice
from caris_desktop.ui.window_appearance import percent_of, scale_words

TWICE = QT_TR_NOOP("select it, then Enter twice")

# Parts of the ids in the usage history: they stay as they are, however the texts are worded.
_LEVEL_IDS: dict[AssistanceLevel, str] = {
    "off": "off",
    "suggest": "suggest: my key does it",
    "act": "by itself, after a countdown",
}
_THEME_IDS: dict[ThemeChoice, str] = {"system": "like the system", "dark": "dark", "light": "light"}


class SettingEntries:
    """Items that would change a setting; current values are left out."""

    def __init__(self, parts: AppContext) -> None:
        self._parts = parts
        self._console = parts.console
        self._state = parts.console.state

    def now(self) -> list[PaletteItem]:
        permissions = self._console.scenario.permissions
        return [
            *(self._of_voices() if permissions.speech else ()),
            *(self._of_levels() if permissions.assistant else ()),
            *self._of_guard(),
            *self._of_sound(),
            *self.of_themes(),
            *self._of_sizes(),
            *self._of_languages(),
            *self._of_wizards(),
        ]

    def _of_voices(self) -> list[PaletteItem]:
        return [
            PaletteItem(
                choice.text,
                tr("Voice"),
                "sliders-horizontal",
                "",
                partial(self._console.do, choice.intent),
                also=tr("speak voice"),
                acts=True,
                id=f"Voice: {choice.id}",
            )
            for group in voice_choices(self._state.voice.value)
            for choice in group
            if not choice.chosen
        ]

    def _of_levels(self) -> list[PaletteItem]:
        """Autonomy levels of the language model, where they can be changed."""
        scenario, levels = self._console.scenario, self._state.levels.value
        return [
            PaletteItem(
                tr("{function}: {level}").format(function=tr(title), level=tr(event_messages.LEVELS[level])),
                tr("Do"),
                "sliders-horizontal",
                "",
                partial(self._console.do, intents.SetLevel(function, level)),
                also=tr("assistant level suggestions proposals"),
                id=f"Do: {title}: {_LEVEL_IDS[level]}",
            )
            for function, title in event_messages.FUNCTIONS.items()
            if function in scenario.assisted
            for level in levels_up_to(scenario.highest_level(function))
            if level != getattr(levels, function)
        ]

    def _of_guard(self) -> list[PaletteItem]:
        drive: DriveStatus = self._state.drive.value
        if drive.guard == "overridden":
            on = partial(self._console.do, intents.SetGuard(on=True))
            text = tr("Turn on the obstacle guard")
            return [PaletteItem(text, tr("Do"), "shield-check", "", on, id="Do: Switch the obstacle guard on")]
        if drive.guard == "absent" or not self._console.scenario.permissions.driving:
            return []
        return [
            PaletteItem(
                tr("Turn off the obstacle guard"),
                tr(TWICE),
                "shield-slash",
                "",
                partial(self._console.do, intents.SetGuard(on=False)),
                deliberate=True,
                again=tr("Press Enter again to turn off the guard"),
                id="Switch the obstacle guard off",
            )
        ]

    def _of_wizards(self) -> list[PaletteItem]:
        wizards = self._parts.wizards
        return [
            PaletteItem(
                tr("Wizard: {name}").format(name=name or tr("not specified")),
                tr("Wizard"),
                "user-gear",
                "",
                partial(wizards.choose, name),
                also=tr("who is at the console profile keys"),
                id=f"Wizard: Wizard: {name or 'nobody in particular'}",
            )
            for name in (*wizards.names, "")
            if name != wizards.current
        ]

    def _of_sound(self) -> list[PaletteItem]:
        return [
            PaletteItem(
                tr("{setting}: {choice}").format(setting=choice.title, choice=choice.text),
                tr("Sound"),
                "microphone",
                "",
                partial(self._console.do, choice.intent),
                also=tr("device input volume"),
                id=f"Sound: {choice.id}",
            )
            for choice in sound_choices(self._console)
            if not choice.chosen
        ]

    def _of_sizes(self) -> list[PaletteItem]:
        appearance = self._parts.appearance
        return [
            PaletteItem(
                scale_words(scale),
                tr("Window"),
                "text-aa",
                "",
                partial(appearance.choose_scale, scale),
                also=tr("larger bigger smaller text font zoom scale"),
                id=f"Window: Size: {f'{percent_of(scale)} % from the next start' if scale else 'as the system has it'}",
            )
            for scale in SCALES
            if scale != appearance.scale
        ]

    def _of_languages(self) -> list[PaletteItem]:
        appearance = self._parts.appearance
        return [
            PaletteItem(
                tr("Language: {name} after a restart").format(name=QLocale(name).nativeLanguageName()),
                tr("Window"),
                "translate",
                "",
                partial(appearance.choose_language, name),
                also=tr("translation"),
                id=f"Window: Language: {QLocale(name).nativeLanguageName()} from the next start",
            )
            for name in appearance.languages()
            if name != appearance.language
        ]

    def of_themes(self) -> list[PaletteItem]:
        appearance = self._parts.appearance
        return [
            PaletteItem(
                tr("Appearance: {theme}").format(theme=tr(words)),
                tr("Window"),
                "moon",
                "",
                partial(appearance.choose_theme, choice),
                also=tr("theme colours colors mode night day"),
                id=f"Window: Appearance: {_THEME_IDS[choice]}",
            )
            for choice, words in THEME_WORDS.items()
        ]
