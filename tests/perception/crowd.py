"""Simulated detections of people who walk past a possibly rotating camera, with ground truth for trackers.

Random by seed. Covered people are not detected, boxes vary by a few percent, one in ten is missed, and there are
occasional false detections.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from caris_desktop.perception.kalman_tracker import overlaps

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 640.0, 480.0, 457.0
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Picture:
    """``shift_px`` is the shift of the image since the last one by camera rotation."""

    stamp_s: float
    truth: dict[int, Floats]
    boxes: Floats
    confidences: Floats
    shift_px: float
    looks: Floats


# Components of an embedding: common to all people, individual, dependent on the visible side, and variation per view.
# Chosen for the distances of OSNet on a street video: one person 0.1 from the same side and 0.2 from another, two
# people 0.35 to 0.6.
_LOOKS, _SHARED, _SIDE, _TREMBLE = 64, 1.4, 0.7, 0.6
_SIDES = 4


def filmed(
    seed: int, *, people: int = 8, seconds: float = 20.0, fps: float = 25.0, turning: bool = False, dropped: float = 0.0
) -> list[Picture]:
    """``dropped`` is the share of randomly lost frames."""
    chance = np.random.default_rng(seed)
    look_chance = np.random.default_rng(seed + 1000)
    theirs = look_chance.normal(0.0, 1.0, (people, 1, _LOOKS)) + _SHARED * look_chance.normal(0.0, 1.0, _LOOKS)
    sides = theirs + _SIDE * look_chance.normal(0.0, 1.0, (people, _SIDES, _LOOKS))
    places = np.column_stack([chance.uniform(-3.5, 3.5, people), chance.uniform(2.0, 8.0, people)])
    ways = _ways(chance, people)
    heading, pictures, shift_px = 0.0, [], 0.0
    step_s = 0.02
    every = max(1, round(1.0 / fps / step_s))
    for step in range(int(seconds / step_s)):
        turn = 0.6 * math.sin(step * step_s * 1.3) if turning else 0.0
        heading += turn * step_s
        shift_px += FOCAL_PX * turn * step_s
        restless = chance.random(people) < step_s / 3.0
        ways[restless] = _ways(chance, int(restless.sum()))
        places += ways * step_s
        for axis, (low, high) in enumerate(((-4.5, 4.5), (1.5, 9.0))):
            outside = (places[:, axis] < low) | (places[:, axis] > high)
            ways[outside, axis] *= -1.0
            places[:, axis] = places[:, axis].clip(low, high)
        if step % every or chance.random() < dropped:
            continue
        truth = _in_picture(places, heading)
        boxes, confidences = _found(chance, truth)
        turned = ((np.arctan2(ways[:, 1], ways[:, 0]) / math.tau + 1.0) * _SIDES).astype(int) % _SIDES
        shown = _embeddings(look_chance, sides[np.arange(people), turned], truth, boxes)
        pictures.append(Picture(step * step_s, truth, boxes, confidences, shift_px, shown))
        shift_px = 0.0
    return pictures


def _embeddings(chance: np.random.Generator, looks: Floats, truth: dict[int, Floats], boxes: Floats) -> Floats:
    """Everybody in a box contributes to its embedding by the covered share, and no two views are equal."""
    shown = chance.normal(0.0, 1.0, (len(boxes), _LOOKS)) * _TREMBLE
    for row, box in enumerate(boxes):
        for person, its in truth.items():
            shown[row] += looks[person] * _covered(box, its) ** 2
    return np.asarray(shown / np.linalg.norm(shown, axis=1, keepdims=True))


def _ways(chance: np.random.Generator, people: int) -> Floats:
    speed = chance.choice([0.0, 0.6, 1.0, 1.3], people)
    heading = chance.uniform(-math.pi, math.pi, people)
    return np.column_stack([speed * np.cos(heading), 0.5 * speed * np.sin(heading)])


def _in_picture(places: Floats, heading: float) -> dict[int, Floats]:
    """Boxes of people with half of the width and a third of the body visible, by person."""
    cos, sin = math.cos(heading), math.sin(heading)
    boxes = {}
    for person, (x, z) in enumerate(places):
        right, ahead = x * cos - z * sin, x * sin + z * cos
        right = x * cos + z * sin
        ahead = -x * sin + z * cos
        if ahead < 0.8:
            continue
        height = FOCAL_PX * (1.6 + 0.05 * (person % 5)) / ahead
        middle, foot = WIDTH_PX / 2 + FOCAL_PX * right / ahead, HEIGHT_PX / 2 + FOCAL_PX * 1.1 / ahead
        box = np.array([middle - 0.19 * height, foot - height, middle + 0.19 * height, foot])
        if 0.0 < middle < WIDTH_PX:
            boxes[person] = np.array(
                [max(0.0, box[0]), max(0.0, box[1]), min(WIDTH_PX, box[2]), min(HEIGHT_PX, box[3])]
            )
    near_first = sorted(boxes, key=lambda person: -boxes[person][3])
    seen: dict[int, Floats] = {}
    for person in near_first:
        box = boxes[person]
        covered = max((_covered(box, seen[other]) for other in seen), default=0.0)
        if covered < 0.66:
            seen[person] = box
    return seen


def _covered(box: Floats, by: Floats) -> float:
    wide = min(box[2], by[2]) - max(box[0], by[0])
    high = min(box[3], by[3]) - max(box[1], by[1])
    return max(0.0, wide) * max(0.0, high) / max(1e-9, (box[2] - box[0]) * (box[3] - box[1]))


def _found(chance: np.random.Generator, truth: dict[int, Floats]) -> tuple[Floats, Floats]:
    boxes, confidences = [], []
    for person, box in truth.items():
        covered = max(
            (_covered(box, other) for who, other in truth.items() if who != person and other[3] > box[3]), default=0.0
        )
        if chance.random() < 0.08 + 0.5 * covered:
            continue
        size = box[2:] - box[:2]
        boxes.append(box + chance.normal(0.0, 0.03, 4) * np.concatenate([size, size]))
        confidences.append(float(np.clip(chance.normal(0.75 - 0.4 * covered, 0.12), 0.1, 0.95)))
    while chance.random() < 0.1:
        height = chance.uniform(40, 240)
        left, top = chance.uniform(0, WIDTH_PX - 60), chance.uniform(0, HEIGHT_PX - height)
        boxes.append(np.array([left, top, left + 0.4 * height, top + height]))
        confidences.append(float(chance.uniform(0.1, 0.5)))
    return np.array(boxes).reshape(-1, 4), np.array(confidences)


def idf1(pictures: list[Picture], followed: list[dict[int, int]]) -> float:
    """IDF1 in percent, the share of boxes and truth with the one right number. ``followed``: box to number."""
    pairs: dict[tuple[int, int], int] = {}
    truths = answers = 0
    for picture, numbers in zip(pictures, followed, strict=True):
        people, rows = list(picture.truth), list(numbers)
        truths, answers = truths + len(people), answers + len(rows)
        if not people or not rows:
            continue
        overlap = overlaps(np.stack([picture.truth[person] for person in people]), picture.boxes[rows])
        for i, j in zip(*linear_sum_assignment(-overlap), strict=True):
            if overlap[i, j] >= 0.5:
                key = (people[i], numbers[rows[j]])
                pairs[key] = pairs.get(key, 0) + 1
    if not pairs:
        return 0.0
    people, numbers_ = sorted({p for p, _ in pairs}), sorted({n for _, n in pairs})
    table = np.zeros((len(people), len(numbers_)))
    for (p, n), count in pairs.items():
        table[people.index(p), numbers_.index(n)] = count
    right = table[linear_sum_assignment(-table)].sum()
    return float(100.0 * 2.0 * right / max(1, truths + answers))
