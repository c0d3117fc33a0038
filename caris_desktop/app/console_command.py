"""The console itself: from arguments to a running window and back."""

import argparse
import gc
import logging
import os
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from PySide6.QtCore import QSettings, QTimer

from caris_desktop import __version__
from caris_desktop.app import bodies, composition
from caris_desktop.app.demo_robot import DemoRobot
from caris_desktop.app.qt_application import the_application
from caris_desktop.app.saved_layouts import SavedLayouts
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.live.child_process import ProcessBody
from caris_desktop.live.console import Console
from caris_desktop.live.garbage import GarbageCollector
from caris_desktop.live.live_robots import LiveRobotHost
from caris_desktop.live.logs import configure_logging, log_file
from caris_desktop.live.robot_explorer import LiveRobotExplorer
from caris_desktop.live.services.microphone import MicrophoneParts
from caris_desktop.live.services.robot import RobotConnection
from caris_desktop.live.session_library import LiveSessionLibrary
from caris_desktop.scenario.model import LayoutNode, Scenario
from caris_desktop.ui.closing_window import ClosingWindow
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme, as_choice

_log = logging.getLogger(__name__)
# No input of any system is called so.
_NO_MICROPHONE = "(none)"


_REST_AFTER_MS = 30  # the window is painted first, and takes its first key


class ConsoleRun:
    """One run of the console: the application, its window and what must be ended with it.

    The window comes first; everything that it does not need to accept a key starts once it is shown.
    """

    def __init__(
        self,
        arguments: argparse.Namespace,
        *,
        settings: QSettings | None = None,
        robot: Callable[[Console], DemoRobot] | None = None,
    ) -> None:
        self.settings = settings or own_settings()
        self._arguments = arguments
        scenario, self._refused_scenario = self._scenario_to_start_with()
        study = composition.open_study(arguments.study)
        check_screen()
        self.application = the_application()
        self.demo_robot: DemoRobot | None = None
        self._garbage: GarbageCollector | None = None
        parts = composition.parts(
            study=study,
            cameras=arguments.camera,
            address_of=self._address_of,
            microphone=MicrophoneParts(
                ProcessBody("microphone", bodies.microphone), self._kept_microphone, self._keep_microphone
            ),
        )
        self.console = Console(parts, scenario)
        self.host = LiveRobotHost(self.console, composition.live_consoles_dir(), self.console)
        theme = self._theme = Theme(
            self.application, as_choice(arguments.theme or self.settings.value("theme", "system"))
        )
        self.window = MainWindow(
            self.console,
            settings=self.settings,
            theme=theme,
            gamepads=self.console.gamepads,
            explorer=LiveRobotExplorer(self.console.asyncio_thread, self.console),
        )
        self.library = LiveSessionLibrary(study.path, self.console.problem, self.console)
        self.window.use_library(self.library)
        self._saved_layouts = SavedLayouts(self.settings)
        self.window.layout_save_requested.connect(self._on_layout_save_requested)
        self.window.layout_reset_requested.connect(self._on_layout_reset_requested)
        self._make_demo_robot = robot
        if robot is None and arguments.demo:
            self._make_demo_robot = DemoRobot
        self.console.gamepads.use_mappings_text(str(self.settings.value("gamepads", "")))
        self.console.gamepads.mappings_changed.connect(self._keep_gamepads)
        self.console.state.scenario.changed.connect(self._on_scenario_changed)

    def show(self) -> None:
        self.window.show_in_place()
        QTimer.singleShot(_REST_AFTER_MS, self._start_rest)

    def close(self) -> None:
        """The robot is stopped before anything else is waited for; what fails does not keep the rest from ending."""
        with ExitStack() as rest:  # what is entered first ends last
            if self.demo_robot is not None:
                rest.callback(self.demo_robot.stop)
            if self._garbage is not None:
                rest.callback(self._garbage.stop)
            rest.callback(self.library.shutdown)
            rest.callback(self.host.shutdown)
            closing = ClosingWindow(self._theme)
            rest.callback(closing.close)
            rest.callback(self.console.shutdown, closing.during)
            rest.callback(self.window.close)

    def _start_rest(self) -> None:
        # What exists now stays for the whole run: no full collection need walk it, which stalls the GUI.
        gc.freeze()
        self._garbage = GarbageCollector(self.console)
        self.console.start()
        self.host.start()
        if self._refused_scenario:
            self.console.problem(
                "warning",
                "The scenario of last time was not opened.",
                f"{self._refused_scenario}",
                f"{self.console.scenario.title} is open instead. Correct the file and open it.",
            )
        if self._make_demo_robot is not None:
            self.demo_robot = self._make_demo_robot(self.console)
            self.demo_robot.start()
            return
        robot = self._arguments.robot or self.console.scenario.robot
        self.console.use_robot(lambda: self._robot_to_start_with(robot), until="connected")

    def _robot_to_start_with(self, robot: str) -> RobotConnection:
        """Raises ToldFailure."""
        try:
            return composition.robot_connection(robot)
        except composition.StartError as refusal:
            raise ToldFailure(str(refusal), "No robot is connected.", "Start again with another --robot.") from refusal

    def _address_of(self, robot: str) -> str | None:
        return self.demo_robot.address_of(robot) if self.demo_robot is not None else None

    def _scenario_to_start_with(self) -> tuple[Scenario, str]:
        """What was asked for; else the one of last time, or, with the reason, the tour guide where that is broken.

        Raises StartError.
        """
        if self._arguments.scenario:
            return composition.find_scenario(self._arguments.scenario), ""
        last_time = str(self.settings.value("scenario", "tour-guide"))
        try:
            return composition.find_scenario(last_time), ""
        except composition.StartError as refusal:
            return composition.find_scenario("tour-guide"), str(refusal)

    def _on_layout_save_requested(self, layout: LayoutNode) -> None:
        replaced = self.console.scenario

        def written(path: Path) -> None:
            self._saved_layouts.note(path, layout, replaced=replaced)
            self._keep_scenario(path)
            self.console.problem("info", "The panel layout was saved.", f"It is in your own copy, {path}.", "")

        self.console.rewrite_scenario(lambda scenario: composition.save_layout(scenario, layout), written)

    def _on_layout_reset_requested(self) -> None:
        """An arrangement that was saved is undone in its file too, or the next start would bring it back."""
        before = self._saved_layouts.before(self.console.scenario)
        if before is None:
            return

        def written(path: Path) -> None:
            self._saved_layouts.forget(path)
            self.console.problem(
                "info", "The panels are back.", "The layout that was saved is undone.", "Save it again to keep another."
            )

        self.console.rewrite_scenario(lambda scenario: composition.save_layout(scenario, before), written)

    def _kept_microphone(self) -> str | None:
        """The system's default until another was chosen."""
        kept = str(self.settings.value("microphone", ""))
        return None if kept == _NO_MICROPHONE else kept

    def _keep_microphone(self, name: str | None) -> None:
        self.settings.setValue("microphone", _NO_MICROPHONE if name is None else name)

    def _keep_gamepads(self, mappings: str) -> None:
        self.settings.setValue("gamepads", mappings)

    def _on_scenario_changed(self, scenario: Scenario) -> None:
        if scenario.path is not None:
            self._keep_scenario(scenario.path)

    def _keep_scenario(self, path: Path) -> None:
        """It is open when the program starts again."""
        self.settings.setValue("scenario", str(path))


