"""Replay double without files and threads, with the seeking of a real one."""

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtWidgets import QApplication, QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import LiveRobotsStatus, PlaybackStatus
from caris_desktop.recording.annotation.annotation_editing import AnnotationError, EditHistory
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.timeline_overview import Moment, SessionOverview, Waveform
from caris_desktop.recording.session.session_header import SessionClock, SessionHeader
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.scenario.scenario_model import PanelLeaf, RecordingSettings, Scenario
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.replay.replay_bar import ReplayBar
from caris_desktop.ui.replay.timeline_view import TimelineView
from caris_desktop.ui.theme import Theme
from tests.ui.fake_console import FakeConsole

STARTED_NS = 5_000_000_000
_UTC_NS = int(datetime(2026, 11, 21, 10, 14, tzinfo=UTC).timestamp()) * 1_000_000_000
FRAME_NS = 33_333_333


def sample_session(duration_s: float, *, trial: dict[str, str] | None = None) -> Session:
    anchor = ClockAnchor(STARTED_NS, _UTC_NS)
    clock = SessionClock(anchor, STARTED_NS)
    header = SessionHeader(anchor, trial={"participant": "P07", "condition": "B"} if trial is None else trial)
    ended_ns = STARTED_NS + round(duration_s * 1e9)
    return Session(Path("2026-11-21-101400-P07"), header, clock, ended_ns, True, "wizard")


class FakeReplay(QObject):
    """Stands in for ReplayConsole; ``calls`` holds (name, arguments) in order."""

    thumbnail_made = Signal(str, object, object)
    noticed = Signal(object)

    def __init__(
        self,
        *,
        duration_s: float = 120.0,
        overview: SessionOverview | None = None,
        coding: AnnotationDocument | None = None,
        trial: dict[str, str] | None = None,
    ) -> None:
        super().__init__()
        self.session = sample_session(duration_s, trial=trial)
        self.history = EditHistory(
            AnnotationDocument(duration_ms=round(duration_s * 1000)) if coding is None else coding, limit=2000
        )
        self.playback = LiveValue(
            PlaybackStatus("P07", STARTED_NS, self.session.ended_ns, STARTED_NS, False, 1.0), self
        )
        self.overview = LiveValue(overview, self)
        self.coding = LiveValue(self.history.document, self)
        self.live_robots = LiveValue(LiveRobotsStatus(), self)
        self.calls: list[tuple[str, Any]] = []
        self.pictures = True

    def named(self, name: str) -> list[Any]:
        return [arguments for called, arguments in self.calls if called == name]

    def set_playback(self, **changes: Any) -> None:
        old: PlaybackStatus = self.playback.value
        fields = {name: getattr(old, name) for name in PlaybackStatus.__dataclass_fields__}
        self.playback.set(PlaybackStatus(**{**fields, **changes}))

    def at_ms(self, at_ms: float) -> None:
        """Move the replay to this time."""
        self.set_playback(position_ns=STARTED_NS + round(at_ms * 1e6))

    @property
    def position_ms(self) -> float:
        return (self.playback.value.position_ns - STARTED_NS) / 1e6

    def play(self) -> None:
        self.calls.append(("play", None))
        self.set_playback(playing=True)

    def pause(self) -> None:
        self.calls.append(("pause", None))
        self.set_playback(playing=False)

    def set_rate(self, rate: float) -> None:
        self.calls.append(("set_rate", rate))
        self.set_playback(rate=rate)

    def seek(self, at_ns: int) -> None:
        self.calls.append(("seek", at_ns))
        self.set_playback(position_ns=min(max(at_ns, STARTED_NS), self.session.ended_ns))

    def step(self, frames: int) -> None:
        self.calls.append(("step", frames))
        self.set_playback(playing=False)
        self.set_playback(position_ns=self.playback.value.position_ns + frames * FRAME_NS)

    def with_names(self, text: str) -> str:
        return text.replace("{p-1}", "Luis")

    def jump(self, kind: Literal["mark", "utterance"], direction: Literal[-1, 1]) -> bool:
        self.calls.append(("jump", (kind, direction)))
        overview: SessionOverview | None = self.overview.value
        moments = () if overview is None else overview.moments
        now_ns = self.playback.value.position_ns
        found = [item.at_ns for item in moments if item.kind == kind and (item.at_ns - now_ns) * direction > 0]
        if found:
            self.set_playback(position_ns=min(found, key=lambda at_ns: abs(at_ns - now_ns)))
        return bool(found)

    def request_thumbnail(self, camera: str, at_ns: int) -> None:
        self.calls.append(("request_thumbnail", (camera, at_ns)))
        if self.pictures:
            QTimer.singleShot(0, self, lambda: self.thumbnail_made.emit(camera, at_ns, sample_picture(at_ns)))

    def edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument]) -> str:
        try:
            self.coding.set(self.history.apply(edit))
        except AnnotationError as refused:
            return str(refused)
        return ""

    def undo_steps(self) -> tuple[str, str]:
        return tr(self.history.undo_step), tr(self.history.redo_step)

    def undo(self) -> bool:
        before = self.history.document
        self.coding.set(self.history.undo())
        return self.history.document is not before

    def redo(self) -> bool:
        before = self.history.document
        self.coding.set(self.history.redo())
        return self.history.document is not before

    def import_annotations(self, path: Path, coder: str, told: Callable[[str], None]) -> None:
        self.calls.append(("import_annotations", (path, coder)))
        told("" if path.suffix in (".eaf", ".csv") else f"{path.name} is neither an .eaf nor a CSV file.")


