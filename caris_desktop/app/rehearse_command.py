"""``caris-desktop rehearse``: scripted wizard in the real console on a simulated robot."""

import argparse
import json
import logging
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path

from PySide6.QtCore import QObject, QPoint, QSettings, Qt, Signal
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QMenu, QTabBar, QWidget

from caris_desktop.app import composition
from caris_desktop.app.arguments import add_accept_named
from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.app.demo_robot import PREPARE, SAY, DemoRobot
from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.geometry import Pose2D, wrap_angle
from caris_desktop.domain.streams import BY_NAME, STATE_STREAMS, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.console import Console
from caris_desktop.live.logs import configure_logging
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import FORMATS, ExportContext, ExportError, export_session
from caris_desktop.scenario.scenario_model import Place
from caris_desktop.ui.action_rows import phrases_on_keys
from caris_desktop.ui.focus_widget import focused_widget
from caris_desktop.ui.main_window import MainWindow

_log = logging.getLogger(__name__)
_STEP_MS = 40
_TYPE_EVERY_STEPS = 2
SAYS = {
    "tour-guide": (
        "Hello. Can the robot arm hurt people when it moves?",
        "That is good to know. Who built you?",
        "Thank you. What is there to see next?",
    ),
    "mental-health-check": (
        "I have exams this week and I am not sleeping well.",
        "Maybe a seven. I worry a lot at night.",
        "Yes, I would like to talk to somebody.",
    ),
}
"""What the participant says in the shipped scenarios."""
SAYS_ELSEWHERE = ("Hello. What are you doing here?", "That sounds interesting.", "Thank you, goodbye.")
_SUGGESTED_WITHIN_S = 20.0
_KEYS = {"forward": Qt.Key.Key_W, "left": Qt.Key.Key_A, "right": Qt.Key.Key_D}


class RehearsalError(Exception):
    """A step failed; the text says which and what was found instead."""


class Until(Value):
    """Wait of the script for ``condition``."""

    what: str
    condition: Callable[[], bool]
    timeout_s: float = 20.0


Script = Generator[Until | None, None, None]


