"""Checkable entries of menus; sound menu: microphones, and volume of the robot's microphone."""

from collections.abc import Callable, Iterable
from dataclasses import field
from functools import partial
from itertools import groupby

from PySide6.QtGui import QAction, QActionGroup
from PySide6.QtWidgets import QMenu

from caris_desktop.domain import intents
from caris_desktop.domain.sound_values import Role
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.services.microphone_service import participant_microphone
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import text_formatting


def add_choices(menu: QMenu, choices: Iterable[tuple[str, bool, Callable[[], object]]]) -> list[QAction]:
    """Add alternatives, of which one holds: text, whether it holds, and what choosing it does."""
    group = QActionGroup(menu)
    actions = []
    for text, holds, choose in choices:
        action = menu.addAction(text)
        action.setCheckable(True)
        action.setChecked(holds)
        action.setActionGroup(group)
        action.triggered.connect(lambda _checked=False, choose=choose: choose())
        actions.append(action)
    return actions


def add_switch(menu: QMenu, text: str, on: bool, use: Callable[[bool], object]) -> None:
    action = menu.addAction(text)
    action.setCheckable(True)
    action.setChecked(on)
    action.toggled.connect(use)


_VOLUMES = (1.0, 0.7, 0.4, 0.2)


class SettingChoice(Value):
    """Entry of a menu: ``text`` is a value of the setting ``title``; ``id`` does not depend on language."""

    text: str
    intent: intents.Intent
    chosen: bool
    title: str = ""
    id: str = field(kw_only=True)


def sound_choices(console: WizardConsole) -> list[SettingChoice]:
    """Entries permitted by the scenario, grouped by title."""
    permissions, hears = console.scenario.permissions, console.scenario.sound.hear
    listens = permissions.audio_recording or permissions.transcription or hears
    choices: list[SettingChoice] = []
    if listens and participant_microphone(console.scenario, console.state.robot.value) == "computer":
        choices += _microphones(console, QT_TR_NOOP("Participant’s microphone"), "participant", console.microphone)
    if permissions.own_voice or permissions.transcription:
        choices += _microphones(console, QT_TR_NOOP("Your microphone"), "wizard", console.wizard_microphone)
    return [*choices, *_volumes(console)] if hears else choices


def _microphones(console: WizardConsole, title: str, role: Role, chosen: str | None) -> list[SettingChoice]:
    names: list[str | None] = [None, *dict.fromkeys(("", *console.microphones()))]
    if chosen not in names:
        names.append(chosen)  # unplugged, but still the selected one
    return [
        SettingChoice(
            tr("No microphone") if name is None else text_formatting.microphone(name),
            intents.UseMicrophone(name, role), name == chosen, tr(title),
            id=f"{title}: {'No microphone' if name is None else name or 'System’s default microphone'}",
        )
        for name in names
    ]  # fmt: skip


def _volumes(console: WizardConsole) -> list[SettingChoice]:
    sound = console.state.sound.value
    return [
        SettingChoice(
            _percent(volume) if volume else tr("Off"), intents.HearRobot(volume > 0.0, volume or sound.volume),
            sound.volume == volume if sound.hearing and volume else not (sound.hearing or volume), tr("Hear the robot"),
            id=f"Hear the robot: {_percent(volume) if volume else 'Off'}",
        )
        for volume in (0.0, *_VOLUMES)
    ]  # fmt: skip


def _percent(volume: float) -> str:
    return f"{volume:.0%}".replace("%", " %")


def add_sound_menus(console: WizardConsole, menu: QMenu) -> None:
    """Add the sound settings that the scenario permits."""
    choices = sound_choices(console)
    if choices:
        menu.addSection(tr("Sound"))
    for title, of_title in groupby(choices, key=lambda choice: choice.title):
        add_choices(
            menu.addMenu(title),
            (
                (text_formatting.in_menu(choice.text), choice.chosen, partial(console.do, choice.intent))
                for choice in of_title
            ),
        )
