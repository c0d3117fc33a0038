"""Panel layouts saved in scenario files, and their previous versions for a reset."""

import json
import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QSettings, Signal

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.intents import SaveLayout, SizeClass
from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.confirmed_files import carry
from caris_desktop.scenario.scenario_file import ScenarioError, save_layout, save_scenario
from caris_desktop.scenario.scenario_library import own_file, own_file_called
from caris_desktop.scenario.scenario_model import (
    LayoutNode,
    Scenario,
    checked_layout,
    layout_data,
    own_layout,
    with_layout,
)
from caris_desktop.ui.window_place import Settings

_log = logging.getLogger(__name__)
_KEY = "layout/before_saving"
_KINDS: tuple[SizeClass, ...] = ("usual", "compact", "large")


class SavedLayouts:
    """Previous layouts in the user's settings, per scenario file and size class."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    def as_before(self, scenario: Scenario) -> Scenario:
        """Scenario with the layouts that this program's saving replaced."""
        for kind in _KINDS:
            known = self._all().get(_name(scenario.path, kind))
            present = own_layout(scenario, kind)
            # A layout that was since edited in the file takes precedence.
            if present is None or not isinstance(known, dict) or known.get("saved") != layout_data(present):
                continue
            try:
                before = known.get("before")
                tree = None if before is None and kind != "usual" else checked_layout(before)
                scenario = with_layout(scenario, kind, tree)
            except ValueError as error:
                _log.warning("the arrangement of %s before it was saved cannot be had back: %s", scenario.path, error)
        return scenario

    def note(self, path: Path, kind: SizeClass, saved: LayoutNode, *, replaced: Scenario) -> None:
        """Note that ``saved`` was written to ``path``; ``replaced`` is the scenario as it was open before."""
        before = own_layout(self.as_before(replaced), kind)
        entry = {"before": None if before is None else layout_data(before), "saved": layout_data(saved)}
        self._persist(self._all() | {_name(path, kind): entry})

    def forget(self, path: Path) -> None:
        names = {_name(path, kind) for kind in _KINDS}
        self._persist({known: layouts for known, layouts in self._all().items() if known not in names})

    def _all(self) -> dict[str, Any]:
        try:
            known = parse_json(str(self._settings.value(_KEY, "{}")))
        except ValueError:
            known = None
        return known if isinstance(known, dict) else {}

    def _persist(self, known: dict[str, Any]) -> None:
        self._settings.setValue(_KEY, json.dumps(known))


def _name(path: Path | None, kind: SizeClass) -> str:
    return str(path) if kind == "usual" else f"{path}#{kind}"


class OwnLayoutFiles:
    """Implementation of LayoutFiles. ``keep_scenario`` is called with the file that is open from then on."""

    def __init__(self, settings: Settings, keep_scenario: Callable[[Path], None]) -> None:
        self._saved = SavedLayouts(settings)
        self._keep_scenario = keep_scenario

    def save(self, scenario: Scenario, intent: SaveLayout) -> Path:
        changed = with_layout(scenario, intent.size_class, _tree_of(intent))
        return _rewritten(replace(changed, title=intent.title)) if intent.title else _written(changed)

    def note_saved(self, path: Path, intent: SaveLayout, *, replaced: Scenario) -> None:
        if not intent.title:
            self._saved.note(path, intent.size_class, _tree_of(intent), replaced=replaced)
        self._keep_scenario(path)

    def as_before(self, scenario: Scenario) -> Scenario:
        return self._saved.as_before(scenario)

    def reset(self, scenario: Scenario, before: Scenario) -> Path:
        for kind in _KINDS:
            scenario = with_layout(scenario, kind, own_layout(before, kind))
        return _written(scenario)

    def note_reset(self, path: Path) -> None:
        self._saved.forget(path)


def _tree_of(intent: SaveLayout) -> LayoutNode:
    """Checked layout of the request. Raises UserFacingError."""
    try:
        return checked_layout(parse_json(intent.layout))
    except ValueError as error:
        raise UserFacingError(
            tr("The panel layout was not saved."),
            tr("The layout cannot be read: {why}.").format(why=error),
            tr("Arrange the panels again, or reset them, then save again."),
        ) from error


def _written(scenario: Scenario) -> Path:
    """Write the scenario to the user's own file. Raises UserFacingError."""
    path = own_file(scenario.path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        carry(scenario, save_layout(scenario, path))
    except (OSError, ScenarioError) as error:
        raise _not_saved(path, error) from error
    return path


def _rewritten(scenario: Scenario) -> Path:
    """Write the scenario to a new file named by its title, never over an existing one. Raises UserFacingError."""
    first = path = own_file_called(scenario.title)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        number = 2
        while path.exists():
            path, number = first.with_stem(f"{first.stem}-{number}"), number + 1
        carry(scenario, save_scenario(scenario, path))
    except (OSError, ScenarioError) as error:
        raise _not_saved(path, error) from error
    return path


def _not_saved(path: Path, error: Exception) -> UserFacingError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else error
    return UserFacingError(
        tr("The panel layout was not saved."),
        tr("{path} cannot be written ({why}).").format(path=path, why=reason),
        tr(
            "Your panel layout is saved on this computer and is restored with the scenario. To save it in "
            "the file, make this folder writable and save again."
        ),
    )


# Settings of this user in memory, written by a background thread.


class SavedSettings(QObject):
    """QSettings interface that never waits for the disk. GUI thread.

    QSettings itself writes in the GUI thread and waits for the disk. Only keys set here are written, so that changes by
    the user's other windows remain.
    """

    failed = Signal(object)  # UserFacingError: a write failed; emitted once until writing works again

    def __init__(self, settings: QSettings, parent: QObject | None = None) -> None:
        super().__init__(parent)
        settings.sync()
        self._file, self._format = settings.fileName(), settings.format()
        self._values = {key: settings.value(key) for key in settings.allKeys()}
        self._work = BackgroundWorker(self)
        self._changed = threading.Lock()
        self._unwritten: dict[str, Any] = {}
        self._failing = False

    @property
    def file(self) -> str:
        """Location: a file, or a key of the system's registry."""
        return self._file

    def value(self, key: str, defaultValue: Any = None) -> Any:  # noqa: N803 - as QSettings has it
        return self._values.get(key, defaultValue)

    def setValue(self, key: str, value: Any) -> None:  # noqa: N802 - as QSettings has it
        if key in self._values and self._values[key] == value:
            return
        self._values[key] = value
        with self._changed:
            waiting = bool(self._unwritten)
            self._unwritten[key] = value
        if not waiting:
            self._work.do(self._write, self._on_written, self._on_failed)

    def finish(self) -> None:
        """Write what is left; later changes are not stored. Blocks for at most half a minute."""
        self._work.finish(lambda _what, work: work())

    def _write(self) -> None:  # any thread
        with self._changed:
            unwritten, self._unwritten = self._unwritten, {}
        settings = QSettings(self._file, self._format)
        for key, value in unwritten.items():
            settings.setValue(key, value)
        settings.sync()
        if settings.status() != QSettings.Status.NoError:
            raise UserFacingError(
                tr("Your settings could not be saved."),
                tr("Changes to the window are lost when it closes. The session is not affected."),
                tr("Make sure that {file} is writable.").format(file=self._file),
                severity="warning",
            )

    def _on_written(self, _nothing: None) -> None:
        self._failing = False

    def _on_failed(self, failure: UserFacingError) -> None:
        if not self._failing:
            self._failing = True
            self.failed.emit(failure)
