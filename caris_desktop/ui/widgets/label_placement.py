"""Placement of name labels over a picture without overlap."""

from collections.abc import Iterator, Sequence

from PySide6.QtCore import QPointF, QRectF

_BETWEEN_PX = 1.0


def tag_places(
    boxes: Sequence[QRectF],
    tags: Sequence[tuple[float, float]],
    picture: QRectF,
    other_words: Sequence[QRectF] = (),
) -> list[QPointF | None]:
    """Top left corner of each box's label of that width and height, in order; all in px.

    A label is on top of its box, or inside its upper edge where the picture ends. If it would cover another label or
    ``other_words``, it moves up by one or more rows, or down into its box; larger boxes, which are closer people, come
    first. Without a free position it is None: overlapping names are illegible.
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
    """Candidate positions: on the box, above it, then inside."""
    top = box.top() - height
    while top >= picture.top():
        yield top
        top -= height + _BETWEEN_PX
    top = box.top() + 1
    while top + height <= picture.bottom() and (top < box.bottom() or top == box.top() + 1):
        yield top
        top += height + _BETWEEN_PX
