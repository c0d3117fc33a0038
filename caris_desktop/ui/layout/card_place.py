"""Where cards lie over the panels: below the title of one that can spare the room, and not on what is clicked."""

from collections.abc import Callable, Sequence

from caris_desktop.scenario.model import PanelName
from caris_desktop.ui.layout.placing import TITLE_PX, GroupPlace
from caris_desktop.ui.layout.rect import Rect

WIDEST_PX = 400
_NARROWEST_PX, _LEAST_PX, _BESIDE_PX, _FROM_EDGE_PX = 280, 200, 12, 20
# The least missed first. Speaking and driving are never covered: they are clicked and typed into all the time.
_GIVES_WAY: tuple[PanelName, ...] = (
    "face", "session", "diagnostics", "motion", "photos", "notes", "robot", "people", "map",
)  # fmt: skip
_LAST: tuple[PanelName, ...] = ("conversation", "assistant", "video")
_WIDE_PX = 700
_SHARE = 0.6
"""Of a panel's height so much may be covered at most: what is clicked in it is above, what lies ahead is below."""


def card_place(
    groups: Sequence[GroupPlace], height_for: Callable[[int], int], taken: Sequence[Rect] = ()
) -> Rect | None:
    """On the panel that is least missed of those that have room; None where none has.

    On a picture and on what was said it is the upper end, as the ground before the robot and the newest words are lower
    down; elsewhere the lower end.

    Parameters
    ----------
    groups
        The panels as they lie, in pixels of what holds them.
    height_for
        How tall the cards are together at a width, both in pixels.
    taken
        Where something lies already that asks for an answer: nothing comes over it.
    """
    rooms = {group.current: _below_title(group) for group in groups}
    tries = [(name, 1.0 if name == "face" else _SHARE) for name in _GIVES_WAY]
    if "video" in rooms and rooms["video"].width >= _WIDE_PX:
        tries.append(("video", 1.0))  # beside its middle
    for name, share in [*tries, *((name, _SHARE) for name in _LAST)]:
        room = rooms.get(name)
        if room is None:
            continue
        width = min(WIDEST_PX, room.width - 2 * _BESIDE_PX)
        height = height_for(width) if width >= _NARROWEST_PX else room.height
        if height + 2 * _BESIDE_PX <= room.height * share:
            top = room.top + _BESIDE_PX if name in _LAST else room.bottom - height - _BESIDE_PX
            found = Rect(room.right - width - _BESIDE_PX, top, width, height)
            if not any(found.overlap(each) for each in taken):
                return found
    return None


def in_the_corner(area: Rect, height_for: Callable[[int], int]) -> Rect:
    """The lower right of ``area``, where nothing else has room."""
    width = max(_LEAST_PX, min(WIDEST_PX, area.width - 32))
    height = height_for(width)
    top = max(area.top, area.bottom - height - _FROM_EDGE_PX)
    return Rect(area.right - width - _FROM_EDGE_PX, top, width, height)


def _below_title(group: GroupPlace) -> Rect:
    body = group.body
    return Rect(body.left, body.top + TITLE_PX, body.width, max(0, body.height - TITLE_PX))
