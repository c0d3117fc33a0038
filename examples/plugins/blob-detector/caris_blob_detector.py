"""Detector for CARIS Desktop: upright bright shapes before a darker wall, as a thermal camera shows people."""

import cv2
import numpy as np

LEAST_HEIGHT = 0.15  # of the picture
UPRIGHT = 1.3  # height by width
LEAST_CONTRAST = 40


class BlobDetector:
    """The contract is ``caris_desktop.perception.detector.DetectorPlugin``."""

    caris_interface = 1
    class_names = ("person",)

    def __init__(self, *, confidence, threads):
        self._confidence = confidence
        cv2.setNumThreads(threads)

    def detect(self, image_bgr):
        grey = cv2.GaussianBlur(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), (9, 9), 0)
        _limit, bright = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        corners, confidences = [], []
        if float(grey.max()) - float(grey.min()) >= LEAST_CONTRAST:
            _, _, shapes, _ = cv2.connectedComponentsWithStats(bright)
            for left, top, width, height, area in shapes[1:]:
                if height < LEAST_HEIGHT * len(grey) or height < UPRIGHT * width:
                    continue
                confidence = area / (width * height)  # a person fills most of a box
                if confidence >= self._confidence:
                    corners.append((left, top, left + width, top + height))
                    confidences.append(confidence)
        return np.array(corners, float).reshape(-1, 4), np.array(confidences), np.zeros(len(corners), int)
