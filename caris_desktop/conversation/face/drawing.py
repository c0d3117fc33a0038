"""Face drawing: a few plain shapes that the window and the robot's web page render alike.

Lengths are hundredths of the shorter side of the screen, from its centre, x to the right and y down. Later shapes cover
earlier ones.
"""

import math
import random
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.face.face_file import Face
from caris_desktop.domain.value_class import Value

BLINK_S = 0.16
_GLIDE_S = 0.12
"""The time in which a movement covers two thirds of its way."""
_EYES_GLIDE_S = 0.07
_STILL = 0.004
_ENVELOPE_S = 0.02
_SYLLABLES_PER_S = 4.2


class FaceState(Value):
    """State of the face at a time. ``gaze_*`` are -1 to 1 as seen on the screen, right and up positive.

    Other fields are as in files; ``hearing`` is the strength of the listening sign, 0 to 1.
    """

    eyes_open: float = 1.0
    lids_deg: float = 0.0
    smile: float = 0.3
    mouth_open: float = 0.0
    gaze_right: float = 0.0
    gaze_up: float = 0.0
    hearing: float = 0.0


class SpokenLoudness(Value):
    """Loudness of an utterance over time: ``shares`` as from ``loudness``, empty if unknown."""

    started_ns: int
    ended_ns: int | None = None
    shares: tuple[float, ...] = ()


def loudness(samples: NDArray[np.int16], rate_hz: int) -> tuple[float, ...]:
    """Loudness of single-channel sound, 0 to 1 (its maximum), per 20 ms."""
    block = max(1, round(rate_hz * _ENVELOPE_S))
    blocks = samples.reshape(-1)[: samples.size // block * block].reshape(-1, block).astype(np.float64)
    if not blocks.size:
        return ()
    loud = np.sqrt(np.square(blocks).mean(axis=1))
    greatest = float(loud.max())
    return tuple(np.round(loud / greatest, 2).tolist()) if greatest > 0 else (0.0,) * len(loud)


class FaceMotion:
    """Computes the face's state at requested times, in order. Plain arithmetic."""

    def __init__(self, face: Face, *, seed: int | None = None) -> None:
        self._random = random.Random(seed)  # noqa: S311 - when to blink
        self._face = face
        self.expression = face.expressions[0]
        self._gaze = (0.0, 0.0)
        self._voice: SpokenLoudness | None = None
        self._hearing = False
        self._state = self._at_rest()
        self._at_ns: int | None = None
        self.next_blink_ns: int | None = None

    def use(self, face: Face) -> None:
        """Change the face, preserving the expression by name if it has one."""
        self._face = face
        self.expression = face.expression(self.expression.name)

    def express(self, name: str) -> None:
        self.expression = self._face.expression(name)

    def turn_gaze_to(self, right: float, up: float) -> None:
        """Set the gaze, -1 to 1 as seen on the screen."""
        self._gaze = (max(-1.0, min(1.0, right)), max(-1.0, min(1.0, up)))

    def speak(self, voice: SpokenLoudness | None) -> None:
        """Move the mouth with this speech; None: closed."""
        self._voice = voice

    def hear(self, hearing: bool) -> None:
        self._hearing = hearing

    def at(self, now_ns: int) -> FaceState:
        """State at this time."""
        passed_s = 0.0 if self._at_ns is None else max(0.0, (now_ns - self._at_ns) / 1e9)
        self._at_ns = now_ns
        now = asdict(self._state)
        for name, target in asdict(self._at_rest()).items():
            share = -math.expm1(-passed_s / (_EYES_GLIDE_S if name.startswith("gaze") else _GLIDE_S))
            arrived = abs(target - now[name]) < _STILL or (name == "mouth_open" and self._voice is not None)
            now[name] = target if arrived else now[name] + (target - now[name]) * share
        self._state = FaceState(**now)
        state = replace(self._state, mouth_open=max(self._state.mouth_open, self._spoken(now_ns)))
        return replace(state, eyes_open=state.eyes_open * self._lids(now_ns))

    @property
    def still(self) -> bool:
        """True if nothing moves until the next blink."""
        now, least = asdict(self._state), {"lids_deg": 30 * _STILL}
        moving = any(abs(to - now[name]) >= least.get(name, _STILL) for name, to in asdict(self._at_rest()).items())
        blinking = self.next_blink_ns is not None and self._at_ns is not None and self._at_ns >= self.next_blink_ns
        return not (moving or blinking or self._voice is not None)

    def _at_rest(self) -> FaceState:
        expression = self.expression
        right, up = self._gaze
        hearing = 1.0 if self._hearing else 0.0
        return FaceState(
            min(1.4, expression.eyes_open * (1.0 + 0.08 * hearing)),
            expression.lids_deg,
            expression.smile,
            expression.mouth_open,
            right,
            up if expression.look_up == 0.0 else expression.look_up,
            hearing,
        )

    def _spoken(self, now_ns: int) -> float:
        voice = self._voice
        if voice is None or now_ns < voice.started_ns or (voice.ended_ns is not None and now_ns >= voice.ended_ns):
            return 0.0
        speaking_s = (now_ns - voice.started_ns) / 1e9
        if voice.shares:
            number = int(speaking_s / _ENVELOPE_S)
            return voice.shares[number] if number < len(voice.shares) else 0.0
        # Unknown loudness: syllables at a typical rate, with varying mouth opening.
        beat = math.sin(math.pi * _SYLLABLES_PER_S * speaking_s)
        return abs(beat) * (0.55 + 0.35 * math.sin(2.3 * speaking_s))

    def _lids(self, now_ns: int) -> float:
        """Eye opening factor during a blink."""
        if not self._face.blink_every_s:
            self.next_blink_ns = None
            return 1.0
        if self.next_blink_ns is None:
            self.next_blink_ns = now_ns + self._pause_ns()
        into_s = (now_ns - self.next_blink_ns) / 1e9
        if into_s >= BLINK_S:
            self.next_blink_ns = now_ns + self._pause_ns()
            return 1.0
        return 1.0 if into_s < 0 else abs(1.0 - 2.0 * into_s / BLINK_S)

    def _pause_ns(self) -> int:
        return round(self._face.blink_every_s * self._random.uniform(0.4, 1.6) * 1e9)


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
