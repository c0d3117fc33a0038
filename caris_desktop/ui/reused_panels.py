"""Decision whether a changed scenario needs its panels rebuilt."""

from dataclasses import replace

from caris_desktop.scenario.scenario_model import LayoutNode, Scenario
from caris_desktop.ui.layout.layout_tree import panels_in


def same_panels(before: Scenario, after: Scenario, arranged: LayoutNode | None) -> bool:
    """Whether no panel needs a rebuild, so that text being typed is not lost.

    True if only a place was saved or removed (panels follow ``state.places``), or the current layout was saved.
    """
    return _only_other_places(before, after) or _only_saves_the_layout(before, after, arranged)


def _only_other_places(before: Scenario, after: Scenario) -> bool:
    moved = replace(after, places=before.places, path=before.path, sha256=before.sha256)
    return before.places != after.places and moved == before


def _only_saves_the_layout(before: Scenario, after: Scenario, arranged: LayoutNode | None) -> bool:
    return (
        arranged is not None
        and set(panels_in(after.layout)) == set(panels_in(arranged))
        and replace(
            after,
            layout=before.layout,
            layout_compact=before.layout_compact,
            layout_large=before.layout_large,
            path=before.path,
            sha256=before.sha256,
            places=before.places,
        )
        == before
    )
