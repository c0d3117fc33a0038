"""``caris-desktop replay``: a recorded session, or a foreign bag, in the console's window."""

import argparse
import functools
import gc
import hashlib
import json
import logging
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from PySide6.QtCore import QSettings, QTimer
from PySide6.QtWidgets import QApplication, QProgressDialog

from caris_desktop.app import composition
from caris_desktop.app.console_command import check_screen, on_signals
from caris_desktop.app.qt_application import GarbageCollector, end_with_screen, forget_screen, the_application
from caris_desktop.app.user_settings import SavedSettings, bring_up_to_date, own_settings, retranslated_failure
from caris_desktop.domain.events import LayoutChanged, Problem, ScenarioOpened
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.background_worker import do_in_parallel
from caris_desktop.live.logs import configure_logging, log_file
from caris_desktop.live.replay_console import ReplayAdapters, ReplayConsole
from caris_desktop.people.people_store import PeopleStore, PeopleStoreError
from caris_desktop.recording.foreign.bag_files import BagError, is_probably_bag
from caris_desktop.recording.foreign.bag_import import import_bag
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.recovery import needs_repair
from caris_desktop.recording.session.session_header import SessionError, is_session
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.robot.profile import parse_profile
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_file import ScenarioError, parse_scenario
from caris_desktop.scenario.scenario_model import LayoutNode, Scenario, checked_layout
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import THEME_KEY, Theme, as_choice
from caris_desktop.ui.window_appearance import ENGLISH, LANGUAGE_KEY, Language

