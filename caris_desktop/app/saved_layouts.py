"""Saving arrangements of panels in scenario files, and what a file said before, so that it can be had back."""

import json
import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.domain.events import ANSWER
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.translation import tr
from caris_desktop.live.console import Console
from caris_desktop.scenario.file import ScenarioError, save_layout, save_scenario
from caris_desktop.scenario.layout import SizeClass, checked_layout, layout_data, own_layout, with_layout
from caris_desktop.scenario.library import own_file, user_scenarios_dir
from caris_desktop.scenario.model import LayoutNode, Scenario
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.window_place import Settings

_log = logging.getLogger(__name__)
_KEY = "layout/before_saving"
_KINDS: tuple[SizeClass, ...] = ("usual", "compact", "large")
_LONGEST_STEM = 60


class SavedLayouts:
    """Kept in the user's settings, for each scenario file and size of screen that an arrangement was saved for."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    def as_before(self, scenario: Scenario) -> Scenario:
        """The scenario with the arrangements that saving replaced, where it was saved by this program."""
        for kind in _KINDS:
            known = self._all().get(_name(scenario.path, kind))
            present = own_layout(scenario, kind)
            # Whoever wrote another arrangement into the file by hand means that one.
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
        """``saved`` went into ``path``; ``replaced`` is the scenario as it was open until then."""
        before = own_layout(self.as_before(replaced), kind)
        entry = {"before": None if before is None else layout_data(before), "saved": layout_data(saved)}
        self._keep(self._all() | {_name(path, kind): entry})

    def forget(self, path: Path) -> None:
        names = {_name(path, kind) for kind in _KINDS}
        self._keep({known: layouts for known, layouts in self._all().items() if known not in names})

    def _all(self) -> dict[str, Any]:
        try:
            known = json.loads(str(self._settings.value(_KEY, "{}")))
        except ValueError:
            known = None
        return known if isinstance(known, dict) else {}

    def _keep(self, known: dict[str, Any]) -> None:
        self._settings.setValue(_KEY, json.dumps(known))


def _name(path: Path | None, kind: SizeClass) -> str:
    return str(path) if kind == "usual" else f"{path}#{kind}"


class LayoutSaving(QObject):
    """Does what the menu Layout of ``window`` asks for. ``keep_scenario`` hears which file is open from then on."""

    def __init__(
        self, window: MainWindow, console: Console, settings: Settings, keep_scenario: Callable[[Path], None]
    ) -> None:
        super().__init__(window)
        self._console = console
        self._saved = SavedLayouts(settings)
        self._keep_scenario = keep_scenario
        window.layout_save_requested.connect(self._on_save_requested)
        window.layout_save_as_requested.connect(self._on_save_as_requested)
        window.layout_reset_requested.connect(self._on_reset_requested)

    def _on_save_requested(self, layout: LayoutNode, kind: SizeClass) -> None:
        replaced = self._console.scenario

        def written(path: Path) -> None:
            self._saved.note(path, kind, layout, replaced=replaced)
            self._keep_scenario(path)
            self._console.problem(
                "info", tr("The panel layout was saved."), tr("It is in your own copy, {path}.").format(path=path), "",
                cause=ANSWER,
            )  # fmt: skip

        self._console.rewrite_scenario(lambda scenario: _written(with_layout(scenario, kind, layout)), written)

    def _on_save_as_requested(self, layout: LayoutNode, kind: SizeClass, title: str) -> None:
        def written(path: Path) -> None:
            self._keep_scenario(path)
            self._console.problem(
                "info", tr("{title} is a scenario now, and open.").format(title=title),
                tr("It is in {path}.").format(path=path), "", cause=ANSWER,
            )  # fmt: skip

        def write(scenario: Scenario) -> Path:
            return _written_anew(replace(with_layout(scenario, kind, layout), title=title))

        self._console.rewrite_scenario(write, written)

    def _on_reset_requested(self) -> None:
        """An arrangement that was saved is undone in its file too, or the next start would bring it back."""
        present = self._console.scenario
        before = self._saved.as_before(present)
        if before == present:
            return

        def written(path: Path) -> None:
            self._saved.forget(path)
            self._console.problem(
                "info", tr("The panels are back."), tr("The layout that was saved is undone."),
                tr("Save it again to keep another."), cause=ANSWER,
            )  # fmt: skip

        def write(scenario: Scenario) -> Path:
            for kind in _KINDS:
                scenario = with_layout(scenario, kind, own_layout(before, kind))
            return _written(scenario)

        self._console.rewrite_scenario(write, written)


def _written(scenario: Scenario) -> Path:
    """Raises ToldFailure."""
    path = own_file(scenario.path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_layout(scenario, path)
    except (OSError, ScenarioError) as error:
        raise _not_saved(path, error) from error
    return path


def _written_anew(scenario: Scenario) -> Path:
    """Into a file of its own, named by its title; nothing that is there is written over. Raises ToldFailure."""
    stem = re.sub(r"[^a-z0-9]+", "-", scenario.title.casefold()).strip("-")[:_LONGEST_STEM] or "scenario"
    folder = user_scenarios_dir()
    path = folder / f"{stem}.yaml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        number = 2
        while path.exists():
            path, number = folder / f"{stem}-{number}.yaml", number + 1
        save_scenario(scenario, path)
    except (OSError, ScenarioError) as error:
        raise _not_saved(path, error) from error
    return path


def _not_saved(path: Path, error: Exception) -> ToldFailure:
    return ToldFailure(
        tr("The panel layout was not saved."),
        tr("{path} cannot be written ({why}).").format(path=path, why=error),
        tr("Your arrangement is kept on this computer and comes back with the scenario. Save it again."),
    )
