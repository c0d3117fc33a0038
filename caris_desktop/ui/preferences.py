"""Wizard profiles: settings per wizard; and preferences, most of them per scenario, restored at the next start."""

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, get_args
from urllib.parse import quote

from PySide6.QtCore import QObject, QTimer, Signal

from caris_desktop.domain import intents
from caris_desktop.domain.events import AssistedFunction, VoiceOutput
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import VoiceStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.scenario.scenario_model import Scenario, levels_up_to
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.panel_manager import PanelManager
from caris_desktop.ui.window_place import Settings

_NAMES_KEY = "wizards/names"
_CURRENT_KEY = "wizards/current"
_NOBODY = "*"  # not the quoted form of any name
LONGEST_NAME = 120


class WizardProfiles(QObject):
    """``current`` is the wizard's name, empty for the default profile; ``changed`` reports a switch.

    Values that a wizard has not set come from the default profile, so that naming a wizard loses no settings. Names are
    case-insensitive. Without ``settings``, values last for this run.
    """

    changed = Signal()

    def __init__(self, settings: Settings | None, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._settings: Settings = settings if settings is not None else _Forgetful()
        self._names = _read_names(self._settings)
        self.current = self._known(_tidied(str(self._settings.value(_CURRENT_KEY, "") or "")))

    @property
    def names(self) -> tuple[str, ...]:
        """All known wizards, in alphabetical order."""
        return tuple(sorted(self._names, key=str.casefold))

    def choose(self, name: str) -> None:
        """Switch to a wizard, adding a new name; empty for the default profile."""
        chosen = self._known(_tidied(name))
        if chosen and chosen not in self._names:
            self._names.append(chosen)
            self._settings.setValue(_NAMES_KEY, json.dumps(self._names))
        if chosen != self.current:
            self.current = chosen
            self._settings.setValue(_CURRENT_KEY, chosen)
            self.changed.emit()

    def value(self, key: str, default: Any = None) -> Any:
        """Value set by this wizard, else that of the default profile."""
        value = self._settings.value(self._place(key))
        return value if value is not None else self._settings.value(f"wizards/{_NOBODY}/{key}", default)

    def own_value(self, key: str, default: Any = None) -> Any:
        """Value set by this wizard only, for personal data such as training results."""
        return self._settings.value(self._place(key), default)

    def set_value(self, key: str, value: Any) -> None:
        self._settings.setValue(self._place(key), value)

    def _place(self, key: str) -> str:
        # Settings treat a slash as a group, and some systems ignore case.
        return f"wizards/{quote(self.current.casefold(), safe=' ') or _NOBODY}/{key}"

    def _known(self, name: str) -> str:
        return next((known for known in self._names if known.casefold() == name.casefold()), name)


class _Forgetful:
    def __init__(self) -> None:
        self._values: dict[str, Any] = {}

    def value(self, key: str, defaultValue: Any = None) -> Any:  # noqa: N803
        return self._values.get(key, defaultValue)

    def setValue(self, key: str, value: Any) -> None:
        self._values[key] = value


def _tidied(name: str) -> str:
    return " ".join(name.split())[:LONGEST_NAME].strip()


def _read_names(settings: Settings) -> list[str]:
    try:
        names = json.loads(str(settings.value(_NAMES_KEY, "[]")))
    except (ValueError, RecursionError):
        return []
    known: dict[str, str] = {}
    for name in names if isinstance(names, list) else ():
        if isinstance(name, str) and _tidied(name):
            known.setdefault(_tidied(name).casefold(), _tidied(name))
    return list(known.values())


_LEAST_SPEED = 0.1


class _Choice(Value):
    """One preference. ``read`` returns the current value as JSON data, or None; it changes with one of ``values``.
    ``file`` returns the part of the scenario file that the preference overrides or selects from.

    ``use`` restores the saved value, silently if that is no longer possible. It returns False while its prerequisites
    are missing, and is then retried.
    """

    name: str
    values: tuple[LiveValue, ...]
    read: Callable[[], Any]
    use: Callable[[Any], bool]
    file: Callable[[Scenario], Any]


class Preferences(QObject):
    """Restores preferences at ``begin`` and saves them from then on.

    The scenario file applies until the wizard chooses otherwise; then the wizard's choice applies, as long as the
    scenario permits and contains it, and until that part of the file changes. Values set by the console when another
    scenario opens are not preferences.
    """

    def __init__(self, console: WizardConsole, wizards: WizardProfiles, board: PanelManager, parent: QObject) -> None:
        super().__init__(parent)
        self._console = console
        self._wizards = wizards
        self._board = board
        self._scenario: Scenario = console.scenario
        state = console.state
        setup = state.assistant_setup
        self._choices = (
            _Choice("speed", (state.drive,), self._speed, self._use_speed, lambda file: file.driving),
            _Choice("voice", (state.voice,), self._voice, self._use_voice, lambda file: (file.voice, file.speech)),
            _Choice(
                "model", (setup,), lambda: setup.value.model, self._use_model,
                lambda file: (file.assistant.model, file.assistant.models),
            ),
            _Choice(
                "role", (setup,), lambda: setup.value.role,
                lambda stored: self._use_prompt("role", stored, setup.value.roles),
                lambda file: _names(file.assistant.roles),
            ),
            _Choice(
                "style", (setup,), lambda: setup.value.style,
                lambda stored: self._use_prompt("style", stored, setup.value.styles),
                lambda file: _names(file.assistant.styles),
            ),
            _Choice("levels", (state.levels,), self._levels, self._use_levels, lambda file: file.assistance),
            _Choice(
                "phrases", (state.phrase_group,), lambda: state.phrase_group.value, self._use_phrases,
                lambda file: [group.title for group in phrase_groups(file.phrases)],
            ),
            _Choice(
                "camera", (state.camera, state.cameras), lambda: state.chosen_camera or None, self._use_camera,
                lambda file: (_names(file.cameras), file.panels.video.camera),
            ),
        )  # fmt: skip
        self._last: dict[str, Any] = {}
        self._waiting: dict[str, Any] = {}
        self._changed: dict[str, Any] = {}
        self._soon = QTimer(self, singleShot=True, interval=0)
        self._soon.timeout.connect(self._persist)
        self._anew = QTimer(self, singleShot=True, interval=0)
        self._anew.timeout.connect(self._use_stored)

    def begin(self) -> None:
        for choice in self._choices:
            for value in choice.values:
                value.changed.connect(lambda _value, choice=choice: self._on_changed(choice))
        self._console.state.scenario.changed.connect(self._on_scenario_changed)
        self._console.state.robot.changed.connect(self._on_robot_changed)
        self._wizards.changed.connect(self._anew.start)
        self._wizards.changed.connect(self._use_in_panels)
        self._board.made.connect(self._on_panel_made)
        self._board.opened.connect(self._use_in_panel)
        for name, panel in self._board.made_so_far.items():
            self._on_panel_made(name, panel)
        self._use_in_panels()
        self._use_stored()

    @property
    def robot_of_last_time(self) -> str:
        """Profile name that this wizard last used with this scenario; empty if none."""
        stored = from_json(self._wizards.value(self._place("robot")))
        return stored if isinstance(stored, str) else ""

    # Saving

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        if self._console.state.practice.value.state in ("preparing", "running"):
            return  # the wizard did not choose the practice robot
        if robot is not None and robot.name:
            self._wizards.set_value(self._place("robot"), json.dumps(robot.name))

    def _on_changed(self, choice: _Choice) -> None:
        if self._anew.isActive():
            return
        chosen = choice.read()
        if chosen is not None and chosen != self._last.get(choice.name):
            # Deferred: this may come from the next scenario, whose change signal follows.
            self._last[choice.name] = self._changed[choice.name] = chosen
            self._waiting.pop(choice.name, None)
            self._soon.start()
        elif choice.name in self._waiting and choice.use(self._waiting[choice.name]):
            self._waiting.pop(choice.name, None)

    def _persist(self) -> None:
        for choice in self._choices:
            if choice.name in self._changed:
                self._wizards.set_value(
                    self._place(choice.name), _stored_text(self._changed[choice.name], choice.file(self._scenario))
                )
        self._changed.clear()

    def _on_scenario_changed(self, _scenario: object) -> None:
        self._changed.clear()
        self._soon.stop()
        self._anew.start()

    def _place(self, name: str) -> str:
        return f"choices/{_stem(self._scenario)}/{name}"

    # Restoring

    def _use_stored(self) -> None:
        self._scenario = self._console.scenario
        self._waiting.clear()
        for choice in self._choices:
            self._last[choice.name] = choice.read()
        for choice in self._choices:
            stored = _stored_value(self._wizards.value(self._place(choice.name)), choice.file(self._scenario))
            if stored is not None and stored != self._last[choice.name] and not choice.use(stored):
                self._waiting[choice.name] = stored

    def _speed(self) -> float:
        return round(float(self._console.state.drive.value.speed_fraction), 3)

    def _use_speed(self, stored: Any) -> bool:
        fits = isinstance(stored, int | float) and not isinstance(stored, bool) and _LEAST_SPEED <= stored <= 1.0
        if fits and self._scenario.permissions.driving:
            self._console.do(intents.SetSpeed(float(stored)))
        return True

    def _voice(self) -> list[Any]:
        voice: VoiceStatus = self._console.state.voice.value
        return [voice.output, voice.name, voice.language, voice.rate, voice.volume]

    def _use_voice(self, stored: Any) -> bool:
        voice: VoiceStatus = self._console.state.voice.value
        if not (isinstance(stored, list) and len(stored) == 5 and self._scenario.permissions.speech):
            return True
        output, name, language, rate, volume = stored
        texts = isinstance(name, str) and isinstance(language, str) and output in get_args(VoiceOutput)
        numbers = all(isinstance(each, int | float) and not isinstance(each, bool) for each in (rate, volume))
        if not (texts and numbers and 0.5 <= rate <= 2.0 and 0.0 <= volume <= 1.0):
            return True
        if name and name != voice.name and name not in (choice for choice, _language in voice.choices):
            return False
        self._console.do(intents.SetVoice(output, name, language, float(rate), float(volume)))
        return True

    def _use_model(self, stored: Any) -> bool:
        if not (isinstance(stored, str) and self._scenario.permissions.assistant):
            return True
        if stored not in (choice.model for choice in self._console.state.assistant_setup.value.models):
            return False
        self._console.do(intents.ChooseModel(stored))
        return True

    def _use_prompt(self, part: Literal["role", "style"], stored: Any, entries: Iterable[Any]) -> bool:
        if isinstance(stored, str) and stored in ("", *_names(entries)) and self._scenario.permissions.assistant:
            self._console.do(intents.ChoosePrompt(part, stored))
        return True

    def _levels(self) -> dict[str, str]:
        levels = self._console.state.levels.value
        return {function: getattr(levels, function) for function in get_args(AssistedFunction)}

    def _use_levels(self, stored: Any) -> bool:
        """Restore lowered levels; a level is never raised."""
        now = self._levels()
        for function in get_args(AssistedFunction):
            level = stored.get(function) if isinstance(stored, dict) else None
            if level != now[function] and level in levels_up_to(now[function]):  # type: ignore[arg-type]
                self._console.do(intents.SetLevel(function, level))
        return True

    def _use_phrases(self, stored: Any) -> bool:
        number = isinstance(stored, int) and not isinstance(stored, bool)
        if number and 0 <= stored < len(phrase_groups(self._scenario.phrases)):
            self._console.state.choose_phrases(stored)
        return True

    def _use_camera(self, stored: Any) -> bool:
        if stored not in self._console.state.cameras.value:
            return not isinstance(stored, str)
        self._console.state.choose_camera(stored)
        return True

    # Panels

    def _on_panel_made(self, name: str, panel: Panel) -> None:
        def save() -> None:
            self._wizards.set_value(
                self._place_of_panel(name), _stored_text(panel.choices(), self._file_of_panel(name))
            )

        panel.choices_changed.connect(save)

    def _use_in_panels(self) -> None:
        for name, panel in self._board.made_so_far.items():
            self._use_in_panel(name, panel)

    def _use_in_panel(self, name: str, panel: Panel) -> None:
        stored = _stored_value(self._wizards.value(self._place_of_panel(name)), self._file_of_panel(name))
        if isinstance(stored, dict):
            with panel.preferences_blocked():
                panel.use_choices(stored)

    def _file_of_panel(self, name: str) -> Any:
        return getattr(self._console.scenario.panels, name, None)

    def _place_of_panel(self, name: str) -> str:
        return f"choices/{_stem(self._console.scenario)}/panels/{name}"


def _stem(scenario: Scenario) -> str:
    return quote(scenario.path.stem if scenario.path is not None else "", safe="")


def _names(entries: Iterable[Any]) -> list[str]:
    return [entry.name for entry in entries]


def _stored_text(chosen: Any, file: Any) -> str:
    return json.dumps({"chosen": chosen, "file": _mark_of(file)})


def _stored_value(text: Any, file: Any) -> Any:
    """The saved value; None if there is none, or if the file has changed since."""
    stored = from_json(text)
    if not (isinstance(stored, dict) and stored.keys() == {"chosen", "file"}):
        return stored  # saved by a version without the file's hash
    return stored["chosen"] if stored["file"] == _mark_of(file) else None


def _mark_of(file: Any) -> str:
    """Hash of a part of the file, to detect changes; independent of keys added by newer program versions."""
    return hashlib.sha256(repr(_said(file)).encode()).hexdigest()[:12]


def _said(part: Any) -> Any:
    if is_dataclass(part) and not isinstance(part, type):
        return [
            (each.name, _said(getattr(part, each.name)))
            for each in fields(part)
            if getattr(part, each.name) != (each.default if each.default_factory is MISSING else each.default_factory())
        ]
    return [_said(each) for each in part] if isinstance(part, tuple) else part


def from_json(text: Any) -> Any:
    """Stored JSON; None if it is none."""
    try:
        return json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        return None
