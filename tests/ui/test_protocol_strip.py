"""Protocol strip: present step, delay, and control by keys, buttons and palette."""

import dataclasses
from collections.abc import Callable, Iterator

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QPlainTextEdit, QWidget

from caris_desktop.domain import clock, intents
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.state import LiveValue, PresentClock
from caris_desktop.live.status import ProtocolStatus
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.recording.session.session_protocol import StepRecord
from caris_desktop.scenario.phrases import Phrase
from caris_desktop.scenario.protocol_steps import Branch, ProtocolSettings, ProtocolStep
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.palette.palette_entries import step_entries
from caris_desktop.ui.protocol_strip import ProtocolStrip, time_words
from caris_desktop.ui.text_formatting import duration
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import CheckBox
from caris_desktop.ui.window_appearance import ENGLISH, TRIAL, Language
from tests.support.polling import wait_for
from tests.support.tab_order_check import tab_order
from tests.support.window_check import text_flaws
from tests.ui import samples
from tests.ui.conftest import find, freshen
from tests.ui.fake_console import FakeConsole

CTRL, SHIFT, ALT, NONE = (
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.AltModifier,
    Qt.KeyboardModifier.NoModifier,
)
STEPS = (
    ProtocolStep("Greet", say="Hello!", minutes=1.0, tick=("Consent", "Coat off"), note="Smile."),
    ProtocolStep(
        "Ask questions", say="How are you?", minutes=0.5,
        branches=(Branch("Cries", "Close"), Branch("Wants to see the robot arm", "Show the robot arm")),
    ),
    ProtocolStep("Show the robot arm", go_to="Robot arm", branches=(Branch("Is bored", "Close"),)),
    ProtocolStep("Close"),
)  # fmt: skip
TOUR = dataclasses.replace(
    samples.TOUR,
    phrases=(*samples.TOUR.phrases, Phrase("Hello!", gesture="nod", face="happy")),
    protocol=ProtocolSettings(STEPS),
)
NOW_NS = clock.now_ns()


class Desk:
    """One window for all tests of this file."""

    def __init__(self, theme: Theme) -> None:
        self.console = FakeConsole(TOUR)
        samples.fill_console(self.console)
        # No stream becomes stale and raises an alarm during the tests.
        self.console.state.close()
        self.window = MainWindow(self.console, theme=theme)
        self.window.resize(1366, 768)
        self.window.show()
        self.window.activateWindow()
        self.strip = self.window._protocol

    def begin(self, step_id: str = "") -> None:
        """Restart the protocol in that step, or in none."""
        self.strip.put_away()
        self.console.protocol.begin_session("wizard")
        self.console.protocol.end_session()
        if step_id:
            self.console.do(intents.GoToStep(step_id))
        self.console.calls.clear()

    @property
    def asked(self) -> list[object]:
        return [arguments for name, arguments in self.console.calls if name == "protocol"]

    @property
    def step(self) -> str:
        step: str = self.console.state.protocol.value.step_id
        return step

    def focus(self, name: str) -> QWidget:
        widget = find(self.window, name)
        widget.setFocus()
        assert QApplication.focusWidget() is widget
        return widget

    def button(self, name: str) -> ActionButton:
        button = find(self.strip, f"strip_{name}")
        assert isinstance(button, ActionButton)
        return button

    def press(self, widget: QWidget) -> None:
        QTest.mouseClick(widget, Qt.MouseButton.LeftButton)

    def shows(self, name: str) -> bool:
        return any(widget.isVisible() for widget in self.window.findChildren(QWidget, name))


@pytest.fixture(scope="module")
def shared_desk(qapp: QApplication, theme: Theme) -> Iterator[Desk]:
    theme.set_choice("dark")
    desk = Desk(theme)
    wait_for(lambda: qapp.processEvents() or QApplication.activeWindow() is desk.window, "the window")
    freshen(desk.console)
    yield desk
    desk.window.close()
    desk.window.deleteLater()


@pytest.fixture
def desk(shared_desk: Desk) -> Iterator[Desk]:
    shared_desk.begin()
    yield shared_desk
    shared_desk.begin()


