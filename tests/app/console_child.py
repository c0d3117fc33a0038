"""Real console in a separate process with commands on stdin, for tests that stop or kill it.

``python -m tests.app.console_child ADDRESS STUDY_DIR`` runs the tour guide; CARIS_TEST_WITH_MODELS adds its language
model and recogniser. Commands: ``press KEY``, ``release KEY``, ``record``, ``end_recording``, ``pause``, ``go_on``,
``mark LABEL``, ``open SCENARIO_FILE``, ``say TEXT``, ``photo``, ``export``, ``go X_M Y_M``, ``stop``, ``place X_M Y_M
NAME``, ``robot NAME``, ``use CONTROL JSON_VALUE``, ``save_map NAME``, ``plug``, ``pad AXIS VALUE``, ``unplug`` (the
virtual gamepad), ``quit``. It prints a JSON line whenever the displayed state changes.
"""

import contextlib
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.app import composition
from caris_desktop.app.console_command import ConsoleRun, default_arguments, end_on_request
from caris_desktop.domain import intents
from caris_desktop.domain.events import AlarmChanged, DriveEnded, Problem, TrialDetails
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef, PersonPlace
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.state import LiveState
from caris_desktop.robot.profile import load_profile, save_profile
from tests.support.console_process import without_models
from tests.support.stdin_commands import StateReporter, run_until_closed
from tests.support.virtual_gamepad import VirtualGamepad


