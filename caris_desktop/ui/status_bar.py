"""Status bar: link, motion without a picture, stream ages, battery, recording, models. Text first, colour second;
what a key press does now; and the connection popup.
"""

import html
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QFontMetricsF, QMouseEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QSizePolicy, QWidget

from caris_desktop.domain.address import is_loopback, without_credentials
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveState, LiveStream
from caris_desktop.live.status import (
    AssistantSetup,
    LinkStatus,
    ListeningStatus,
    LoadStatus,
    MicrophoneStatus,
    PerceptionStatus,
    RecordingStatus,
    SoundStatus,
)
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.accessibility import has_role
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter, KeyOwner
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.panel_table import possible_panels
from caris_desktop.ui.robot_motion import RobotMotion
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.buttons import ActionButton, StatusButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.labels import IconLabel, label, named, restyle
from caris_desktop.ui.window_place import InSight

_HEIGHT_PX = 22
_WORDS: dict[KeyOwner, tuple[str, str, str]] = {
    "driving": (QT_TR_NOOP("Keys drive"), "blue", "game-controller"),
    "typing": (QT_TR_NOOP("You type · Alt drives"), "text", "text-aa"),
    "window": (QT_TR_NOOP("Alt drives"), "dim", "keyboard"),
    "nowhere": (QT_TR_NOOP("Keys inactive: Esc"), "amber", "keyboard"),
    "dialog": (QT_TR_NOOP("No keys: dialog open"), "amber", "keyboard"),
    "menu": (QT_TR_NOOP("No keys: menu open"), "amber", "keyboard"),
    "elsewhere": (QT_TR_NOOP("Keys used elsewhere"), "amber", "keyboard"),
    "off": ("", "dim", "keyboard"),
}

_USUAL: tuple[KeyOwner, ...] = ("driving", "typing", "window")


def owner_words(owner: KeyOwner) -> str:
    """Short label; empty if the scenario does not drive."""
    return tr(_WORDS[owner][0])


def owner_sentence(owner: KeyOwner, caps: Sequence[str]) -> str:
    """Instruction on which keys to press. ``caps``: caps of the four directions in the current layout."""
    keys = " ".join(cap.removeprefix("Alt ").removeprefix("⌥ ") for cap in caps)
    match owner:
        case "driving":
            return tr("Hold {keys} or arrows").format(keys=keys)
        case "typing":
            return tr("Alt+{keys} while you type").format(keys=keys)
        case "window":
            return tr("Hold Alt+{keys}").format(keys=keys)
        case _:
            return owner_words(owner)


