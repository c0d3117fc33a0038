"""Layout geometry: rectangles of tab groups and split handles for a layout tree."""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Literal

from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, SplitNode, panels_in
from caris_desktop.ui.layout.layout_rect import Rect
from caris_desktop.ui.layout.layout_tree import Side, path_of, shares, split_at

GAP_PX = 8
TAB_BAR_PX = 36
TITLE_PX = 38
_EDGE_PX = 18  # this near to the outer edge, a drop goes to that edge of the whole area
_SIDE_SHARE = 0.28  # share of a group's width or height in which a drop goes to that side

Room = tuple[int, int]
"""Width and height in pixels."""
RoomOf = Callable[[PanelName], Room]
_SQUEEZED: Room = (140, TITLE_PX)  # minimum that always remains of a panel: its title bar


class GroupPlace(Value):
    """Rectangle of a tab group or a single panel."""

    panels: tuple[PanelName, ...]
    current: PanelName
    rect: Rect

    @property
    def tabbed(self) -> bool:
        return len(self.panels) > 1

    @property
    def tab_bar(self) -> Rect:
        return Rect(self.rect.left, self.rect.top, self.rect.width, TAB_BAR_PX if self.tabbed else 0)

    @property
    def body(self) -> Rect:
        """Area below the tab bar."""
        bar = self.tab_bar.height
        return Rect(self.rect.left, self.rect.top + bar, self.rect.width, max(0, self.rect.height - bar))


class Handle(Value):
    """Split handle: divides the split at ``path`` between its parts ``before`` and ``after``, with minimum lengths
    ``least``. ``lengths``: current lengths of all visible parts by index.
    """

    path: tuple[int, ...]
    before: int
    after: int
    split: Literal["horizontal", "vertical"]
    rect: Rect
    lengths: tuple[tuple[int, int], ...]
    least: tuple[int, int]


class DockGeometry(Value):
    groups: tuple[GroupPlace, ...] = ()
    handles: tuple[Handle, ...] = ()

    def group_of(self, panel: PanelName) -> GroupPlace | None:
        return next((group for group in self.groups if panel in group.panels), None)


def least_room(node: LayoutNode, visible: Collection[str], least: RoomOf) -> Room:
    """Minimum size of the visible panels of a tree."""
    if not isinstance(node, SplitNode):
        rooms = [least(panel) for panel in panels_in(node) if panel in visible]
        bar = TAB_BAR_PX if len(rooms) > 1 else 0
        return (max((room[0] for room in rooms), default=0), max((room[1] for room in rooms), default=0) + bar)
    rooms = [
        least_room(child, visible, least)
        for child in node.children
        if any(panel in visible for panel in panels_in(child))
    ]
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
        return _whole_pixels([floor + spare * each for each in over], total_px)
    fixed: dict[int, float] = {}
    while True:
        free = [index for index in range(count) if index not in fixed]
        total = sum(weights[index] for index in free)
        left = total_px - sum(fixed.values())
        small = [index for index in free if left * weights[index] < least[index] * total]
        if not small:
            return _whole_pixels(
                [fixed[i] if i in fixed else left * weights[i] / total for i in range(count)], total_px
            )
        fixed |= {index: float(least[index]) for index in small}


def _whole_pixels(parts: Sequence[float], total_px: int) -> list[int]:
    """Round lengths without losing a pixel in total."""
    edges, position = [0], 0.0
    for part in parts:
        position += part
        edges.append(round(position))
    edges[-1] = total_px
    return [max(0, edges[i + 1] - edges[i]) for i in range(len(parts))]


def place(node: LayoutNode, rect: Rect, visible: Collection[str], least: RoomOf) -> DockGeometry:
    """Lay out the ``visible`` panels of a tree."""
    groups: list[GroupPlace] = []
    handles: list[Handle] = []
    for part in _placed(node, rect, visible, least, ()):
        (groups if isinstance(part, GroupPlace) else handles).append(part)  # type: ignore[arg-type]
    return DockGeometry(tuple(groups), tuple(handles))


def _placed(
    node: LayoutNode, rect: Rect, visible: Collection[str], least: RoomOf, path: tuple[int, ...]
) -> Iterator[GroupPlace | Handle]:
    if not isinstance(node, SplitNode):
        panels = tuple(panel for panel in panels_in(node) if panel in visible)
        if panels:
            current = None if isinstance(node, PanelLeaf) else node.current
            yield GroupPlace(panels, current if current in panels else panels[0], rect)
        return
    indices = [i for i, child in enumerate(node.children) if any(panel in visible for panel in panels_in(child))]
    if not indices:
        return
    across = node.split == "horizontal"
    room_px = (rect.width if across else rect.height) - GAP_PX * (len(indices) - 1)
    part_of = shares(node)
    needs = [least_room(node.children[i], visible, least)[0 if across else 1] for i in indices]
    given = lengths(max(0, room_px), [part_of[i] for i in indices], needs, _SQUEEZED[0 if across else 1])
    at = rect.left if across else rect.top
    for number, (i, length) in enumerate(zip(indices, given, strict=True)):
        part = Rect(at, rect.top, length, rect.height) if across else Rect(rect.left, at, rect.width, length)
        yield from _placed(node.children[i], part, visible, least, (*path, i))
        at += length
        if number + 1 < len(indices):
            gap = Rect(at, rect.top, GAP_PX, rect.height) if across else Rect(rect.left, at, rect.width, GAP_PX)
            had = tuple(zip(indices, given, strict=True))
            yield Handle(path, i, indices[number + 1], node.split, gap, had, (needs[number], needs[number + 1]))
            at += GAP_PX


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
        (handle, handle.before == at[len(handle.path)])
        for handle in placing.handles
        if len(handle.path) < len(at)
        and handle.path == at[: len(handle.path)]
        and at[len(handle.path)] in (handle.before, handle.after)
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
    mark: Rect
    at: int | None = None


def drop_at(placing: DockGeometry, rect: Rect, x: int, y: int, panel: PanelName) -> Drop | None:
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
    head = Rect(group.rect.left, group.rect.top, group.rect.width, TAB_BAR_PX)
    if head.contains(x, y):
        return Drop(others[0], "tab", group.rect, None if not group.tabbed else -1)
    wide, high = group.rect.width or 1, group.rect.height or 1
    nearest, part = min(
        ((side, px / (wide if side in ("left", "right") else high)) for side, px in _edges(group.rect, x, y)),
        key=lambda each: each[1],
    )
    if part < _SIDE_SHARE:
        return Drop(others[0], nearest, _half(group.rect, nearest, 0.5))
    return None if panel in group.panels else Drop(others[0], "tab", group.rect)


def _edges(rect: Rect, x: int, y: int) -> tuple[tuple[Side, int], ...]:
    return (
        ("left", x - rect.left),
        ("right", rect.right - 1 - x),
        ("above", y - rect.top),
        ("below", rect.bottom - 1 - y),
    )


def _half(rect: Rect, side: Side, share: float) -> Rect:
    wide, high = round(rect.width * share), round(rect.height * share)
    if side == "left":
        return Rect(rect.left, rect.top, wide, rect.height)
    if side == "right":
        return Rect(rect.right - wide, rect.top, wide, rect.height)
    if side == "above":
        return Rect(rect.left, rect.top, rect.width, high)
    return Rect(rect.left, rect.bottom - high, rect.width, high)
