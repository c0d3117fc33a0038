"""Protocol strip: the steps in a row, current step, elapsed time, next step and branches in one line."""

from collections.abc import Sequence
from dataclasses import replace
from textwrap import shorten
from typing import TYPE_CHECKING, Literal

from PySide6.QtCore import QEvent, QObject, QPoint, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QHideEvent, QIcon, QResizeEvent
from PySide6.QtWidgets import QPushButton, QSizePolicy, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import LATE_FROM_S
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import ProtocolStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.protocol_steps import ProtocolStep
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import PROTOCOL_GROUP, present_step, target_of
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.focus_widget import Bar, application
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.text_formatting import duration
from caris_desktop.ui.theme import Theme, icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import CheckBox
from caris_desktop.ui.widgets.labels import ElidedLabel, label, named, restyle
from caris_desktop.ui.widgets.popups import FloatingCard

if TYPE_CHECKING:
    # Imported late: the window is shown before session files are read.
    from caris_desktop.recording.annotation.timeline_overview import SessionOverview
    from caris_desktop.recording.session.session_protocol import StepRecord
StepState = Literal["done", "skipped", "now", "late", "ahead"]

_PILL_PX = 28
_PILL_SIDE_PX, _ICON_PX, _PILL_GAP_PX = 12, 14, 6
_PILLS_LEAST_PX = 130
_PILL_ICONS: dict[StepState, str] = {
    "done": "check", "skipped": "skip-forward", "now": "caret-down", "late": "caret-down", "ahead": "",
}  # fmt: skip


class DisplayedStep(Value):
    """Step as displayed; ``time`` is set for the current one."""

    step_id: str
    number: int
    title: str
    state: StepState
    time: str = ""

    @property
    def text(self) -> str:
        if self.state in ("done", "skipped"):
            return self.title
        return f"{self.number} {self.title}" + (f" · {self.time}" if self.time else "")

    @property
    def words(self) -> str:
        """Accessible name and tooltip."""
        named = {
            "done": tr("Step {number}, {title}: done"),
            "skipped": tr("Step {number}, {title}: skipped"),
            "now": tr("Step {number}, {title}: now, {time}"),
            "late": tr("Step {number}, {title}: now, {time}"),
            "ahead": tr("Step {number}, {title}: not done yet"),
        }[self.state]
        return named.format(number=self.number, title=self.title, time=self.time)