def test_one_key_continues_to_the_next_step_while_typing_and_while_driving(desk: Desk) -> None:
    field = desk.focus("speak_field")
    QTest.keyClick(field, Qt.Key.Key_PageDown, CTRL)
    assert desk.asked == [intents.NextStep()] and desk.step == "greet"
    video = desk.focus("video_view")
    QTest.keyClick(video, Qt.Key.Key_PageDown)
    assert desk.asked == [intents.NextStep()] * 2 and desk.step == "ask-questions"
    assert desk.button("next_step").key == "PgDown"
    desk.focus("speak_field")
    assert desk.button("next_step").key == "Ctrl PgDown"


def test_back_and_skip_have_a_key_each(desk: Desk) -> None:
    desk.begin("ask-questions")
    field = desk.focus("speak_field")
    QTest.keyClick(field, Qt.Key.Key_PageDown, CTRL | SHIFT)
    assert desk.asked == [intents.SkipStep()] and desk.console.state.protocol.value.skipped == ("ask-questions",)
    QTest.keyClick(field, Qt.Key.Key_PageUp, CTRL)
    assert desk.asked[1:] == [intents.PreviousStep()] and desk.step == "ask-questions"


def test_the_only_branch_is_one_key(desk: Desk) -> None:
    desk.begin("show-the-robot-arm")
    assert desk.button("branch").text() == "Is bored: Close"
    QTest.keyClick(desk.focus("speak_field"), Qt.Key.Key_B, CTRL)
    assert desk.asked == [intents.TakeBranch("Is bored")] and desk.step == "close"


@pytest.mark.parametrize(("name", "chord", "left_over"), [("speak_field", CTRL, CTRL), ("video_view", NONE, NONE)])
def test_of_several_branches_the_digit_says_which(
    desk: Desk, name: str, chord: Qt.KeyboardModifier, left_over: Qt.KeyboardModifier
) -> None:
    """Ctrl may still be held, and the digit must not start a goal meanwhile."""
    desk.begin("ask-questions")
    widget = desk.focus(name)
    QTest.keyClick(widget, Qt.Key.Key_B, chord)
    assert desk.asked == [] and desk.shows("branches_card")
    QTest.keyClick(widget, Qt.Key.Key_2, left_over)
    assert desk.asked == [intents.TakeBranch("Wants to see the robot arm")]
    assert desk.console.calls == [("protocol", desk.asked[0])], "neither a place nor a suggestion"
    assert desk.step == "show-the-robot-arm" and not desk.shows("branches_card")


def test_any_other_key_does_what_it_does_and_no_branch_is_taken(desk: Desk) -> None:
    desk.begin("ask-questions")
    field = desk.focus("speak_field")
    assert isinstance(field, QPlainTextEdit)
    field.clear()
    QTest.keyClick(field, Qt.Key.Key_B, CTRL)
    QTest.keyClick(field, Qt.Key.Key_Y)
    assert field.toPlainText() == "y" and desk.asked == [] and not desk.shows("branches_card")
    QTest.keyClick(field, Qt.Key.Key_1)
    assert field.toPlainText() == "y1" and desk.asked == []
    field.clear()
    desk.press(desk.button("branch"))
    desk.press(find(desk.window, "branch_1"))
    assert desk.asked == [intents.TakeBranch("Cries")]


def test_escape_stops_the_robot_and_puts_the_branches_away(desk: Desk) -> None:
    desk.begin("ask-questions")
    field = desk.focus("speak_field")
    QTest.keyClick(field, Qt.Key.Key_B, CTRL)
    QTest.keyClick(field, Qt.Key.Key_Escape)
    assert desk.console.named("stop") and not desk.shows("branches_card") and desk.asked == []


def test_texts_and_goals_of_the_step_have_one_key_each(desk: Desk) -> None:
    desk.begin("greet")
    field = desk.focus("speak_field")
    QTest.keyClick(field, Qt.Key.Key_F11)
    assert desk.console.named("say") == [("Hello!", "phrase")]
    table = desk.window.actions_table
    row = table.spec("say_step")
    assert row is not None
    intent = table.intent_of(row)
    assert intent == intents.Say("Hello!", "phrase", gesture="nod", face="happy")
    desk.begin("show-the-robot-arm")
    assert not desk.shows("strip_say_step")
    QTest.keyClick(field, Qt.Key.Key_0, ALT)
    assert desk.console.named("go_to_place") == ["Robot arm"]
    QTest.keyClick(desk.focus("video_view"), Qt.Key.Key_0)
    assert desk.console.named("go_to_place") == ["Robot arm"] * 2