def sample_picture(at_ns: int) -> NDArray[np.uint8]:
    """A corridor whose brightness depends on the time."""
    shade = int(60 + 50 * math.sin(at_ns / 7e9))
    image = np.full((90, 160, 3), (shade + 30, shade + 20, shade), np.uint8)
    image[60:, :] = (70, 80, 90)
    left = int(80 + 60 * math.sin(at_ns / 3e9))
    image[25:75, max(0, left - 8) : left + 8] = (50, 160, 220)
    return image


class ReplayScene(QWidget):
    """The widgets that a replay adds, stacked, with space for panels above."""

    def __init__(self, theme: Theme, replay: FakeReplay, *, height_px: int = 620) -> None:
        super().__init__()
        self.theme, self.replay = theme, replay
        scenario = Scenario("Tour guide", PanelLeaf("video"), recording=RecordingSettings(("greeting", "question")))
        self.console = FakeConsole(scenario)
        self.state = self.console.state
        self.actions_table = Actions(self, self.console, self)
        self.actions_table.rebuild(scenario)
        self.timeline = TimelineView(theme, replay, self.state, self.actions_table)
        self.bar = ReplayBar(theme, replay, self.actions_table)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        inner = QVBoxLayout()
        inner.setContentsMargins(8, 8, 8, 8)
        inner.addWidget(self.timeline)
        column.addLayout(inner, 1)
        column.addWidget(self.bar)
        self.resize(1350, height_px)


def open_scene(qtbot: QtBot, theme: Theme, replay: FakeReplay) -> ReplayScene:
    """Open the scene as active window with the focus on the timeline."""
    scene = ReplayScene(theme, replay)
    qtbot.addWidget(scene, before_close_func=lambda _scene: scene.state.close())
    scene.show()
    scene.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is scene)
    scene.timeline.canvas.setFocus()
    return scene


STANCE = Vocabulary(
    "stance",
    (
        VocabularyEntry("curious", "Leans in, asks"),
        VocabularyEntry("neutral"),
        VocabularyEntry("reserved", "Steps back, looks away"),
        VocabularyEntry("confused"),
    ),
)


def sample_coding(duration_ms: int) -> AnnotationDocument:
    """Two coders with one tier each of the same vocabulary, and one of free text."""
    tiers = (
        Tier("c-Ana-tier-1", "Stance", "Ana", "stance"),
        Tier("c-Ana-tier-2", "Remarks", "Ana"),
        Tier("c-Ben-tier-1", "Stance", "Ben", "stance"),
    )
    values = [entry.value for entry in STANCE.entries]
    annotations = []
    for tier, shift in ((tiers[0], 0), (tiers[2], 380)):
        for number, start in enumerate(range(2000, min(90_000, duration_ms - 8000), 6500)):
            value = values[(number + (1 if shift and number % 5 == 3 else 0)) % 4]
            annotations.append(
                Annotation(f"{tier.tier_id}-{number + 1}", tier.tier_id, start + shift, start + 5200, value)
            )
    annotations.append(Annotation("c-Ana-90", tiers[1].tier_id, 15_000, 21_500, "laughs at the filler"))
    annotations.append(Annotation("c-Ana-91", tiers[1].tier_id, 42_000, 44_000, "wizard was slow here"))
    order = {tier.tier_id: number for number, tier in enumerate(tiers)}
    annotations.sort(key=lambda item: (order[item.tier_id], item.start_ms))
    return AnnotationDocument(tiers, (STANCE,), tuple(annotations), duration_ms)