class Driver(StateReporter):
    """Executes the commands and reports the displayed state."""

    def __init__(self, run: ConsoleRun) -> None:
        super().__init__()
        self._run = run
        self._problems: list[str] = []
        self._pad: VirtualGamepad | None = None
        self._alarms_raised: list[str] = []
        self._drive_ended: list[str] = []
        self._frame: dict[str, int] = {}
        self._frames_missing = 0
        run.console.state.event_happened.connect(self._on_event)
        run.console._bus.tap(lambda frame, _raw: self._on_frame(frame), (FrameRef,))

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        window = self._run.window
        if word == "press":
            QTest.keyClick(window, Qt.Key.Key_D, Qt.KeyboardModifier.ControlModifier)
            QTest.keyPress(QApplication.focusWidget() or window, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "release":
            QTest.keyRelease(QApplication.focusWidget() or window, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "record":
            self._run.console.do(intents.StartRecording(TrialDetails(participant="P1"), anyway=True))
        elif word == "end_recording":
            self._run.console.do(intents.StopRecording())
        elif word in ("pause", "go_on"):
            self._run.console.do(intents.PauseRecording(paused=word == "pause"))
        elif word == "mark":
            self._run.console.do(intents.Mark(rest))
        elif word == "open":
            # As after the wizard's confirmation of the file's references; the console itself reports a wrong file.
            with contextlib.suppress(composition.StartError):
                composition.find_scenario(rest, accept_named=True)
            self._run.console.do(intents.OpenScenario(Path(rest)))
        elif word == "say":
            self._run.console.do(intents.Say(line.partition(" ")[2], "typed"))
        elif word == "photo":
            self._run.console.do(intents.TakePhoto())
        elif word == "export":
            folder = self._run.console.session_folder
            if folder is not None:
                self._run.library.start_export([folder], ["csv"], folder / "export-csv")
        elif word == "go":
            x_m, y_m = map(float, rest.split())
            self._run.console.do(intents.GoToPoint(Pose2D(x_m, y_m, 0.0)))
        elif word == "stop":
            self._run.console.do(intents.Stop())
        elif word == "place":
            x_m, y_m, name = rest.split(maxsplit=2)
            self._run.console.do(intents.SavePlace(name, Pose2D(float(x_m), float(y_m), 0.0)))
        elif word == "robot":
            # As after the wizard's confirmation of the profile's references.
            composition.confirm_robot(rest, accept_named=True)
            self._run.console.do(intents.UseRobot(rest))
        elif word == "use":
            control, value = rest.split(maxsplit=1)
            self._run.console.do(intents.UseControl(control, json.loads(value)))
        elif word == "save_map":
            self._run.console.do(intents.SaveMap(rest))
        elif word == "plug":
            self._pad = VirtualGamepad()
        elif word == "pad" and self._pad is not None:
            axis, value = rest.split()
            self._pad.push(int(axis), float(value))
        elif word == "unplug" and self._pad is not None:
            self._pad.unplug()
        elif word == "quit":
            QApplication.closeAllWindows()

    def _on_event(self, event: object) -> None:
        if isinstance(event, DriveEnded):
            self._drive_ended.append(event.reason)
        elif isinstance(event, Problem):
            self._problems.append(f"{event.what} {event.meaning} {event.advice}")
        elif isinstance(event, AlarmChanged) and event.state == "raised":
            self._alarms_raised.append(event.what)

    def _on_frame(self, frame: FrameRef) -> None:
        """Frame received in the thread of the link, before any conflation."""
        self._frames_missing += frame.sequence - self._frame.get(frame.camera, frame.sequence - 1) - 1
        self._frame[frame.camera] = frame.sequence

    def _state(self) -> dict[str, object]:
        console, state = self._run.console, self._run.console.state
        return {
            "link": state.link.value.state,
            "drive_allowed": state.drive.value.allowed,
            "video": state.frame.freshness,
            "frames_missing": self._frames_missing if self._frame else None,
            "scan": state.scan.freshness,
            "map": state.map.freshness,
            "recording": state.recording.value.state,
            "perception": state.perception.value.state,
            "people_here": len(state.persons.value),
            "seen_by": [sorted(person.cameras) for person in state.persons.value],
            "robot": state.robot.value.name if state.robot.value is not None else "",
            "people_in_map": [[round(p.x_m, 1), round(p.y_m, 1)] for p in _people_in_map(state)],
            "goal": state.goal.value.state if state.goal.value is not None else "",
            "places": [place.name for place in state.places.value],
            "guard": state.drive.value.guard,
            "moving": self._run.window.hold.motion.moving,
            "held": state.drive.value.emergency_stop,
            "conversation": [turn.text for turn in state.transcript.value if turn.said],
            "going_on": state.going_on.value.state,
            "going_on_card": self._run.window.findChild(QWidget, "going_on_card").isVisible(),
            "path": state.path.freshness,
            "controls": {name: status.state for name, status in state.control_states.value.items()},
            "readings": sorted(state.readings.value.values) if state.readings.value is not None else [],
            "session": str(console.session_folder or ""),
            "children": console.child_pids,
            "scenario": console.scenario.title,
            "assistant": state.assistant.value.state,
            "drive_ended": list(self._drive_ended),
            "problems": list(self._problems),
            "alarms": [alarm.what for alarm in state.alarms.value],
            "alarms_raised": list(self._alarms_raised),
            "exports": [str(folder) for folder in self._run.library.export.value.written],
        }


def _people_in_map(state: LiveState) -> tuple[PersonPlace, ...]:
    return state.people_in_map.value.people if state.people_in_map.freshness == "fresh" else ()


def _simulated_at(address: str, folder: Path) -> str:
    """Profile of the simulated robot at this address; an address alone means an unknown robot."""
    path = folder / "simulated-robot.yaml"
    save_profile(replace(load_profile("simulated"), address=address), path)
    return str(path)


def main(address: str, study: Path, driver_type: type[Driver] = Driver, *, scenario: str = "") -> int:
    """Run until the window is closed; ``driver_type`` executes the commands. ``scenario``: a file, or else the tour."""
    settings = QSettings(str(study.parent / "settings.ini"), QSettings.Format.IniFormat)
    camera = os.environ.get("CARIS_TEST_CAMERA")
    robot = _simulated_at(address, study.parent) if "://" in address else address
    if not scenario and "CARIS_TEST_WITH_MODELS" in os.environ:
        scenario = "tour-guide"
    elif not scenario:
        scenario = str(without_models(layouts_dir() / "tour-guide.yaml", study.parent))
    composition.confirm_robot(robot, accept_named=True)
    composition.find_scenario(scenario, accept_named=True)
    run = ConsoleRun(
        default_arguments(scenario=scenario, robot=robot, study=study, camera=camera and [camera]),
        settings=settings,
    )
    end_on_request(run)
    run.show()
    return run_until_closed(run, driver_type(run))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
