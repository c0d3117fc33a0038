"""Panel table: title, icon, neighbours and required permission of each panel."""

import importlib
from collections.abc import Mapping
from functools import partial
from typing import Any

from caris_desktop.domain.intents import Permission
from caris_desktop.domain.plugins import PluginError, find, load, watched
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import PanelName, Scenario, plugin_panels

_imported: set[str] = set()


class PanelSpec(Value):
    """Row of the panel table.

    The class of the panel ``video`` is ``VideoPanel`` in ``panels/video_panel.py``, imported only when a scenario shows
    it. ``neighbours``: a panel outside the
    scenario's layout opens in a tab with the first of these that is open. Without ``permission`` the panel is absent,
    whatever the layout says. ``library``: module that takes longer to import than a turn of the event loop may take;
    the panel is created once it is imported in the background. ``also``: other words that find it in the palette.
    """

    name: PanelName
    title: str
    icon: str
    neighbours: tuple[PanelName, ...]
    permission: Permission | None = None
    library: str = ""
    also: str = ""

    @property
    def ready(self) -> bool:
        """Whether the panel can be created within a turn."""
        return not self.library or self.library in _imported

    def import_library(self) -> None:
        """Import ``library``, in the background if possible."""
        importlib.import_module(self.library)
        _imported.add(self.library)

    def load(self) -> Any:
        """Import the panel's class, or what makes it, at first use."""
        if self.library:
            self.import_library()
        return load(find("panels", self.name))


class PluginPanelSpec(PanelSpec):
    """Row of the panel of a plug-in."""

    @property
    def plugin_name(self) -> str:
        return self.name.removeprefix("plugin:")

    def import_library(self) -> None:
        """Import the plug-in in the background; the panel reports its failure."""
        try:
            with watched(plugin := find("panels", self.plugin_name)):
                load(plugin)
        except PluginError:
            pass
        _imported.add(self.library)

    def load(self) -> Any:
        module = importlib.import_module("caris_desktop.ui.plugin_panel")  # its base class imports this table
        return partial(module.PluginPanel, self.plugin_name)


class _PanelTable(dict[PanelName, PanelSpec]):
    """Built-in panels; a row of another name is that of a plug-in."""

    def __missing__(self, name: PanelName) -> PanelSpec:
        title = name.removeprefix("plugin:").replace("_", " ").replace("-", " ").capitalize()
        return PluginPanelSpec(name, title, "puzzle-piece", ("session", "people", "map"), library=name)


_PLOTS = "pyqtgraph"

_ROWS = (
    PanelSpec("video", QT_TR_NOOP("Video"), "video-camera", ("map", "people"), also=QT_TR_NOOP("camera picture")),
    PanelSpec("map", QT_TR_NOOP("Map"), "map-trifold", ("people", "session", "drive"), library=_PLOTS),
    PanelSpec("drive", QT_TR_NOOP("Drive"), "game-controller", ("map", "people", "session"), "driving",
              also=QT_TR_NOOP("joystick speed")),
    PanelSpec("people", QT_TR_NOOP("People"), "users", ("session", "drive", "map")),
    PanelSpec("speak", QT_TR_NOOP("Speak"), "chat-text", ("assistant",), "speech"),
    PanelSpec("conversation", QT_TR_NOOP("Conversation"), "chats", ("assistant", "people", "session", "map")),
    PanelSpec("assistant", QT_TR_NOOP("Assistant"), "sparkle", ("people", "session", "map"), "assistant"),
    PanelSpec("session", QT_TR_NOOP("Session"), "list-bullets", ("people", "drive", "assistant", "map")),
    PanelSpec("robot", QT_TR_NOOP("Robot"), "sliders", ("people", "drive", "session", "map"), "robot_controls"),
    PanelSpec("motion", QT_TR_NOOP("Motion"), "chart-line", ("map", "drive", "people", "session"), library=_PLOTS),
    PanelSpec("photos", QT_TR_NOOP("Photos"), "image", ("people", "session", "map", "drive"), "photos"),
    PanelSpec("face", QT_TR_NOOP("Robot’s face"), "smiley", ("people", "session", "map"), "face"),
    PanelSpec("notes", QT_TR_NOOP("Notes"), "note-pencil", ("session", "people", "conversation", "map"), "notes"),
    PanelSpec("diagnostics", QT_TR_NOOP("Diagnostics"), "gauge", ("session", "people", "assistant", "drive", "map")),
)  # fmt: skip
PANELS: Mapping[PanelName, PanelSpec] = _PanelTable({spec.name: spec for spec in _ROWS})


def possible_panels(scenario: Scenario) -> tuple[PanelName, ...]:
    """All panels that this scenario offers, in its layout or not; of plug-ins, those in its layouts."""
    built_in = tuple(
        name
        for name, spec in PANELS.items()
        if (spec.permission is None or getattr(scenario.permissions, spec.permission))
        and name not in scenario.panels_off
    )
    return (*built_in, *(name for name in plugin_panels(scenario) if name not in scenario.panels_off))
