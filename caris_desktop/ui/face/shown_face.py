"""Conversion of ``state.face_drawing`` for a FaceView."""

from typing import Any

import numpy as np
from PySide6.QtGui import QImage

from caris_desktop.conversation.face.drawing import Drawing
from caris_desktop.ui.face.face_view import FaceView
from caris_desktop.ui.widgets.foreign_picture import image_of


def show_on(view: FaceView, contents: Any) -> None:
    """Show a drawing, an image array or JPEG data, or nothing."""
    if isinstance(contents, bytes):
        view.show_picture(image_of(contents))
    elif isinstance(contents, np.ndarray):
        height, width = contents.shape[:2]
        # The array may be freed before the widget paints.
        view.show_picture(QImage(contents.data, width, height, 3 * width, QImage.Format.Format_BGR888).copy())
    else:
        view.show_drawing(contents if isinstance(contents, Drawing) else None)
