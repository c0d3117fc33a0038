"""Displayed frames: unchanged, or with blurred people if the scenario requires it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from PySide6.QtWidgets import QApplication

from caris_desktop.app.composition import find_scenario
from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.live.replay_video import DisplayFrames
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import BlurSettings

SECOND_NS = 1_000_000_000
PICTURE = np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8)
ADA, BEN = PersonBox(1, "p-ada", 20, 20, 60, 180, 0.9), PersonBox(2, "p-ben", 200, 20, 60, 180, 0.9)


class Frames:
    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        return None if ref.sequence == 0 else PICTURE.copy()


def frame(at_s: float, sequence: int = 1) -> FrameRef:
    return FrameRef(round(at_s * SECOND_NS), None, "front", "", 0, sequence, 320, 240)


def kept(image: NDArray[np.uint8] | None, box: PersonBox) -> float:
    """Share of unchanged pixels in the box."""
    part = np.s_[int(box.top_px) : int(box.top_px + box.height_px), int(box.left_px) : int(box.left_px + box.width_px)]
    assert image is not None
    return float((image[part] == PICTURE[part]).all(axis=2).mean())


def showing(blur: BlurSettings) -> tuple[LiveState, DisplayFrames]:
    state = LiveState()
    state.close()
    state.scenario.set(replace(find_scenario("tour-guide"), blur=blur))
    return state, DisplayFrames(Frames(), state)


@pytest.mark.parametrize("blur", [BlurSettings(), BlurSettings("everybody"), BlurSettings("nobody", shown=True)])
def test_without_it_pictures_are_as_they_are(qapp: QApplication, blur: BlurSettings) -> None:
    shown = showing(blur)[1].read(frame(1.0))
    assert np.array_equal(shown, PICTURE)  # type: ignore[arg-type]


def test_people_are_covered_where_they_probably_are_by_now(qapp: QApplication) -> None:
    _, frames = showing(BlurSettings("everybody", shown=True))
    for at_s, left_px in ((1.0, 20.0), (1.1, 30.0)):
        moved = replace(ADA, left_px=left_px)
        frames.add(People(round(at_s * SECOND_NS), "front", 1, 320, 240, (moved,), 50.0))
    shown = frames.read(frame(1.3))
    assert kept(shown, replace(ADA, left_px=50.0)) < 0.02
    assert kept(shown, BEN) == 1.0
    assert frames.read(frame(1.3, sequence=0)) is None


def test_frames_without_a_recent_detection_are_blurred_completely(qapp: QApplication) -> None:
    _, frames = showing(BlurSettings("everybody", shown=True))
    assert kept(frames.read(frame(1.0)), BEN) < 0.02
    frames.add(People(SECOND_NS, "front", 1, 320, 240, (ADA,), 50.0))
    frames.add(People(round(1.9 * SECOND_NS), "rear", 1, 320, 240, (), 50.0))
    assert kept(frames.read(frame(1.4)), BEN) == 1.0
    assert kept(frames.read(frame(1.6)), BEN) < 0.02


def test_a_consenting_person_is_shown(qapp: QApplication) -> None:
    state, frames = showing(BlurSettings("without_consent", shown=True))
    state.persons.set((PersonRow("p-ben", 2, "Ben", True, 0, 0, consents=("video",)),))
    frames.add(People(SECOND_NS, "front", 1, 320, 240, (ADA, BEN), 50.0))
    shown = frames.read(frame(1.1))
    assert kept(shown, BEN) == 1.0 and kept(shown, ADA) < 0.02


def test_shared_frames_are_blurred_as_recorded_ones(qapp: QApplication) -> None:
    state, frames = showing(BlurSettings("without_consent"))
    state.persons.set(
        (PersonRow("p-ben", 2, "Ben", True, 0, 0, consents=("photo",)), PersonRow("p-ada", 1, "Ada", True, 0, 0))
    )
    frames.add(People(SECOND_NS, "front", 1, 320, 240, (ADA, BEN), 50.0))
    given = frames.read_to_give(frame(1.1))
    assert kept(given, BEN) == 1.0 and kept(given, ADA) < 0.02
    assert kept(frames.read(frame(1.1)), ADA) == 1.0
    assert kept(frames.read_to_give(frame(3.0)), BEN) < 0.02, "nobody was looked for lately"
    nobody = showing(BlurSettings("nobody", shown=True))[1]
    assert kept(nobody.read_to_give(frame(1.1)), ADA) == 1.0
