"""Face drawing: a few plain shapes that the window and the robot's web page render alike.

Lengths are hundredths of the shorter side of the screen, from its centre, x to the right and y down. Later shapes cover
earlier ones.
"""

import math
from dataclasses import asdict
from typing import Any, Literal

from caris_desktop.conversation.face.face_file import Face
from caris_desktop.conversation.face.face_motion import FaceState
from caris_desktop.domain.value_class import Value

_GAZE_SHARE = 0.22
"""How far the eyes move, in their widths."""
_MOUTH_OPENS = 0.45
"""How far a mouth opens, in its widths."""
_CAPTION_Y, _CAPTION_SIZE, _CAPTION_WIDTH = 33.0, 4.6, 88.0
_RAISED = 7.0
"""How far the face gives way to a caption."""


class Box(Value):
    """Filled rectangle around (x, y) with rounded corners, rotated clockwise."""

    x: float
    y: float
    width: float
    height: float
    radius: float
    turn_deg: float
    ink: str
    kind: Literal["box"] = "box"


class Lips(Value):
    """Filled area between two curves from (left, y) to (right, y), whose control points are at
    ``upper`` and ``lower``.
    """

    left: float
    right: float
    y: float
    upper: float
    lower: float
    stroke: float
    ink: str
    kind: Literal["lips"] = "lips"


class Words(Value):
    """Centred text, first line at ``y``, wrapped at ``width``."""

    text: str
    y: float
    size: float
    width: float
    ink: str
    kind: Literal["words"] = "words"


Shape = Box | Lips | Words


class Drawing(Value):
    """Complete drawing of one frame."""

    background: str
    shapes: tuple[Shape, ...]

    def plain(self) -> dict[str, Any]:
        """JSON form; three decimals are finer than any screen."""
        return {
            "background": self.background,
            "shapes": [
                {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(shape).items()}
                for shape in self.shapes
            ],
        }


def drawing_of(face: Face, state: FaceState, *, caption: str = "") -> Drawing:
    """Drawing of the face in this state."""
    eyes, mouth = face.eyes, face.mouth
    raised = _RAISED if caption else 0.0
    shift_x = state.gaze_right * _GAZE_SHARE * eyes.width
    shift_y = -state.gaze_up * _GAZE_SHARE * eyes.width
    height = max(eyes.height * state.eyes_open, min(eyes.height, 1.2))
    radius = min(eyes.width, height) / 2 * eyes.roundness
    shapes: list[Shape] = []
    for side in (-1, 1):
        x, y = side * eyes.apart / 2 + shift_x, -eyes.above - raised + shift_y
        shapes.append(Box(x, y, eyes.width, height, radius, 0.0, face.ink))
        if state.lids_deg:
            # Eyelid in the background colour, which covers the upper end of the eye at a slant.
            turn_deg = side * state.lids_deg
            drop = height * 0.30 * min(1.0, abs(state.lids_deg) / 18)
            lid_y = y - height / 2 - eyes.height / 2 + drop
            shapes.append(Box(x, lid_y, eyes.width * 1.8, eyes.height, 0.0, turn_deg, face.background))
    half = mouth.width / 2 * (1.0 - 0.25 * state.mouth_open)
    bend = state.smile * mouth.width * 0.33
    open_by = state.mouth_open * _MOUTH_OPENS * mouth.width
    left, right, mouth_y = -half + shift_x * 0.3, half + shift_x * 0.3, mouth.below - raised
    upper = mouth_y + bend * (1 - 0.8 * state.mouth_open) - open_by * 0.3
    shapes.append(Lips(left, right, mouth_y, upper, mouth_y + bend + open_by, mouth.stroke, face.ink))
    if state.hearing > 0.02:
        wide = 26.0 * state.hearing
        shapes.append(Box(0.0, 46.0, wide, 1.1, 0.55, 0.0, _between(face.background, face.ink, 0.55)))
    if caption:
        shapes.append(Words(caption, _CAPTION_Y, _CAPTION_SIZE, _CAPTION_WIDTH, face.words))
    return Drawing(face.background, tuple(shapes))


def words_alone(face: Face, text: str) -> Drawing:
    """Text only, as large as its length allows."""
    size = max(4.0, min(14.0, 44.0 / math.sqrt(max(1, len(text)) / 4)))
    return Drawing(face.background, (Words(text, -size, size, 92.0, face.words),))


def _between(first: str, second: str, share: float) -> str:
    parts = [
        round(int(first[at : at + 2], 16) * (1 - share) + int(second[at : at + 2], 16) * share) for at in (1, 3, 5)
    ]
    return "#" + "".join(f"{part:02x}" for part in parts)
