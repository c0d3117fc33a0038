"""The arrangement of the panels as plain data, as scenario files and recordings hold it."""

import json
from typing import Any

from caris_desktop.domain.shipped import schema_validator
from caris_desktop.scenario.model import SCENARIO_VERSION, LayoutNode, PanelLeaf, SplitNode, TabNode


def layout_from_data(node: dict[str, Any]) -> LayoutNode:
    """The tree that checked data describe."""
    if "panel" in node:
        return PanelLeaf(node["panel"])
    if "tabs" in node:
        return TabNode(tuple(node["tabs"]), node.get("current"))
    children = tuple(layout_from_data(child) for child in node["children"])
    weights = node.get("weights", [1.0] * len(children))
    return SplitNode(node["split"], children, tuple(float(weight) for weight in weights))


def checked_layout(node: Any) -> LayoutNode:
    """As :func:`layout_from_data`, from data that nobody has checked. Raises ValueError."""
    whole = {"version": SCENARIO_VERSION, "title": "-", "layout": node}
    error = next(schema_validator("scenario.schema.json").iter_errors(whole), None)
    if error is not None:
        raise ValueError(f"not an arrangement of panels: {error.message[:200]}")
    return layout_from_data(node)


def layout_data(node: LayoutNode) -> dict[str, Any]:
    """What a file says of the tree."""
    if isinstance(node, PanelLeaf):
        return {"panel": node.panel}
    if isinstance(node, TabNode):
        data: dict[str, Any] = {"tabs": list(node.tabs)}
        return data if node.current is None else {**data, "current": node.current}
    return {
        "split": node.split,
        "weights": [plain_number(weight) for weight in node.weights],
        "children": [layout_data(child) for child in node.children],
    }


def layout_text(node: LayoutNode) -> str:
    """The tree as one line of JSON, as records hold it."""
    return json.dumps(layout_data(node))


def plain_number(number: float) -> float | int:
    """Whole numbers without a point."""
    return int(number) if number == int(number) else number
