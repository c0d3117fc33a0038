"""Contract tests for plug-ins: the author of one calls the function of its group in a test.

Each raises AssertionError with a sentence about what the interface says and the plug-in does not do.
"""

import contextlib
import io
import json
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.plugin_server import Asked, LanguageModel, pieces
from caris_desktop.domain.plugins import INTERFACES, Plugin, PluginError, PluginGroup
from caris_desktop.perception.box_motion import Floats
from caris_desktop.perception.detector_plugins import DetectorPlugin, checked_detections
from caris_desktop.perception.tracker import checked_tracks
from caris_desktop.perception.tracker_plugins import Tracker, TrackerFrame

_WIDTH_PX, _HEIGHT_PX = 640, 480
_FRAMES = 40


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
    try:
        yield from pieces(Plugin("checked", "language_models", "", "", ""), model, asked)
    except PluginError as error:
        raise AssertionError(str(error)) from error


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
        with _silent():
            found = detector.detect(image_bgr)
        try:
            plugin = Plugin("checked", "detectors", "", "", "")
            detections = checked_detections(plugin, found, image_bgr.shape, len(names))
        except PluginError as error:
            raise AssertionError(str(error)) from error
        people = sum(names[row].lower() == "person" for row in detections.classes)
        if image_bgr.min() == image_bgr.max():
            assert not people, "nobody is in a grey picture"
        else:
            assert people, "somebody is in the picture that was given"


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
