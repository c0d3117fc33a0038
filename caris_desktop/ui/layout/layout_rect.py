"""Rectangles in px, and clamping of windows to existing screens."""

from collections.abc import Sequence

from caris_desktop.domain.value_class import Value

LEAST_WINDOW_PX = (240, 160)
_TITLE_PX = 40  # title bar of the window manager, above the window's own area


class Rect(Value):
    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """First column to the right of it."""
        return self.left + self.width

    @property
    def bottom(self) -> int:
        """First row below it."""
        return self.top + self.height

    def contains(self, x: int, y: int) -> bool:
        return self.left <= x < self.right and self.top <= y < self.bottom

    def overlap(self, other: "Rect") -> int:
        """Area of the intersection in px."""
        width = min(self.right, other.right) - max(self.left, other.left)
        height = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(0, width) * max(0, height)


def on_a_screen(place: Rect, screens: Sequence[Rect]) -> Rect:
    """The rectangle moved, and shrunk if necessary, into the screen with the largest overlap.

    Windows of a disconnected screen stay reachable. ``screens``: available area of each, primary first; without any the
    rectangle is unchanged.
    """
    if not screens:
        return place
    screen = max(screens, key=place.overlap)
    if not place.overlap(screen):
        screen = screens[0]
    width = max(min(place.width, screen.width), min(LEAST_WINDOW_PX[0], screen.width))
    height = max(min(place.height, screen.height - _TITLE_PX), min(LEAST_WINDOW_PX[1], screen.height))
    left = max(screen.left, min(place.left, screen.right - width))
    lowest = max(screen.top, screen.bottom - height)
    top = min(max(screen.top + _TITLE_PX, place.top), lowest)
    return Rect(left, top, width, height)
