"""Console command: from arguments to a running window, and its orderly end."""

import argparse
import gc
import logging
import os
import platform
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from PySide6.QtCore import QLockFile, QSettings, Qt, QTimer
from PySide6.QtWidgets import QApplication

from caris_desktop import __version__
from caris_desktop.app import composition
from caris_desktop.app.arguments import build_parser
from caris_desktop.app.composition import StartError
from caris_desktop.app.demo_robot import FAULT, PROFILE, DemoRobot
from caris_desktop.app.qt_application import GarbageCollector, end_with_screen, forget_screen, the_application
from caris_desktop.app.user_settings import (
    OwnLayoutFiles,
    SavedSettings,
    bring_up_to_date,
    own_settings,
    retranslated_failure,
)
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import ANSWER
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.file_replacement import SHARE_VARIABLE, narrow
from caris_desktop.domain.sound_values import Role
from caris_desktop.domain.translation import tr
from caris_desktop.live.confirmed_files import ConfirmationNeededError
from caris_desktop.live.console import Console
from caris_desktop.live.logs import configure_logging, log_file
from caris_desktop.live.robot_connections import RobotConnections, show_window
from caris_desktop.live.robot_explorer import LiveRobotExplorer
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.session_library import LiveSessionLibrary
from caris_desktop.live.status import LinkStatus
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.quit_guard import ClosingWindow
from caris_desktop.ui.theme import SCALE_KEY, THEME_KEY, Theme, as_choice
from caris_desktop.ui.window_appearance import ENGLISH, LANGUAGE_KEY, Language

# Single console per study: two would overwrite each other's people, and drive one robot. A second start, such as
# another double click during the first, brings the existing window to the front.

_LOCK = ".console.lock"
# A console listens only once its window is shown, and may write for long at its end.
_WAITS_S, _TRIES_AFTER_S = 20.0, 0.25


class AlreadyOpenError(Exception):
    """The study is open on this computer, and its window is now in front."""


@contextmanager
def held(study: Path, consoles: Path) -> Iterator[None]:
    """Hold the study's lock. ``consoles``: where running consoles listen.

    Raises AlreadyOpenError, or StartError if the console that holds it cannot be shown.
    """
    lock = QLockFile(str(study / _LOCK))
    lock.setStaleLockTime(0)  # held as long as its process runs, however long that is
    until_s = time.monotonic() + _WAITS_S
    while not lock.tryLock(0):
        if lock.error() != QLockFile.LockError.LockFailedError:
            # A read-only study is reported when something is to be written.
            _log.warning("the study %s is not locked: %s", study, lock.error())
            break
        # Leave the study to the console that holds it, unless that is still starting or about to end.
        pid, host, _program = lock.getLockInfo()
        if pid and host != platform.node():
            raise StartError(
                f"The study {study} is open on the computer {host}. Two consoles cannot use the same study. "
                "Close it on that computer, or choose another folder with --study."
            )
        if pid and show_window(consoles, pid):
            raise AlreadyOpenError(f"The study {study} is already open: its window was brought to the front.")
        if time.monotonic() > until_s:
            raise StartError(
                f"The study {study} is open in another console (process {pid}), which does not respond. "
                "Close that console, or choose another folder with --study."
            )
        time.sleep(_TRIES_AFTER_S)
    try:
        yield
    finally:
        lock.unlock()


_log = logging.getLogger(__name__)
# No input has this name on any system.
_NO_MICROPHONE = "(none)"
_MICROPHONE_KEYS: dict[Role, str] = {"participant": "sound/microphone", "wizard": "sound/wizard_microphone"}
_GAMEPADS_KEY = "gamepad/mappings"
_SCENARIO_KEY = "scenario/last"
_OWN_ROBOT_KEY = "robot/own_simulated"


# A window that is invisible, on another desktop or behind others, is not painted.
_REST_AT_LATEST_MS = 2000