def run(arguments: argparse.Namespace) -> int:
    """Open the window and stay until it is closed."""
    configure_logging(log_file(), verbose=arguments.verbose)
    _log.info("CARIS Desktop %s starts", __version__)
    try:
        console_run = ConsoleRun(arguments)
    except composition.StartError as refusal:
        print(refusal, file=sys.stderr)
        return 2
    # A terminal's Ctrl+C closes the window in order; the timer lets Python see the signal between Qt events.
    signal.signal(signal.SIGINT, lambda *_: console_run.application.closeAllWindows())
    signal.signal(signal.SIGTERM, lambda *_: console_run.application.closeAllWindows())
    heartbeat = QTimer()
    heartbeat.timeout.connect(_let_python_run)
    heartbeat.start(200)
    console_run.show()
    try:
        return console_run.application.exec()
    finally:
        console_run.close()


def own_settings() -> QSettings:
    """What this user's windows keep, of the console and of a replay alike."""
    return QSettings("CARIS", "CARIS Desktop")


def check_screen() -> None:
    """Without a screen Qt would end the program with words that help nobody. Raises StartError."""
    places = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in places):
        raise composition.StartError(
            "There is no screen to open the window on. Start the console from a desktop session; without one, "
            "'caris-desktop rehearse' plays a scenario, and 'bash packaging/demo.sh' makes a virtual screen for it."
        )


def _let_python_run() -> None:
    """Entered so that pending Python signal handlers get their turn."""


def default_arguments(**changes: object) -> argparse.Namespace:
    """The console's arguments as if nothing was given on the command line."""
    values: dict[str, object] = {
        "scenario": None,
        "robot": None,
        "camera": None,
        "study": None,
        "demo": False,
        "theme": None,
        "verbose": False,
    }
    return argparse.Namespace(**{**values, **changes})
