"""Where the names over a picture stand when people stand close together."""

from collections.abc import Iterator, Sequence

from PySide6.QtCore import QPointF, QRectF

_BETWEEN_PX = 1.0


def tag_places(
    boxes: Sequence[QRectF],
    tags: Sequence[tuple[float, float]],
    picture: QRectF,
    other_words: Sequence[QRectF] = (),
) -> list[QPointF | None]:
    """The upper left corner of each box's tag of that width and height, in the order given; all in pixels.

    A tag stands on its box, or in its upper edge where the picture ends. Where that covers another tag or lies below
    ``other_words`` over the picture it is lifted by a row or a few, or goes down into its box; larger boxes, which are
    nearer people, choose first. Where all of that is taken it is None: of two names on one another none can be read.
    """
    places: list[QPointF | None] = [None] * len(boxes)
    taken = list(other_words)
    for number in sorted(range(len(boxes)), key=lambda number: -boxes[number].height()):
        box, (width, height) = boxes[number], tags[number]
        for top in _rows(box, height, picture):
            tag = QRectF(box.left() - 1, top, width, height)
            if not any(tag.intersects(other) for other in taken):
                taken.append(tag)
                places[number] = tag.topLeft()
                break
    return places


def _rows(box: QRectF, height: float, picture: QRectF) -> Iterator[float]:
    """Where a tag may begin in the picture: on its box, above that, and at last within it."""
    top = box.top() - height
    while top >= picture.top():
        yield top
        top -= height + _BETWEEN_PX
    top = box.top() + 1
    while top + height <= picture.bottom() and (top < box.bottom() or top == box.top() + 1):
        yield top
        top += height + _BETWEEN_PX
