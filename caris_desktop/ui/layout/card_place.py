"""Popup placement over the panels: below the title of a panel with room to spare, clear of frequently
clicked widgets.
"""

from collections.abc import Callable, Sequence

from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui.layout.dock_geometry import TITLE_PX, GroupPlace
from caris_desktop.ui.layout.layout_rect import Rect

WIDEST_PX = 400
_NARROWEST_PX, _LEAST_PX, _BESIDE_PX, _FROM_EDGE_PX = 280, 200, 12, 20
# Least important panels first. Speak and Drive are never covered: they are in constant use.
_GIVES_WAY: tuple[PanelName, ...] = (
    "face", "session", "diagnostics", "motion", "photos", "notes", "robot", "people", "map",
)  # fmt: skip
_LAST: tuple[PanelName, ...] = ("conversation", "assistant", "video")
_WIDE_PX = 700
_SHARE = 0.6
"""Maximum covered share of a panel's height: controls are at its top, and in the video the path ahead
is at the bottom.
"""


def card_place(
    groups: Sequence[GroupPlace], height_for: Callable[[int], int], taken: Sequence[Rect] = ()
) -> Rect | None:
    """Rectangle over the least important panel with enough room; None if there is none.

    At the upper end of video and transcript, because the ground ahead and the newest words are further down; at the
    lower end elsewhere. ``groups``: tab groups as laid out, in px of the dock area. ``height_for``: height of the
    popups for a width. ``taken``: areas of popups that ask a question and must not be covered.
    """
    rooms = {group.current: _below_title(group) for group in groups}
    tries = [(name, 1.0 if name == "face" else _SHARE) for name in _GIVES_WAY]
    if "video" in rooms and rooms["video"].width >= _WIDE_PX:
        tries.append(("video", 1.0))  # next to its centre
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
    """Lower right corner of ``area``, the fallback."""
    width = max(_LEAST_PX, min(WIDEST_PX, area.width - 32))
    height = height_for(width)
    top = max(area.top, area.bottom - height - _FROM_EDGE_PX)
    return Rect(area.right - width - _FROM_EDGE_PX, top, width, height)


def _below_title(group: GroupPlace) -> Rect:
    body = group.body
    return Rect(body.left, body.top + TITLE_PX, body.width, max(0, body.height - TITLE_PX))