_log = logging.getLogger(__name__)
T = TypeVar("T")
_IMPORT_PREFIX = ".import-"
_UNFINISHED_AFTER_S = 24 * 3600.0
# Each jump requests these again, and parsing one takes longer than the window may freeze.
_MAX_TEXTS = 64


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "session", type=Path, help="session folder, or a ROS bag (.bag, a rosbag2 folder, an .mcap file)"
    )
    parser.add_argument("--at", type=float, metavar="SECONDS", help="start at this second of the session")
    parser.add_argument("--at-ns", type=int, help=argparse.SUPPRESS)  # the same on the session's own clock
    parser.add_argument("--theme", choices=("system", "dark", "light"), help="theme for this run")
    parser.add_argument(
        "--language", metavar="NAME", help="language for this run, such as 'de' (default: the console's language)"
    )
    parser.add_argument("--told-in-window", action="store_true", help=argparse.SUPPRESS)  # in its language
    parser.add_argument("--verbose", action="store_true", help="show the log in the terminal")


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 if the window was closed, 1 if annotations could not be saved, 2 if the session could not be
    opened (reason on stderr).
    """
    configure_logging(log_file(), verbose=arguments.verbose)
    try:
        check_screen()
        replay = ReplayRun(arguments)
    except (composition.StartError, SessionError) as refusal:
        reason = str(refusal)
        print(tr(reason) if arguments.told_in_window else reason, file=sys.stderr)
        return 2
    session = replay.console.session
    for sentence in dict.fromkeys((*session.notices, *session.losses)):
        print(sentence, file=sys.stderr)
    on_signals(replay.application, lambda *_: replay.application.closeAllWindows())
    end_with_screen(replay.application)
    replay.show()
    try:
        status = replay.application.exec()
    finally:
        replay.close()
        forget_screen()
    if replay.console.unsaved:
        print(replay.console.unsaved, file=sys.stderr)
        return status or 1
    return status


class ReplayRun:
    """One replay: session, replacement of the console, and window. Raises StartError, SessionError."""

    def __init__(self, arguments: argparse.Namespace, *, settings: QSettings | None = None) -> None:
        self._arguments = arguments
        self.application = the_application()
        store = own_settings() if settings is None else settings
        self._settings_trouble = bring_up_to_date(store)
        self.settings = SavedSettings(store)
        self._language = Language()
        self._language.use(arguments.language or str(self.settings.value(LANGUAGE_KEY, ENGLISH)))
        session = _opened(_session_folder(arguments.session))
        self._videos = VideoReader(session)
        self._people = _people_of(session)
        self.console = ReplayConsole(parts_of(session, self._videos, self._name_of), session)
        theme = Theme(self.application, as_choice(arguments.theme or self.settings.value(THEME_KEY, "system")))
        self.window = MainWindow(self.console, settings=self.settings, theme=theme, scenarios=lambda: ())
        self.window.use_replay(self.console)
        self.settings.failed.connect(self._on_settings_failed)
        self._garbage: GarbageCollector | None = None

    def show(self) -> None:
        self.window.show_in_place()
        QTimer.singleShot(0, self._start_rest)

    def close(self) -> None:
        with ExitStack() as rest:  # last entered, first ended, whatever else fails
            rest.callback(self.settings.finish)
            if self._garbage is not None:
                rest.callback(self._garbage.stop)
            if self._people is not None:
                rest.callback(self._people.close)
            rest.callback(self._videos.close)
            rest.callback(self.console.shutdown)
            rest.callback(self.window.close)

    def _start_rest(self) -> None:
        self._garbage = GarbageCollector(self.console)
        self.console.start()
        if self._settings_trouble is not None:
            self._on_settings_failed(retranslated_failure(self._settings_trouble))
        if self._arguments.at_ns is not None:
            self.console.seek(self._arguments.at_ns)
        elif self._arguments.at is not None:
            self.console.seek(self.console.session.started_ns + round(self._arguments.at * 1e9))

    def _on_settings_failed(self, failure: UserFacingError) -> None:
        now_ns = self.console.state.present.now_ns()
        self.window.problems.show_problem(
            Problem(now_ns, failure.severity, failure.what, failure.meaning, failure.advice)
        )

    def _name_of(self, person_id: str) -> str | None:
        if self._people is None:
            return None
        try:
            return self._people.name_of(person_id)
        except PeopleStoreError:
            _log.warning("the name of a person cannot be read", exc_info=True)
            return None


def parts_of(session: Session, videos: VideoReader, name_of: Callable[[str], str | None]) -> ReplayAdapters:
    """Parts of this session's replay. Raises SessionError."""
    return ReplayAdapters(
        start_scenario=_first_scenario(session),
        read_scenario=_read_scenario,
        read_layout=_read_layout,
        read_robot=lambda chosen: _or_raise(_robot_in(chosen.profile, chosen.name)),
        name_of=name_of,
        end_ns=session.ended_ns,
        cameras=videos.cameras,
        frame_times=functools.cache(videos.frame_times_ns),
        monotonic_ns=time.monotonic_ns,
        unsaved_dir=log_file().parent / "unsaved annotations",
        live_consoles=composition.live_consoles_dir(),
    )


def _opened(folder: Path) -> Session:
    """Open a session; a small window shows the progress of a long repair. Raises SessionError."""
    if not needs_repair(folder):
        return open_session(folder)
    gc.enable()  # disabled for a quick start, which a repair is not
    dialog = QProgressDialog()
    dialog.setWindowTitle("CARIS Desktop")
    dialog.setLabelText(
        tr(
            "This session was interrupted while it was being recorded.\nIt is being repaired; nothing that "
            "was found is discarded."
        )
    )
    dialog.setRange(0, 0)
    dialog.setCancelButton(None)
    dialog.setMinimumDuration(500)
    dialog.setValue(0)
    try:
        return do_in_parallel(lambda: open_session(folder), QApplication.processEvents)
    finally:
        dialog.close()


def _session_folder(path: Path) -> Path:
    """Session at ``path``; a bag is first converted, in the user's cache. Raises SessionError."""
    if not path.exists():
        raise SessionError(QT_TR_NOOP("{path} does not exist."), path=path)
    if is_session(path) or not is_probably_bag(path):
        return path
    return _imported(path)


