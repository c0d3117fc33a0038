"""Local camera without frames: specific advice for each cause."""

import numpy as np
import pytest

from caris_desktop.perception.cameras.camera_source import CameraError, ChosenCamera
from caris_desktop.perception.cameras.device_camera import DeviceCamera


class Capture:
    """Double of OpenCV's capture with a limited number of frames."""

    def __init__(self, pictures: int) -> None:
        self._left = pictures

    def isOpened(self) -> bool:
        return True

    def set(self, _property: int, _value: float) -> bool:
        return True

    def get(self, _property: int) -> float:
        return 0.0

    def read(self) -> tuple[bool, object]:
        self._left -= 1
        return self._left >= 0, np.zeros((4, 4, 3), np.uint8)


@pytest.mark.parametrize(
    ("pictures", "says", "advises"),
    [(0, "does not deliver any images", "other programs"), (1, "stopped delivering", "cable")],
)
def test_access_to_a_device_is_checked_only_where_no_picture_came(
    monkeypatch: pytest.MonkeyPatch, pictures: int, says: str, advises: str
) -> None:
    monkeypatch.setattr("cv2.VideoCapture", lambda _target: Capture(pictures))
    camera = DeviceCamera(ChosenCamera("device", "0", "desk"))
    for _each in range(pictures):
        camera.read()
    with pytest.raises(CameraError, match=says) as told:
        camera.read()
    assert advises in told.value.advice
