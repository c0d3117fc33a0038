"""Contract tests for plug-ins: the author of one calls the function of its group in a test.

Each raises AssertionError with a sentence about what the interface says and the plug-in does not do.
"""

import contextlib
import io
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from caris_desktop.domain.plugins import INTERFACES, Plugin, PluginError, PluginGroup
from caris_desktop.perception.box_motion import Floats
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
        shown = Counter[int]()
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
