"""The detector keeps the contract of the program."""

import numpy as np
from caris_blob_detector import BlobDetector

from caris_desktop.app.plugin_contracts import check_detector


def test_it_keeps_the_contract():
    picture = np.full((480, 640, 3), 20, np.uint8)
    picture[100:400, 200:300] = 220
    check_detector(BlobDetector, [picture])
