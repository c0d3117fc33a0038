"""Contract of detectors of others; their failures in the process are in ``tests/live/test_perception_worker.py``."""

from typing import Any

import numpy as np
import pytest

from caris_desktop.app.plugin_contracts import check_detector

SOMEBODY = np.random.default_rng(1).integers(0, 255, (120, 160, 3), np.uint8)


def detector(answer: Any, names: tuple[str, ...] = ("person", "chair")) -> Any:
    class Made:
        caris_interface = 1
        class_names = names

        def __init__(self, *, confidence: float, threads: int) -> None:
            pass

        def detect(self, image_bgr: Any) -> Any:
            return answer(image_bgr)

    return Made


def nobody(_image_bgr: Any) -> Any:
    return np.zeros((0, 4)), np.zeros(0), np.zeros(0, int)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (detector(nobody, ("dog",)), "none of the classes"),
        (detector(nobody), "somebody is in the picture"),
        (detector(lambda _image: ([[0, 0, 9, 9]], [0.9], [0])), "nobody is in a grey picture"),
        (detector(lambda _image: ([[0, 0, 9, 9]], [0.9], [5])), "classes that it does not name"),
        (detector(lambda _image: ([[0, 0, 9, 9]], [1.9], [1])), "a confidence beyond"),
        (detector(lambda _image: ([[0, 0, 9, 9]], [], [1])), "not of one length"),
        (detector(lambda _image: [1, 2]), "did not return corners"),
        (detector(lambda image: image.fill(0)), "read-only"),
    ],
)
def test_the_contract_refuses(made: Any, message: str) -> None:
    with pytest.raises((AssertionError, ValueError), match=message):
        check_detector(made, [SOMEBODY])


def test_the_contract_accepts_one_that_finds_somebody() -> None:
    def found(image_bgr: Any) -> Any:
        return nobody(image_bgr) if image_bgr.min() == image_bgr.max() else ([[1, 2, 30, 90]], [0.9], [0])

    check_detector(detector(found), [SOMEBODY])
