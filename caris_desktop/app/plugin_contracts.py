"""Contract tests for plug-ins: the author of one calls the function of its group in a test.

Each raises AssertionError with a sentence about what the interface says and the plug-in does not do.
"""

import contextlib
import io
import json
import queue
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtWidgets import QWidget

from caris_desktop import __version__
from caris_desktop.conversation.embedded_server import Asked, LanguageModel, pieces
from caris_desktop.conversation.speech_plugins import SpeechPlugin, checked_rate, checked_sound, checked_words
from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.plugins import INTERFACES, Plugin, PluginError, PluginGroup
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.perception.cameras.plugin_camera import READ_WITHIN_S, CameraPlugin, checked_image
from caris_desktop.perception.detector import DetectorPlugin, checked_detections
from caris_desktop.perception.kalman_tracker import Floats
from caris_desktop.perception.tracker import checked_tracks
from caris_desktop.perception.tracker_plugins import Tracker, TrackerFrame
from caris_desktop.recording.measures.measure_plugins import SessionMeasure, checked_definition, checked_value
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import StartRecording
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from caris_desktop.recording.session.manifest import DERIVED_FOLDER
from caris_desktop.recording.session.session_header import RecordedScenario, SessionHeader
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import ExportContext, Exporter, checked_paths
from caris_desktop.robot.bridge_server import VELOCITIES, Robot
from caris_desktop.ros.message_conversion import decode_odometry
from caris_desktop.scenario.scenario_model import PanelLeaf, Scenario
from caris_desktop.ui.plugin_panel import MAX_CALL_S, MAX_CREATION_S, REQUESTS, PanelConsole

_WIDTH_PX, _HEIGHT_PX = 640, 480
_FRAMES = 40
_QUESTION = UtteranceChanged(0, "question", "participant", "Where is the “café” & the exit?", "heard", "started")
_ANSWER = UtteranceChanged(0, "answer", "robot", "On the ground floor.", "typed", "started")
_AT_ONCE_S = 0.5


