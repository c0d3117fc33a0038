"""Panel layout as plain data, for scenario files and recordings."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.key_path import KeyPath, Problem
from caris_desktop.domain.schema_fields import data_of, value_from
from caris_desktop.domain.schema_validation import allowed_words, problems
from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import LayoutNode, Scenario

"""What room the panels have: less than they need, that of a common screen, or plenty."""


def own_layout(scenario: Scenario, kind: SizeClass) -> LayoutNode | None:
    """Layout in the scenario's file for such a screen; None if it derives from the usual one."""
    if kind == "compact":
        return scenario.layout_compact
    return scenario.layout_large if kind == "large" else scenario.layout


def with_layout(scenario: Scenario, kind: SizeClass, tree: LayoutNode | None) -> Scenario:
    """Scenario with another layout for such a screen; only the usual one is mandatory."""
    if kind == "compact":
        return replace(scenario, layout_compact=tree)
    if kind == "large":
        return replace(scenario, layout_large=tree)
    return scenario if tree is None else replace(scenario, layout=tree)


def layout_from_data(node: dict[str, Any]) -> LayoutNode:
    """Layout from validated data."""
    layout: LayoutNode = value_from(LayoutNode, node)
    return layout


def checked_layout(node: Any) -> LayoutNode:
    """As :func:`layout_from_data`, for unvalidated data. Raises ValueError."""
    for _path, problem in problems(LayoutNode, node, ("layout",)):
        raise ValueError(tr("invalid panel layout: {problem}").format(problem=problem[:200]))
    return layout_from_data(node)


def layout_problems(node: dict[str, Any], path: KeyPath, seen: set[str]) -> Iterator[Problem]:
    """Problems that the schema cannot express. ``seen`` are panels used elsewhere."""
    if "children" in node:
        weights = node.get("weights")
        if weights is not None and len(weights) != len(node["children"]):
            yield (
                (*path, "weights"),
                tr("{weights} weights for {children} children. Allowed: one weight for each child.").format(
                    weights=len(weights), children=len(node["children"])
                ),
            )
        for index, child in enumerate(node["children"]):
            yield from layout_problems(child, (*path, "children", index), seen)
        return
    panels: list[tuple[KeyPath, str]] = [((*path, "panel"), node["panel"])] if "panel" in node else []
    panels += [((*path, "tabs", index), panel) for index, panel in enumerate(node.get("tabs", []))]
    for place, panel in panels:
        if panel in seen:
            yield place, tr("duplicate panel '{panel}'. Allowed: each panel once.").format(panel=panel)
        seen.add(panel)
    if "current" in node and node["current"] not in node["tabs"]:
        yield (
            (*path, "current"),
            tr("'{panel}' is not one of these tabs.").format(panel=node["current"])
            + " "
            + allowed_words(node["current"], node["tabs"]),
        )


def layout_data(node: LayoutNode) -> dict[str, Any]:
    """File content of the layout."""
    data: dict[str, Any] = data_of(LayoutNode, node)
    return data


def layout_text(node: LayoutNode) -> str:
    """Layout as one line of JSON, for recordings."""
    return json.dumps(layout_data(node))
