"""The status bar: link, age of each stream, battery, recording, models. Words first, colour second."""

from PySide6.QtCore import QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QFontMetricsF, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QHBoxLayout, QSizePolicy, QWidget

from caris_desktop.live.intents import WizardIntents
from caris_desktop.live.state import LiveStream
from caris_desktop.live.status import LinkStatus, PerceptionStatus, RecordingStatus
from caris_desktop.ui import tokens, words
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme

HEIGHT_PX = 32
_LINK_WORDS = {
    "connecting": ("amber", "connecting"), "connected": ("green", ""), "trouble": ("amber", "unsteady"),
    "lost": ("red", "out of reach"), "closed": ("dim", "not connected"),
}  # fmt: skip
_LINK_ICONS = {
    "connecting": "circle-dashed", "connected": "check-circle", "trouble": "warning", "lost": "warning-octagon",
    "closed": "circle",
}  # fmt: skip


class StatusItem(QWidget):
    """One short text, with an icon where it is more than a number."""

    clicked = Signal()

    def __init__(self, theme: Theme, name: str) -> None:
        super().__init__()
        self.setObjectName(name)
        self._theme = theme
        self._text, self._role, self._icon = "", "dim", ""
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.hide()
        theme.changed.connect(self.update)

    @property
    def text(self) -> str:
        return self._text

    def say(self, text: str, role: str = "dim", *, icon: str = "", tip: str = "") -> None:
        """Empty text hides the item."""
        if (text, role, icon) != (self._text, self._role, self._icon):
            self._text, self._role, self._icon = text, role, icon
            metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX))
            self.setFixedWidth(round(metrics.horizontalAdvance(text) + (20 if icon else 0) + 2))
            self.setVisible(bool(text))
            self.setAccessibleName(text)
            self.update()
        self.setToolTip(tip)

    def mousePressEvent(self, _event: QMouseEvent) -> None:
        self.clicked.emit()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        left = 0.0
        if self._icon:
            draw_icon(painter, QRectF(0, self.height() / 2 - 7.5, 15, 15), self._icon, self._theme.color(self._role))
            left = 20.0
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        painter.setPen(self._theme.color(self._role))
        rect = QRectF(left, 0, self.width() - left + 4, self.height())
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), self._text)


class StatusBar(QWidget):
    """Refreshes four times a second: ages grow by themselves."""

    connection_clicked = Signal()

    def __init__(self, theme: Theme, console: WizardIntents, *first: QWidget) -> None:
        """``first`` are shown at the left end."""
        super().__init__()
        self.setObjectName("status_bar")
        self.setFixedHeight(HEIGHT_PX)
        self._theme = theme
        self._console = console
        self.items = {
            name: StatusItem(theme, f"status_{name}")
            for name in ("link", "round_trip", "video", "lidar", "battery", "perception", "models", "recording", "disk")
        }
        row = QHBoxLayout(self)
        row.setContentsMargins(16, 0, 16, 0)
        row.setSpacing(20)
        for widget in first:
            row.addWidget(widget)
        for name, item in self.items.items():
            if name == "recording":
                row.addStretch(1)
            row.addWidget(item)
        for name in ("link", "round_trip", "video", "lidar"):
            self.items[name].clicked.connect(self.connection_clicked)
            self.items[name].setCursor(Qt.CursorShape.PointingHandCursor)
        self._timer = QTimer(self, interval=250)
        self._timer.timeout.connect(self.refresh)
        self._timer.start()
        theme.changed.connect(self.update)
        state = console.state
        for value in (state.link, state.recording, state.perception):
            value.changed.connect(self._on_changed)
        self.refresh()

    def _on_changed(self, _value: object) -> None:
        self.refresh()

    def refresh(self) -> None:
        state, items = self._console.state, self.items
        link: LinkStatus = state.link.value
        role, word = _LINK_WORDS[link.state]
        robot = link.robot or "Robot"
        items["link"].say(
            f"{robot} {word}".strip(), role, icon=_LINK_ICONS[link.state], tip=f"{link.address}\n{link.detail}".strip()
        )
        connected = link.state in ("connected", "trouble")
        round_trip = link.round_trip_ms if connected else None
        items["round_trip"].say(
            f"link {round_trip:.0f} ms" if round_trip is not None else "",
            tip="Time to the robot and back. Click for the last minute.",
        )
        items["video"].say(*_stream_words("video", state.frame), tip="Age of the newest picture")
        items["lidar"].say(*_stream_words("LIDAR", state.scan), tip="Age of the newest LIDAR scan")
        battery = state.battery.value.charge_fraction if state.battery.value is not None else None
        low = battery is not None and battery < 0.2
        items["battery"].say(
            f"battery {'low, ' if low else ''}{battery:.0%}".replace("%", " %") if battery is not None else "",
            "amber" if low else "dim", icon="battery-warning" if low else "",
        )  # fmt: skip
        self._say_models(state.perception.value)
        self._say_recording(state.recording.value)

    def _say_models(self, perception: PerceptionStatus) -> None:
        match perception.state:
            case "ready":
                took_ms = perception.inference_ms
                self.items["perception"].say(
                    "people: ready" if took_ms is None else f"people {took_ms:.0f} ms",
                    tip=f"Time to find the people in a picture, on this computer.\n{perception.model}".strip(),
                )
            case "loading":
                self.items["perception"].say("people: loading model", tip=perception.model)
            case "failed":
                self.items["perception"].say(
                    "people are not being found", "amber", icon="warning", tip=perception.detail
                )
            case _:
                self.items["perception"].say("")
        scenario = self._console.scenario
        local = not scenario.permissions.assistant or scenario.assistant.model == "embedded"
        self.items["models"].say(
            "local models only" if local else f"language model: {scenario.assistant.model}",
            tip="Nothing that is said or asked leaves this computer." if local else "",
        )

    def _say_recording(self, recording: RecordingStatus) -> None:
        item = self.items["recording"]
        match recording.state:
            case "recording":
                item.say(f"recording, {words.size(recording.written_bytes)}", "text", icon="record")
            case "starting" | "stopping":
                item.say("starting to record" if recording.state == "starting" else "saving the recording")
            case "failed":
                item.say("recording failed", "red", icon="warning-octagon", tip=recording.detail)
            case _:
                item.say("not recording")
        free = recording.free_bytes
        low = free is not None and free < 2e9
        text = "" if free is None else f"{words.size(free)} {'left on disk' if low else 'free'}"
        self.items["disk"].say(text, "amber" if low else "dim", icon="warning" if low else "")

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect(), self._theme.color("panel"))
        painter.setPen(self._theme.color("line"))
        painter.drawLine(0, 0, self.width(), 0)


def _stream_words(name: str, stream: LiveStream) -> tuple[str, str]:
    age_s = stream.age_s()
    match stream.freshness:
        case "fresh":
            return f"{name} {words.age(age_s or 0.0)}", "dim"
        case "stale":
            return f"{name} delayed {words.age(age_s or 0.0)}", "amber"
        case "lost":
            return f"{name} lost for {words.age(age_s or 0.0)}", "red"
        case _:
            return f"no {name} yet", "dim"