class KeyOwnerChip(QWidget):
    """Indicator that follows ``hold.key_owner``."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme, hold: DriveInputFilter) -> None:
        super().__init__()
        self.setObjectName("key_owner")
        self._theme = theme
        self._owner: KeyOwner = "off"
        self._roomy = False
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        self.setToolTip(tr("Shows what the keyboard controls now"))
        self._icon, self._words = IconLabel(theme, size_px=15), label("", "small")
        self._pill = named(QFrame(), "key_owner_pill")
        self._pill.setFixedHeight(_HEIGHT_PX)
        layouts.hbox(self._pill, self._icon, self._words, margins_px=(10, 0, 11, 0), spacing_px=6)
        layouts.hbox(self, self._pill, 1, margins_px=0)
        hold.key_owner_changed.connect(self.show_owner)
        self.show_owner(hold.key_owner)

    @property
    def text(self) -> str:
        return owner_words(self._owner)

    def show_owner(self, owner: KeyOwner) -> None:
        self._owner = owner
        if not self.text:
            self.hide()
        elif self.parentWidget() is not None:  # without a parent it would be a window
            self.show()
        self.setAccessibleName(self.text)
        _text, role, icon = _WORDS[owner]
        self._words.setText(self.text)
        self._icon.show_icon(icon, "text")
        restyle(self._pill, tone=role)
        self.updateGeometry()

    def sizeHint(self) -> QSize:
        texts = (self.text, *map(owner_words, _USUAL)) if self._roomy else (self.text,)
        return QSize(max(map(self._width_of, texts)), _HEIGHT_PX)

    def set_roomy(self, roomy: bool) -> None:
        """Set whether it is as wide for typing as for driving, so that nothing beside it moves with the focus."""
        if roomy != self._roomy:
            self._roomy = roomy
            self.updateGeometry()

    def _width_of(self, text: str) -> int:
        return round(QFontMetricsF(self._theme.font(tokens.STATUS_PX)).horizontalAdvance(text)) + 42


HEIGHT_PX = 28
_SIDE_PX, _GAP_PX, _STEP_PX = 16, 20, 6
# Items that appear only with something to report (any role but "dim"); else the bar's tooltip has them.
_WHEN_NEEDED = ("models", "round_trip", "listening", "perception", "lidar", "video", "recording", "disk")
# Items elided if space is short. The recording item is never elided.
_MAY_BE_CUT = (
    "load", "link", "motion", "dropped", "perception", "refused", "battery", "disk", "pose", "microphone", "video",
)  # fmt: skip
_LEAST_PX, _NAME_CHARACTERS = 90, 40
_NEWS_PX = (120, 340)
_ROOMY_PX = 1200
ROOM_LOW_S, ROOM_ALMOST_GONE_S = 30 * 60.0, 5 * 60.0
BATTERY_OLD_AFTER_S = 60.0
_LINK_WORDS = {
    "connecting": ("amber", QT_TR_NOOP("{robot} connecting")),
    "connected": ("green", "{robot}"),
    "trouble": ("amber", QT_TR_NOOP("{robot} link unstable")),
    "lost": ("red", QT_TR_NOOP("{robot} unreachable")),
    "closed": ("dim", QT_TR_NOOP("{robot} not connected")),
}
_LINK_ICONS = {
    "connecting": "circle-dashed", "connected": "check-circle", "trouble": "warning", "lost": "warning-octagon",
    "closed": "circle",
}  # fmt: skip


class StatusItem(QWidget):
    """Short text, with an icon where it is more than a number."""

    accessible_role = QAccessible.Role.StaticText

    clicked = Signal()

    def __init__(self, theme: Theme, name: str) -> None:
        super().__init__()
        self.setObjectName(name)
        self._theme = theme
        self.text, self.role, self._icon = "", "dim", ""
        self._tip = ""
        self.left_out = False
        self.full_px = 0
        """Width in px with its whole text."""
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.hide()

    def say(self, text: str, role: str = "dim", *, icon: str = "", tip: str = "") -> None:
        """Set the text; an empty text hides the item."""
        if (text, role, icon) != (self.text, self.role, self._icon):
            self.text, self.role, self._icon = text, role, icon
            metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX))
            width = metrics.horizontalAdvance(text) + (20 if icon else 0) + 2
            # Rounded up in steps, so that a digit more or less moves nothing and causes no layout pass.
            self.full_px = math.ceil(width / _STEP_PX) * _STEP_PX if text else 0
            if self.full_px != self.minimumWidth():
                self.setFixedWidth(self.full_px)
            self.setVisible(bool(text) and not self.left_out)
            self.setAccessibleName(text)
            self.update()
        if tip != self._tip:
            self._tip = tip
            self._show_tip()

    def use_room(self, width_px: int) -> None:
        """Limit the width; the tooltip shows elided text."""
        width_px = min(self.full_px, width_px)
        if width_px != self.minimumWidth():
            self.setFixedWidth(width_px)
            self._show_tip()
            self.update()

    def _show_tip(self) -> None:
        lines = ([self.text] if self.minimumWidth() < self.full_px else []) + self._tip.splitlines()
        self.setToolTip("\n".join(lines))
        self.setAccessibleDescription(" ".join(self._tip.splitlines()))

    def leave_out(self, left_out: bool) -> None:
        """Hide the item whatever its text."""
        if left_out != self.left_out:
            self.left_out = left_out
            self.setVisible(bool(self.text) and not left_out)

    def mousePressEvent(self, _event: QMouseEvent) -> None:
        self.clicked.emit()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        left = 0.0
        if self._icon:
            draw_icon(painter, QRectF(0, self.height() / 2 - 7.5, 15, 15), self._icon, self._theme.color(self.role))
            left = 20.0
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        painter.setPen(self._theme.color(self.role))
        rect = QRectF(left, 0, self.width() - left + 4, self.height())
        text = self.text
        if self.minimumWidth() < self.full_px:
            text = painter.fontMetrics().elidedText(text, Qt.TextElideMode.ElideRight, round(self.width() - left))
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), text)


class StatusBar(Bar, InSight):
    """Status bar, refreshed at 4 Hz because ages grow."""

    accessible_role = QAccessible.Role.StatusBar

    connection_clicked = Signal()

    def __init__(self, theme: Theme, console: WizardConsole, *first: QWidget, news: StatusButton) -> None:
        """``first`` are at the left end, then ``news``, to which all other items yield."""
        super().__init__()
        self._in_replay = False
        self._shown_states: tuple[object, ...] = ()
        self.setObjectName("status_bar")
        self.setFixedHeight(HEIGHT_PX)
        self._console = console
        self._first = first
        names = (
            "link", "motion", "round_trip", "video", "lidar", "pose", "battery", "refused", "perception", "listening",
            "load", "models", "microphone", "recording", "dropped", "disk",
        )  # fmt: skip
        self.items = {name: StatusItem(theme, f"status_{name}") for name in names}
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        row = self._row = layouts.hbox(self, *first, news, margins_px=(_SIDE_PX, 0, _SIDE_PX, 0), spacing_px=_GAP_PX)
        self._news = news
        news.words_changed.connect(self._fit)
        for name, item in self.items.items():
            if name == "microphone":
                row.addStretch(1)
            row.addWidget(item)
        for name in ("link", "round_trip", "video", "lidar", "pose", "refused"):
            self.items[name].clicked.connect(self.connection_clicked)
            self.items[name].setCursor(Qt.CursorShape.PointingHandCursor)
        self._motion = RobotMotion(console.state, self)
        self._motion.changed.connect(self.refresh)
        self.picture_seen: Callable[[], bool] = lambda: False
        """Whether the picture is in view, which says how the robot moves."""
        self._timer = QTimer(self, interval=250)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()
        state = console.state
        microphones = (state.microphone, state.wizard_microphone, state.sound)
        for value in (state.link, state.recording, state.perception, state.load, state.listening, *microphones):
            value.changed.connect(self._on_changed)
        for value in (state.goal, state.drive):
            value.changed.connect(self._on_driven)
        self.refresh()

    def _on_changed(self, _value: object) -> None:
        """Update at once on a new state; mere counters wait for the next refresh."""
        if self._states() != self._shown_states:
            self.refresh()

    def _on_driven(self, _value: object) -> None:
        self._say_motion()
        self._fit()

    def _states(self) -> tuple[object, ...]:
        state = self._console.state
        link: LinkStatus = state.link.value
        recording: RecordingStatus = state.recording.value
        perception: PerceptionStatus = state.perception.value
        lost = tuple(recording.dropped)
        open_ = (state.microphone.value.state, state.wizard_microphone.value.state, state.sound.value)
        return (
            link.state, link.robot, recording.state, lost, perception.state, perception.detail, state.load.value.step,
            open_, state.listening.value.state,
        )  # fmt: skip

    def refresh(self) -> None:
        state, items = self._console.state, self.items
        self._shown_states = self._states()
        link: LinkStatus = state.link.value
        role, text = _LINK_WORDS[link.state]
        if link.state == "connecting" and not state.present.live:
            text = QT_TR_NOOP("{robot} not reachable")
        robot = text_formatting.shortened(link.robot, _NAME_CHARACTERS) or tr("Robot")
        facts = text_formatting.link_facts(link, state.traffic.value, state.present.anchor).replace(" · ", "\n")
        icon, whose = _LINK_ICONS[link.state], tr(text).format(robot=robot)
        if not state.present.live:
            # This replay may run while another robot is driven.
            role, icon = "dim" if role == "green" else role, "clock-counter-clockwise"
            whose = tr("{what} · recorded").format(what=whose)
        minute = tr("Click for the last minute.")
        items["link"].say(whose, role, icon=icon, tip=f"{link.robot}\n{facts}\n{minute}".strip())
        self._say_motion()
        connected = link.state in ("connected", "trouble")
        round_trip = link.round_trip_ms if connected else None
        items["round_trip"].say(
            tr("link {time} ms").format(time=f"{round_trip:.0f}") if round_trip is not None else "",
            tip=_round_trip_tip(link, state.present.anchor),
        )
        items["video"].say(*self._stream_words(tr("video"), state.frame), tip=tr("Age of the newest picture"))
        items["lidar"].say(*self._stream_words(tr("LIDAR"), state.scan), tip=tr("Age of the newest LIDAR scan"))
        # The map shows the pose; the status bar only reports a stale one.
        old_pose = state.pose.freshness in ("stale", "lost")
        items["pose"].say(
            *(self._stream_words(tr("pose"), state.pose) if old_pose else ("",)), tip=tr("Age of the newest pose")
        )
        self._say_battery()
        refused = sum(measured.refused for measured in state.traffic.value.values())
        items["refused"].say(
            tr("%n messages refused", "", refused) if refused > 1 else tr("1 message refused") if refused else "",
            "amber", icon="warning",
            tip=tr(
                "Messages from the robot that could not be used: malformed, too large or of the wrong type.\n"
                    "Diagnostics shows which topics are affected."
            ),
        )  # fmt: skip
        load: LoadStatus = state.load.value
        items["load"].say(
            tr("busy: {what}").format(what=tr(load.detail)) if load.detail else "", "amber",
            icon="gauge" if load.detail else "",
            tip=tr("The computer is overloaded. Driving, stopping, sound and the recording continue as before."),
        )  # fmt: skip
        self._say_models(state.perception.value)
        self._say_microphones(state.microphone.value, state.wizard_microphone.value, state.sound.value)
        self._say_listening(state.listening.value, state.microphone.value)
        self._say_recording(state.recording.value)
        self._fit()

    def _stream_words(self, name: str, stream: LiveStream) -> tuple[str, str]:
        age = text_formatting.age(stream.age_s() or 0.0)
        if not stream.age_known and stream.freshness == "fresh":
            return tr("{stream}, age unknown").format(stream=name), "amber"
        if stream.arrives_late:
            return tr("{stream} arrives {age} old").format(stream=name, age=age), (
                "amber" if stream.freshness == "stale" else "red"
            )
        silent = text_formatting.age(stream.silent_s() or 0.0)
        match stream.freshness:
            case "fresh":
                return tr("{stream} {age}").format(stream=name, age=age), "dim"
            case "stale":
                return tr("{stream} delayed {age}").format(stream=name, age=silent), "amber"
            case "lost":
                return tr("{stream} lost for {age}").format(stream=name, age=silent), "red"
            case _:
                none = tr("no {stream} yet") if self._console.state.present.live else tr("no {stream}")
                return none.format(stream=name), "dim"

    def minimumSizeHint(self) -> QSize:
        # A long text must not make the window wider than its screen.
        return QSize(200, HEIGHT_PX)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        """Hide what is as it should be, and in a narrow window the battery; then elide long texts.

        The bar's tooltip shows hidden items, an item's own its elided text.
        """
        for widget in self._first:
            if isinstance(widget, KeyOwnerChip):
                widget.set_roomy(self.width() >= _ROOMY_PX)
        hidden = []
        for name in _WHEN_NEEDED:
            item = self.items[name]
            item.leave_out(item.role == "dim")
            if item.role == "dim" and item.text:
                hidden.append(item.text)
        battery = self.items["battery"]
        widths = [widget.sizeHint().width() for widget in self._first if not widget.isHidden()]
        widths += [each.full_px for each in self.items.values() if each.text and (each is battery or not each.left_out)]
        news_px = min(self._news.full_px, _NEWS_PX[1])
        widths += [] if self._news.isHidden() else [news_px]
        missing_px = sum(widths) + _GAP_PX * len(widths) + 2 * _SIDE_PX - self.width()
        gives_way = missing_px > 0 and bool(battery.text) and battery.role == "dim"
        battery.leave_out(gives_way)  # once: shown for a moment, it would leave a gap, and others overlap
        if gives_way:
            missing_px -= battery.full_px + _GAP_PX
            hidden.append(battery.text)
        self.setToolTip("\n".join(hidden))
        self.setAccessibleDescription(", ".join(hidden))
        for name in _MAY_BE_CUT:
            item = self.items[name]
            if item.isHidden():
                continue
            gives_px = min(max(0, missing_px), max(0, item.full_px - _LEAST_PX))
            item.use_room(item.full_px - gives_px)
            missing_px -= gives_px
        self._news.use_room(max(_NEWS_PX[0], news_px - missing_px))
        self._row.activate()  # before the next painting, which would show the new items over the old places

    def _say_motion(self) -> None:
        state, motion = self._console.state, self._motion
        if self._in_replay or self.picture_seen():
            self.items["motion"].say("")
            return
        going = text_formatting.goal_now(state.goal.value)
        now = text_formatting.robot_now(state.drive.value, state.goal.value, state.robot.value) if going else ""
        role = {"warning": "amber", "unknown": "amber", "moving": "blue"}.get(motion.role, "green")
        text = " · ".join(part for part in (motion.text, now) if part)
        self.items["motion"].say(text, role, icon=motion.sign.icon)

    def _say_battery(self) -> None:
        stream = self._console.state.battery
        battery = stream.value.charge_fraction if stream.value is not None else None
        if battery is None:
            self.items["battery"].say("")
            return
        low = battery < 0.2
        age_s = stream.age_s() or 0.0
        # Robots report their charge at any rate; only minutes of silence make it stale.
        old = age_s > BATTERY_OLD_AFTER_S
        charge, age = f"{battery:.0%}".replace("%", " %"), text_formatting.age(age_s)
        text = (tr("battery low, {charge}") if low else tr("battery {charge}")).format(charge=charge)
        self.items["battery"].say(
            tr("{battery}, reported {age} ago").format(battery=text, age=age) if old else text,
            "amber" if low or old else "dim",
            icon="battery-warning" if low else "",
            tip=tr("Reported {age} ago").format(age=age),
        )

    def _say_models(self, perception: PerceptionStatus) -> None:
        match perception.state:
            case "ready":
                took_ms = perception.inference_ms
                tip = tr("Time to detect people in a picture, on this computer.")
                if perception.server:
                    tip = tr("Time to detect people in a picture, on {server}, which receives the pictures.")
                self.items["perception"].say(
                    tr("people: ready") if took_ms is None else tr("people {time} ms").format(time=f"{took_ms:.0f}"),
                    tip=f"{tip.format(server=perception.server)}\n{perception.model}".strip(),
                )
            case "loading":
                self.items["perception"].say(tr("people: loading model"), tip=perception.model)
            case "failed":
                self.items["perception"].say(
                    tr("people: detection failed"), "amber", icon="warning", tip=tr(perception.detail)
                )
            case _:
                self.items["perception"].say("")
        scenario = self._console.scenario
        setup: AssistantSetup = self._console.state.assistant_setup.value
        local = not scenario.permissions.assistant or not setup.server
        text, tip = tr("local models only"), tr("Speech and questions do not leave this computer.")
        if not local:
            text = tr("language model: {model}").format(model=text_formatting.shortened(setup.model, _NAME_CHARACTERS))
            tip = tr("Questions are sent to {server}.").format(server=setup.server)
        if perception.server and not is_loopback(perception.server):
            too = tr("{models}, pictures sent too").format(models=text)
            text = tr("pictures leave this computer") if local else too
            found = tr("People are detected on {server}, which receives the pictures.").format(server=perception.server)
            tip = f"{tip}\n{found}"
            local = False
        ear = scenario.listening
        if scenario.permissions.transcription and ear.engine == "server" and not is_loopback(ear.server):
            too = tr("{models}, sound sent too").format(models=text)
            text = tr("sound leaves this computer") if local else too
            local = False
            made = tr("Speech is transcribed on {server}, which receives the sound.")
            tip = f"{tip}\n{made.format(server=without_credentials(ear.server))}"
        self.items["models"].say(text, "dim" if local else "text", tip=tip)

    def _say_listening(self, listening: ListeningStatus, microphone: MicrophoneStatus) -> None:
        """State of speech recognition, if the scenario uses it."""
        item = self.items["listening"]
        if not self._console.scenario.permissions.transcription:
            item.say("")
            return
        match listening.state:
            case "ready" if microphone.state in ("starting", "on"):
                tip = tr("Speech near the robot is transcribed.")
                if listening.language:
                    tip = tr("Speech near the robot is transcribed ({language}).").format(language=listening.language)
                item.say(tr("listening"), tip=f"{tip}\n{listening.model}\n{tr(listening.detail)}".strip())
            case "loading":
                item.say(tr("listening: loading model"))
            case "failed":
                item.say(tr("no transcription"), "amber", icon="warning", tip=tr(listening.detail))
            case _:
                item.say(tr("no transcription"), tip=tr("No microphone is picking up the participant."))

    def _say_microphones(self, participant: MicrophoneStatus, wizard: MicrophoneStatus, sound: SoundStatus) -> None:
        """Open microphones, and whose they are."""
        if self._in_replay:
            return
        tips = [text_formatting.microphone_facts(each) for each in (participant, wizard) if each.state != "off"]
        talks = sound.talking and wizard.state in ("starting", "on")
        if sound.hearing:
            tips.append(tr("You hear what the participant’s microphone picks up"))
        if talks and wizard.state == "starting":
            text, role, icon = tr("your microphone opens…"), "amber", "microphone"
        elif talks:
            whom = tr("the participant hears you") if sound.talking == "robot" else tr("you are dictating")
            text, role, icon = whom, "green", "microphone"
        elif "failed" in (participant.state, wizard.state):
            text, role, icon = tr("microphone failed"), "amber", "microphone-slash"
        elif participant.state == "off" and wizard.state == "off":
            text, role, icon = "", "dim", ""
        else:
            text = tr("microphone open") if participant.state != "off" else tr("your microphone is open")
            role, icon = "text", "microphone"
        self.items["microphone"].say(text, role, icon=icon, tip="\n".join(tips))

    def show_replay(self) -> None:
        """Switch to a replay: hide the items about this computer's disk and microphones."""
        self._in_replay = True
        for name in ("microphone", "recording", "disk"):
            self.items[name].say("")
        self._fit()

    def _say_recording(self, recording: RecordingStatus) -> None:
        if self._in_replay:
            return
        item = self.items["recording"]
        match recording.state:
            case "recording":
                item.say(tr("recording, {size}").format(size=text_formatting.size(recording.written_bytes)))
            case "paused":
                item.say(tr("paused, {size}").format(size=text_formatting.size(recording.written_bytes)))
            case "starting" | "stopping":
                item.say(tr("starting to record") if recording.state == "starting" else tr("saving the recording"))
            case "failed":
                item.say(tr("recording failed"), "red", icon="warning-octagon", tip=tr(recording.detail))
            case _:
                item.say(tr("not recording"))
        dropped = {stream: count for stream, count in recording.dropped.items() if count}
        self.items["dropped"].say(
            text_formatting.all_missing(dropped), "amber", icon="warning",
            tip="\n".join([
                *(text_formatting.missing(stream, count) for stream, count in sorted(dropped.items())),
                tr("The computer or its disk could not keep up. Speech and actions are still recorded."),
            ]),
        )  # fmt: skip
        self._say_disk(recording)

    def _say_disk(self, recording: RecordingStatus) -> None:
        """Remaining recording time while recording, else free space."""
        item, free, room_s = self.items["disk"], recording.free_bytes, recording.room_s
        if recording.state == "recording" and room_s is not None:
            rate = text_formatting.size(recording.bytes_per_s * 3600)
            tip = tr("Currently {rate} per hour. Video is reduced first when disk space runs low.").format(rate=rate)
            if free is not None:
                tip = tr("{free} free, currently {rate} per hour. Video is reduced first when disk space runs low.")
                tip = tip.format(free=text_formatting.size(free), rate=rate)
            room = text_formatting.long_duration(room_s)
            if room_s < ROOM_ALMOST_GONE_S:
                item.say(
                    tr("disk almost full: room for {time}").format(time=room), "red", icon="warning-octagon", tip=tip
                )
            elif room_s < ROOM_LOW_S:
                item.say(tr("room for {time} only").format(time=room), "amber", icon="warning", tip=tip)
            else:
                item.say(tr("room for {time}").format(time=room), tip=tip)
            return
        low = free is not None and free < 2e9
        text = ""
        if free is not None:
            text = (tr("{size} left on disk") if low else tr("{size} free")).format(size=text_formatting.size(free))
        item.say(text, "amber" if low else "dim", icon="warning" if low else "")


