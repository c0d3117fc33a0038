"""Each dialog, card and secondary window of the program, opened as by the wizard, for checks."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import shiboken6
from PySide6.QtCore import QPointF, QSize, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QApplication, QLineEdit, QListWidget, QTabWidget, QWidget

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.intents import GoToStep
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.live.status import CrashRecoveryStatus, LiveRobotsStatus, PracticeStatus
from caris_desktop.robot.discovery import Exploration
from caris_desktop.robot.profile_proposal import propose
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.observer_window import SEES_WORDS
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_appearance import ENGLISH, Language
from caris_desktop.ui.window_menus import TitleDialog
from caris_desktop.ui.window_place import WINDOW_FRAME
from tests.support.window_check import text_flaws
from tests.ui import (
    samples,
    test_confirm_file,
    test_practice_strip,
    test_resume_trial_card,
    test_same_names,
    test_saved_session_card,
    test_sessions,
    test_video,
)
from tests.ui.conftest import freshen
from tests.ui.fake_console import FakeConsole, FakeLibrary
from tests.ui.fake_replay import FakeReplay, sample_coding, sample_overview
from tests.ui.preflight.test_preflight import CHECKS
from tests.ui.test_robot_dialog import ADDRESS, OFFER, MemoryExplorer

SMALLEST, SMALL, USUAL = QSize(683, 384), QSize(911, 512), QSize(1366, 768)
"""Logical sizes of a screen of 1366x768 at 200, 150 and 100 %."""

SCENARIO = "tour-guide"
_COMES_ROUND_MS = 400


@dataclass(frozen=True, slots=True)
class Seen:
    """An opened part: an overlay of the main window, or a window."""

    name: str
    part: QWidget


class EveryWindow:
    """The windows of a session and of a replay in one language."""

    def __init__(self, theme: Theme, language: str) -> None:
        self.language = Language()
        self.language.use(language)
        self.console = FakeConsole(load_scenario(layouts_dir() / f"{SCENARIO}.yaml"))
        samples.fill_console(self.console)
        self.console.state.preflight.set(CHECKS)
        self.explorer = MemoryExplorer()
        self.window = MainWindow(
            self.console,
            theme=theme,
            gamepads=Gamepads(self.console.state, lambda _event: None),
            explorer=self.explorer,  # type: ignore[arg-type]
        )
        self.window.use_library(FakeLibrary(test_sessions.SESSIONS, test_sessions.HITS))
        self.theme = theme
        self._opened: dict[int, QSize] = {}
        self.replayed: FakeConsole | None = None
        self.window.resize(USUAL)
        self.window.show()
        freshen(self.console)
        self.console.state.close()

    def close(self) -> None:
        self.window.close()
        self.language.use(ENGLISH)
        self.window.deleteLater()

    def seen(self, *, with_what_is_beside: bool = False) -> Iterator[Seen]:
        """Each part in turn; the previous one is closed."""
        yield from self._cards()
        yield from self._of_sessions()
        yield from self._of_the_robot()
        yield from self._of_the_scenario()
        if with_what_is_beside:
            yield from self._next_to()
        yield from self._shown_to_others()
        yield from self.of_the_replay(with_cards=with_what_is_beside)

    def _cards(self) -> Iterator[Seen]:
        window = self.window
        for name, open_card in (
            ("palette", window.show_command_palette),
            ("keys", window.show_shortcuts),
            ("connection", window._connection.open),
            ("preflight", window.show_preflight),
            ("alarms", window._alarms.show_alarms),
        ):
            open_card()
            yield Seen(name, self._card())
            window.hold.escape_pressed.emit()
        window.show_set_up()
        yield Seen("first use", self._card())
        window.show_help()
        seen = self._own("help", "help_window")
        yield seen
        _close(seen)
        for step in ("robot", "sound"):
            window.show_set_up()
            page = self._card()
            _press(page, "first_use_own")
            _press(page, f"first_use_to_{step}")
            yield Seen(f"first use, {step}", page)
        window.hold.escape_pressed.emit()

    def _card(self, name: str = "", window: QWidget | None = None) -> QWidget:
        kind = QWidget if name else Overlay
        return next(card for card in (window or self.window).findChildren(kind, name or None) if card.isVisible())

    def _of_sessions(self) -> Iterator[Seen]:
        sessions = self.window.sessions
        sessions.open_start_dialog()
        yield self._own("start", "start_dialog")
        sessions.open_sessions()
        yield self._own("sessions", "sessions_window")
        sessions.open_sessions()
        seen = self._own("sessions found", "sessions_window")
        field = seen.part.findChild(QLineEdit, "sessions_search")
        assert field is not None
        field.setText("robot")
        field.returnPressed.emit()
        yield seen
        _close(seen)
        sessions.open_export([test_sessions.SESSIONS[0].folder])
        yield self._own("export", "export_dialog")

    def _of_the_robot(self) -> Iterator[Seen]:
        robots = self.window.robots
        robots.open_dialog()
        yield self._own("robot", "robot_dialog")
        for name, page in (("robot mapped", 0), ("robot offers", 1)):
            robots.open_dialog()
            seen = self._own(name, "robot_dialog")
            field = seen.part.findChild(QLineEdit, "robot_address")
            assert field is not None
            field.setText(ADDRESS)
            if name == "robot mapped":
                _press(seen.part, "robot_security")
            _press(seen.part, "robot_look")
            self.explorer.done(Exploration(ADDRESS, OFFER, propose(OFFER), ()))
            pages = seen.part.findChild(QTabWidget, "robot_pages")
            assert pages is not None
            pages.setCurrentIndex(page)
            yield seen
        _close(seen)
        self.window.gamepad.open()
        yield self._own("gamepad", "gamepad_dialog")
        self.window.faces.edit()
        yield self._own("face editor", "face_editor")

    def _of_the_scenario(self) -> Iterator[Seen]:
        dialog = TitleDialog(self.theme, self.window)
        dialog.show()
        yield self._own("layout title", "layout_title_dialog")
        row, rows = 0, 1
        while row < rows:
            self.window.editor.open()
            seen = self._own(f"scenario, {row}", "scenario_editor")
            sections = seen.part.findChild(QListWidget, "editor_sections")
            assert sections is not None
            rows = sections.count()
            sections.setCurrentRow(row)
            yield seen
            row += 1
        _close(seen)

    def _of_files(self) -> Iterator[Seen]:
        state = self.console.state
        state.file_question.reset_value(test_confirm_file.QUESTION)
        yield self._own("confirm file", "confirm_file_dialog")
        state.file_question.reset_value(None)
        state.import_question.reset_value(test_same_names.QUESTION)
        seen = self._own("same names", "same_names_dialog")
        yield seen
        _close(seen)
        state.import_question.reset_value(None)

    def _next_to(self) -> Iterator[Seen]:
        """File dialogs, cards and banners in the window, floating panels, and dialogs of Qt."""
        yield from self._of_files()
        yield from self._in_the_window()
        files = self.window.menus._parts.scenario_files
        for name, opened in (("import scenario", files.choose_import), ("share scenario", files.choose_share)):
            opened()
            seen = self._own(name, "scenario_file_dialog")
            yield seen
            _close(seen)

    def _in_the_window(self) -> Iterator[Seen]:
        """Cards at their subject, banners and strips, and a floating panel."""
        window, console = self.window, self.console
        window.activateWindow()
        window.open_panel("people")
        people = window.panels["people"]
        for page in ("about", "merge", "forget"):
            people.open_card(console.state.persons.value[0].person_id)
            assert people.card is not None
            people.card.show_page(page)
            yield Seen(f"person, {page}", people.card)
        people.card.close_card()
        console.mark("Interested", mark_id="mark-1")
        window.marking.card.show_mark("mark-1")
        yield Seen("mark", window.marking.card)
        window.marking.card.write_note()
        yield Seen("note", window.marking.card)
        window.marking.card.close_card()
        protocol = window._protocol
        console.do(GoToStep(console.scenario.protocol.steps[3].step_id))
        for name, opened in (("steps", protocol.show_steps), ("branches", protocol.choose_branch)):
            opened()
            yield Seen(name, self._card(f"{name}_card"))
            protocol.put_away()
        window.open_panel("map")
        tools = window.panels["map"].tools
        tools._on_place_clicked(console.scenario.places[0].name, QPointF(120, 80))
        yield Seen("place", self._card("map_card"))
        tools.ask_map_name("save_map")
        yield Seen("map name", self._card("map_name"))
        tools._remove(console.scenario.places[0].name)
        yield Seen("place removed", self._card("map_undo"))
        window.hold.escape_pressed.emit()
        yield from self._in_the_picture()
        window.problems.show_problem(Problem(clock.now_ns(), "error", "It stopped", "It means this.", "Do that."))
        yield Seen("problem", window.problems)
        window._question.ask("Erase everything that was recorded?", "Erase", lambda: None)
        yield Seen("question", window._strip)
        window._question.put_away()
        console.state.going_on.set(test_resume_trial_card.OFFERED)
        yield Seen("going on", self._card("going_on_card"))
        console.state.going_on.set(CrashRecoveryStatus())
        test_saved_session_card.stop_recording(console)
        yield Seen("session saved", self._card("saved_session_card"))
        window.hold.escape_pressed.emit()
        console.state.practice.set(test_practice_strip.status_at(2))
        yield Seen("practice", window.practice)
        console.state.practice.set(PracticeStatus())
        for panel in ("speak", "people"):
            window.dock_host.toggle_floating(panel)
            yield self._own(f"floating, {panel}", "floating_panels")
            window.dock_host.toggle_floating(panel)

    def _in_the_picture(self) -> Iterator[Seen]:
        """The card of a point on the floor, which requires a camera with known position."""
        state, panel = self.console.state, self.window.panels["video"]
        before = state.robot.value
        state.robot.set(test_video.ROBOT)
        state.goal.set(None)
        test_video.show_frame(self.console)
        assert isinstance(panel, VideoPanel)
        QTest.mouseClick(panel.view, Qt.MouseButton.LeftButton, pos=test_video.pixel_of_floor(panel, 3.0, 0.4))
        yield Seen("floor", self._card("video_card"))
        self.window.hold.escape_pressed.emit()
        state.robot.set(before)

    def _shown_to_others(self) -> Iterator[Seen]:
        for sees in SEES_WORDS:
            self.window.observers.open(sees)
            shown = self.window.observers.open_window
            assert shown is not None
            shown.complete()
            yield Seen(f"observer, {sees}", shown)
        self.window.observers.close()
        face = self.console.state.face
        face.set(replace(face.value, window=True))
        yield self._own("face", "face_window")
        face.set(replace(face.value, window=False))

    def of_the_replay(self, *, with_cards: bool = False) -> Iterator[Seen]:
        """The replay window with its timeline, next to a robot, and then its dialogs."""
        console = FakeConsole(self.console.scenario)
        console.state = LiveState(present=PresentClock(live=False))
        samples.fill_console(console)
        window, replay = MainWindow(console, theme=self.theme), FakeReplay(coding=sample_coding(120_000))
        self.replayed = console
        replay.overview.set(sample_overview())
        window.use_replay(replay)
        window.show()
        console.state.close()
        window.resize(USUAL)
        self.settle()
        assert window._replay_parts is not None
        timeline = window._replay_parts.timeline
        for name, opened in (
            ("agreement", timeline.open_agreement), ("import", timeline.open_import),
            ("tier", timeline.open_tier_dialog),
        ):  # fmt: skip
            opened()
            seen = self._own(name, f"{name}_dialog")
            yield seen
            _close(seen)
        window.resize(SMALLEST)
        self.settle()
        yield Seen("replay", window)
        _press(window, "timeline_drawer")
        yield Seen("replay, timeline", window)
        if with_cards:
            timeline.canvas.select(replay.coding.value.annotations[0].annotation_id)
            timeline.acts.rename_selected()
            yield Seen("annotation", self._card("label_card", window))
            timeline.acts.give_up()
        replay.live_robots.set(LiveRobotsStatus(("The robot of the second floor",)))
        _press(window, "timeline_drawer")
        yield Seen("replay, live robot", window)
        window.close()
        window.deleteLater()

    def _own(self, name: str, object_name: str) -> Seen:
        found = [
            widget for widget in QApplication.topLevelWidgets()
            if widget.objectName() == object_name and widget.isVisible()
        ]  # fmt: skip
        assert found, f"no window {object_name}: {[one.objectName() for one in QApplication.topLevelWidgets()]}"
        return Seen(name, found[0])

    def flaws_in(self, seen: Seen, screen: QSize) -> list[str]:
        """Text flaws on a screen of that size."""
        part, room = seen.part, screen - WINDOW_FRAME
        if part.isWindow() and part.objectName() != "main_window":
            opened = self._opened.setdefault(id(part), part.size().expandedTo(part.sizeHint()))
            part.resize(opened.boundedTo(room))
        else:
            part.window().resize(screen)
        self.settle()
        found = text_flaws(part)
        if found:
            QTest.qWait(_COMES_ROUND_MS)
            found = text_flaws(part)
        size, most = part.size(), screen if part.objectName() == "main_window" else room
        if part.isWindow() and (size.width() > most.width() or size.height() > most.height()):
            found.append(f"is {size.width()} x {size.height()} px at least, and the screen has less")
        return [f"{seen.name} at {screen.width()}x{screen.height()}: {flaw}" for flaw in found]

    def settle(self) -> None:
        for _ in range(10):
            QApplication.processEvents()


def _close(seen: Seen) -> None:
    if shiboken6.isValid(seen.part):
        seen.part.close()


def _press(part: QWidget, name: str) -> None:
    button = part.findChild(QAbstractButton, name)
    assert button is not None, name
    button.click()
