"""Camera for CARIS Desktop that shows a clock and a count of pictures, to measure the delay of video."""

import time

import cv2
import numpy as np

WIDTH_PX, HEIGHT_PX, USUAL_HZ = 640, 480, 20.0


class ClockCamera:
    """The contract is ``caris_desktop.perception.cameras.plugin_camera.CameraPlugin``; the target is the rate in Hz."""

    caris_interface = 1

    def __init__(self, target):
        try:
            self._period_s = 1.0 / float(target or USUAL_HZ)
        except (ValueError, ZeroDivisionError):
            raise OSError(f"{target} is no number of pictures a second") from None
        self._number = 0
        self._due_s = time.monotonic()

    def read(self):
        now_s = time.monotonic()
        time.sleep(max(0.0, self._due_s - now_s))
        self._due_s = max(self._due_s, now_s) + self._period_s
        self._number += 1
        image = np.full((HEIGHT_PX, WIDTH_PX, 3), 40, np.uint8)
        now = time.time()
        self._write(image, time.strftime("%H:%M:%S", time.localtime(now)) + f".{int(now % 1 * 1000):03d}", 200)
        self._write(image, f"picture {self._number}", 320)
        # A bar that crosses the picture once a second is read off without digits.
        left_px = int(now % 1 * WIDTH_PX)
        cv2.rectangle(image, (left_px, 400), (left_px + 6, 460), (255, 255, 255), -1)
        return image

    def _write(self, image, text, bottom_px):
        cv2.putText(image, text, (40, bottom_px), cv2.FONT_HERSHEY_SIMPLEX, 2.0, (255, 255, 255), 3)
