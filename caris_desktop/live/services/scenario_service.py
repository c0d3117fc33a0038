"""Scenario service: current scenario, its places, and saved dock layouts."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, WIZARD, Actor
from caris_desktop.domain.events import Event, LayoutChanged, PlacesChanged, ScenarioOpened
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.intents import SameName
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import BackgroundWorker, new_timer
from caris_desktop.live.confirmed_files import ConfirmationNeededError, accept
from caris_desktop.live.service import ContextService, Handlers, ServiceContext
from caris_desktop.live.status import IN_SESSION, SavedScenario
from caris_desktop.scenario.bundle import ImportQuestion, NameConflict
from caris_desktop.scenario.scenario_file import OtherFileError, own_file
from caris_desktop.scenario.scenario_model import Place, Scenario

_POLL_EVERY_S = 0.25
"""Pause of panel updates in s while a scenario change creates panels, which ends teleoperation. An edited scenario
changes little, and does not stop driving.
"""
_NEXT_TURN_MS = 1
"""Delay in ms between services and window on a scenario change, so that keys are handled in between; 0 ms would precede
keyboard events. What is not permitted is refused from the first turn on.
"""


class Imported(Value):
    """Imported scenario: its path; names changed automatically, as text; and where replaced files were moved."""

    path: Path
    renamed: str = ""
    put_aside: str = ""


class LayoutFiles(Protocol):
    """Saving of dock layouts in scenario files, with the former layout for a reset.

    ``save`` and ``reset`` access files in a background thread and raise UserFacingError; all else is called in the GUI
    thread.
    """

    def save(self, scenario: Scenario, intent: intents.SaveLayout) -> Path:
        """Write the scenario with a layout, to its own file or a new one for its title; returns the path."""

    def note_saved(self, path: Path, intent: intents.SaveLayout, *, replaced: Scenario) -> None:
        """Register a saved layout; ``replaced``: the scenario before."""

    def as_before(self, scenario: Scenario) -> Scenario:
        """The scenario with the layouts that saving replaced."""

    def reset(self, scenario: Scenario, before: Scenario) -> Path:
        """Write the scenario with the layouts of ``before``."""

    def note_reset(self, path: Path) -> None:
        """Register a reset."""


class ScenarioAdapters(Value):
    """``load`` and all saving functions raise UserFacingError; ``text`` is the recorded text of a scenario.
    ``save_text`` gets the text, its file, the file it was edited from and the checksum it may replace, and returns the
    new contents. ``share`` writes one file for others, ``unpack`` imports one with decisions on name conflicts, and
    ``conflicts`` lists these. All access files and run in a background thread. Without ``layouts`` dock layouts are not
    saved.
    """

    load: Callable[[Path], Scenario]
    save_places: Callable[[Scenario], Scenario]
    text: Callable[[Scenario], str]
    save_text: Callable[[str, Path, Path | None, str], str]
    share: Callable[[Scenario, Path], None] = lambda _scenario, _path: None
    unpack: Callable[[Path, Sequence[SameName]], Imported] = lambda path, _decided: Imported(path)
    conflicts: Callable[[Path], tuple[NameConflict, ...]] = lambda _path: ()
    layouts: LayoutFiles | None = None


Places = tuple[Place, ...]
Filed = tuple[Scenario, str]
"""Scenario as in its file, with its text."""


class ScenarioService(ContextService):
    """Maintains ``state.scenario`` and ``state.places``. ``apply`` passes a scenario to all services. A scenario
    changed on disk by another program is reopened.

    Files are accessed in the order of requests, so that the last one wins.
    """

    def __init__(
        self, context: ServiceContext, parts: ScenarioAdapters, scenario: Scenario, *, apply: Callable[[Scenario], None]
    ) -> None:
        super().__init__(context)
        self._parts = parts
        self._apply = apply
        self._layout: LayoutChanged | None = None
        # A scenario given at program start counts as the wizard's choice.
        self._opened_by: Actor = WIZARD
        self._closed = False
        self._show = new_timer(self, self._show_current, _NEXT_TURN_MS, single_shot=True)
        self.current = scenario
        self._text = parts.text(scenario)
        # ``current`` after all pending requests; for the background thread only.
        self._filed = scenario
        self._state.scenario.set(scenario)
        self._watch = ScenarioWatch(self._slow_work, self._on_changed_outside, self)
        self._watch.use(scenario.path, scenario.sha256)

    def handlers(self) -> Handlers:
        return {
            intents.OpenScenario: self._open,
            intents.SaveScenario: self._save,
            intents.ImportScenario: self._import,
            intents.ConfirmFile: self._confirm_file,
            intents.ShareScenario: self._share,
            intents.SavePlace: self._save_place,
            intents.RemovePlace: self._remove_place,
            intents.KeepLayout: self._store_layout,
            intents.SaveLayout: self._save_layout,
            intents.ResetLayout: self._reset_layout,
        }

    def use_scenario(self, scenario: Scenario) -> None:
        self._state.places.set(scenario.places)
        self._bus.publish(self._opened())

    def state_events(self, now_ns: int) -> list[Event]:
        """Initial events of a recording about it."""
        return [self._opened(), *([] if self._layout is None else [replace(self._layout, stamp_ns=now_ns)])]

    def _save_layout(self, intent: intents.SaveLayout) -> None:
        if self._parts.layouts is None:
            raise UserFacingError(
                tr("The panel layout was not saved."),
                tr("Nothing is saved in this run."),
                tr("Start the console without a rehearsal, and save the layout there."),
            )
        layouts, replaced = self._parts.layouts, self.current

        def written(path: Path) -> None:
            layouts.note_saved(path, intent, replaced=replaced)
            if intent.title:
                what = tr("The scenario {title} was created and is open.").format(title=intent.title)
                self._bus.inform(what, tr("It is in {path}.").format(path=path))
            else:
                where = tr("It is saved in your own copy, {path}.").format(path=path)
                self._bus.inform(tr("The panel layout was saved."), where)

        self._rewrite(lambda scenario: layouts.save(scenario, intent), written, intent.actor)

    def _reset_layout(self, intent: intents.ResetLayout) -> None:
        """Undo a saved layout in the file too; otherwise the next start would restore it."""
        if self._parts.layouts is None:
            return  # none was saved
        layouts = self._parts.layouts
        before = layouts.as_before(self.current)
        if before == self.current:
            return

        def written(path: Path) -> None:
            layouts.note_reset(path)
            self._bus.inform(
                tr("The panel layout was reset."), tr("The saved layout was undone."),
                tr("Save the layout again to store another one."),
            )  # fmt: skip

        self._rewrite(lambda scenario: layouts.reset(scenario, before), written, intent.actor)

    def _rewrite(self, write: Callable[[Scenario], Path], written: Callable[[Path], None], actor: Actor) -> None:
        """Write the scenario with ``write``, notify ``written``, and open the result.

        ``write`` runs in a background thread and raises UserFacingError.
        """

        def work() -> tuple[Path, Filed]:
            path = write(self._filed)
            return path, self._load(path)

        def done(outcome: tuple[Path, Filed]) -> None:
            path, filed = outcome
            written(path)
            self._use(filed, actor)

        self._slow_work.do(work, done, self._bus.answer)

    def start(self) -> None:
        self._watch.start()

    def stop(self) -> None:
        self._closed = True
        self._show.stop()
        self._watch.stop()

    def _on_changed_outside(self, path: Path) -> None:
        """Reopen the scenario after an external change, unless it needs a confirmation."""

        def work() -> Filed:
            try:
                return self._load(path)
            except ConfirmationNeededError:
                raise
            except UserFacingError as failure:
                raise RefusedError(
                    tr("The scenario file was changed and is now invalid."),
                    failure.meaning,
                    tr(
                        "The previous scenario stays in effect. Correct the file: the console reads it again "
                        "automatically."
                    ),
                ) from failure

        self._slow_work.do(work, lambda filed: self._use(filed, CONSOLE), self._bus.answer)

    def _open(self, intent: intents.OpenScenario) -> None:
        self._slow_work.do(
            lambda: self._load(intent.path), lambda filed: self._use(filed, intent.actor), self._bus.answer
        )

    def _confirm_file(self, intent: intents.ConfirmFile) -> None:
        """Save the confirmation before the pending intent: both go through the same queue."""
        question = self._state.file_question.value
        if question is None or question.sha256 != intent.sha256:
            return
        self._state.file_question.set(None)
        if not intent.accepted:
            self._bus.inform(
                tr("“{title}” is not used.").format(title=question.title),
                tr("Nothing that the file refers to was opened or connected."),
                tr("Open it again to confirm it, or correct the file."),
            )
            return

        def save() -> None:
            try:
                accept(question)
            except OSError as error:
                raise UserFacingError(
                    tr("Your answer could not be saved."),
                    tr("“{title}” is not used ({why}).").format(title=question.title, why=error.strerror or error),
                    tr("Free some disk space, or make your settings writable, then open it again."),
                ) from error

        self._slow_work.do(save, lambda _saved: None, self._bus.answer)

    def _save(self, intent: intents.SaveScenario) -> None:
        in_session = self._state.recording.value.state in IN_SESSION

        def work() -> tuple[SavedScenario, Filed | ConfirmationNeededError | None]:
            text = self._parts.save_text(intent.text, intent.path, intent.edited, intent.replaces)
            concerned = [path.resolve() for path in (intent.path, intent.edited) if path is not None]
            if in_session and intent.path not in (intent.edited, own_file(intent.edited)):
                # For another scenario the protocol would restart: the recording keeps its own.
                concerned = [intent.path.resolve()]
            open_now = self._filed.path is not None and self._filed.path.resolve() in concerned
            sha256 = hashlib.sha256(text.encode("utf-8")).hexdigest()
            try:
                return SavedScenario(intent.path, text, sha256), self._load(intent.path) if open_now else None
            except ConfirmationNeededError as needed:
                return SavedScenario(intent.path, text, sha256), needed

        def done(outcome: tuple[SavedScenario, Filed | ConfirmationNeededError | None]) -> None:
            saved, filed = outcome
            self._state.saved_scenario.reset_value(saved)
            if isinstance(filed, ConfirmationNeededError):
                self._bus.answer(filed)
            elif filed is not None:
                self._use(filed, intent.actor)

        def failed(failure: UserFacingError) -> None:
            taken = isinstance(failure.__cause__, OtherFileError)
            self._state.saved_scenario.reset_value(SavedScenario(intent.path, problem=failure.meaning, taken=taken))
            self._bus.answer(failure)

        self._slow_work.do(work, done, failed)

    def _import(self, intent: intents.ImportScenario) -> None:
        def work() -> tuple[Imported, Filed] | ImportQuestion:
            decided = {(one.kind, one.name) for one in intent.decided}
            conflicts = self._parts.conflicts(intent.path)
            if any((one.part.kind, one.part.name) not in decided for one in conflicts):
                return ImportQuestion(intent.path, conflicts)
            imported = self._parts.unpack(intent.path, intent.decided)
            return imported, self._load(imported.path)

        def done(outcome: tuple[Imported, Filed] | ImportQuestion) -> None:
            if isinstance(outcome, ImportQuestion):
                self._state.import_question.reset_value(outcome)
                return
            imported, filed = outcome
            self._use(filed, intent.actor)
            if not (imported.put_aside or imported.renamed):
                what = tr("“{title}” was imported and is open.").format(title=self.current.title)
                where = tr("It is in {path}.").format(path=imported.path)
                self._bus.inform(what, where)
            if imported.put_aside:
                self._bus.inform(
                    tr("The imported scenario replaced existing files."),
                    tr("The replaced files are not lost: they are in {files}.").format(files=imported.put_aside),
                    tr("Delete them when you no longer need them."),
                )
            if imported.renamed:
                self._bus.inform(
                    tr("These names were already in use: {names}.").format(names=imported.renamed),
                    tr("The existing files are unchanged, and the imported scenario uses its own files."),
                    tr("Compare the files when you have time."),
                )

        self._slow_work.do(work, done, self._bus.answer)

    def _share(self, intent: intents.ShareScenario) -> None:
        def done(_written: None) -> None:
            self._bus.inform(
                tr("The scenario was exported to {file}.").format(file=intent.path.name),
                tr(
                    "The file contains the phrases, places, prompts and notes, and the robot profile without any "
                    "secrets."
                ),
                tr("The recipient opens it with “Import a scenario”."),
            )

        self._slow_work.do(lambda: self._parts.share(self._filed, intent.path), done, self._bus.answer)

    def _load(self, path: Path) -> Filed:  # background thread
        self._filed = self._parts.load(path)
        return self._filed, self._parts.text(self._filed)

    def _use(self, filed: Filed, actor: Actor) -> None:
        before = self.current.path
        self.current, self._text = filed
        self._watch.use(self.current.path, self.current.sha256)
        self._opened_by = actor
        if self._closed:
            return
        self._layout = None
        if self.current.path != before:
            self._bus.hold_back(_POLL_EVERY_S)
        self._apply(self.current)
        self._show.start()

    def _show_current(self) -> None:
        # Reopened with the layout of its file.
        self._state.scenario.reset_value(self.current)

    def _opened(self) -> ScenarioOpened:
        scenario = self.current
        name = scenario.path.name if scenario.path else ""
        return ScenarioOpened(clock.now_ns(), name, scenario.title, scenario.sha256, self._text, self._opened_by)

    def _save_place(self, intent: intents.SavePlace) -> None:
        place = Place(" ".join(intent.place.split()), intent.pose_in_map)

        def with_it(places: Places) -> Places:
            at = next((index for index, one in enumerate(places) if one.name == place.name), len(places))
            return (*places[:at], place, *places[at + 1 :])

        self._change_places(with_it, PlacesChanged(clock.now_ns(), place.name, intent.pose_in_map, intent.actor))

    def _remove_place(self, intent: intents.RemovePlace) -> None:
        def without_it(places: Places) -> Places | None:
            left = tuple(place for place in places if place.name != intent.place)
            return left if len(left) < len(places) else None

        self._change_places(without_it, PlacesChanged(clock.now_ns(), intent.place, None, intent.actor))

    def _change_places(self, change: Callable[[Places], Places | None], event: PlacesChanged) -> None:
        """``change`` returns None for no change."""

        def work() -> Filed | None:
            places = change(self._filed.places)
            if places is None:
                return None
            self._filed = self._parts.save_places(replace(self._filed, places=places))
            return self._filed, self._parts.text(self._filed)

        def done(filed: Filed | None) -> None:
            if filed is None:
                return
            self.current, self._text = filed
            self._watch.use(self.current.path, self.current.sha256)
            self._opened_by = event.actor
            self._state.places.set(self.current.places)
            self._bus.publish(event)
            self._bus.publish(self._opened())
            self._state.scenario.set(self.current)

        self._slow_work.do(work, done, self._bus.answer)

    def _store_layout(self, intent: intents.KeepLayout) -> None:
        self._layout = LayoutChanged(clock.now_ns(), intent.layout, intent.actor)
        self._bus.publish(self._layout)


WATCH_EVERY_MS = 1000
FILE_AT_REST_MS = 250

Touched = tuple[int, int, int]
"""modification time in ns, size, inode"""


class ScenarioWatch(QObject):
    """File watcher of the scenario: detects a change by another program, once writing has finished.

    Calls ``changed(path)`` once per new content of the file. GUI thread; files are read in the background.

    Polls the file once a second instead of using notifications: cheap, works on network drives and with editors that
    replace the file, and QFileSystemWatcher was seen to hang and crash the program. A change counts if it is the same
    twice, so that a file being written is left alone. The program's own writes are announced by :meth:`use`, in the
    order of background work.
    """

    def __init__(
        self, slow_work: BackgroundWorker, changed: Callable[[Path], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._slow_work = slow_work
        self._changed = changed
        self._path: Path | None = None
        self._known = ""
        self._checksum_seen = ""
        self._touched: Touched | None = None
        self._asking = False
        self._clock = new_timer(self, self._ask, WATCH_EVERY_MS)
        self._rest = new_timer(self, self.check_contents, FILE_AT_REST_MS, single_shot=True)

    def start(self) -> None:
        self._clock.start()

    def stop(self) -> None:
        self._clock.stop()
        self._rest.stop()

    def use(self, path: Path | None, sha256: str) -> None:
        """Watch this file, with this checksum."""
        if path != self._path:
            self._touched = None
        self._path, self._known, self._checksum_seen = path, sha256, ""

    def check_contents(self) -> None:
        """Check the contents now, even if the file looks the same."""
        self._touched = None
        self._asking = False
        self._ask()

    def _ask(self) -> None:
        path, before = self._path, self._touched
        if path is None or self._asking:
            return  # an unresponsive disk is queried once
        self._asking = True

        def on_answer(found: tuple[Touched | None, str]) -> None:
            self._asking = False
            if path == self._path and found[0] != before:
                self._touched = found[0]
                sha256 = found[1]
                if sha256 in ("", self._known):
                    self._checksum_seen = ""  # temporarily missing, or unchanged
                elif sha256 != self._checksum_seen:
                    self._checksum_seen = sha256
                    if self._clock.isActive():
                        self._rest.start()
                else:
                    self._known, self._checksum_seen = sha256, ""
                    self._changed(path)

        self._slow_work.do(lambda: _read(path, before), on_answer, lambda _failure: None)


def _read(path: Path, before: Touched | None) -> tuple[Touched | None, str]:
    """File metadata, and the checksum if it differs from ``before``; None and empty if the file is missing."""
    try:
        found = path.stat()
        touched = found.st_mtime_ns, found.st_size, found.st_ino
        return touched, "" if touched == before else hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None, ""
