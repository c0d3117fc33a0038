"""The face page in a real browser."""

import queue

import cv2
import numpy as np
import pytest

from caris_desktop.conversation.face.drawing import FaceState, drawing_of
from caris_desktop.conversation.face.face_file import Face
from caris_desktop.conversation.face.page import PageOpened, drawn, run_face_page
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from tests.support.chromium import Browser, chromium_or_skip
from tests.support.polling import wait_for

FACE = Face("A", background="#102030", ink="#ffeecc")
UNIT = 6  # a hundredth of 600 pixels


@pytest.mark.long
def test_the_face_follows_its_state_and_never_stays_when_nobody_moves_it() -> None:
    chromium_or_skip()
    told: queue.Queue[object] = queue.Queue()
    body = ProcessSpec("face page", run_face_page, (False,))
    page = ChildProcess(body, on_message=lambda message, _raw: told.put(message))
    page.start()
    opened = told.get(timeout=30)
    assert isinstance(opened, PageOpened)
    address = opened.address
    page.send(drawn(drawing_of(FACE, FaceState())))
    try:
        with Browser(address) as browser:

            def ink_at(x: float, y: float) -> str:
                """Colour at a place in hundredths of the shorter side, relative to the centre."""
                at = f"{400 + x * UNIT}, {300 + y * UNIT}, 1, 1"
                data = browser.value(f"Array.from(pen.getImageData({at}).data)")
                return "#" + "".join(f"{part:02x}" for part in data[:3])

            wait_for(lambda: browser.value("!!drawing"), "the page to be told", timeout_s=20)
            assert browser.value("document.getElementById('lost').hidden") is True
            eye = FACE.eyes.apart / 2, -FACE.eyes.above
            assert [ink_at(side * eye[0], eye[1]) for side in (-1, 1)] == [FACE.ink, FACE.ink]
            assert ink_at(0, 0) == ink_at(60, 45) == FACE.background

            page.send(drawn(drawing_of(FACE, FaceState(eyes_open=0.0, mouth_open=1.0))))
            wait_for(lambda: ink_at(eye[0], eye[1] - 6) == FACE.background, "the eyes to close", timeout_s=5)
            assert ink_at(0, FACE.mouth.below + 3) == FACE.ink

            green = cv2.imencode(".png", np.full((60, 80, 3), (0, 255, 0), np.uint8))[1].tobytes()
            page.send(green)
            wait_for(lambda: browser.value("picture.naturalWidth") == 80, "the picture", timeout_s=5)
            assert browser.value("picture.hidden") is False
            page.send(drawn(drawing_of(FACE, FaceState())))
            wait_for(lambda: browser.value("picture.hidden"), "the face again", timeout_s=5)

            page.stop(grace_s=2.0)
            wait_for(lambda: browser.value("drawing === null"), "the face to go", timeout_s=15)
            assert "lost" in browser.value("lost.textContent") and browser.value("lost.hidden") is False
            assert ink_at(eye[0], eye[1]) == "#000000"
    finally:
        page.stop(grace_s=2.0)