def _imported(bag: Path) -> Path:
    """Session converted from the bag, cached by path, size and time. Raises SessionError."""
    folder = composition.imports_dir()
    try:
        folder /= _import_name(bag)
        if (folder / "session.json").exists():
            return folder
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Remove what killed programs left behind; younger imports may still be in progress. Raises OSError.
        for path in folder.parent.iterdir():
            unfinished = path.name.startswith(_IMPORT_PREFIX) or (path.name[:1] == "." and path.suffix == ".importing")
            if unfinished and not path.is_symlink() and time.time() - path.stat().st_mtime > _UNFINISHED_AFTER_S:
                _log.info("removing %s, which an import left behind", path)
                shutil.rmtree(path, ignore_errors=True)
        print(f"Reading {bag.name} …", file=sys.stderr)
        gc.enable()  # as above
        # A folder of another name until it is whole.
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=_IMPORT_PREFIX) as workplace:
            partial = Path(workplace) / folder.name
            report = import_bag(bag, partial)
            partial.replace(folder)
    except BagError as error:
        raise SessionError(str(error)) from error
    except OSError as error:
        if (folder / "session.json").exists():
            return folder  # another replay of this bag was faster
        _log.warning("importing %s into %s", bag, folder, exc_info=True)
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{bag} cannot be opened: converting it to a session in {folder} failed ({why}). Free "
                    "some disk space there, and make sure that the folder is writable."
                ),
                bag=bag,
                folder=folder.parent,
                why=error.strerror or error,
            )
        ) from error
    for topic in report.not_understood:
        print(f"Skipped: {topic.topic} ({topic.type}): {topic.reason}", file=sys.stderr)
    return folder


def _import_name(bag: Path) -> str:
    parts = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
    facts = [(str(part.resolve()), part.stat().st_size, part.stat().st_mtime_ns) for part in parts if part.is_file()]
    digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:12]
    return f"{bag.stem[:40]}-{digest}"


def _first_scenario(session: Session) -> Scenario:
    """First scenario of the record; the tour guide if there is none."""
    with SessionTimeline(session) as timeline:
        opened = next(iter(timeline.events(ScenarioOpened)), None)
    if opened is not None:
        try:
            return replace(_read_scenario(opened[1]), sha256=opened[1].sha256)
        except ValueError as error:
            _log.warning("the scenario of the session cannot be read: %s", error)
    return composition.find_scenario("tour-guide")


def _read_scenario(opened: ScenarioOpened) -> Scenario:
    if not opened.content:
        raise ValueError("the recording does not contain the scenario")
    return _or_raise(_scenario_in(opened.content, opened.file_name or "scenario.yaml"))


def _read_layout(changed: LayoutChanged) -> LayoutNode:
    """Layout of the record, checked by the schema of scenario files like any foreign file."""
    layout = _layout_in(changed.layout)
    if isinstance(layout, ValueError):
        raise layout.with_traceback(None)
    return layout


def _or_raise(read: T | ValueError) -> T:
    """Return the value or raise the cached error: each jump requests it again."""
    if isinstance(read, ValueError):
        raise read.with_traceback(None)
    return read


@functools.lru_cache(_MAX_TEXTS)
def _scenario_in(text: str, file_name: str) -> Scenario | ValueError:
    try:
        return parse_scenario(text, path=Path(file_name), recorded=True)
    except (ScenarioError, ValueError, RecursionError) as error:
        return ValueError(str(error))


@functools.lru_cache(_MAX_TEXTS)
def _layout_in(text: str) -> LayoutNode | ValueError:
    try:
        return checked_layout(json.loads(text))
    except (ValueError, RecursionError) as error:
        return ValueError(str(error))


@functools.lru_cache(_MAX_TEXTS)
def _robot_in(text: str, name: str) -> RobotProfile | ValueError:
    try:
        return parse_profile(text, file_name=f"{name}.yaml", name=name)
    except (ValueError, RecursionError) as error:
        return ValueError(str(error))


def _people_of(session: Session) -> PeopleStore | None:
    """Names of people, if the session is in its study folder."""
    database = session.folder.resolve().parent.parent / "people.sqlite"
    if not database.is_file():
        return None
    try:
        return PeopleStore(database)
    except PeopleStoreError:
        _log.warning("names of people are not shown", exc_info=True)
        return None