class Rehearsal(QObject):
    """Runs the script step by step between Qt events. Emits ``finished(error text or "")`` at its end."""

    finished = Signal(str)

    def __init__(
        self,
        window: MainWindow,
        console: Console,
        out: Path,
        *,
        seconds: float,
        ask_robot: Callable[[str, Sequence[str]], None],
        trial: Mapping[str, str],
    ) -> None:
        """``ask_robot`` calls a service of the robot with texts of its participant. The start dialog gets ``trial``."""
        super().__init__(window)
        self._window = window
        self._console = console
        self._state = console.state
        self._out = out
        self._seconds = seconds
        self._ask_robot = ask_robot
        self._trial = trial
        self._transcribed: list[UtteranceChanged] = []
        self._state.event_happened.connect(self._on_event)
        self._held: set[Qt.Key] = set()
        self._script = self._play()
        self._waiting: Until | None = None
        self._deadline_ns = 0
        self._started_ns = clock.now_ns()
        self.steps: list[dict[str, object]] = []
        self.screenshots: dict[Path, QImage] = {}
        self.session_folder: Path | None = None
        self._timer = new_timer(self, self._step)

    def start(self) -> None:
        self._timer.start(_STEP_MS)

    # The script

    def _play(self) -> Script:
        state, scenario = self._state, self._console.scenario
        yield Until("the robot is connected", lambda: state.link.value.state == "connected", 30.0)
        yield Until("video arrives", lambda: state.frame.freshness == "fresh", 30.0)
        yield Until("LIDAR scans arrive", lambda: state.scan.freshness == "fresh")
        yield Until("the person detector is ready", lambda: state.perception.value.state == "ready", 90.0)
        if scenario.permissions.assistant:
            yield Until("the language model is ready", lambda: state.assistant.value.state == "ready", 90.0)
        path = scenario.path
        self._says = SAYS.get(path.stem if path is not None else "", SAYS_ELSEWHERE)
        self._ask_robot(PREPARE, self._says)
        self._note("everything is ready")

        yield from self._start_recording()
        yield from self._meet()
        if scenario.permissions.speech:
            yield from self._greet()
        if scenario.permissions.transcription and scenario.permissions.speech:
            yield from self._talk()
        if scenario.permissions.photos:
            yield from self._take_photo()
        if scenario.permissions.driving:
            yield from self._drive_while_speaking()
        if scenario.permissions.assistant:
            yield from self._ask_assistant()
        if scenario.permissions.driving and scenario.places:
            yield from self._go_to_place_and_stop()
        self._press(Qt.Key.Key_M, Qt.KeyboardModifier.ControlModifier)
        self._note("marked the moment")
        while self._elapsed_s() < self._seconds:
            yield None
        yield Until("the robot is quiet", lambda: state.speech.value.now is None, 30.0)
        self._screenshot("before-the-end")
        self.session_folder = self._console.session_folder
        self._click("record_button")
        yield Until("the recording menu is open", lambda: isinstance(QApplication.activePopupWidget(), QMenu))
        self._choose("Stop recording")
        yield Until("the recording is closed", lambda: state.recording.value.state == "idle", 20.0)
        self._note("recording closed")
        self._screenshot("end")

    def _choose(self, text: str) -> None:
        """Click an entry of the open menu."""
        menu = QApplication.activePopupWidget()
        if isinstance(menu, QMenu):
            for action in menu.actions():
                if action.text() == text:
                    QTest.mouseClick(menu, Qt.MouseButton.LeftButton, pos=menu.actionGeometry(action).center())
                    return
        raise RehearsalError(f"the menu has no entry {text!r}")

    def _start_recording(self) -> Script:
        self._click("record_button")
        yield Until("the start dialog is open", lambda: self._find("start_dialog") is not None)
        for entry, text in self._trial.items():
            field = self._find(f"start_{entry}")
            if isinstance(field, QLineEdit):
                self._click(field.objectName())
                field.selectAll()
                yield from self._type(field, text)
        self._screenshot("start-dialog")
        for check in self._state.preflight.value:
            if check.manual and check.state != "passed":
                self._click(f"tick_{check.id}")
                yield None
        self._click("start_dialog_begin")
        begun = ("starting", "recording")
        marker = "start_asked"
        yield Until(
            "the recording starts, or the failed checks are shown",
            lambda: self._state.recording.value.state in begun or self._find(marker) is not None,
        )
        if self._state.recording.value.state not in begun:
            self._note("recording anyway")
            self._click("start_dialog_begin")
        yield Until("recording runs", lambda: self._state.recording.value.state == "recording")
        self._note("recording")

    def _meet(self) -> Script:
        state = self._state
        yield Until("a person was detected", lambda: any(row.here for row in state.persons.value), 40.0)
        self._note(f"{sum(row.here for row in state.persons.value)} person(s) present")

    def _greet(self) -> Script:
        state = self._state
        yield from self._say_phrase(1, "Hello.")
        yield Until("the greeting is spoken", lambda: state.speech.value.now is not None)
        self._screenshot("greeting")
        yield Until("the greeting was said", lambda: state.speech.value.now is None, 20.0)
        self._note("greeted")

    def _talk(self) -> Script:
        """Let the participant speak, and answer with a suggestion, a phrase and by typing."""
        state = self._state
        yield Until("transcription is ready", lambda: state.listening.value.state in ("ready", "failed"), 90.0)
        for number, text in enumerate(self._says):
            before = len(self._transcribed)
            self._ask_robot(SAY, (text,))
            yield Until("the participant is transcribed", lambda count=before: len(self._transcribed) > count, 90.0)  # type: ignore[misc]
            self._note(f"the participant said “{self._transcribed[-1].text}”")
            if number == 0:
                yield from self._answer_by_suggestion()
            elif number == 1:
                yield from self._say_phrase(3, "I see.")
            else:
                yield from self._say_by_typing("That is a good question. Let us have a look.")
            yield Until("the answer is spoken", lambda: state.speech.value.now is not None)
            yield Until("the answer was said", lambda: state.speech.value.now is None, 30.0)
        self._screenshot("conversation")

    def _answer_by_suggestion(self) -> Script:
        until_ns = clock.now_ns() + int(_SUGGESTED_WITHIN_S * 1e9)
        while not self._state.suggestions.value.cards and clock.now_ns() < until_ns:
            yield None
        if self._state.suggestions.value.cards:
            self._screenshot("suggestions")
            self._note("answered by a suggestion")
            self._press(Qt.Key.Key_1, Qt.KeyboardModifier.ControlModifier)
        else:
            # None is a valid answer of a language model.
            self._note("no suggestion: answered by a phrase")
            yield from self._say_phrase(2, "Please tell me more.")

    def _say_phrase(self, number: int, otherwise: str) -> Script:
        """Say a phrase by its key; type ``otherwise`` if there is no such phrase or it requires a word first."""
        phrases = phrases_on_keys(self._console.scenario, self._state.phrase_group.value)
        if number <= len(phrases) and "{" not in phrases[number - 1].say:
            self._press(Qt.Key(Qt.Key.Key_F1 + number - 1))
        else:
            yield from self._say_by_typing(otherwise)

    def _say_by_typing(self, text: str) -> Script:
        self._press(Qt.Key.Key_L, Qt.KeyboardModifier.ControlModifier)
        field = self._find("speak_field")
        if field is None:
            raise RehearsalError("there is no field to type the robot's speech")
        yield from self._type(field, text)
        self._press(Qt.Key.Key_Return, target=field)

    def _take_photo(self) -> Script:
        folder = self._console.session_folder
        # With a stale picture no photo can be taken; a wizard looks before pressing the key.
        yield Until("the video is up to date", lambda: self._window.actions_table.available("photo"), 60.0)
        self._press(Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier)
        yield Until("the photo is on disk", lambda: bool(folder and list((folder / "photos").glob("*.png"))))
        self._note("photo taken")

    def _drive_while_speaking(self) -> Script:
        state = self._state
        yield Until("the robot's position is known", lambda: state.pose.value is not None)
        if self._console.scenario.permissions.speech:
            yield from self._say_by_typing("Please follow me, I would like to show you around.")
            yield Until("the sentence is spoken", lambda: state.speech.value.now is not None)
        self._press(Qt.Key.Key_D, Qt.KeyboardModifier.ControlModifier)
        start = state.pose.value.pose_in_map
        target = self._nearest_place(start)
        self._note("driving" + (f" towards {target.name}" if target else ""))
        driven_while_speaking = False
        photographed = False
        until_ns = clock.now_ns() + 14_000_000_000
        while clock.now_ns() < until_ns:
            pose = state.pose.value.pose_in_map if state.pose.value else start
            driven_m = _distance_m(pose, start)
            spoken = state.speech.value.now is not None
            moving = self._moving()
            driven_while_speaking = driven_while_speaking or (spoken and moving)
            if not photographed and spoken and moving and driven_m > 0.3:
                self._screenshot("driving")
                photographed = True
            there = target is not None and _distance_m(pose, target.pose_in_map) < 0.4
            if there or (driven_m > 2.5 and not spoken):
                break
            drive = state.drive.value
            if self._held and not drive.allowed:
                raise RehearsalError(f"driving was refused: {drive.reason}")
            if self._held and not (drive.target_forward_mps or drive.target_turn_radps):
                self._hold(set())  # automatic stop, as after a stall: a wizard releases the key and presses again
            else:
                self._hold(self._keys_towards(pose, target))
            yield None
        self._hold(set())
        yield Until("the robot stands still", lambda: not state.odometry.value.twist.moving, 10.0)
        driven_m = _distance_m(state.pose.value.pose_in_map, start)
        self._note(f"drove {driven_m:.1f} m by keyboard, {'while' if driven_while_speaking else 'not while'} speaking")
        if driven_m < 0.2:
            raise RehearsalError(f"the robot hardly moved ({driven_m:.2f} m) while keys were held")

    def _ask_assistant(self) -> Script:
        state = self._state
        for bar in (bar for top in QApplication.topLevelWidgets() for bar in top.findChildren(QTabBar)):
            for number in range(bar.count()):
                if bar.isVisible() and bar.tabText(number) == "Assistant":
                    QTest.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(number).center())
        if self._find("assistant_field") is None:
            # The scenario permits it but shows other panels: found as a wizard would, by search.
            yield from self._find_anything("Assistant")
            yield Until("the Assistant panel is open", lambda: self._find("assistant_field") is not None)
        field = self._find("assistant_field")
        if not isinstance(field, QLineEdit):
            raise RehearsalError("there is no field to ask the assistant")
        self._click("assistant_field")
        yield from self._type(field, "Hello, I am here for the first time.")
        self._press(Qt.Key.Key_Return, target=field)
        yield Until("the assistant answers", lambda: bool(state.assistant.value.answer), 40.0)
        yield Until("the answer is complete", lambda: state.assistant.value.state != "answering", 60.0)
        self._screenshot("assistant")
        if state.assistant.value.state == "failed":
            raise RehearsalError(f"the assistant failed: {state.assistant.value.detail}")
        self._note("the assistant answered")
        if not self._console.scenario.permissions.speech:
            return
        self._click("assistant_say")
        yield Until("the answer is spoken", lambda: state.speech.value.now is not None)
        self._press(Qt.Key.Key_F12)
        yield Until("the robot is silent", lambda: state.speech.value.now is None)
        self._note("answer spoken, then stopped")

    def _go_to_place_and_stop(self) -> Script:
        state = self._state
        pose = state.pose.value.pose_in_map
        place = max(self._console.scenario.places, key=lambda place: _distance_m(pose, place.pose_in_map))
        yield from self._find_anything(f"Go to {place.name}")
        yield Until(
            "the robot navigates",
            lambda: state.goal.value is not None and state.goal.value.state == "active" and self._moving(),
            15.0,
        )
        until_ns = clock.now_ns() + 4_000_000_000
        while clock.now_ns() < until_ns and state.goal.value.state == "active":
            yield None
        self._screenshot("going-to-a-place")
        self._press(Qt.Key.Key_Escape)
        yield Until("stop halts the robot", lambda: not self._moving(), 5.0)
        yield Until("the goal is cancelled", lambda: state.goal.value.state in ("cancelled", "reached"), 5.0)
        self._note(f"sent to {place.name}, stopped with Esc")

    def _find_anything(self, words: str) -> Script:
        self._press(Qt.Key.Key_K, Qt.KeyboardModifier.ControlModifier)
        yield Until("Find anything is open", lambda: self._find("palette_field") is not None)
        field = self._find("palette_field")
        if field is None:
            raise RehearsalError("Find anything has no text field")
        yield from self._type(field, words)
        self._press(Qt.Key.Key_Return, target=field)

    # The wizard's hands

    def _find(self, name: str) -> QWidget | None:
        for top in QApplication.topLevelWidgets():
            if top.isVisible():
                found = top if top.objectName() == name else top.findChild(QWidget, name)
                if isinstance(found, QWidget) and found.isVisible():
                    return found
        return None

    def _click(self, name: str) -> None:
        widget = self._find(name)
        if widget is None:
            raise RehearsalError(f"the window has no '{name}'")
        middle = QPoint(widget.width() // 2, widget.height() // 2)
        QTest.mouseClick(widget, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, middle)

    def _press(
        self,
        key: Qt.Key,
        modifiers: Qt.KeyboardModifier = Qt.KeyboardModifier.NoModifier,
        *,
        target: QWidget | None = None,
    ) -> None:
        QTest.keyClick(target or self._focus(), key, modifiers)

    def _type(self, field: QWidget, text: str) -> Script:
        for character in text:
            QTest.keyClicks(field, character)
            for _ in range(_TYPE_EVERY_STEPS - 1):
                yield None

    def _hold(self, keys: set[Qt.Key]) -> None:
        """Hold exactly these drive keys."""
        for key in self._held - keys:
            QTest.keyRelease(self._focus(), key)
        for key in keys - self._held:
            QTest.keyPress(self._focus(), key)
        self._held = set(keys)

    def _focus(self) -> QWidget:
        return QApplication.activePopupWidget() or focused_widget() or self._window

    def _keys_towards(self, pose: Pose2D, target: Place | None) -> set[Qt.Key]:
        if target is None:
            ahead = self._clear_ahead_m(0.0)
            return {_KEYS["forward"]} if ahead > 0.8 else {_KEYS["left"]}
        bearing = math.atan2(target.pose_in_map.y_m - pose.y_m, target.pose_in_map.x_m - pose.x_m)
        off = wrap_angle(bearing - pose.heading_rad)
        keys: set[Qt.Key] = set()
        if abs(off) > math.radians(8):
            keys.add(_KEYS["left"] if off > 0 else _KEYS["right"])
        if abs(off) < math.radians(30):
            keys.add(_KEYS["forward"])
        return keys

    # The wizard's eyes and ears

    def _on_event(self, event: object) -> None:
        if isinstance(event, UtteranceChanged) and event.speaker == "participant" and event.state == "finished":
            self._transcribed.append(event)

    def _nearest_place(self, pose: Pose2D) -> Place | None:
        """Nearest place with a free line of sight of the LIDAR; None if there is none."""
        for place in sorted(self._console.scenario.places, key=lambda place: _distance_m(pose, place.pose_in_map)):
            distance_m = _distance_m(pose, place.pose_in_map)
            bearing = math.atan2(place.pose_in_map.y_m - pose.y_m, place.pose_in_map.x_m - pose.x_m)
            if distance_m > 1.0 and self._clear_ahead_m(wrap_angle(bearing - pose.heading_rad)) > distance_m:
                return place
        return None

    def _clear_ahead_m(self, bearing_in_robot_rad: float) -> float:
        """Free distance in that direction by the last scan, in a corridor of the robot's width."""
        scan = self._state.scan.value
        heading_rad = scan.robot_from_laser.heading_rad
        nearest_m = math.inf
        for index, range_m in enumerate(scan.ranges_m):
            angle = scan.angle_min_rad + index * scan.angle_increment_rad + heading_rad
            off = wrap_angle(angle - bearing_in_robot_rad)
            if math.isfinite(range_m) and abs(off) < math.pi / 2 and abs(range_m * math.sin(off)) < 0.35:
                nearest_m = min(nearest_m, float(range_m * math.cos(off)))
        return nearest_m

    def _moving(self) -> bool:
        return bool(self._state.odometry.value and self._state.odometry.value.twist.moving)

    # Running

    def _step(self) -> None:
        if QApplication.activeWindow() is None:
            self._window.activateWindow()  # without a window manager, nothing activates it when a dialog closes
            return
        try:
            if self._waiting is not None:
                if not self._waiting.condition():
                    if clock.now_ns() > self._deadline_ns:
                        self._end(f"timed out after {self._waiting.timeout_s:.0f} s: {self._waiting.what}")
                    return
                self._waiting = None
            self._waiting = next(self._script)
            if self._waiting is not None:
                self._deadline_ns = clock.now_ns() + int(self._waiting.timeout_s * 1e9)
        except StopIteration:
            self._end("")
        except RehearsalError as failure:
            self._end(str(failure))
        except Exception as error:
            _log.exception("the rehearsal failed")
            self._end(f"{type(error).__name__}: {error}")

    def _end(self, failure: str) -> None:
        self._timer.stop()
        self._hold(set())
        if failure:
            self._screenshot("failed")
        for path, image in self.screenshots.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            if not image.save(str(path)):
                _log.error("%s could not be written", path)
        (self._out / "rehearsal.json").write_text(
            json.dumps({"failure": failure, "steps": self.steps}, indent=2), encoding="utf-8"
        )
        self.finished.emit(failure)

    def _note(self, step: str) -> None:
        self.steps.append({"at_s": round(self._elapsed_s(), 1), "what": step})
        print(f"{self._elapsed_s():6.1f} s  {step}", flush=True)

    def _elapsed_s(self) -> float:
        return (clock.now_ns() - self._started_ns) / 1e9

    def _screenshot(self, name: str) -> None:
        """Take a screenshot now, write it at the end: writing would block the window."""
        path = self._out / "screenshots" / f"{len(self.screenshots) + 1:02d}-{name}.png"
        if QApplication.platformName() == "offscreen":
            picture = self._window.grab()
        else:  # includes dialogs and popups
            inside = self._window.geometry()
            picture = self._window.screen().grabWindow(0, inside.x(), inside.y(), inside.width(), inside.height())
        self.screenshots[path] = picture.toImage()


def _distance_m(pose: Pose2D, other: Pose2D) -> float:
    return math.hypot(other.x_m - pose.x_m, other.y_m - pose.y_m)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file or name")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder")
    parser.add_argument("--seconds", metavar="N", type=float, default=0.0, help="minimum duration in seconds")
    parser.add_argument("--seed", metavar="N", type=int, default=7, help="seed of the simulated robot")
    parser.add_argument("--participant", metavar="CODE", default="P07", help="the participant (default: %(default)s)")
    parser.add_argument("--condition", metavar="NAME", default="B", help="the condition (default: %(default)s)")
    parser.add_argument(
        "--camera",
        metavar="SOURCE",
        action="append",
        help="use this camera instead of the simulated robot's; can be repeated, also with 'robot'",
    )
    add_accept_named(parser)
    parser.add_argument("--theme", choices=("system", "dark", "light"), default="dark")
    parser.add_argument("--size", metavar="WxH", help="size of the window (default: as large as the screen)")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 if all steps succeeded and the session can be read, replayed and exported."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or sys.platform in ("win32", "darwin")):
        os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    out: Path = arguments.out.resolve()
    try:
        out.mkdir(parents=True, exist_ok=True)
        size_px = [int(number) for number in arguments.size.split("x")] if arguments.size else None
    except OSError as error:
        print(f"Cannot write to {out}: {error}. Choose another --out.", file=sys.stderr)
        return 2
    except ValueError:
        print(f"--size {arguments.size} is not a size such as 1920x1080.", file=sys.stderr)
        return 2
    configure_logging(out / "console.log")

    try:
        console_run = ConsoleRun(
            default_arguments(
                scenario=arguments.scenario,
                study=out / "study",
                camera=arguments.camera,
                theme=arguments.theme,
                accept_named=arguments.accept_named,
            ),
            settings=QSettings(str(out / "settings.ini"), QSettings.Format.IniFormat),
            robot=lambda console: DemoRobot(console, seed=arguments.seed),
        )
    except composition.StartError as refusal:
        print(refusal, file=sys.stderr)
        return 2
    if size_px is not None:
        console_run.window.resize(*size_px)
    elif QApplication.platformName() == "offscreen":
        console_run.window.resize(1920, 1080)
    else:
        console_run.window.setWindowState(Qt.WindowState.WindowMaximized)

    def ask_robot(service: str, texts: Sequence[str]) -> None:
        if console_run.demo_robot is not None:
            console_run.demo_robot.call(service, [{"text": text} for text in texts])

    rehearsal = Rehearsal(
        console_run.window,
        console_run.console,
        out,
        seconds=arguments.seconds,
        ask_robot=ask_robot,
        trial={"participant": arguments.participant, "condition": arguments.condition, "wizard": "W1"},
    )
    failures: list[str] = []

    def on_finished(failure: str) -> None:
        failures.append(failure)
        console_run.application.exit(0)

    rehearsal.finished.connect(on_finished)
    console_run.show()
    rehearsal.start()
    try:
        console_run.application.exec()
    finally:
        console_run.close()
    failure = failures[0] if failures else "the window was closed"
    exports, back = out / "exports", ReadBack((), ())
    if not failure and rehearsal.session_folder is not None:
        print("Reading back and exporting the session; this takes a moment.", flush=True)
        back = read_back(rehearsal.session_folder, exports)
    print(f"Session:     {rehearsal.session_folder or console_run.console.session_folder or 'none'}")
    for sentence in back.found:
        print(f"Read back:   {sentence}")
    print(f"Exports:     {exports if exports.is_dir() else 'none'}")
    print(f"Screenshots: {out / 'screenshots'}")
    print(f"Log:         {out / 'console.log'}")
    if failure:
        print(f"The rehearsal stopped: {failure}", file=sys.stderr)
        return 1
    if back.problems:
        print("The rehearsal is complete, but its session has problems:", file=sys.stderr)
        print(
            *back.problems,
            "Do not record with this installation until the problems are solved.",
            sep="\n",
            file=sys.stderr,
        )
        return 1
    print("The rehearsal is complete, and its session is intact.")
    return 0


