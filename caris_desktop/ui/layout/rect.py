"""Rectangles in pixels, and where windows may lie: on a screen that exists."""

from collections.abc import Sequence

from caris_desktop.domain.value_class import dataclass

LEAST_WINDOW_PX = (240, 160)
_TITLE_PX = 40  # a window manager's title bar, above what is ours


@dataclass(frozen=True, slots=True)
class Rect:
    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """The first column behind it."""
        return self.left + self.width

    @property
    def bottom(self) -> int:
        """The first row below it."""
        return self.top + self.height

    def contains(self, x: int, y: int) -> bool:
        return self.left <= x < self.right and self.top <= y < self.bottom

    def overlap(self, other: "Rect") -> int:
        """How many pixels both have."""
        width = min(self.right, other.right) - max(self.left, other.left)
        height = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(0, width) * max(0, height)


def on_a_screen(place: Rect, screens: Sequence[Rect]) -> Rect:
    """The place moved, and made smaller where it must be, to lie whole on the screen that it is nearest to.

    A screen that is not there today leaves its windows where they can be reached. ``screens`` are what windows may use
    of each, the first one the main screen; none leaves the place as it is.
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