def check_tracker(make: Callable[..., Tracker]) -> None:
    """Contract of the group ``caris_desktop.trackers``; ``make`` is what the entry point names.

    Two people walk past each other at a distance, at 10 Hz with gaps; people come, go, and nobody is there.
    """
    _check_version(make, "trackers")
    for appearance in (True, False):
        first, second = make(appearance=appearance), make(appearance=appearance)
        assert first is not second, "one instance is made for each camera"
        shown = Counter[tuple[int, int]]()
        for step in range(_FRAMES):
            stamp_s = 100.0 + 0.1 * step + (0.2 if step > _FRAMES // 2 else 0.0)
            way_px = 6.0 * step
            walkers = np.array([[20 + way_px, 100, 90 + way_px, 300], [540 - way_px, 260, 620 - way_px, 470]])
            pairs = _follow(first, walkers, np.array([0.9, 0.8]), stamp_s, appearance=appearance)
            shown.update(pairs)
            _follow(second, walkers[:1], np.array([0.9]), stamp_s, appearance=appearance)
        usual = [pair for pair, _ in shown.most_common(2)]
        assert len(usual) == 2 and {row for _, row in usual} == {0, 1}, "two people in plain sight are both followed"
        assert len({number for number, _ in usual}) == 2, "two people do not have the same number"
        assert min(shown[pair] for pair in usual) >= _FRAMES // 2, "a person keeps the number while followed"
        for boxes in (0, 1, 30, 0, 2):
            stamp_s += 1.0
            corners = np.tile(np.array([[50.0, 50, 90, 150]]), (boxes, 1)) + 17.0 * np.arange(boxes)[:, None]
            _follow(first, corners, np.linspace(0.1, 1.0, boxes), stamp_s, appearance=appearance)


def check_language_model(make: Callable[[], LanguageModel]) -> None:
    """Contract of the group ``caris_desktop.language_models``; ``make`` is what the entry point names.

    A question, one with the conversation before it, one of which nobody waits for the end, and one with a schema.
    """
    _check_version(make, "language_models")
    model = make()
    system, question = {"role": "system", "content": "Be brief."}, {"role": "user", "content": "Where is the café?"}
    earlier = ({"role": "user", "content": "Hello."}, {"role": "assistant", "content": "Hello!"})
    for messages in ((question,), (system, *earlier, question)):
        assert "".join(_answer(model, messages)).strip(), "a question has an answer"
    cut_off = _answer(model, (system, question))
    assert next(cut_off, ""), "the first piece has text"
    cut_off.close()
    assert "".join(_answer(model, (question,))).strip(), "a question after a cancelled one has an answer"
    schema = {"type": "object", "properties": {"answer": {"type": "string"}}, "required": ["answer"]}
    written = "".join(_answer(model, (question,), schema))
    try:
        content = json.loads(written)
    except ValueError:
        return  # allowed, and of no use for suggestions
    assert isinstance(content, dict) and isinstance(content.get("answer"), str), f"{written} does not keep the schema"


def _answer(
    model: LanguageModel, messages: tuple[dict[str, str], ...], schema: dict[str, Any] | None = None
) -> Generator[str]:
    asked = Asked(messages, max_tokens=96, temperature=0.0, seed=1, schema=schema)
    with _as_assertions():
        yield from pieces(Plugin("checked", "language_models", "", "", ""), model, asked)


def check_detector(make: Callable[..., DetectorPlugin], pictures: Sequence[NDArray[np.uint8]] = ()) -> None:
    """Contract of the group ``caris_desktop.detectors``; ``make`` is what the entry point names.

    In each of ``pictures`` (uint8, BGR, shape (height, width, 3)) somebody must be found; in a grey one, of several
    sizes, nobody.
    """
    _check_version(make, "detectors")
    detector = make(confidence=0.1, threads=1)
    names = tuple(detector.class_names)
    assert "person" in [name.lower() for name in names], f"none of the classes {names} is person"
    grey = [np.full((*size_px, 3), 127, np.uint8) for size_px in ((480, 640), (720, 1280), (321, 123))]
    for picture in (*grey, *pictures, *grey):
        image_bgr = picture.copy()
        image_bgr.flags.writeable = False
        with _as_assertions():
            with _silent():
                found = detector.detect(image_bgr)
            plugin = Plugin("checked", "detectors", "", "", "")
            detections = checked_detections(plugin, found, image_bgr.shape, len(names))
        people = sum(names[row].lower() == "person" for row in detections.classes)
        if image_bgr.min() == image_bgr.max():
            assert not people, "nobody is in a grey picture"
        else:
            assert people, "somebody is in the picture that was given"


def check_exporter(export: Exporter, *folders: Path) -> None:
    """Contract of the group ``caris_desktop.exporters``; ``export`` is what the entry point names.

    It exports a session in which two people talk, one in which nothing happened, and those in ``folders``.
    """
    _check_version(export, "exporters")
    with tempfile.TemporaryDirectory() as temporary:
        for number, session in enumerate(_unchanged_sessions(Path(temporary), folders)):
            out = Path(temporary, f"out-{number}")
            out.mkdir()
            shares: list[float] = []
            with _silent():
                written = export(session, out, ExportContext(progress=shares.append))
            with _as_assertions():
                checked_paths(Plugin("checked", "exporters", "", "", ""), written, out)
            assert all(0 <= share <= 1 for share in shares), "the progress is between 0 and 1"


def check_measure(make: Callable[[], SessionMeasure], *folders: Path, name: str) -> None:
    """Contract of the group ``caris_desktop.measures``; ``make`` is what the entry point called ``name`` names.

    It measures a session in which two people talk, one in which nothing happened, and those in ``folders``.
    """
    _check_version(make, "measures")
    plugin = Plugin(name, "measures", "", "", "")
    with tempfile.TemporaryDirectory() as temporary, _as_assertions():
        definition = checked_definition(plugin, make())
        for session in _unchanged_sessions(Path(temporary), folders):
            with _silent():
                first, second = make().measure(session), make().measure(session)
            assert checked_value(plugin, definition, first) == second, "a session has the same value each time"
            assert first is not None or definition.empty, "the meaning of no value is described"


def _unchanged_sessions(temporary: Path, folders: Sequence[Path]) -> Iterator[Session]:
    """Sample sessions and those in ``folders``; each must stay as it is."""
    samples = temporary / "talk", temporary / "silence"
    record_sample(samples[0], talk=True)
    record_sample(samples[1], talk=False)
    for folder in (*samples, *folders):
        session, before = open_session(folder), _files(folder)
        yield session
        assert _files(folder) == before, "it writes nothing into the folder of a session"


@contextlib.contextmanager
def _as_assertions() -> Iterator[None]:
    try:
        yield
    except PluginError as error:
        raise AssertionError(str(error)) from error


def check_speech(make: Callable[..., SpeechPlugin], recordings: Sequence[tuple[NDArray[np.float32], str]] = ()) -> None:
    """Contract of the group ``caris_desktop.speech``; ``make`` is what the entry point names.

    A voice says texts of several lengths. A recogniser transcribes silence, noise, and ``recordings``: float32 at
    16 kHz, each with a text of which it must find the first word.
    """
    _check_version(make, "speech")
    plugin, made = Plugin("checked", "speech", "", "", ""), make(language="en")
    assert hasattr(made, "speak") or hasattr(made, "transcribe"), "it has neither speak nor transcribe"
    with _as_assertions(), _silent():
        if hasattr(made, "speak"):
            checked_rate(plugin, made.rate_hz)
            short, long = (
                checked_sound(plugin, made.speak(text, rate=1.0, volume=1.0))
                for text in ("Hello.", "Hello, and welcome to the “museum” of 1,000 [[clocks]] & <b>bells</b>! ☺")
            )
            assert len(long) > len(short), "a longer text has a longer sound"
            silent = checked_sound(plugin, made.speak("Hello.", rate=1.0, volume=0.0))
            assert np.abs(silent.astype(int)).max() <= np.abs(short.astype(int)).max(), "no volume is not louder"
        if hasattr(made, "transcribe"):
            noise = np.random.default_rng(0).normal(0.0, 0.01, 32_000).astype(np.float32)
            for sound, text in ((np.zeros(16_000, np.float32), ""), (noise, ""), *recordings):
                words = checked_words(plugin, made.transcribe(sound, before=""), len(sound) / 16_000)
                found = " ".join(word.casefold() for word, _, _ in words)
                first = (text.split() or [""])[0].casefold().strip(".,!?")
                assert first in found, f"{text!r} was transcribed as {found!r}"
                assert words == () or sound.any(), "silence has no words"


def check_camera(make: Callable[[str], CameraPlugin], target: str = "") -> None:
    """Contract of the group ``caris_desktop.cameras``; ``make`` is what the entry point names, ``target`` a camera that
    is there.
    """
    _check_version(make, "cameras")
    plugin, camera, sizes = Plugin("checked", "cameras", "", "", ""), make(target), set()
    for _ in range(10):
        began_s = time.monotonic()
        with _silent(), _as_assertions():
            sizes.add(checked_image(plugin, camera.read()).shape)
        assert time.monotonic() - began_s < READ_WITHIN_S, f"a picture came after more than {READ_WITHIN_S:g} s"
    assert len(sizes) == 1, "all pictures have one size"


def record_sample(folder: Path, *, talk: bool) -> None:
    """Record a session: with ``talk``, a question of a participant and the robot's answer after half a second."""
    header = SessionHeader(
        clock=ClockAnchor.take(), program_version=__version__, scenario=RecordedScenario("Sample"),
        trial={"participant": "P01", "condition": "A", "trial": "1", "wizard": "Ada"},
    )  # fmt: skip
    limits, begin_ns = DiskLimits(reserve_bytes=4096), clock.now_ns() - 60_000_000_000
    recorder = SessionRecorder(
        StartRecording(folder, header), frames=FrameRings(()), report=lambda _: None, limits=limits,
        started_ns=begin_ns,
    )  # fmt: skip
    for said, start_ms, end_ms in ((_QUESTION, 10_000, 12_000), (_ANSWER, 12_500, 14_000)) if talk else ():
        recorder.write(replace(said, stamp_ns=begin_ns + start_ms * 1_000_000))
        recorder.write(replace(said, stamp_ns=begin_ns + end_ms * 1_000_000, state="finished"))
    recorder.close("wizard")
    recorder.finish()


def _files(folder: Path) -> dict[Path, int]:
    """Files of a session, and when each was changed."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: path.stat().st_mtime_ns for path in files if DERIVED_FOLDER not in path.parts}


def check_robot(make: Callable[[str], Robot], target: str = "", *, velocity: str, odometry: str) -> None:
    """Contract of the group ``caris_desktop.robots``; ``make`` is what the entry point names.

    The robot at ``target`` is driven forward for a second, by 0.1 m/s on the topic ``velocity``, and must stop.
    """
    _check_version(make, "robots")
    with _silent():
        robot = make(target)
        names = robot.interfaces()
    assert set(names) == {"topics", "services", "actions"}, "interfaces() has topics, services and actions"
    for topic in (velocity, odometry):
        assert topic in names["topics"], f"{topic} is none of its topics"
    kind = names["topics"][velocity]
    assert kind in VELOCITIES, f"{velocity} has the type {kind}, which is none of {', '.join(VELOCITIES)}"
    received: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    stop = robot.subscribe(odometry, names["topics"][odometry], received.put, 1)
    robot.publish(velocity, kind, None, latch=False)
    stamped = kind.endswith("Stamped")
    for forward_mps in (0.1,) * 10 + (0.0,) * 10:
        twist = {"linear": {"x": forward_mps}}
        began_s = time.monotonic()
        robot.publish(velocity, kind, {"twist": twist} if stamped else twist, latch=False)
        assert time.monotonic() - began_s < _AT_ONCE_S, "publish() waits"
        time.sleep(0.1)
    speeds = []
    while not received.empty():
        speeds.append(decode_odometry(received.get(), stamp_ns=0).twist.forward_mps)
    assert speeds, f"nothing was received from {odometry}"
    assert max(speeds) > 0.0, f"{odometry} shows no motion while it is driven"
    assert speeds[-1] == 0.0 or speeds[-1] < max(speeds) / 2, "zero does not stop it"
    unknown = (
        lambda: robot.call("/no_such_service", {}, 1.0),
        lambda: robot.run_goal("/no_such_action", "test_msgs/action/None", {}, received.put, threading.Event()),
    )
    for request in unknown:
        try:
            request()
        except Exception as error:
            assert str(error), "an exception without a text"
        else:
            raise AssertionError("a service or action that does not exist raises an exception")
    stop()
    robot.close()


def check_panel(make: Callable[[PanelConsole], QWidget], *values: Any) -> None:
    """Contract of the group ``caris_desktop.panels``; ``make`` is what the entry point names.

    The panel is made with a console without a robot, and gets ``values`` of the streams and events that it follows. A
    test of it needs a QApplication (``qtbot`` of pytest-qt).
    """
    _check_version(make, "panels")
    console = _ConsoleWithoutRobot()
    with _silent():
        began_s = time.monotonic()
        widget = make(console)
        assert isinstance(widget, QWidget), "a panel is a QWidget"
        assert time.monotonic() - began_s < MAX_CREATION_S, f"it takes more than {MAX_CREATION_S:g} s to be made"
        for value in values:
            shown = [show for kind, show in console.following if isinstance(value, kind)]
            assert shown, f"it does not follow {type(value).__name__}"
            for show in shown:
                began_s = time.monotonic()
                show(value)
                assert time.monotonic() - began_s < MAX_CALL_S, f"a call takes more than {MAX_CALL_S:g} s"
        widget.grab()
    widget.deleteLater()


class _ConsoleWithoutRobot:
    """Console of a panel under test: grants every request."""

    scenario = Scenario("Test", PanelLeaf("plugin:test"))

    def __init__(self) -> None:
        self.following: list[tuple[type[Any], Callable[[Any], None]]] = []

    def follow(self, kind: type[Any], show: Callable[[Any], None]) -> None:
        assert kind in BY_TYPE, f"{kind.__name__} is no stream and no event"
        self.following.append((kind, show))

    def request(self, intent: Intent) -> str:
        assert isinstance(intent, REQUESTS), f"a panel cannot request {type(intent).__name__}"
        return ""


def _follow(
    tracker: Tracker, corners_px: Floats, confidences: Floats, stamp_s: float, *, appearance: bool
) -> list[tuple[int, int]]:
    image_bgr = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 127, np.uint8)
    for array in (image_bgr, corners_px, confidences):
        array.flags.writeable = False
    embedder = (lambda rows: np.eye(32)[[row % 32 for row in rows]]) if appearance else None
    frame = TrackerFrame(image_bgr, stamp_s, embedder=embedder)
    with _silent():
        found = tracker.follow(corners_px, confidences, frame)
    try:
        return checked_tracks(Plugin("checked", "trackers", "", "", ""), found, len(corners_px))
    except PluginError as error:
        raise AssertionError(f"with {len(corners_px)} boxes {error}") from error


def _check_version(made_from: Any, group: PluginGroup) -> None:
    version = getattr(made_from, "caris_interface", None)
    assert version == INTERFACES[group], f"caris_interface must be {INTERFACES[group]}, and is {version!r}"


@contextlib.contextmanager
def _silent() -> Any:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        yield
    assert not printed.getvalue(), f"it prints “{printed.getvalue().strip()}”; use logging"