def _round_trip_tip(link: LinkStatus, anchor: ClockAnchor) -> str:
    """Tooltip: round trip, and the robot's clock offset."""
    lines = [tr("Round trip to the robot.")]
    if link.clock_offset_ms is not None:
        offset = text_formatting.clock_offset(link.clock_offset_ms, link.clock_uncertainty_ms, anchor)
        lines.append(tr("Robot clock {offset}.").format(offset=offset))
    return "\n".join([*lines, tr("Click for the last minute.")])


SPAN_S = 60.0
_SAMPLE_MS = 250
_CURVES = (
    ("round_trip", QT_TR_NOOP("Round trip to the robot"), "blue", Qt.PenStyle.SolidLine),
    ("video", QT_TR_NOOP("Age of the picture"), "green", Qt.PenStyle.DashLine),
    ("lidar", QT_TR_NOOP("Age of the LIDAR scan"), "amber", Qt.PenStyle.DotLine),
)


class ConnectionCard(Overlay):
    """Popup with the curves of the last minute, sampled at 4 Hz: (monotonic seconds, milliseconds or nan). The plotting
    library is imported when it is first opened.
    """

    diagnostics_requested = Signal()
    robots_requested = Signal()

    def __init__(self, theme: Theme, window: QWidget, state: LiveState) -> None:
        super().__init__(theme, window, width_px=860)
        named(self, "connection_card", tr("Connection in the last minute"))
        length = round(SPAN_S * 1000 / _SAMPLE_MS)
        self.times_s: deque[float] = deque(maxlen=length)
        self.values_ms: dict[str, deque[float]] = {name: deque(maxlen=length) for name, *_ in _CURVES}
        self._plot: Any = None
        self._curves: dict[str, Any] = {}
        self._legend: dict[str, _LegendEntry] = {}
        self._state = state
        self._facts = label("", "note", wraps=True, objectName="connection_facts")
        self._diagnostics = ActionButton(
            theme, tr("All topics"), icon="gauge", objectName="connection_diagnostics",
            toolTip=tr("Open the Diagnostics panel: rate, age and size of all incoming data"),
            clicked=self.diagnostics_requested,
        )  # fmt: skip
        robots = ActionButton(
            theme, tr("Another robot…"), icon="robot", objectName="connection_robots", clicked=self.robots_requested
        )
        heading = label(tr("Connection in the last minute"), "heading", wraps=True)
        head = layouts.hbox(None, (heading, 1), self._diagnostics, robots, spacing_px=8)
        self._layout = layouts.vbox(self.card, head, self._facts, margins_px=(20, 16, 20, 16), spacing_px=10)
        row = FlowRow(gap_px=16)
        for name, text, *_ in _CURVES:
            self._legend[name] = _LegendEntry(tr(text), name)
            row.add(self._legend[name])
        row.set_gap(4)
        self._layout.addWidget(row)
        for requested in (self.diagnostics_requested, self.robots_requested):
            requested.connect(self.close_overlay)
        timer = QTimer(self, interval=_SAMPLE_MS)
        timer.timeout.connect(self.sample)
        timer.start()
        theme.changed.connect(self._style)

    def sample(self) -> None:
        state = self._state
        self.times_s.append(time.monotonic())
        link = state.link.value
        linked = link.state in ("connected", "trouble") and link.round_trip_ms is not None
        self.values_ms["round_trip"].append(link.round_trip_ms if linked else float("nan"))
        for name, stream in (("video", state.frame), ("lidar", state.scan)):
            age_s = stream.age_s()
            self.values_ms[name].append(float("nan") if age_s is None else age_s * 1000)
        if self.isVisible():
            self.refresh()

    def open(self) -> None:
        self._diagnostics.setVisible("diagnostics" in possible_panels(self._state.scenario.value))
        if self._plot is None:
            self._build_plot()
        self._style()
        self.refresh()
        super().open()
        self.setFocus(Qt.FocusReason.OtherFocusReason)

    def card_height_px(self) -> int:
        return 420

    def _build_plot(self) -> None:
        import pyqtgraph

        self._plot = pyqtgraph.PlotWidget()
        has_role(self._plot, QAccessible.Role.Chart)
        self._plot.setObjectName("connection_plot")
        self._plot.setAccessibleName(tr("Connection in the last minute"))
        for part in (self._plot, self._plot.viewport()):
            part.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._plot.setMouseEnabled(x=False, y=False)
        self._plot.setMenuEnabled(False)
        self._plot.hideButtons()
        self._plot.setXRange(-SPAN_S, 0, padding=0)
        # pyqtgraph interprets axis labels as HTML.
        self._plot.setLabel("bottom", html.escape(tr("seconds ago")))
        self._plot.setLabel("left", html.escape(tr("milliseconds")))
        self._plot.showGrid(x=False, y=True, alpha=0.25)
        for name, *_ in _CURVES:
            self._curves[name] = self._plot.plot([], [], connect="finite")
        self._layout.addWidget(self._plot, 1)

    def _style(self) -> None:
        if self._plot is None:
            return
        import pyqtgraph

        self._plot.setBackground(self._theme.color("panel"))
        for side in ("bottom", "left"):
            axis = self._plot.getAxis(side)
            axis.setPen(self._theme.color("line_strong"))
            axis.setTextPen(self._theme.color("dim"))
            axis.setStyle(tickFont=self._theme.font(tokens.STATUS_PX - 1))
        for name, _, role, dash in _CURVES:
            self._curves[name].setPen(pyqtgraph.mkPen(self._theme.color(role), width=2, style=dash))

    def refresh(self) -> None:
        """Redraw the samples so far."""
        self._facts.setText(
            text_formatting.link_facts(self._state.link.value, self._state.traffic.value, self._state.present.anchor)
        )
        if self._plot is None or not self.times_s:
            return
        now_s = self.times_s[-1]
        ago = [moment - now_s for moment in self.times_s]
        highest = 50.0
        for name, *_ in _CURVES:
            values = list(self.values_ms[name])
            self._curves[name].setData(ago, values)
            highest = max([highest, *(value for value in values if value == value)])  # noqa: PLR0124 (not a number)
            self._legend[name].show_value(values[-1])
        self._plot.setYRange(0, min(highest * 1.1, 3000.0), padding=0)


class _LegendEntry(QWidget):
    """Legend entry: line sample, label, latest value."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, text: str, name: str) -> None:
        super().__init__()
        self._name = text
        self._words = QLabel()
        sample = named(QFrame(), f"curve_{name}")
        sample.setFixedSize(24, 2)
        layouts.hbox(self, sample, self._words, margins_px=0, spacing_px=10)
        # Room for the longest value, so that nothing moves.
        self._words.setFixedSize(self.fontMetrics().horizontalAdvance(f"{text}  0000 ms") + 6, 24)

    def show_value(self, milliseconds: float) -> None:
        value = "–" if milliseconds != milliseconds else f"{milliseconds:.0f} ms"  # noqa: PLR0124 (not a number)
        self._words.setText(f"{self._name}  {value}")
        self.setAccessibleName(f"{self._name} {value}")
