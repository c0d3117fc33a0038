"""Layout geometry: rectangles of tab groups and split handles for a layout tree, and adaptation of the tree to the
screen size: panels are folded into tabs on small screens and spread on large ones.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Literal

from PySide6.QtCore import QRect, QSize

from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode, panels_in
from caris_desktop.ui.dock_layout import (
    Side,
    front_of,
    groups_in,
    path_of,
    place_next_to,
    shares,
    split_at,
    tidy,
    with_weights,
    without,
)
from caris_desktop.ui.panel import TITLE_HEIGHT_PX

GAP_PX = 8
TAB_BAR_PX = 36
_EDGE_PX = 18  # this near to the outer edge, a drop goes to that edge of the whole area
_SIDE_SHARE = 0.28  # share of a group's width or height in which a drop goes to that side

Room = tuple[int, int]
"""Width and height in pixels."""
RoomOf = Callable[[PanelName], Room]
_SQUEEZED: Room = (140, TITLE_HEIGHT_PX)  # minimum that always remains of a panel: its title bar


class GroupPlace(Value):
    """Rectangle of a tab group or a single panel."""

    panels: tuple[PanelName, ...]
    current: PanelName
    rect: QRect

    @property
    def tabbed(self) -> bool:
        return len(self.panels) > 1

    @property
    def tab_bar(self) -> QRect:
        return QRect(self.rect.topLeft(), QSize(self.rect.width(), TAB_BAR_PX if self.tabbed else 0))

    @property
    def body(self) -> QRect:
        """Area below the tab bar."""
        return self.rect.adjusted(0, self.tab_bar.height(), 0, 0)


class Handle(Value):
    """Split handle: divides the split at ``path`` between its parts ``before`` and ``after``, with minimum lengths
    ``least``. ``lengths``: current lengths of all visible parts by index.
    """

    path: tuple[int, ...]
    before: int
    after: int
    split: Literal["horizontal", "vertical"]
    rect: QRect
    lengths: tuple[tuple[int, int], ...]
    least: tuple[int, int]


class DockGeometry(Value):
    groups: tuple[GroupPlace, ...] = ()
    handles: tuple[Handle, ...] = ()

    def group_of(self, panel: PanelName) -> GroupPlace | None:
        return next((group for group in self.groups if panel in group.panels), None)


def _visible_children(split: SplitNode, visible: Collection[str]) -> list[int]:
    """Indices of the children with a visible panel."""
    return [i for i, child in enumerate(split.children) if any(panel in visible for panel in panels_in(child))]


def least_room(node: LayoutNode, visible: Collection[str], least: RoomOf) -> Room:
    """Minimum size of the visible panels of a tree."""
    if not isinstance(node, SplitNode):
        rooms = [least(panel) for panel in panels_in(node) if panel in visible]
        bar = TAB_BAR_PX if len(rooms) > 1 else 0
        return (max((room[0] for room in rooms), default=0), max((room[1] for room in rooms), default=0) + bar)
    rooms = [least_room(node.children[i], visible, least) for i in _visible_children(node, visible)]
    gaps = GAP_PX * max(0, len(rooms) - 1)
    widths, heights = [room[0] for room in rooms], [room[1] for room in rooms]
    if node.split == "horizontal":
        return (sum(widths) + gaps, max(heights, default=0))
    return (max(widths, default=0), sum(heights) + gaps)


def lengths(total_px: int, weights: Sequence[float], least: Sequence[int], squeezed: int) -> list[int]:
    """Divide ``total_px`` by weight, respecting each minimum; if that is impossible, all shrink in proportion, down to
    ``squeezed`` where possible.
    """
    count = len(weights)
    if sum(least) >= total_px:
        floor = min(squeezed, total_px // count)
        over = [max(0, each - floor) for each in least]
        spare = (total_px - floor * count) / max(1, sum(over))
        parts = [floor + spare * each for each in over]
    else:
        fixed: dict[int, float] = {}
        while True:
            free = [index for index in range(count) if index not in fixed]
            total, left = sum(weights[index] for index in free), total_px - sum(fixed.values())
            small = [index for index in free if left * weights[index] < least[index] * total]
            if not small:
                break
            fixed |= {index: float(least[index]) for index in small}
        parts = [fixed[i] if i in fixed else left * weights[i] / total for i in range(count)]
    edges = [round(edge) for edge in accumulate(parts, initial=0.0)]
    edges[-1] = total_px  # no pixel is lost by rounding
    return [max(0, after - before) for before, after in pairwise(edges)]


def place(whole: LayoutNode, area: QRect, visible: Collection[str], least: RoomOf) -> DockGeometry:
    """Lay out the ``visible`` panels of a tree."""
    groups: list[GroupPlace] = []
    handles: list[Handle] = []

    def lay(node: LayoutNode, rect: QRect, path: tuple[int, ...]) -> None:
        if not isinstance(node, SplitNode):
            panels = tuple(panel for panel in panels_in(node) if panel in visible)
            if panels:
                groups.append(GroupPlace(panels, front_of(node) if front_of(node) in panels else panels[0], rect))
            return
        indices = _visible_children(node, visible)
        axis = 0 if node.split == "horizontal" else 1
        room_px = max(0, (rect.width(), rect.height())[axis] - GAP_PX * (len(indices) - 1))
        needs = [least_room(node.children[i], visible, least)[axis] for i in indices]
        given = lengths(room_px, [shares(node)[i] for i in indices], needs, _SQUEEZED[axis]) if indices else []
        at = (rect.left(), rect.top())[axis]
        for number, (i, length) in enumerate(zip(indices, given, strict=True)):
            if number:
                before, lengths_of = indices[number - 1], tuple(zip(indices, given, strict=True))
                gap = _slice(rect, axis, at, GAP_PX)
                handles.append(Handle(path, before, i, node.split, gap, lengths_of, (needs[number - 1], needs[number])))
                at += GAP_PX
            lay(node.children[i], _slice(rect, axis, at, length), (*path, i))
            at += length

    lay(whole, area, ())
    return DockGeometry(tuple(groups), tuple(handles))


def _slice(rect: QRect, axis: int, at: int, length: int) -> QRect:
    """Part of ``rect`` from ``at`` on, across (axis 0) or down."""
    return QRect(at, rect.top(), length, rect.height()) if axis == 0 else QRect(rect.left(), at, rect.width(), length)


def dragged(node: LayoutNode, handle: Handle, moved_px: int) -> tuple[float, ...]:
    """Weights of the handle's split after dragging: the two adjacent parts change within their minimums, the others
    keep their lengths.
    """
    had = dict(handle.lengths)
    before, after = had[handle.before], had[handle.after]
    # Parts already below their minimum may stay so.
    lowest, highest = min(handle.least[0], before), before + after - min(handle.least[1], after)
    had[handle.before] = max(lowest, min(before + moved_px, highest))
    had[handle.after] = before + after - had[handle.before]
    part_of = shares(split_at(node, handle.path))
    # Hidden parts keep their share.
    visible, total = sum(part_of[i] for i in had), sum(had.values()) or 1
    return tuple(max(0.001, visible * had[i] / total) if i in had else part for i, part in enumerate(part_of))


def grown(
    node: LayoutNode, placing: DockGeometry, panel: PanelName, by_px: int
) -> tuple[tuple[int, ...], tuple[float, ...]] | None:
    """Path and new weights of the split that makes a panel larger by this much, or smaller if negative; None if there
    is none. It is the innermost possible split, and parts after the panel shrink first.
    """
    at = path_of(node, panel)
    around = [
        (handle, handle.before == at[depth])
        for handle in placing.handles
        if (depth := len(handle.path)) < len(at)
        and handle.path == at[:depth]
        and at[depth] in (handle.before, handle.after)
    ]
    for handle, is_before in sorted(around, key=lambda each: (-len(each[0].path), not each[1])):
        weights = dragged(node, handle, by_px if is_before else -by_px)
        if weights != dragged(node, handle, 0):
            return handle.path, weights
    return None


class Drop(Value):
    """Drop target: next to or in the tabs of ``beside``; without it, at an outer edge."""

    beside: PanelName | None
    side: Side
    mark: QRect


def drop_at(placing: DockGeometry, rect: QRect, x: int, y: int, panel: PanelName) -> Drop | None:
    """Effect of dropping ``panel`` at a point of ``rect``; None for no effect."""
    if not rect.contains(x, y):
        return None
    own_group = placing.group_of(panel)
    if own_group is None or len(placing.groups) > 1 or own_group.tabbed:
        for side, near in _edges(rect, x, y):
            if near < _EDGE_PX:
                return Drop(None, side, _half(rect, side, 0.25))
    group = next((group for group in placing.groups if group.rect.contains(x, y)), None)
    if group is None:
        return None
    others = [each for each in group.panels if each != panel]
    if not others:
        return None
    width, height = group.rect.width(), group.rect.height()
    part = {side: px / (width if side in ("left", "right") else height) for side, px in _edges(group.rect, x, y)}
    nearest = min(part, key=part.__getitem__)
    in_title = y < group.rect.top() + TAB_BAR_PX
    if part[nearest] < _SIDE_SHARE and not in_title:
        return Drop(others[0], nearest, _half(group.rect, nearest, 0.5))
    return Drop(others[0], "tab", group.rect) if in_title or panel not in group.panels else None


def _edges(rect: QRect, x: int, y: int) -> tuple[tuple[Side, int], ...]:
    """Distance to each side."""
    return (
        ("left", x - rect.left()),
        ("right", rect.right() - x),
        ("above", y - rect.top()),
        ("below", rect.bottom() - y),
    )


def _half(rect: QRect, side: Side, share: float) -> QRect:
    """Part of ``rect`` along a side of it."""
    rest_x, rest_y = rect.width() - round(rect.width() * share), rect.height() - round(rect.height() * share)
    cuts = {
        "left": (0, 0, -rest_x, 0),
        "right": (rest_x, 0, 0, 0),
        "above": (0, 0, 0, -rest_y),
        "below": (0, rest_y, 0, 0),
    }
    return rect.adjusted(*cuts[side])


COMPACT_BELOW: Room = (1500, 700)  # A 1366x768 screen leaves about 1350x630 for panels.
LARGE_FROM: Room = (2300, 1100)

COMFORT: Mapping[PanelName, Room] = {
    "video": (420, 300),
    "speak": (400, 214),
    "conversation": (380, 240),
    "map": (304, 250),
    "drive": (290, 230),
    "people": (300, 190),
    "assistant": (320, 250),
    "session": (300, 220),
    "robot": (300, 220),
    "face": (260, 210),
    "photos": (300, 240),
    "motion": (300, 200),
    "notes": (300, 200),
    "diagnostics": (340, 220),
}
"""Comfortable size of each panel, title bar included."""

IMPORTANCE: tuple[PanelName, ...] = (
    "video", "speak", "conversation", "map", "assistant", "people", "drive", "notes", "session", "face", "robot",
    "photos", "motion", "diagnostics",
)  # fmt: skip
"""Panels by importance; the last ones are folded into tabs first."""
ALWAYS_SEEN = 3  # this many of the most important panels are never folded; they shrink instead
_OTHER_ROOM: Room = (280, 200)
_LEAST_PICTURE: Room = (200, 150)
_DIRECTIONS: tuple[Literal["horizontal", "vertical"], ...] = ("horizontal", "vertical")
_STACKED = 0.75  # of the comfortable height of panels: with less, they are not put one below the other
_ENOUGH = 0.85  # of the possible height of a picture: with less, what lies beside it becomes a tab


def size_class(width: int, height: int) -> SizeClass:
    if width < COMPACT_BELOW[0] or height < COMPACT_BELOW[1]:
        return "compact"
    return "large" if width >= LARGE_FROM[0] and height >= LARGE_FROM[1] else "usual"


def fitted(tree: LayoutNode, width: int, height: int, aspect: float | None = None) -> LayoutNode:
    """The tree adapted to this size, and to pictures with this ``aspect``, so that no bars lie beside them: on a small
    screen as large as the others permit, else in the room that the tree gives them.
    """
    kind = size_class(width, height)
    if kind == "compact":
        small = tidy(_compact(tidy(tree), width, height))
        return small if aspect is None else tidy(_around_picture(small, width, height, aspect))
    whole = tidy(_spread(tidy(tree), width, height)) if kind == "large" else tidy(tree)
    return whole if aspect is None else tidy(_without_bars(whole, width, height, aspect))


def _picture_room(tree: LayoutNode, width: int, height: int) -> tuple[list[int | None], list[int], list[int]]:
    """Across and down: the depth of the nearest split on the way to the picture, the length that its parts share, and
    the extent of the picture's group.
    """
    depths: list[int | None] = [None, None]
    totals, extent = [0, 0], [width, height]
    path = path_of(tree, "video")
    for depth, index in enumerate(path):
        split = split_at(tree, path[:depth])
        axis = 0 if split.split == "horizontal" else 1
        depths[axis] = depth
        totals[axis] = extent[axis] - GAP_PX * (len(split.children) - 1)
        extent[axis] = round(totals[axis] * shares(split)[index])
    return depths, totals, extent


def _without_bars(tree: LayoutNode, width: int, height: int, aspect: float) -> LayoutNode:
    """The tree with the panel of the picture as large as the picture in it; its neighbours share the rest as before. A
    picture much wider than its room gets as much as the others permit.
    """
    depths, totals, (across_px, down_px) = _picture_room(tree, width, height)
    if across_px < _ENOUGH * down_px * aspect:
        return _around_picture(tree, width, height, aspect)
    axis, length = (1, across_px / aspect) if across_px < down_px * aspect else (0, down_px * aspect)
    depth, path = depths[axis], path_of(tree, "video")
    if depth is None or "video" not in map(front_of, groups_in(tree)):
        return tree
    part_of = shares(split_at(tree, path[:depth]))
    share = length / totals[axis]
    rest = (1 - share) / (1 - part_of[path[depth]])
    weights = tuple(share if i == path[depth] else part * rest for i, part in enumerate(part_of))
    return with_weights(tree, path[:depth], weights)


def _around_picture(tree: LayoutNode, width: int, height: int, aspect: float, *, moved: bool = False) -> LayoutNode:
    """The tree with the picture as large as the others permit; ``moved``: some of them moved beside it."""
    path = path_of(tree, "video")
    splits = [split_at(tree, path[:depth]) for depth in range(len(path))]
    (across, down), totals, now = _picture_room(tree, width, height)
    if across is None or "video" not in map(front_of, groups_in(tree)):
        return tree
    tab_bar = 0 if PanelLeaf("video") in groups_in(tree) else TAB_BAR_PX
    beside = _others(splits[across], path[across])
    around = [] if down is None else _others(splits[down], path[down])
    most_height = (totals[1] if around else now[1]) - sum(_need(child, 1) for child, _share in around) - tab_bar
    in_row = down is None or across > down  # something lies beside the picture in the same column
    most_width = totals[0] - sum(_need(child, 0) for child, _share in beside) if in_row else now[0]
    if down is None and not moved:  # the others need not get more than they have
        most_width = max(most_width, now[0])
    in_column = 0 if in_row else max(_need(child, 0) for child, _share in around)
    if beside and not in_row and aspect * most_height < min(in_column, now[0]):
        # What lies above or below needs more width than the picture: it moves beside it, if that is high enough.
        stacked = sum(_need(child, 1) for child, _share in around)
        stacked += max(_need(child, 1) for child, _share in beside)
        if height >= _STACKED * stacked:
            host = min((front_of(group) for child, _share in beside for group in groups_in(child)), key=_importance)
            for panel in [panel for child, _share in around for panel in panels_in(child)]:
                tree = place_next_to(without(tree, {panel}) or tree, host, panel, "below")
                at = path_of(tree, panel)[:-1]
                heights = (float(_need(child, 1)) for child in split_at(tree, at).children)
                tree = with_weights(tree, at, tuple(heights))
            return _around_picture(tree, width, height, aspect, moved=True)
    if most_height + tab_bar < _LEAST_PICTURE[1] or most_width < _LEAST_PICTURE[0]:
        if not in_row or down is None:
            return tree
        most_width = 0
    picture_height = min(max(most_height, _LEAST_PICTURE[1]), most_width / aspect)
    if in_row and picture_height < _ENOUGH * most_height and all(_rank(child) >= ALWAYS_SEEN for child, _ in beside):
        folded = [panel for child, _share in beside for panel in panels_in(child)]
        rest = without(tree, folded)
        if rest is not None and isinstance(rest, SplitNode):
            for panel in folded:
                rest = _with_tabs(rest, PanelLeaf(panel))
            return _around_picture(tidy(rest), width, height, aspect)
    lengths_at = {across: max(aspect * picture_height, min(in_column, now[0])), down: picture_height + tab_bar}
    for depth, length in lengths_at.items():
        if depth is None:
            continue
        axis = 0 if depth == across else 1
        others = _others(splits[depth], path[depth])
        needs = [_need(child, axis) for child, _share in others]
        left = lengths(totals[axis] - round(length), [share for _child, share in others], needs, 0)
        weights = [float(max(1, each)) for each in left]
        weights.insert(path[depth], length)
        tree = with_weights(tree, path[:depth], tuple(weights))
    return tree


def _others(split: SplitNode, index: int) -> list[tuple[LayoutNode, float]]:
    parts = list(zip(split.children, shares(split), strict=True))
    return parts[:index] + parts[index + 1 :]


def _need(node: LayoutNode, axis: int, *, in_front: bool = True) -> int:
    """Extent in which every visible panel, or also those behind tabs, has its comfortable size."""
    needing = {front_of(group) for group in groups_in(node)} if in_front else panels_in(node)

    def room(panel: PanelName) -> Room:
        return COMFORT.get(panel, _OTHER_ROOM) if panel in needing else (0, 0)

    return least_room(node, panels_in(node), room)[axis]


def _rank(node: LayoutNode) -> int:
    """Importance rank of the node's most important panel; lower is more important."""
    return min(map(_importance, panels_in(node)))