class ConsoleRun:
    """One run of the console: application, window, and everything to be ended with it.

    The window comes first; everything not needed to accept a key starts after it is shown.
    """

    def __init__(
        self,
        arguments: argparse.Namespace,
        *,
        settings: QSettings | None = None,
        robot: Callable[[Console], DemoRobot] | None = None,
    ) -> None:
        store = own_settings() if settings is None else settings
        self._settings_trouble = bring_up_to_date(store)
        self.settings = SavedSettings(store)
        self._arguments = arguments
        # Without a visible window, nobody can be asked.
        self._asks_robot = robot is None
        self._to_confirm: ConfirmationNeededError | None = None
        scenario, refused = self._scenario_to_start_with()
        study = composition.open_study(arguments.study)
        self._narrowed = study.narrowed + narrow([*composition.own_folders(), Path(store.fileName())])
        check_screen()
        self.application = the_application(str(self.settings.value(SCALE_KEY, "")))
        self._language = Language()
        self._language.use(arguments.language or str(self.settings.value(LANGUAGE_KEY, ENGLISH)))
        self._refused_scenario = _why_refused(refused) if refused else ""
        self.demo_robot: DemoRobot | None = None
        self._garbage: GarbageCollector | None = None
        self._to_start: deque[Callable[[], None]] = deque()
        parts = composition.parts(
            study=study,
            cameras=arguments.camera,
            address_of=lambda robot: self.demo_robot.address_of(robot) if self.demo_robot is not None else None,
            microphone=composition.microphones(self._stored_microphone, self._store_microphone),
        )
        practice = replace(parts.practice, robot=self._use_simulated_robot, cut_link=self._cut_link)
        robots = replace(parts.robots, simulated=self._use_simulated_robot)
        of_scenario = replace(parts.scenario, layouts=OwnLayoutFiles(self.settings, self._store_scenario))
        self.console = Console(replace(parts, practice=practice, robots=robots, scenario=of_scenario), scenario)
        self.settings.failed.connect(self._on_settings_failed)
        self.host = RobotConnections(self.console, composition.live_consoles_dir(), self.console)
        self.host.window_requested.connect(self._show_window)
        theme = self._theme = Theme(
            self.application, as_choice(arguments.theme or self.settings.value(THEME_KEY, "system"))
        )
        self.window = MainWindow(
            self.console,
            settings=self.settings,
            theme=theme,
            gamepads=self.console.gamepads,
            explorer=LiveRobotExplorer(self.console.asyncio_thread, self.console),
            all_panels=False,
        )
        self.library = LiveSessionLibrary(
            study.path,
            partial(self.console.problem, cause=ANSWER),
            self.console,
            replay_options=("--language", arguments.language) if arguments.language else (),
        )
        self.window.use_library(self.library)
        self.window.preferences.begin()
        self._make_demo_robot = robot
        if robot is None and arguments.demo:
            self._make_demo_robot = DemoRobot
        self.console.gamepads.use_mappings_text(str(self.settings.value(_GAMEPADS_KEY, "")))
        self.console.gamepads.mappings_changed.connect(partial(self.settings.setValue, _GAMEPADS_KEY))
        self.console.state.scenario.changed.connect(self._on_scenario_changed)
        self.console.state.link.changed.connect(self._on_link_changed)

    def show(self) -> None:
        """Show the window; start the rest once it is painted with all its panels: nine processes starting at once leave
        it no processor time for a second.
        """
        self.window.show_in_place()
        self.window.board.completed.connect(self._start_rest, Qt.ConnectionType.QueuedConnection)
        QTimer.singleShot(_REST_AT_LATEST_MS, self.window, self._start_rest)

    def _show_window(self) -> None:
        """Bring the window to the front, when the running console is started again."""
        if self.window.isMinimized():
            self.window.showNormal()
        self.window.raise_()
        self.window.activateWindow()
        self.application.alert(self.window)

    def close(self) -> None:
        """Stop the robot before waiting for anything else; a failure does not prevent the rest from ending."""
        self._to_start.clear()
        with ExitStack() as rest:  # last entered, first ended
            rest.callback(self.settings.finish)
            if self.demo_robot is not None:
                rest.callback(self.demo_robot.stop)
            if self._garbage is not None:
                rest.callback(self._garbage.stop)
            rest.callback(self.library.shutdown)
            rest.callback(self.host.shutdown)
            closing = ClosingWindow()
            rest.callback(closing.close)
            rest.callback(self.console.shutdown, closing.during)
            rest.callback(self.window.close)

    def _start_rest(self) -> None:
        """Start the rest over a few turns of the event loop, since keys are typed already."""
        if self._garbage is not None:
            return
        # Current objects stay for the whole run: excluding them from full collections avoids GUI stalls.
        gc.freeze()
        self._garbage = GarbageCollector(self.console)
        self._to_start.extend((
            self.console.start, self.host.start, self.begin_first_use, self.report_settings, self.report_narrowed,
            self.report_scenario,
            self._ask_or_connect,
        ))  # fmt: skip
        self._start_next()

    def _start_next(self) -> None:
        if self._to_start:
            self._to_start.popleft()()
            QTimer.singleShot(0, self.window, self._start_next)

    def _ask_or_connect(self) -> None:
        """If the first scenario awaits confirmation, its robot waits too."""
        if self._to_confirm is None:
            self._connect_first_robot()
            return
        self.console.state.file_question.changed.connect(self._on_file_question)
        self.console.state.file_question.reset_value(self._to_confirm.question)

    def _on_file_question(self, question: object) -> None:
        """Handle the answer: after a yes, the scenario opens a moment later, and its robot is connected."""
        if question is not None or self._to_confirm is None:
            return
        self.console.state.file_question.changed.disconnect(self._on_file_question)
        self._to_confirm = None
        # The scenario is requested again in the next turn; later requests queue behind it.
        QTimer.singleShot(
            0, self.window, lambda: self.console.run_in_background(lambda: None, lambda _: self._connect_first_robot())
        )

    def _connect_first_robot(self) -> None:
        if self._make_demo_robot is not None:
            self.demo_robot = self._make_demo_robot(self.console)
            self.demo_robot.start()
            return
        named, robot = self._arguments.robot, self._arguments.robot or self.console.scenario.robot
        last = "" if named else self.window.preferences.robot_of_last_time
        if not named and (last or robot) == PROFILE and self.settings.value(_OWN_ROBOT_KEY, "") == "yes":
            # It ended with the console that had started it.
            self._use_simulated_robot(WIZARD)
            return
        self.console.use_robot(lambda: self._robot_to_start_with(robot, last), until="connected")

    def begin_first_use(self) -> None:
        """Start the introduction, unless the user names a robot and so knows the program, or in a rehearsal."""
        if self._make_demo_robot in (None, DemoRobot) and self._arguments.robot is None:
            self.window.first_use.begin(with_simulated_robot=self._arguments.demo)

    def report_settings(self) -> None:
        """Report settings of the last run that could not be loaded."""
        if self._settings_trouble is not None:
            self._on_settings_failed(retranslated_failure(self._settings_trouble))

    def report_narrowed(self) -> None:
        """Report files that were open to other users of this computer."""
        if self._narrowed:
            self.console.problem(
                "info",
                tr(
                    "%n files and folders of this study and your settings were accessible to other users.",
                    "",
                    self._narrowed,
                ),
                tr("From now on, only you can read them and everything recorded later."),
                tr("To share a study with your group, start with {variable}=1.").format(variable=SHARE_VARIABLE),
            )

    def report_scenario(self) -> None:
        """Report that another scenario than that of the last run is open."""
        if self._refused_scenario:
            self.console.problem(
                "warning",
                tr("The previous scenario was not opened."),
                self._refused_scenario,
                tr("{title} is open instead. Correct the file and open it.").format(title=self.console.scenario.title),
            )

    def _on_settings_failed(self, failure: UserFacingError) -> None:
        self.console.problem(failure.severity, failure.what, failure.meaning, failure.advice)

    def _robot_to_start_with(self, robot: str, last: str) -> RobotConnection:
        """Robot of the ``last`` run if one of that name still exists, else ``robot``. Raises UserFacingError."""
        if self._arguments.accept_named:
            composition.confirm_robot(robot, accept_named=True)
        if last:
            with suppress(composition.StartError):
                return composition.robot_connection(last)
        try:
            return composition.robot_connection(robot)
        except composition.StartError as refusal:
            raise UserFacingError(
                str(refusal), tr("No robot is connected."), tr("Start again with another --robot.")
            ) from refusal

    def _use_simulated_robot(self, actor: Actor) -> None:
        """Connect the simulated robot, now or as soon as it is ready."""
        if self.demo_robot is None:
            self.demo_robot = DemoRobot(self.console, actor=actor)
            self.demo_robot.start()
        else:
            self.demo_robot.use(actor)

    def _cut_link(self, seconds: float) -> None:
        if self.demo_robot is not None:
            self.demo_robot.call(FAULT, [{"command": f"drop_link:{seconds:g}"}])

    def _scenario_to_start_with(self) -> tuple[Scenario, str]:
        """Requested scenario, else that of the last run; if that is invalid, the tour guide and the invalid one's name.

        Raises StartError.
        """
        named = self._arguments.scenario
        last_time = str(self.settings.value(_SCENARIO_KEY, "tour-guide"))
        try:
            reference = named or last_time
            accepted = self._arguments.accept_named
            return composition.find_scenario(reference, accept_named=accepted, ask=self._asks_robot), ""
        except ConfirmationNeededError as needed:
            self._to_confirm = needed
            return composition.find_scenario("tour-guide"), ""
        except composition.StartError:
            if named:
                raise
            return composition.find_scenario("tour-guide"), last_time

    def _stored_microphone(self, role: Role) -> str | None:
        """Stored microphone; empty for the system's default, None if switched off."""
        stored = str(self.settings.value(_MICROPHONE_KEYS[role], ""))
        return None if stored == _NO_MICROPHONE else stored

    def _store_microphone(self, role: Role, name: str | None) -> None:
        self.settings.setValue(_MICROPHONE_KEYS[role], _NO_MICROPHONE if name is None else name)

    def _on_link_changed(self, link: LinkStatus) -> None:
        """Store whether the last robot was one of this console's own."""
        if link.state == "connected":
            is_demo = self.demo_robot is not None and link.address == self.demo_robot.address_of(PROFILE)
            if (self.settings.value(_OWN_ROBOT_KEY, "") == "yes") != is_demo:
                self.settings.setValue(_OWN_ROBOT_KEY, "yes" if is_demo else "")

    def _on_scenario_changed(self, scenario: Scenario) -> None:
        practising = self.console.state.practice.value.state in ("preparing", "running")
        if scenario.path is not None and not practising:
            self._store_scenario(scenario.path)

    def _store_scenario(self, path: Path) -> None:
        """Store the scenario for the next start."""
        self.settings.setValue(_SCENARIO_KEY, str(path))