def test_what_a_step_says_is_read_on_its_button(desk: Desk) -> None:
    """A narrower button has it in its accessible name and its tooltip."""
    desk.window.resize(1920, 1080)
    desk.begin("ask-questions")
    button = find(desk.window, "strip_say_step")
    assert isinstance(button, ActionButton)
    assert button.text() == button.accessibleName() == "Say “How are you?”"
    desk.window.resize(900, 700)
    assert button.text() in ("Say it", "")
    assert button.accessibleName() == button.toolTip() == "Say “How are you?”"
    desk.window.resize(1366, 768)


def test_time_is_reported_in_words_and_late_in_words_and_colour() -> None:
    status = ProtocolStatus("ask", "Ask", 2, 4, since_ns=0, expected_s=90.0)
    assert [time_words(status, round(s * 1e9)) for s in (0, 42, 90.4, 91, 170, 3700)] == [
        "0:00 of 1:30", "0:42 of 1:30", "1:30 of 1:30", "1:31 of 1:30 · 0:01 over", "2:50 of 1:30 · 1:20 over",
        "1:01:40 of 1:30 · 1:00:10 over",
    ]  # fmt: skip
    assert time_words(dataclasses.replace(status, expected_s=0.0), 125_000_000_000) == "2:05"
    assert duration(3723) == "1:02:03"