def sample_overview(
    duration_s: float = 120.0, *, video: bool = True, sound: bool = True, more_tiers: int = 0
) -> SessionOverview:
    """A session in which robot and participant alternate."""
    rng = np.random.default_rng(4)
    end_ms = round(duration_s * 1000)
    names = ("Robot speech", "Participant", "Motion", "People", "Marks", "Problems")
    names += tuple(f"Reading {number + 1}" for number in range(more_tiers))
    tiers = tuple(Tier(f"record-{number}", name) for number, name in enumerate(names))
    annotations: list[Annotation] = []
    moments: list[Moment] = []
    lines = ("Hello, nice to meet you!", "Over there is our robot arm.", "It stops as soon as it touches something.")
    answers = ("Can it hurt people when it moves?", "Interesting!", "How heavy is it?")

    def add(tier: int, start: int, end: int, text: str) -> None:
        if start < end_ms:
            annotations.append(Annotation(f"r{len(annotations)}", f"record-{tier}", start, min(end, end_ms), text))

    for number, start in enumerate(range(1500, end_ms - 6000, 9000)):
        add(0, start, start + 2600, lines[number % 3])
        moments.append(Moment("utterance", STARTED_NS + start * 1_000_000, f"Robot: {lines[number % 3]}"))
        add(1, start + 3600, start + 5400, answers[number % 3])
        moments.append(Moment("utterance", STARTED_NS + (start + 3600) * 1_000_000, answers[number % 3]))
    for number, start in enumerate(range(0, end_ms, 24_000)):
        add(2, start + 5000, start + 14_000, "driving" if number % 2 == 0 else "turning left")
        add(3, start, start + 23_000, f"Person {number + 1}")
    for start, text in ((12_500, "laughter"), (47_000, "Wizard error: late"), (81_000, "")):
        if start < end_ms:
            add(4, start, start + 500, text)
            moments.append(Moment("mark", STARTED_NS + start * 1_000_000, text))
    if end_ms > 62_000:
        add(5, 62_000, 66_000, "The camera sends pictures late")
    for number in range(more_tiers):
        for start in range(number * 300, end_ms - 2000, 7000):
            add(6 + number, start, start + 3000, f"value {start % 9}")
    order = {tier.tier_id: number for number, tier in enumerate(tiers)}
    annotations.sort(key=lambda item: (order[item.tier_id], item.start_ms))
    moments.sort(key=lambda item: item.at_ns)
    seconds = np.arange(0.0, duration_s, 0.1)
    driving = ((seconds % 24) > 5) & ((seconds % 24) < 14)
    forward = np.where(driving, 0.35 + 0.05 * np.sin(seconds), 0.0)
    speed = np.column_stack((seconds, forward, 0.3 * np.sin(seconds / 3) * driving)).astype(np.float32)
    waveforms: tuple[Waveform, ...] = ()
    if sound:
        buckets = round(duration_s * 50)
        at_s = np.arange(buckets) / 50
        voices = (
            ("microphone", ((at_s % 9) > 5.0) & ((at_s % 9) < 7.0)),
            ("robot_voice", ((at_s % 9) > 1.5) & ((at_s % 9) < 4.1)),
        )
        waveforms = tuple(
            Waveform(f"audio-{name}.wav", STARTED_NS, 20_000_000, _loud(rng, loud)) for name, loud in voices
        )
    return SessionOverview(
        AnnotationDocument(tiers, (), tuple(annotations), end_ms), tuple(moments), waveforms, speed,
        ("front",) if video else (),
    )  # fmt: skip


def _loud(rng: np.random.Generator, loud: NDArray[np.bool_]) -> NDArray[np.float32]:
    size = (0.03 + 0.7 * loud) * rng.uniform(0.25, 1.0, len(loud))
    return np.column_stack((-size, size)).astype(np.float32)
