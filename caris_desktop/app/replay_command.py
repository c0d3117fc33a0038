"""``caris-desktop replay``: a recorded session, or somebody else's bag, in the console's window."""

import argparse
import asyncio
import functools
import hashlib
import json
import logging
import signal
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QSettings, QTimer
from PySide6.QtWidgets import QApplication, QProgressDialog

from caris_desktop import __version__
from caris_desktop.app import composition
from caris_desktop.app.console_command import check_screen
from caris_desktop.domain.events import LayoutChanged, RobotChosen, ScenarioOpened
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.garbage import GarbageCollector
from caris_desktop.live.logs import configure_logging
from caris_desktop.live.replay_console import ReplayConsole, ReplayParts
from caris_desktop.people.register import PeopleRegister, PeopleStoreError
from caris_desktop.recording.bag_import import BagError, import_bag, looks_like_bag
from caris_desktop.recording.recovery import needs_repair
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session_reader import Session, SessionError, open_session
from caris_desktop.robot.profile import RobotProfile, parse_profile
from caris_desktop.scenario.file import parse_scenario
from caris_desktop.scenario.layout import checked_layout
from caris_desktop.scenario.model import LayoutNode, Scenario
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme, as_choice

_log = logging.getLogger(__name__)
_LOOK_EVERY_S = 0.02


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "session", type=Path, help="folder of a session, or a ROS bag (.bag, a rosbag2 folder, an .mcap file)"
    )
    parser.add_argument("--at", type=float, metavar="SECONDS", help="begin at this second of the session")
    parser.add_argument("--at-ns", type=int, help=argparse.SUPPRESS)  # the same on the session's own clock
    parser.add_argument("--theme", choices=("system", "dark", "light"), help="this run's theme")
    parser.add_argument("--verbose", action="store_true", help="show the log in the terminal")


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 when the window was closed, 2 when the session could not be opened (stderr says why)."""
    configure_logging(composition.log_file(), verbose=arguments.verbose)
    try:
        check_screen()
        replay = ReplayRun(arguments)
    except (composition.StartError, SessionError) as refusal:
        print(refusal, file=sys.stderr)
        return 2
    for notice in replay.console.session.notices:
        print(notice, file=sys.stderr)
    signal.signal(signal.SIGINT, lambda *_: replay.application.closeAllWindows())
    signal.signal(signal.SIGTERM, lambda *_: replay.application.closeAllWindows())
    heartbeat = QTimer()
    heartbeat.timeout.connect(lambda: None)  # Python sees signals only between Qt events
    heartbeat.start(200)
    replay.show()
    try:
        return replay.application.exec()
    finally:
        replay.close()


class ReplayRun:
    """One replay: the session, what stands in for the console, and the window. Raises StartError, SessionError."""

    def __init__(self, arguments: argparse.Namespace, *, settings: QSettings | None = None) -> None:
        self._arguments = arguments
        existing = QApplication.instance()
        self.application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
        self.application.setApplicationName("CARIS Desktop")
        self.application.setApplicationVersion(__version__)
        self.settings = QSettings("caris-desktop", "console") if settings is None else settings
        session = _opened(_session_folder(arguments.session))
        self._videos = VideoReader(session)
        self._register = _register_of(session)
        self.console = ReplayConsole(
            ReplayParts(
                start_scenario=_first_scenario(session),
                read_scenario=_read_scenario,
                read_layout=_read_layout,
                read_robot=_read_robot,
                name_of=self._name_of,
                end_ns=session.ended_ns,
                cameras=self._videos.cameras,
                frame_times=functools.cache(self._videos.frame_times_ns),
                monotonic_ns=time.monotonic_ns,
            ),
            session,
        )
        theme = Theme(self.application, as_choice(arguments.theme or self.settings.value("theme", "system")))
        self.window = MainWindow(self.console, settings=self.settings, theme=theme, scenarios=lambda: ())
        self.window.use_replay(self.console)
        self._garbage: GarbageCollector | None = None

    def show(self) -> None:
        self.window.show()
        QTimer.singleShot(0, self._start_rest)

    def close(self) -> None:
        self.window.close()
        self.console.shutdown()
        self._videos.close()
        if self._garbage is not None:
            self._garbage.stop()

    def _start_rest(self) -> None:
        self._garbage = GarbageCollector(self.console)
        self.console.start()
        if self._arguments.at_ns is not None:
            self.console.seek(self._arguments.at_ns)
        elif self._arguments.at is not None:
            self.console.seek(self.console.session.started_ns + round(self._arguments.at * 1e9))

    def _name_of(self, person_id: str) -> str | None:
        if self._register is None:
            return None
        try:
            person = self._register.get(person_id)
        except PeopleStoreError:
            _log.warning("the name of a person cannot be read", exc_info=True)
            return None
        return None if person is None else person.name


def _opened(folder: Path) -> Session:
    """Open it; repairing a long one takes a while, which a small window tells. Raises SessionError."""
    if not needs_repair(folder):
        return open_session(folder)
    told = QProgressDialog()
    told.setWindowTitle("CARIS Desktop")
    told.setLabelText(
        "This session was cut off while it was recorded.\n"
        "It is being repaired; nothing of what was found is thrown away."
    )
    told.setRange(0, 0)
    told.setCancelButton(None)
    told.setMinimumDuration(500)
    told.setValue(0)
    background = AsyncioThread()
    try:
        opened = background.submit(asyncio.to_thread(open_session, folder))
        while not opened.done():
            QApplication.processEvents()
            time.sleep(_LOOK_EVERY_S)
        return opened.result()
    finally:
        background.stop()
        told.close()


def _session_folder(path: Path) -> Path:
    """The session at ``path``; a bag becomes one first, in the user's cache. Raises SessionError."""
    if not path.exists():
        raise SessionError(f"There is no {path}.")
    if (path / "session.json").exists() or not looks_like_bag(path):
        return path
    return _imported(path)