# Verification of a new recording: read back, replayed and exported to every format.

_OF_FORMAT = QT_TR_NOOP("Export as {format}: {told}")


class ReadBack(Value):
    """Sentences: results ``found``, and ``problems``; without problems the session is complete."""

    found: tuple[str, ...]
    problems: tuple[str, ...]


def read_back(folder: Path, exports: Path) -> ReadBack:
    """Read the closed session in ``folder`` in every supported way; each format has a folder in ``exports``."""
    found: list[str] = []
    problems: list[str] = []
    try:
        session = open_session(folder)
        read = Counter(spec.name for spec, _ in session.values())
        problems += [*session.notices, *session.losses, *_missing(session, read), *_not_replayed(session, read)]
    except SessionError as error:
        return ReadBack((), (str(error),))
    found.append(f"{read.total()} values from {len(read)} streams read back, {session.duration_s:.0f} s replayed.")
    written: list[str] = []
    for each in FORMATS:
        notes: list[str] = []
        try:
            export_session(folder, each.name, exports / each.name, ExportContext(warn=notes.append))
            written.append(each.name)
        except ExportError as error:
            problems.append(localized(_OF_FORMAT, format=each.name, told=localized(str(error))))
        found += [localized(_OF_FORMAT, format=each.name, told=note) for note in dict.fromkeys(notes)]
    return ReadBack((*found, f"Exported formats: {', '.join(written) or 'none'}."), tuple(problems))


def _missing(session: Session, read: Counter[str]) -> list[str]:
    """Streams with more or fewer values in the record than the recorder counted."""
    counted = Counter({name: count for name, count in session.header.counts.items() if name in BY_NAME})
    if not counted:
        return ["The recorder counted no values, so it is unknown whether the recording is complete."]
    return [
        f"{read[name]} of {counted[name]} values of {name} can be read."
        for name in sorted(counted | read)
        if counted[name] != read[name]
    ]


def _not_replayed(session: Session, read: Counter[str]) -> list[str]:
    with SessionTimeline(session) as timeline:
        shown_types = {type(value) for value in timeline.state_at(timeline.end_ns)}
    expected = [spec for spec in STATE_STREAMS if spec.delivery is Delivery.LATEST and read[spec.name]]
    lost = [spec.name for spec in expected if spec.value_type not in shown_types]
    return [f"Missing in the replay: {', '.join(lost)}."] if lost else []
