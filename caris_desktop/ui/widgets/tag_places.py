"""Where the names over a picture stand when people stand close together."""

from collections.abc import Sequence

from PySide6.QtCore import QPointF, QRectF

_BETWEEN_PX = 1.0
_ROWS_UP = 3


def tag_places(boxes: Sequence[QRectF], tags: Sequence[tuple[float, float]], picture: QRectF) -> list[QPointF]:
    """The upper left corner of each box's tag of that width and height, in the order given; all in pixels.

    A tag stands on its box, or in its upper edge where the picture ends. Where that covers another tag it is lifted by
    a row or a few, or goes down into its box; larger boxes, which are nearer people, choose first. Where all of that
    is taken, it stays on its box.
    """
    places = [QPointF()] * len(boxes)
    taken: list[QRectF] = []
    for number in sorted(range(len(boxes)), key=lambda number: -boxes[number].height()):
        box, (width, height) = boxes[number], tags[number]
        above = box.top() - height
        rows = [above - row * (height + _BETWEEN_PX) for row in range(_ROWS_UP)]
        rows += [box.top() + 1, box.top() + 1 + height + _BETWEEN_PX]
        fitting = [QRectF(box.left() - 1, top, width, height) for top in rows if top >= picture.top()]
        free = (tag for tag in fitting if not any(tag.intersects(other) for other in taken))
        chosen = next(free, fitting[0])
        taken.append(chosen)
        places[number] = chosen.topLeft()
    return places