def _imported(bag: Path) -> Path:
    """The session that the bag was made into, once: told apart by place, size and time. Raises SessionError."""
    folder = composition.imports_dir() / _import_name(bag)
    if (folder / "session.json").exists():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    print(f"Reading {bag.name} …", file=sys.stderr)
    # A folder of another name until it is whole.
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".import-") as workplace:
        partial = Path(workplace) / folder.name
        try:
            report = import_bag(bag, partial)
        except BagError as error:
            raise SessionError(str(error)) from error
        partial.replace(folder)
    for topic in report.not_understood:
        print(f"Not understood: {topic.topic} ({topic.type}): {topic.reason}", file=sys.stderr)
    return folder


def _import_name(bag: Path) -> str:
    parts = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
    facts = [(str(part.resolve()), part.stat().st_size, part.stat().st_mtime_ns) for part in parts if part.is_file()]
    digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:12]
    return f"{bag.stem[:40]}-{digest}"


def _first_scenario(session: Session) -> Scenario:
    """The scenario that the record begins with; where it does not say, the tour guide's panels are shown."""
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
        raise ValueError("the recording does not hold the scenario")
    return parse_scenario(opened.content, path=Path(opened.file_name or "scenario.yaml"))


def _read_layout(changed: LayoutChanged) -> LayoutNode:
    """Checked by the schema of scenario files, as whatever comes from a file."""
    return checked_layout(json.loads(changed.layout))


def _read_robot(chosen: RobotChosen) -> RobotProfile:
    return parse_profile(chosen.profile, file_name=f"{chosen.name}.yaml", name=chosen.name)


def _register_of(session: Session) -> PeopleRegister | None:
    """Names of people, where the session lies in its study."""
    database = session.folder.resolve().parent.parent / "people.sqlite"
    if not database.is_file():
        return None
    try:
        return PeopleRegister(database)
    except PeopleStoreError:
        _log.warning("names of people are not shown", exc_info=True)
        return None