def test_a_step_that_is_late_says_so_on_its_pill(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    state = desk.console.state
    monkeypatch.setattr(state, "present", PresentClock(now_ns=lambda: NOW_NS))
    shown = []
    for took_s in (20.0, 110.0):
        since_ns = NOW_NS - round(took_s * 1e9)
        state.protocol.set(
            ProtocolStatus("ask-questions", "Ask questions", 2, 4, since_ns, expected_s=30.0, done=("greet",))
        )
        shown.append(next(step for step in desk.strip.pills.shown if step.number == 2))
    assert [(step.text, step.state) for step in shown] == [
        ("2 Ask questions · 0:20 of 0:30", "now"),
        ("2 Ask questions · 1:50 of 0:30 · 1:20 over", "late"),
    ]
    assert shown[1].words == "Step 2, Ask questions: now, 1:50 of 0:30 · 1:20 over"
    pill = find(desk.strip, "step_2")
    assert pill.accessibleName() == shown[1].words
    amber = desk.window.theme.color("amber_soft").rgb()
    image = pill.grab().toImage()
    assert image.pixel(image.width() // 2, 4) == amber


def test_every_step_can_be_begun_from_the_list_which_opens_by_the_present_one(desk: Desk) -> None:
    desk.begin("greet")
    desk.press(find(desk.strip, "step_1"))
    rows = [row.text() for row in desk.window.findChildren(ActionButton) if row.objectName().startswith("step_row_")]
    assert [text.split(" · ")[0] for text in rows] == [
        "1  Greet", "2  Ask questions", "3  Show the robot arm", "4  Close",
    ]  # fmt: skip
    assert desk.shows("step_note")
    desk.press(find(desk.window, "step_row_4"))
    assert desk.asked == [intents.GoToStep("close")] and not desk.shows("steps_card")
    desk.press(find(desk.strip, "step_3"))
    assert desk.asked[1:] == [intents.GoToStep("show-the-robot-arm")]


def test_the_list_that_a_key_opens_takes_a_digit_and_a_press_next_to_it_closes_it(desk: Desk) -> None:
    field = desk.focus("speak_field")
    QTest.keyClick(field, Qt.Key.Key_PageUp, CTRL | SHIFT)
    row = find(desk.window, "step_row_3")
    assert isinstance(row, ActionButton) and row.key == "3"
    QTest.keyClick(field, Qt.Key.Key_3)
    assert desk.asked == [intents.GoToStep("show-the-robot-arm")] and not desk.shows("steps_card")
    desk.press(find(desk.strip, "step_3"))
    assert desk.shows("steps_card") and row.key == "", "who opens it with the mouse types on"
    QTest.keyClick(field, Qt.Key.Key_1)
    assert isinstance(field, QPlainTextEdit) and field.toPlainText() == "1" and len(desk.asked) == 1
    field.clear()
    desk.press(field.viewport())
    assert not desk.shows("steps_card")


def test_a_ticked_item_is_a_box_in_the_line_or_in_the_list(desk: Desk) -> None:
    desk.begin("greet")
    box = find(desk.strip, "strip_tick_2")
    assert isinstance(box, CheckBox) and box.text() == "Coat off"
    desk.press(box)
    assert desk.asked == [intents.TickItem("Coat off", True)] and box.isChecked()
    desk.strip.show_steps()
    ticks = [box for box in desk.window.findChildren(CheckBox) if box.window() is desk.window and box.isVisible()]
    in_card = [box for box in ticks if not desk.strip.isAncestorOf(box)]
    assert [(box.text(), box.isChecked()) for box in in_card] == [("Consent", False), ("Coat off", True)]
    desk.press(in_card[1])
    assert desk.asked[1:] == [intents.TickItem("Coat off", False)] and not box.isChecked()


@pytest.mark.parametrize("width_px", [1366, 1024])
def test_nothing_of_the_line_is_cut_or_lies_upon_another(desk: Desk, width_px: int) -> None:
    desk.window.resize(width_px, 768)
    try:
        for step in ("", *(step.step_id for step in STEPS)):
            desk.begin(step)
            QApplication.processEvents()
            strip, right = desk.strip, 0
            parts = [part for part in strip.findChildren(QWidget) if part.isVisible() and part.parent() is strip]
            for part in sorted(parts, key=lambda part: part.x()):
                assert part.x() >= right, (step, part.objectName())
                right = part.x() + part.width()
                if isinstance(part, ActionButton):
                    assert part.width() >= part.sizeHint().width(), (step, part.objectName())
            assert right <= strip.width()
            present = next(pill for pill in strip.pills.shown if pill.state in ("now", "late") or not step)
            pill = find(strip, f"step_{present.number}")
            assert pill.width() >= pill.sizeHint().width(), step
    finally:
        desk.window.resize(1366, 768)


@pytest.mark.long
def test_tab_goes_through_the_line_from_left_to_right(desk: Desk) -> None:
    for step in ("", *(step.step_id for step in STEPS)):
        if step:
            desk.begin(step)
        QApplication.processEvents()
        reached = [part for part in tab_order(desk.window) if desk.strip.isAncestorOf(part)]
        left = [part.mapTo(desk.strip, part.rect().topLeft()).x() for part in reached]
        assert len(left) > 4 and left == sorted(left), (step, [part.objectName() for part in reached])


def test_steps_and_branches_are_found_by_name(desk: Desk) -> None:
    desk.begin("ask-questions")
    entries = {entry.text: entry for entry in desk.window.palette_entries()}
    assert entries["Next step"].key in ("Ctrl PgDown", "PgDown")
    entries["Cries: continue to Close"].do()
    entries["Step 1: Greet"].do()
    assert desk.asked == [intents.TakeBranch("Cries"), intents.GoToStep("greet")]


class Bare:
    """Strip without the rest of the window."""

    def __init__(self, theme: Theme, scenario: Scenario) -> None:
        self.console = FakeConsole(scenario)
        self.window = QWidget()
        self.actions = Actions(self.window, self.console, self.window)
        self.actions.rebuild(scenario)
        self.hold = DriveInputFilter(self.console, self.actions, self.window)
        self.strip = ProtocolStrip(theme, self.console, self.actions, self.hold)
        self.strip.setParent(self.window)
        self.strip.resize(1366, 40)
        self.window.show()

    def close(self) -> None:
        self.hold.close()
        self.window.close()
        self.window.deleteLater()
        self.console.state.close()

    def offered(self) -> list[str]:
        """Visible buttons."""
        buttons = self.strip.findChildren(ActionButton)
        return [button.objectName().removeprefix("strip_") for button in buttons if button.isVisible()]


@pytest.fixture
def bare(qapp: QApplication, theme: Theme) -> Iterator[Callable[[Scenario], Bare]]:
    made: list[Bare] = []

    def make(scenario: Scenario) -> Bare:
        made.append(Bare(theme, scenario))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_a_scenario_without_protocol_has_no_line_no_key_and_no_words_for_it(bare: Callable[[Scenario], Bare]) -> None:
    desk = bare(samples.TOUR)
    assert not desk.strip.isVisible()
    assert [spec.id for spec in desk.actions.specs if spec.group == "Protocol"] == []
    assert step_entries(desk.console) == []
    desk.console.scenario = TOUR
    desk.console.protocol.use_scenario(TOUR)
    desk.console.state.scenario.set(TOUR)
    assert desk.strip.isVisible()


def test_a_scenario_that_neither_speaks_nor_drives_offers_neither(bare: Callable[[Scenario], Bare]) -> None:
    both = tuple(dataclasses.replace(step, say="Hello!", go_to="Robot arm") for step in STEPS)
    scenario = dataclasses.replace(TOUR, protocol=ProtocolSettings(both))
    silent = dataclasses.replace(TOUR.permissions, speech=False, driving=False)
    acts = {"say_step", "go_to_step_place"}
    for permissions, offers in ((TOUR.permissions, acts), (silent, set())):
        desk = bare(dataclasses.replace(scenario, permissions=permissions))
        desk.console.do(intents.GoToStep("greet"))
        assert acts.intersection(desk.offered()) == offers
        assert {spec.id for spec in desk.actions.specs if spec.id in acts} == offers


def test_a_replay_shows_where_the_wizard_was_and_goes_nowhere(bare: Callable[[Scenario], Bare]) -> None:
    desk, overview, wanted = bare(TOUR), LiveValue(None), []
    desk.strip.moment_requested.connect(wanted.append)
    desk.strip.show_replay(overview)
    state = desk.console.state
    state.protocol.set(
        ProtocolStatus(
            "close", "Close", 4, 4, state.present.now_ns(), done=("greet",), skipped=("ask-questions",),
        )
    )  # fmt: skip
    assert [step.state for step in desk.strip.shown_steps()] == ["done", "skipped", "ahead", "now"]
    assert desk.offered() == []
    QTest.mouseClick(find(desk.strip, "step_1"), Qt.MouseButton.LeftButton)
    assert desk.console.calls == [] and wanted == []
    assert TOUR.path is not None
    file = TOUR.path.name
    overview.set(
        SessionOverview(
            AnnotationDocument((), (), ()), (),
            steps=(
                StepRecord("greet", "Greet", 1, 60.0, 1, 75.0, 15.0, 0, 2, 2, 7_000, file),
                StepRecord("ask-questions", "Ask questions", 2, 30.0, 2, 20.0, 0.0, 1, 0, 0, 9_000, file),
                StepRecord("show-the-robot-arm", "Show the robot arm", 3, 0.0, 0, 0.0, 0.0, 0, 0, 0, None, file),
                StepRecord("close", "Close", 4, 0.0, 1, 125.0, 0.0, 0, 0, 0, 11_000, file),
                StepRecord("greet", "Greet", 1, 5.0, 1, 5.0, 0.0, 0, 0, 0, 99_000, "another scenario.yaml"),
            ),
        )
    )  # fmt: skip
    QTest.mouseClick(find(desk.strip, "step_4"), Qt.MouseButton.LeftButton)
    rows = [row for row in desk.window.findChildren(ActionButton) if row.objectName().startswith("step_row_")]
    assert [row.text().partition(" · ")[2] for row in rows] == [
        "1:15 of 1:00 · 0:15 over", "0:20 of 0:30 · skipped · started 2 times", "not started", "2:05",
    ]  # fmt: skip
    QTest.mouseClick(rows[1], Qt.MouseButton.LeftButton)
    QTest.mouseClick(find(desk.strip, "step_3"), Qt.MouseButton.LeftButton)
    assert wanted == [9_000] and desk.console.calls == [], "to where it began, if it did"


@pytest.mark.parametrize("language", [ENGLISH, TRIAL])
@pytest.mark.long("trial")
def test_every_step_of_every_shipped_scenario_can_be_read(bare: Callable[[Scenario], Bare], language: str) -> None:
    """On the smallest screen, late, with texts that are 40 % longer."""
    speaks = Language()
    speaks.use(language)
    try:
        read = 0
        for path in sorted(layouts_dir().glob("*.yaml")):
            scenario = load_scenario(path)
            if not scenario.protocol.steps:
                continue
            desk = bare(scenario)
            for step in scenario.protocol.steps:
                desk.console.do(intents.GoToStep(step.step_id))
                status = desk.console.state.protocol.value
                late_ns = status.since_ns - round((step.expected_s + 3725) * 1e9)
                desk.console.state.protocol.set(dataclasses.replace(status, since_ns=late_ns))
                QApplication.processEvents()
                assert text_flaws(desk.window) == [], (path.stem, step.title)
                read += 1
        assert read > 15
    finally:
        speaks.use(ENGLISH)
