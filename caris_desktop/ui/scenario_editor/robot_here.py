"""Button that sets a place to the robot's current pose."""

import math

from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.translation import tr
from caris_desktop.ui import tokens
from caris_desktop.ui.scenario_editor.editing_context import FormContext
from caris_desktop.ui.widgets.buttons import ActionButton

POSE_KEYS = {"x_m", "y_m", "heading_deg"}
"""Keys of a group that is a pose in the map."""


class RobotHere(ActionButton):
    """Button for the group at ``path``."""

    def __init__(self, context: FormContext, path: KeyPath) -> None:
        super().__init__(context.theme, tr("Here"), icon="robot", height_px=32, text_px=tokens.STATUS_PX)
        self._context = context
        self._path = path
        self.setObjectName("place_from_robot")
        self.setAccessibleName(context.spoken(tr("Use the robot's current position")))
        self.clicked.connect(self._use_position)

    def refresh(self) -> None:
        known = self._context.robot_pose() is not None
        self.setEnabled(known)
        where = tr("Use the robot's current position and heading")
        self.setToolTip(where if known else tr("The robot's position in the map is unknown"))

    def _use_position(self) -> None:
        pose = self._context.robot_pose()
        if pose is None:
            return
        document = self._context.editing.document
        document.pause()
        for name, value in (
            ("x_m", round(pose.x_m, 2)),
            ("y_m", round(pose.y_m, 2)),
            ("heading_deg", round(math.degrees(pose.heading_rad))),
        ):
            document.set((*self._path, name), value)
        self._context.editing.emit_changes()