def _why_refused(scenario: str) -> str:
    """Reason why the scenario is refused, in the wizard's language: called once that is in use."""
    try:
        composition.find_scenario(scenario)
    except composition.StartError as refusal:
        return str(refusal)
    return ""


def run(arguments: argparse.Namespace) -> int:
    """Open the window and run until it is closed."""
    configure_logging(log_file(), verbose=arguments.verbose)
    _log.info("CARIS Desktop %s starts", __version__)
    try:
        with held(composition.open_study(arguments.study).path, composition.live_consoles_dir()):
            console_run = ConsoleRun(arguments)
            end_on_request(console_run)
            console_run.show()
            try:
                return console_run.application.exec()
            finally:
                console_run.close()
                forget_screen()
    except AlreadyOpenError as error:
        print(error)
        return 0
    except composition.StartError as refusal:
        print(refusal, file=sys.stderr)
        return 2


def end_on_request(console_run: ConsoleRun) -> None:
    """End in order on Ctrl+C, when the terminal is closed, and at shutdown or logout; at once when
    the screen is lost.
    """
    application, console = console_run.application, console_run.console

    def end(_number: int, _frame: object) -> None:
        console.expect_end()
        # Nobody can be asked, and a window in use for driving would stay.
        application.exit(0)

    on_signals(application, end)
    application.commitDataRequest.connect(lambda _manager: console.expect_shutdown())
    application.aboutToQuit.connect(console.expect_end)
    end_with_screen(application)


def on_signals(application: QApplication, end: Callable[[int, object], None]) -> None:
    """Call ``end`` on Ctrl+C, when the terminal is closed, and when the system asks the program to end."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), end)
    heartbeat = QTimer(application)
    heartbeat.timeout.connect(lambda: None)  # Python handles signals only between Qt events
    heartbeat.start(200)


def check_screen() -> None:
    """Check for a screen: without one, Qt would abort with an unhelpful message. Raises StartError."""
    places = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in places):
        raise composition.StartError(
            "No screen is available for the window. Start the console from a desktop session. Without one, "
            "'caris-desktop rehearse' plays a scenario, and 'bash packaging/demo.sh' creates a virtual "
            "screen for it."
        )


def default_arguments(**changes: object) -> argparse.Namespace:
    """Console arguments for an empty command line."""
    return build_parser().parse_args([], argparse.Namespace(**changes))
