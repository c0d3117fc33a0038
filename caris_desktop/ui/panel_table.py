"""Panel table: module, icon, neighbours and required permission of each panel."""

import importlib
from collections.abc import Mapping
from typing import Any

from caris_desktop.domain.intents import Permission
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import PanelName, Scenario

_imported: set[str] = set()


class PanelSpec(Value):
    """Row of the panel table.

    ``module`` and ``class_name`` are imported only when a scenario shows the panel. ``neighbours``: a panel outside the
    scenario's layout opens in a tab with the first of these that is open. Without ``permission`` the panel is absent,
    whatever the layout says. ``library``: module that takes longer to import than a turn of the event loop may take;
    the panel is created once it is imported in the background.
    """

    title: str
    module: str
    class_name: str
    icon: str
    neighbours: tuple[PanelName, ...]
    permission: Permission | None = None
    library: str = ""

    @property
    def ready(self) -> bool:
        """Whether the panel can be created within a turn."""
        return not self.library or self.library in _imported

    def import_library(self) -> None:
        """Import ``library``, in the background if possible."""
        importlib.import_module(self.library)
        _imported.add(self.library)

    def load(self) -> type[Any]:
        """Import the panel's class, a Panel, at first use."""
        if self.library:
            self.import_library()
        panel: type[Any] = getattr(
            importlib.import_module(f"caris_desktop.ui.panels.{self.module}_panel"), self.class_name
        )
        return panel


_PLOTS = "pyqtgraph"

PANELS: Mapping[PanelName, PanelSpec] = {
    "video": PanelSpec(QT_TR_NOOP("Video"), "video", "VideoPanel", "video-camera", ("map", "people")),
    "map": PanelSpec(
        QT_TR_NOOP("Map"), "map", "MapPanel", "map-trifold", ("people", "session", "drive"), library=_PLOTS
    ),
    "drive": PanelSpec(
        QT_TR_NOOP("Drive"), "drive", "DrivePanel", "game-controller", ("map", "people", "session"), "driving"
    ),
    "people": PanelSpec(QT_TR_NOOP("People"), "people", "PeoplePanel", "users", ("session", "drive", "map")),
    "speak": PanelSpec(QT_TR_NOOP("Speak"), "speak", "SpeakPanel", "chat-text", ("assistant",), "speech"),
    "conversation": PanelSpec(
        QT_TR_NOOP("Conversation"),
        "conversation",
        "ConversationPanel",
        "chats",
        ("assistant", "people", "session", "map"),
    ),
    "assistant": PanelSpec(
        QT_TR_NOOP("Assistant"), "assistant", "AssistantPanel", "sparkle", ("people", "session", "map"), "assistant"
    ),
    "session": PanelSpec(
        QT_TR_NOOP("Session"), "session", "SessionPanel", "list-bullets", ("people", "drive", "assistant", "map")
    ),
    "robot": PanelSpec(
        QT_TR_NOOP("Robot"), "robot", "RobotPanel", "sliders", ("people", "drive", "session", "map"), "robot_controls"
    ),
    "motion": PanelSpec(
        QT_TR_NOOP("Motion"),
        "motion",
        "MotionPanel",
        "chart-line",
        ("map", "drive", "people", "session"),
        library=_PLOTS,
    ),
    "photos": PanelSpec(
        QT_TR_NOOP("Photos"), "photos", "PhotosPanel", "image", ("people", "session", "map", "drive"), "photos"
    ),
    "face": PanelSpec(QT_TR_NOOP("Robot’s face"), "face", "FacePanel", "smiley", ("people", "session", "map"), "face"),
    "notes": PanelSpec(
        QT_TR_NOOP("Notes"), "notes", "NotesPanel", "note-pencil", ("session", "people", "conversation", "map"), "notes"
    ),
    "diagnostics": PanelSpec(
        QT_TR_NOOP("Diagnostics"),
        "diagnostics",
        "DiagnosticsPanel",
        "gauge",
        ("session", "people", "assistant", "drive", "map"),
    ),
}


def possible_panels(scenario: Scenario) -> tuple[PanelName, ...]:
    """All panels that this scenario offers, in its layout or not."""
    return tuple(
        name
        for name, spec in PANELS.items()
        if (spec.permission is None or getattr(scenario.permissions, spec.permission))
        and name not in scenario.panels_off
    )