def _importance(panel: PanelName) -> int:
    return IMPORTANCE.index(panel) if panel in IMPORTANCE else len(IMPORTANCE)


def _compact(node: LayoutNode, width: int, height: int) -> LayoutNode:
    """Fold the least important parts of each split into tabs until the rest have enough space."""
    if not isinstance(node, SplitNode):
        return node
    axis = 0 if node.split == "horizontal" else 1
    length_px = (width, height)[axis]
    parts = list(zip(node.children, shares(node), strict=True))
    while len(parts) > 1 and sum(_need(child, axis) for child, _ in parts) + GAP_PX * (len(parts) - 1) > length_px:
        foldable = [i for i in range(len(parts)) if _rank(parts[i][0]) >= ALWAYS_SEEN]
        if not foldable:
            break
        least = max(foldable, key=lambda i: _rank(parts[i][0]))
        folded, share = parts.pop(least)
        host = max(range(len(parts)), key=lambda i: (_rank(parts[i][0]), -abs(i - least)))
        child, part = parts[host]
        parts[host] = (_with_tabs(child, folded), part + share)
    if len(parts) == 1:
        return _compact(parts[0][0], width, height)
    room = length_px - GAP_PX * (len(parts) - 1)
    given = lengths(room, [share for _, share in parts], [_need(child, axis) for child, _ in parts], 0)
    children = tuple(
        _compact(child, *((length, height) if axis == 0 else (width, length)))
        for (child, _), length in zip(parts, given, strict=True)
    )
    return SplitNode(node.split, children, tuple(float(max(1, length)) for length in given))