class StepPill(QPushButton):
    """Button of a step. A click does not take the focus."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        self.step = DisplayedStep("", 0, "", "ahead")
        self.setProperty("role", "pill")
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setIconSize(QSize(_ICON_PX, _ICON_PX))
        theme.changed.connect(self._show_icon)

    def show_step(self, step: DisplayedStep) -> None:
        if step != self.step:
            self.step = step
            self.setAccessibleName(step.words)
            self.setToolTip(step.words)
            self.setText(step.text.replace("&", "&&"))
            restyle(self, tone={"now": "blue", "late": "amber"}.get(step.state, ""))
            self._show_icon()

    def _show_icon(self) -> None:
        present, name = self.step.state in ("now", "late"), _PILL_ICONS[self.step.state]
        self.setIcon(icon(name, self._theme.color("text" if present else "dim"), _ICON_PX) if name else QIcon())
        # The arrow of the list of steps follows the text.
        self.setLayoutDirection(Qt.LayoutDirection.RightToLeft if present else Qt.LayoutDirection.LeftToRight)

    def wanted_px(self) -> int:
        # Measured with wide digits, so that a running time moves nothing.
        wide = "".join("0" if sign.isdigit() else sign for sign in self.step.text)
        return self.fontMetrics().horizontalAdvance(wide) + self._around_px

    @property
    def _around_px(self) -> int:
        return 2 * _PILL_SIDE_PX + 2 + (_ICON_PX + 6 if _PILL_ICONS[self.step.state] else 0)

    def sizeHint(self) -> QSize:
        return QSize(self.wanted_px(), _PILL_PX)

    def place(self, left_px: int, width_px: int) -> None:
        """Place in the row, with as much of the text as fits."""
        right = Qt.TextElideMode.ElideRight
        text = self.fontMetrics().elidedText(self.step.text, right, width_px - self._around_px + 1)
        self.setText(text.replace("&", "&&"))
        self.setGeometry(left_px, 0, width_px, _PILL_PX)


class StepPills(QWidget):
    """Row of steps."""

    clicked = Signal(DisplayedStep)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("step_pills")
        self._theme = theme
        self._pills: list[StepPill] = []
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setFixedHeight(_PILL_PX)
        theme.changed.connect(self._arrange)

    def minimumSizeHint(self) -> QSize:
        return QSize(_PILLS_LEAST_PX, _PILL_PX)

    @property
    def shown(self) -> list[DisplayedStep]:
        """Visible steps, from left to right."""
        return [pill.step for pill in self._pills if not pill.isHidden()]

    @property
    def buttons(self) -> Sequence[StepPill]:
        """Buttons of all steps, in order."""
        return tuple(self._pills)

    @property
    def present_px(self) -> int:
        """Width of the current or first step."""
        return self._pills[self._middle].wanted_px() if self._pills else 0

    def show_steps(self, steps: Sequence[DisplayedStep]) -> None:
        layouts.adjust_count(self._pills, len(steps), self._new_pill)
        for pill, step in zip(self._pills, steps, strict=True):
            pill.show_step(step)
            pill.setObjectName(f"step_{step.number}")
        self._arrange()

    def _new_pill(self) -> StepPill:
        pill = StepPill(self._theme, self)
        pill.clicked.connect(lambda: self.clicked.emit(pill.step))
        return pill

    @property
    def _middle(self) -> int:
        """Index of the current step; the first before the start, the last after the end."""
        states = [pill.step.state for pill in self._pills]
        present = [index for index, state in enumerate(states) if state in ("now", "late")]
        return present[0] if present else 0 if "ahead" in states else len(states) - 1

    def _arrange(self) -> None:
        if not self._pills:
            return
        middle = self._middle
        first = last = middle
        widths_px = [pill.wanted_px() for pill in self._pills]
        room = self.width() - widths_px[middle]
        # Following steps take precedence over former ones.
        for _ in self._pills:
            for after in (True, False):
                beside = last + 1 if after else first - 1
                if 0 <= beside < len(widths_px) and room >= widths_px[beside] + _PILL_GAP_PX:
                    room -= widths_px[beside] + _PILL_GAP_PX
                    first, last = min(first, beside), max(last, beside)
        left = 0
        for index, pill in enumerate(self._pills):
            pill.setVisible(first <= index <= last)
            if first <= index <= last:
                width = min(widths_px[index], self.width())
                pill.place(left, width)
                left += width + _PILL_GAP_PX

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._arrange()


HEIGHT_PX = 36
_BUTTON_PX = 28
_GAP_PX, _SIDE_PX = 6, 8
_SECOND_MS = 250
_LEAST_PX, _NOTE_PX = 600, 160
_MOST_INLINE_TICKS = 2
_QUOTED_LETTERS = 40
# Levels of shrinking in a narrow window, in this order; key caps and the current step always stay.
_FULL, _NO_NOTE, _TICKS_COUNTED, _NEXT_SHORT, _ACTS_SHORT, _BRANCH_SHORT, _ALL_SHORT = range(7)


class ProtocolStrip(Bar, QWidget):
    """Protocol strip, hidden if the scenario has no protocol. In a replay it shows the step at that time and the
    duration of each step in the session; ``moment_requested`` is the start time of a clicked step.
    """

    accessible_role = QAccessible.Role.Grouping

    moment_requested = Signal(int)

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions, hold: DriveInputFilter) -> None:
        super().__init__()
        self.setObjectName("protocol_strip")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setAccessibleName(tr("Protocol"))
        self.setFixedHeight(HEIGHT_PX)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._console = console
        self._actions = actions
        self._hold = hold
        self._records: dict[tuple[str, str], StepRecord] = {}
        self._replay = False
        self._asks_for_step = False
        self._steps_card: StepsCard | None = None
        self._branches_card: BranchesCard | None = None
        self.pills = StepPills(theme)
        self.pills.clicked.connect(self._on_pill_clicked)
        self._note = ElidedLabel(role="fine", objectName="step_note_line")
        self._ticks: list[CheckBox] = []
        self._ticked = self._button("ticks_button", icon="check-square", menu_arrow=True)
        self._ticked.clicked.connect(self._open_or_close_list)
        self._say = self._button("say_step", "say_step", icon="chat-text")
        self._go = self._button("go_to_step_place", "go_to_step_place", icon="flag")
        self._branch = self._button("branch", "branch", icon="git-branch", may_shrink=True)
        self._back = self._button("previous_step", "previous_step", icon="arrow-left", ghost=True)
        self._skip = self._button("skip_step", "skip_step", icon="skip-forward", ghost=True)
        self.next_button = self._button("next_step", "next_step", icon="arrow-right", may_shrink=True)
        self._acts = (self._say, self._go, self._branch, self._back, self._skip, self.next_button)
        self._row = layouts.hbox(
            self, (self.pills, 3), (self._note, 1), self._ticked, *self._acts, margins_px=(_SIDE_PX, 0, _SIDE_PX, 0),
            spacing_px=_GAP_PX,
        )  # fmt: skip
        self._clock = QTimer(self, interval=_SECOND_MS)
        self._clock.timeout.connect(self._show_time)
        state = console.state
        for value in (state.protocol, state.scenario):
            value.changed.connect(self.refresh)
        actions.answer_for(PROTOCOL_GROUP, self)
        actions.keys_changed.connect(self._make_room)
        hold.escape_pressed.connect(self.put_away)
        self.refresh()

    def _button(
        self, name: str, action_id: str = "", *, icon: str, ghost: bool = False, menu_arrow: bool = False,
        may_shrink: bool = False,
    ) -> ActionButton:  # fmt: skip
        button = ActionButton(
            self._theme, icon=icon, role="ghost" if ghost else "plain", height_px=_BUTTON_PX,
            text_px=tokens.STATUS_PX + 1, menu_arrow=menu_arrow, may_shrink=may_shrink, once=True,
            objectName=f"strip_{name}",
        )  # fmt: skip
        if action_id:
            button.bind(self._actions, action_id)
        return button

    # Display

    @property
    def status(self) -> ProtocolStatus:
        status: ProtocolStatus = self._console.state.protocol.value
        return status

    @property
    def _step(self) -> ProtocolStep | None:
        return present_step(self._console.scenario, self._console.state)

    def show_replay(self, overview: LiveValue) -> None:
        """Show a replay, without controls. ``overview`` as in ReplayConsole."""
        self._replay = True
        overview.follow(self._on_overview)

    def _on_overview(self, overview: "SessionOverview | None") -> None:
        steps = () if overview is None else overview.steps
        self._records = {(record.scenario, record.step_id): record for record in steps}
        self.refresh()

    def refresh(self) -> None:
        """Update from scenario and state."""
        steps = self._console.scenario.protocol.steps
        if not steps:
            self.hide()
            self._clock.stop()
            self.put_away()
            return
        if self.parentWidget() is not None:
            self.show()
        step = self._step
        self._say_buttons(step)
        self._show_ticks(step)
        note = tr("The protocol has ended.") if self.status.ended else ""
        self._note.setText(note if step is None else step.note)
        self._show_time()
        if step is None:
            self._clock.stop()
        elif not self._clock.isActive():
            self._clock.start()

    def shown_steps(self) -> list[DisplayedStep]:
        """All steps in their current state."""
        status, now_ns = self.status, self._console.state.present.now_ns()
        present: StepState = "late" if is_late(status, now_ns) else "now"
        return [
            DisplayedStep(step.step_id, number, step.title, present, time_words(status, now_ns))
            if step.step_id == status.step_id
            else DisplayedStep(step.step_id, number, step.title, _state(step.step_id, status))
            for number, step in enumerate(self._console.scenario.protocol.steps, start=1)
        ]

    def _show_time(self) -> None:
        steps = self.shown_steps()
        self.pills.show_steps(steps)
        if self._steps_card is not None and self._steps_card.isVisible():
            self._fill_steps_card(steps)
        self._make_room()

    def _say_buttons(self, step: ProtocolStep | None) -> None:
        permissions, status = self._console.scenario.permissions, self.status
        live = not self._replay
        self._say.setVisible(live and permissions.speech and step is not None and bool(step.say))
        self._go.setVisible(live and permissions.driving and step is not None and bool(step.go_to))
        self._branch.setVisible(live and step is not None and bool(step.branches))
        self._back.setVisible(live and (step is not None or status.ended))
        self._skip.setVisible(live and step is not None)
        self.next_button.setVisible(live and not status.ended)
        if step is not None:
            self._say.setToolTip(tr("Say “{text}”").format(text=step.say))
            self._go.setToolTip(tr("Drive to {place}").format(place=step.go_to))
            self._branch.setToolTip("\n".join(self._branch_texts(step)))
        self._back.setAccessibleName(tr("Back to the previous step"))
        self._back.setToolTip(tr("Back to the previous step. Its timer continues from where it stopped."))
        self._skip.setAccessibleName(tr("Skip this step"))
        self._skip.setToolTip(tr("Skip this step and continue with the next one"))
        if self._branches_card is not None and self._branches_card.isVisible():
            self.put_away()

    def _next_words(self, level: int) -> str:
        status, short = self.status, level >= _NEXT_SHORT
        if level >= _ALL_SHORT:
            return ""
        if not status.step_id:
            return tr("Start") if short else tr("Start: {step}").format(step=status.next_title)
        if not status.next_title:
            return tr("Finish")
        return tr("Next step") if short else tr("Next: {step}").format(step=status.next_title)

    def _say_words(self, step: ProtocolStep | None, level: int) -> str:
        if level > _FULL or step is None or not step.say:
            return "" if level >= _ACTS_SHORT else tr("Say it")
        return tr("Say “{text}”").format(text=shorten(step.say, _QUOTED_LETTERS, placeholder="…"))

    def _branch_words(self, step: ProtocolStep, level: int) -> str:
        if level >= _ALL_SHORT:
            return ""
        if len(step.branches) == 1 and level < _BRANCH_SHORT:
            return self._branch_texts(step)[0]
        return tr("%n branches", "", len(step.branches)) if len(step.branches) > 1 else tr("Branch")

    def _branch_texts(self, step: ProtocolStep) -> list[str]:
        scenario = self._console.scenario
        return [
            tr("{what}: {step}").format(what=branch.title, step=target_of(scenario, branch).title)
            for branch in step.branches
        ]

    # Checklist

    def _ticks_now(self, step: ProtocolStep | None) -> list[tuple[str, bool]]:
        return [] if step is None else [(item, item in self.status.ticked) for item in step.tick]

    def _show_ticks(self, step: ProtocolStep | None) -> None:
        """Show a short checklist in the strip itself if there is room."""
        ticks = self._ticks_now(step)
        inline = ticks if len(ticks) <= _MOST_INLINE_TICKS else []
        if [box.text() for box in self._ticks] != [item for item, _ in inline]:
            for box in self._ticks:
                layouts.discard(box)
            self._ticks = [self._new_tick(number, item) for number, (item, _) in enumerate(inline, start=1)]
        for box, (_, on) in zip(self._ticks, inline, strict=True):
            box.setChecked(on)
            box.setEnabled(not self._replay)
        done = sum(on for _, on in ticks)
        self._ticked.set_label(tr("{done} of {all} ticked").format(done=done, all=len(ticks)))

    def _new_tick(self, number: int, item: str) -> CheckBox:
        box = CheckBox(self._theme, item, objectName=f"strip_tick_{number}", clicked=lambda on: self._tick(item, on))
        box.setFont(self._theme.font(tokens.STATUS_PX + 1))
        self._row.insertWidget(self._row.indexOf(self._ticked), box)
        return box

    def _tick(self, item: str, on: bool) -> None:
        self._console.do(intents.TickItem(item, on))
        self._show_ticks(self._step)

    # Commands

    def _on_pill_clicked(self, step: DisplayedStep) -> None:
        if step.state in ("now", "late"):
            self._open_or_close_list()
        else:
            self._go_to(step.step_id)

    def _go_to(self, step_id: str) -> None:
        record = self._record_of(step_id)
        if not self._replay:
            self._console.do(intents.GoToStep(step_id))
        elif record is not None and record.first_ns is not None:
            self.moment_requested.emit(record.first_ns)

    def choose_branch(self) -> None:
        """Take the only branch at once; of several, the one whose digit follows or that is clicked."""
        step = self._step
        if step is None or not step.branches:
            return
        if len(step.branches) == 1:
            self._take_branch(1)
            return
        card = self._branches_card
        if card is None:
            card = self._branches_card = BranchesCard(self._theme, self.window())
            card.chosen.connect(self._take_branch)
            card.closed.connect(self._on_card_closed)
        card.show_branches(self._branch_texts(step))
        card.open_below(self._branch, self)
        digits = "".join(str(number) for number in range(1, len(step.branches) + 1))
        self._hold.ask_next_key(digits, self._on_digit, after=Qt.KeyboardModifier.ControlModifier)

    def _on_digit(self, digit: str) -> None:
        if digit:
            self._take_branch(int(digit))
        elif self._branches_card is not None:
            self._branches_card.hide()

    def _take_branch(self, number: int) -> None:
        step = self._step
        self.put_away()
        if step is not None and number <= len(step.branches):
            self._console.do(intents.TakeBranch(step.branches[number - 1].title))

    def show_steps(self) -> None:
        """Open the list of all steps; the next digit may select one."""
        if self._steps_card is not None:
            self._steps_card.hide()
        self._asks_for_step = True
        self._open_or_close_list()
        count = len(self._console.scenario.protocol.steps)
        digits = "".join(str(number) for number in range(1, min(count, MOST_DIGITS) + 1))
        self._hold.ask_next_key(digits, self._on_step_digit)

    def _on_step_digit(self, digit: str) -> None:
        steps = self._console.scenario.protocol.steps
        if self._steps_card is not None:
            self._steps_card.hide()
        if digit and int(digit) <= len(steps):
            self._go_to(steps[int(digit) - 1].step_id)

    def _open_or_close_list(self) -> None:
        card = self._steps_card
        if card is None:
            card = self._steps_card = StepsCard(self._theme, self.window())
            card.chosen.connect(self._go_to)
            card.ticked.connect(self._tick)
            card.closed.connect(self._on_card_closed)
        if card.isVisible():
            card.hide()
            return
        self._fill_steps_card(self.shown_steps())
        card.open_below(self.pills, self)

    def _on_card_closed(self) -> None:
        self._asks_for_step = False
        self._hold.ask_no_key()

    def _fill_steps_card(self, steps: list[DisplayedStep]) -> None:
        step = self._step
        if self._steps_card is not None:
            note = "" if step is None else step.note
            if self._replay:
                records = [self._record_of(step.step_id) for step in steps]
                steps = [
                    step if record is None else replace(step, time=record_words(record))
                    for step, record in zip(steps, records, strict=True)
                ]
            self._steps_card.show_steps(
                steps, note, self._ticks_now(step), digits=self._asks_for_step, live=not self._replay
            )

    def _record_of(self, step_id: str) -> "StepRecord | None":
        """Record of a step of the present scenario."""
        path = self._console.scenario.path
        return self._records.get(("" if path is None else path.name, step_id))

    def put_away(self) -> None:
        """Close the popups below the strip."""
        for card in (self._branches_card, self._steps_card):
            if card is not None:
                card.hide()

    # Layout and style

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._make_room()

    def minimumSizeHint(self) -> QSize:
        return QSize(_LEAST_PX, HEIGHT_PX)

    def _make_room(self) -> None:
        level = _FULL
        while level < _ALL_SHORT and self._needed_px(level) > self.width():
            level += 1
        step, full = self._step, self._words(_FULL)
        for button, text in self._words(level).items():
            button.set_label(text, name=full[button])
        self._note.setVisible(level < _NO_NOTE and bool(self._note.text()))
        inline = level < _TICKS_COUNTED and bool(self._ticks)
        for box in self._ticks:
            box.setVisible(inline)
        self._ticked.setVisible(step is not None and bool(step.tick) and not inline)

    def _needed_px(self, level: int) -> int:
        """Minimum width of the strip at this level of shrinking."""
        step = self._step
        widths = [self.pills.present_px]
        if self._note.text() and level < _NO_NOTE:
            widths.append(min(_NOTE_PX, self._note.fontMetrics().horizontalAdvance(self._note.text()) + 8))
        if step is not None and step.tick:
            inline = level < _TICKS_COUNTED and self._ticks
            widths += [box.sizeHint().width() for box in self._ticks] if inline else [self._ticked.sizeHint().width()]
        widths += [button.width_with(text) for button, text in self._words(level).items() if not button.isHidden()]
        return sum(widths) + _GAP_PX * len(widths) + 2 * _SIDE_PX

    def _words(self, level: int) -> dict[ActionButton, str]:
        """Button texts at this level of shrinking."""
        step = self._step
        return {
            self._say: self._say_words(step, level),
            self._go: "" if level >= _ACTS_SHORT else tr("Go there"),
            self._branch: "" if step is None or not step.branches else self._branch_words(step, level),
            self._back: "",
            self._skip: "",
            self.next_button: self._next_words(level),
        }


def _state(step_id: str, status: ProtocolStatus) -> StepState:
    return "skipped" if step_id in status.skipped else "done" if step_id in status.done else "ahead"


def time_words(status: ProtocolStatus, now_ns: int) -> str:
    """Elapsed and expected time of the current step, and the time over it."""
    return _planned_and_actual(status.elapsed_s(now_ns), status.expected_s, status.late_s(now_ns))


def record_words(record: "StepRecord") -> str:
    """Recorded and planned time of a step in a session, and the time over it."""
    if not record.visits:
        return tr("not started")
    words = _planned_and_actual(record.time_s, record.expected_s, record.late_s)
    if record.skipped:
        words = tr("{time} · skipped").format(time=words)
    return words if record.visits == 1 else tr("{time} · started %n times", "", record.visits).format(time=words)


def _planned_and_actual(actual_s: float, expected_s: float, late_s: float) -> str:
    if not expected_s:
        return duration(actual_s)
    if late_s < LATE_FROM_S:
        return tr("{elapsed} of {expected}").format(elapsed=duration(actual_s), expected=duration(expected_s))
    return tr("{elapsed} of {expected} · {excess} over").format(
        elapsed=duration(actual_s), expected=duration(expected_s), excess=duration(late_s)
    )


def is_late(status: ProtocolStatus, now_ns: int) -> bool:
    """Whether the step is late by a whole second, so that colour and text change together."""
    return status.late_s(now_ns) >= LATE_FROM_S


MOST_DIGITS = 9
_ROW_PX = 34
_WIDE_PX = 440
_MOST_HIGH_PX = 420
_ICONS: dict[StepState, str] = {
    "done": "check", "skipped": "skip-forward", "now": "play", "late": "play", "ahead": "circle",
}  # fmt: skip


class _CardBelow(FloatingCard):
    """Popup below a part of the strip; a click elsewhere closes it and keeps its usual effect."""

    accessible_role = QAccessible.Role.Dialog

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window)
        self._presses = EventWatch(self, self._on_pressed, QEvent.Type.MouseButtonPress)

    def open_below(self, part: QWidget, strip: QWidget) -> None:
        self._strip = strip
        if self.isHidden():
            self._presses.add(application())
        self.adjustSize()
        where = part.mapTo(self._room, QPoint(0, part.height() + 6))
        room = self._room.rect()
        self.move(max(6, min(where.x(), room.width() - self.width() - 6)), where.y())
        self.show()
        self.raise_()

    def _on_pressed(self, pressed: QObject) -> None:
        # A click on the strip, which opens and closes the popup, is none elsewhere.
        own = (self, self._strip)
        if isinstance(pressed, QWidget) and not any(p is pressed or p.isAncestorOf(pressed) for p in own):
            self.hide()

    def hideEvent(self, event: QHideEvent) -> None:
        application().removeEventFilter(self._presses)
        super().hideEvent(event)


class StepsCard(_CardBelow):
    """List of steps to choose from, below the note and checklist of the current step."""

    chosen = Signal(str)
    ticked = Signal(str, bool)

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window)
        named(self, "steps_card", tr("All steps of the protocol"))
        self._note = label("", wraps=True, objectName="step_note")
        self._boxes = layouts.vbox(spacing_px=2)
        self._ticks: list[CheckBox] = []
        self._rows: list[ActionButton] = []
        inside = QWidget()
        self._list = layouts.vbox(inside, margins_px=0, spacing_px=2)
        self._scroll = list_area(inside, framed=False)
        layouts.vbox(self, self._note, self._boxes, self._scroll, margins_px=10, spacing_px=8)
        self.setFixedWidth(_WIDE_PX)

    def show_steps(
        self, steps: Sequence[DisplayedStep], note: str, ticks: Sequence[tuple[str, bool]], *, digits: bool, live: bool
    ) -> None:
        """``digits``: the next digit selects one of the first nine. ``live``: the checklist can be edited."""
        self._note.setText(note)
        self._note.setVisible(bool(note))
        layouts.adjust_count(self._ticks, len(ticks), self._new_box)
        for box, (item, on) in zip(self._ticks, ticks, strict=True):
            box.setText(item)
            box.setChecked(on)
            box.setEnabled(live)
        layouts.adjust_count(self._rows, len(steps), self._new_row)
        for row, step in zip(self._rows, steps, strict=True):
            row.setObjectName(f"step_row_{step.number}")
            row.set_key(str(step.number) if digits and step.number <= MOST_DIGITS else "")
            text = step.title if row.key else f"{step.number}  {step.title}"
            row.set_label(f"{text} · {step.time}" if step.time else text, icon=_ICONS[step.state])
            row.setProperty("step_id", step.step_id)
            row.setChecked(step.state in ("now", "late"))
            row.setAccessibleName(step.words)
            row.setToolTip(step.words)
        self._scroll.setFixedHeight(min(_MOST_HIGH_PX, len(steps) * (_ROW_PX + 2)))

    def _new_box(self) -> CheckBox:
        box = CheckBox(self._theme)
        box.clicked.connect(lambda on, box=box: self.ticked.emit(box.text(), on))
        self._boxes.addWidget(box)
        return box

    def _new_row(self) -> ActionButton:
        row = ActionButton(self._theme, role="ghost", height_px=_ROW_PX, may_shrink=True, key_first=True)
        row.setCheckable(True)
        row.setMaximumWidth(_WIDE_PX - 24)
        row.clicked.connect(lambda _checked=False, row=row: self._on_row(row))
        self._list.addWidget(row, 0, Qt.AlignmentFlag.AlignLeft)
        return row

    def _on_row(self, row: ActionButton) -> None:
        self.hide()
        self.chosen.emit(row.property("step_id"))


class BranchesCard(_CardBelow):
    """Branches of the current step, each with its digit."""

    chosen = Signal(int)

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(theme, window)
        named(self, "branches_card", tr("Actions of the participant"))
        self._rows: list[ActionButton] = []
        self._column = layouts.vbox(self, margins_px=8, spacing_px=4)

    def show_branches(self, texts: Sequence[str]) -> None:
        layouts.adjust_count(self._rows, len(texts), self._new_row)
        for number, (row, text) in enumerate(zip(self._rows, texts, strict=True), start=1):
            row.setObjectName(f"branch_{number}")
            row.set_label(text)
            row.set_key(str(number))

    def _new_row(self) -> ActionButton:
        number = len(self._rows) + 1
        row = ActionButton(self._theme, key_first=True, height_px=_ROW_PX, clicked=lambda: self.chosen.emit(number))
        self._column.addWidget(row)
        return row
