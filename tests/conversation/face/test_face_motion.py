import itertools
from dataclasses import replace

import numpy as np

from caris_desktop.conversation.face.drawing import (
    Box,
    FaceMotion,
    FaceState,
    Lips,
    SpokenLoudness,
    Words,
    drawing_of,
    loudness,
)
from caris_desktop.conversation.face.face_file import Face

FRAME_NS = 40_000_000
UNBLINKING = Face("A", blink_every_s=0.0)


def looks(motion: FaceMotion, seconds: float, *, from_s: float = 0.0) -> list[FaceState]:
    return [motion.at(round(from_s * 1e9) + number * FRAME_NS) for number in range(round(seconds * 25))]


def test_it_blinks_about_as_often_as_its_file_says_and_each_time_briefly() -> None:
    seen = looks(FaceMotion(Face("A", blink_every_s=4.0), seed=1), 200)
    closed = [look.eyes_open < 0.6 for look in seen]
    blinks = sum(now and not before for before, now in itertools.pairwise(closed))
    assert 35 <= blinks <= 70
    longest = max(len(list(group)) for shut, group in itertools.groupby(closed) if shut)
    assert longest <= 5, "a fifth of a second"
    assert all(look.eyes_open == 1.0 for look in looks(FaceMotion(UNBLINKING), 60))


def test_eyes_and_expressions_glide_and_come_to_rest() -> None:
    motion = FaceMotion(UNBLINKING)
    looks(motion, 1)
    assert motion.still
    motion.turn_gaze_to(1.0, -0.5)
    motion.express("happy")
    seen = looks(motion, 1, from_s=1)
    across = [look.gaze_right for look in seen]
    assert across == sorted(across) and 0 < across[1] < 1 and across[-1] == 1.0
    assert (seen[-1].gaze_up, seen[-1].smile) == (-0.5, 0.9)
    assert motion.still


def test_the_mouth_opens_with_the_sound_and_closes_with_its_end() -> None:
    motion = FaceMotion(UNBLINKING)
    looks(motion, 1)
    rate_hz = 16_000
    second = np.arange(rate_hz) / rate_hz
    loud = (8000 * np.sin(440 * 2 * np.pi * second)).astype(np.int16)
    shares = loudness(np.concatenate([loud, np.zeros(rate_hz, np.int16), loud // 2]), rate_hz)
    motion.speak(SpokenLoudness(1_000_000_000, shares=shares))
    openings = [look.mouth_open for look in looks(motion, 3, from_s=1)]
    assert min(openings[2:23]) > 0.9 and max(openings[27:48]) == 0.0 and 0.4 < np.mean(openings[52:73]) < 0.6
    motion.speak(None)
    assert looks(motion, 1, from_s=4)[-1].mouth_open == 0.0


def test_a_voice_that_nobody_hears_here_moves_the_mouth_in_syllables_until_it_ends() -> None:
    motion = FaceMotion(UNBLINKING)
    motion.speak(SpokenLoudness(0))
    openings = [look.mouth_open for look in looks(motion, 4)]
    opened = sum(now > 0.3 >= before for before, now in itertools.pairwise(openings))
    assert 8 <= opened <= 24


def test_the_drawing_follows_the_gaze() -> None:
    face = UNBLINKING
    plain = drawing_of(face, FaceState())
    right = drawing_of(face, FaceState(gaze_right=1.0, gaze_up=1.0))
    eyes = [shape for shape in plain.shapes if isinstance(shape, Box)]
    moved = [shape for shape in right.shapes if isinstance(shape, Box)]
    assert all(after.x > before.x and after.y < before.y for before, after in zip(eyes, moved, strict=True))
    (mouth,) = (shape for shape in plain.shapes if isinstance(shape, Lips))
    (speaking,) = (shape for shape in drawing_of(face, FaceState(mouth_open=1.0)).shapes if isinstance(shape, Lips))
    assert speaking.lower - speaking.upper > mouth.lower - mouth.upper + 5
    captioned = drawing_of(face, FaceState(), caption="Hello")
    (words,) = (shape for shape in captioned.shapes if isinstance(shape, Words))
    (raised,) = (shape for shape in captioned.shapes if isinstance(shape, Lips))
    assert words.text == "Hello" and raised.y < mouth.y < words.y
    assert len(drawing_of(face, FaceState(hearing=1.0)).shapes) == len(plain.shapes) + 1
    assert drawing_of(replace(face, ink="#ffffff"), FaceState()).plain()["shapes"][0]["ink"] == "#ffffff"