def _with_tabs(node: LayoutNode, folded: LayoutNode) -> LayoutNode:
    """The tree with the panels of ``folded`` added to its least important tab group."""
    if isinstance(node, SplitNode):
        host = max(range(len(node.children)), key=lambda i: _rank(node.children[i]))
        children = list(node.children)
        children[host] = _with_tabs(children[host], folded)
        return SplitNode(node.split, tuple(children), node.weights)
    # The most important of the groups' current tabs stays in front.
    front: PanelName = min([front_of(node), *map(front_of, groups_in(folded))], key=_importance)
    return TabNode((*panels_in(node), *panels_in(folded)), front)


def _spread(node: LayoutNode, width: int, height: int) -> LayoutNode:
    """Spread tabs side by side or stacked as long as each has its comfortable size."""
    if isinstance(node, SplitNode):
        axis = 0 if node.split == "horizontal" else 1
        length_px = (width, height)[axis] - GAP_PX * (len(node.children) - 1)
        children = tuple(
            _spread(child, *((round(length_px * share), height) if axis == 0 else (width, round(length_px * share))))
            for child, share in zip(node.children, shares(node), strict=True)
        )
        return SplitNode(node.split, children, node.weights)
    if isinstance(node, PanelLeaf):
        return node
    for axis, split in enumerate(_DIRECTIONS):
        for alone in range(len(node.tabs) - 1, 0, -1):
            parts = _first_alone(node, alone)
            across = max(_need(part, 1 - axis, in_front=False) for part in parts)
            along = sum(_need(part, axis, in_front=False) for part in parts) + GAP_PX * (len(parts) - 1)
            if along <= (width, height)[axis] and across <= (width, height)[1 - axis]:
                return SplitNode(split, parts, tuple(float(_need(part, axis, in_front=False)) for part in parts))
    return node


def _first_alone(node: TabNode, count: int) -> tuple[LayoutNode, ...]:
    """The current and other panels alone, ``count`` in all; the rest in tabs."""
    front = front_of(node)
    ordered = (front, *(panel for panel in node.tabs if panel != front))
    return (*(PanelLeaf(panel) for panel in ordered[:count]), tidy(TabNode(ordered[count:])))
