"""What ``state.face_drawing`` holds, on a FaceView."""

from typing import Any

import numpy as np
from PySide6.QtGui import QImage

from caris_desktop.conversation.face.drawing import Drawing
from caris_desktop.ui.face.face_view import FaceView
from caris_desktop.ui.widgets.foreign_picture import image_of


def show_on(view: FaceView, shown: Any) -> None:
    """A drawing, a picture as an array or as JPEG, or nothing."""
    if isinstance(shown, bytes):
        view.show_picture(image_of(shown))
    elif isinstance(shown, np.ndarray):
        height, width = shown.shape[:2]
        # The array is a copy of its own, but nobody holds it for as long as the picture is painted.
        view.show_picture(QImage(shown.data, width, height, 3 * width, QImage.Format.Format_BGR888).copy())
    else:
        view.show_drawing(shown if isinstance(shown, Drawing) else None)
