"""Map tools: navigation goals, places, robot pose and distances, with their popups."""

import math
from collections.abc import Callable
from functools import partial

from PySide6.QtCore import QObject, QPointF, Qt, QTimer, Signal
from PySide6.QtWidgets import QMenu

from caris_desktop.domain import intents
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import Place
from caris_desktop.ui import text_formatting
from caris_desktop.ui.map.map_state import Tool
from caris_desktop.ui.map.map_view import MapView
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.widgets.popups import ChoiceCard, NameCard

_TOLD_SHOWN_S = 8.0
_NO_PLACE_SHOWN_S = 5.0
_UNDO_SHOWN_MS = 10_000
_HINTS: dict[Tool, str] = {
    "look": "",
    "goal": QT_TR_NOOP("Press at the goal, drag for the heading · Esc cancels"),
    "pose": QT_TR_NOOP("Press at the robot, drag for the heading · Esc cancels"),
    "place": QT_TR_NOOP("Press at the place, drag for the heading · Esc cancels"),
    "measure": QT_TR_NOOP("Drag from one point to another · Esc ends measuring"),
}
_MENU: tuple[tuple[Tool, str, str], ...] = (
    ("goal", QT_TR_NOOP("Go here: position and heading"), "G"),
    ("place", QT_TR_NOOP("Add a place"), ""),
    ("pose", QT_TR_NOOP("Robot is here: set the robot's position"), ""),
    ("measure", QT_TR_NOOP("Measure a distance"), ""),
)


def add_action(
    menu: QMenu,
    name: str,
    text: str,
    act: Callable[[], object],
    *,
    key: str = "",
    checked: bool | None = None,
    enabled: bool = True,
) -> None:
    """Add an entry that calls ``act``; ``checked``: state of one that can be checked."""
    action = menu.addAction("\t".join((text, key)).rstrip("\t"))
    action.setObjectName(name)
    action.setCheckable(checked is not None)
    action.setChecked(bool(checked))
    action.setEnabled(enabled)
    action.triggered.connect(lambda _checked=False: act())


class MapTools(QObject):
    """Tools of the map's menu, and popups at clicked points. ``by_odometry``: there is no map."""

    reported = Signal(str, str, float)  # text, role, display time in seconds
    changed = Signal()

    def __init__(self, panel: Panel, view: MapView) -> None:
        super().__init__(panel)
        self._panel = panel
        self._view = view
        self._console, self._state, self._table, self._theme = panel.console, panel.state, panel.table, panel.theme
        self.by_odometry = False
        self._drives = panel.console.scenario.permissions.driving
        self._moving: str | None = None
        self._naming: tuple[str, Pose2D | None] = ("", None)
        self._before: Place | None = None  # a place before it was moved or removed
        self._card = ChoiceCard(self._theme, view, name="map_card")
        self._card.closed.connect(lambda: self._view.update_state(mark=None))
        self._undo = ChoiceCard(self._theme, view, name="map_undo")
        self._undo_ends = QTimer(self, singleShot=True, interval=_UNDO_SHOWN_MS)
        self._undo_ends.timeout.connect(self._undo.hide)
        self._name = NameCard(self._theme, view, name="map_name")
        self._name.named.connect(self._on_named)
        view.place_clicked.connect(self._on_place_clicked)
        view.ground_clicked.connect(self._on_ground_clicked)
        view.aimed.connect(self._on_aimed)
        view.tool_changed.connect(self._on_tool_changed)
        view.moved.connect(self._card.hide)
        panel.hold.escape_pressed.connect(self._on_escape)

    def fill_menu(self, menu: QMenu) -> None:
        """Add the tools that robot and scenario allow."""
        for tool, text, key in _MENU:
            if self._is_offered(tool):
                checked = self._view.map_state.tool == tool
                use = partial(self.use, "look" if checked else tool)
                add_action(menu, f"map_tool_{tool}", tr(text), use, key=key, checked=checked)

    def _is_offered(self, tool: Tool) -> bool:
        able = {"goal": self.can_navigate, "pose": self._can_set_pose}.get(tool, lambda: True)
        return tool == "measure" or (self.may_go and able())

    def toggle_goal(self) -> bool:
        """Toggle the goal tool; False if there is none."""
        if not self._is_offered("goal"):
            return False
        self.use("look" if self._view.map_state.tool == "goal" else "goal")
        return True

    def use(self, tool: Tool, *, at: QPointF | None = None) -> None:
        self._moving = None
        self._card.hide()
        self._name.hide()
        if tool not in ("look", "measure") and self._refuse_place():
            tool = "look"
        self._view.set_tool(tool, at=at)
        self._view.setFocus(Qt.FocusReason.OtherFocusReason)
        self._on_tool_changed(self._view.map_state.tool)

    def _on_tool_changed(self, tool: str) -> None:
        if tool == "look":
            self._view.update_state(hint="")
        elif self._view.map_state.aim is not None and self._view.map_state.aim.anchored:
            self._view.update_state(hint=tr("Click the direction to face · Esc cancels"))
        elif self._moving is not None:
            where = tr("Press at the new position of {place}, drag to set the heading · Esc cancels")
            self._view.update_state(hint=where.format(place=self._moving))
        else:
            self._view.update_state(hint=tr(_HINTS[self._view.map_state.tool]))

    def _on_escape(self) -> None:
        self._moving = None
        self._view.give_up()
        for card in (self._card, self._undo):
            card.hide()
        if not self._name.isHidden():
            self._name.hide()
            self._view.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_place_clicked(self, name: str, where: QPointF) -> None:
        if not self.may_go:
            return
        go_text = tr("Go to {place}").format(place=name)
        choices: list[tuple[str, str, str, Callable[[], object]]] = [
            (f"go_to_{name}", go_text, "navigation-arrow", partial(self.go_to, name)),
            ("map_place_move", tr("Move"), "map-pin", partial(self._begin_moving, name)),
            ("map_place_remove", tr("Remove"), "trash", partial(self._remove, name)),
        ]
        if self.can_navigate():
            self._card.offer(where, self.goal_speed(), choices)
        else:
            self._card.offer(where, name, choices[1:], per_row=2)

    def goal_speed(self) -> str:
        """Speed limit on the way to a goal, shown before one is chosen."""
        return text_formatting.goal_speed(self._state.robot.value, self._state.drive.value, begins=True)[0]

    def _on_ground_clicked(self, at: QPointF, where: QPointF) -> None:
        if not self.may_go or self._refuse_place():
            return
        if not self._card.isHidden():
            self._card.hide()
            return
        refusal = self._view.grid.refusal_at(at)
        pose = self.pose_now()
        line = refusal
        if not refusal and pose is not None:
            speed, _by_speed_setting = text_formatting.goal_speed(self._state.robot.value, self._state.drive.value)
            distance_m = math.dist((at.x(), at.y()), (pose.x_m, pose.y_m))
            away = tr("{distance:.1f} m from the robot").format(distance=distance_m)
            line = " · ".join(part for part in (away, speed if self.can_navigate() else "") if part)
            if self._state.map.value is not None and self._view.grid.value_at(at) is None:
                line = ", ".join((line, tr("not on the map yet")))
        choices: list[tuple[str, str, str, Callable[[], object]]] = []
        if not refusal:
            target = Pose2D(at.x(), at.y(), self._view.heading_towards(at))
            if self.can_navigate():
                go = partial(self._console.do, intents.GoToPoint(target))
                choices.append(("map_go_here", tr("Go here"), "navigation-arrow", go))
                choices.append(("map_go_heading", tr("Choose heading"), "compass", lambda: self.use("goal", at=at)))
            choices.append(("map_add_place", tr("Add place"), "flag", lambda: self.use("place", at=at)))
            if self._can_set_pose():
                choices.append(("map_robot_here", tr("Robot is here"), "map-pin", lambda: self.use("pose", at=at)))
        self._card.offer(where, line, choices, per_row=2 if self.can_navigate() else 1)
        self._view.update_state(mark=at)

    def _on_aimed(self, tool: str, pose: Pose2D, headed: bool) -> None:
        moving, self._moving = self._moving, None
        match tool:
            case "goal":
                self._console.do(intents.GoToPoint(pose))
            case "pose":
                self._console.do(intents.SetInitialPose(pose))
                sent = tr("Position sent to the robot")
                as_before = tr("Position sent to the robot (heading unchanged)")
                self.reported.emit(sent if headed else as_before, "hint", _TOLD_SHOWN_S)
            case "place" if moving is not None:
                old = self._place(moving)
                if old is not None and not headed:
                    pose = Pose2D(pose.x_m, pose.y_m, old.pose_in_map.heading_rad)
                self._console.do(intents.SavePlace(moving, pose))
                self._offer_undo(old, tr("{place} was moved").format(place=moving))
            case "place":
                self._ask_place_name(pose)
        self.changed.emit()

    def _begin_moving(self, name: str) -> None:
        self.use("place")
        self._moving = name
        self._on_tool_changed("place")

    def _place(self, name: str) -> Place | None:
        return next((place for place in self._state.places.value if place.name == name), None)

    def _remove(self, name: str) -> None:
        before = self._place(name)
        self._console.do(intents.RemovePlace(name))
        self._offer_undo(before, tr("{place} was removed").format(place=name))

    def _offer_undo(self, before: Place | None, done: str) -> None:
        self._before = before
        middle = QPointF(self._view.width() / 2, self._view.height())
        self._undo.offer(middle, done, [("map_undo_button", tr("Undo"), "arrow-u-up-left", self._put_back)])
        self._undo_ends.start()

    def _put_back(self) -> None:
        if self._before is not None:
            self._console.do(intents.SavePlace(self._before.name, self._before.pose_in_map))
            self._before = None

    def name_robot_place(self) -> None:
        pose = self.pose_now()
        if pose is not None:
            self._ask_place_name(pose)

    def _ask_place_name(self, pose: Pose2D, line: str = "", text: str = "") -> None:
        self._naming = ("place", pose)
        line = line or tr("What is the place called?")
        self._name.ask(self._view.to_view(pose.x_m, pose.y_m), line, verb=tr("Add"), text=text)

    def ask_map_name(self, operation: str) -> None:
        self._naming = (operation, None)
        line, verb = tr("Which saved map of the robot should be loaded?"), tr("Load")
        if operation == "save_map":
            line, verb = tr("Under which name should the robot's map be saved?"), tr("Save")
        self._name.ask(QPointF(self._view.width() / 2, self._view.height() / 3), line, verb=verb)

    def _on_named(self, name: str) -> None:
        purpose, pose = self._naming
        if purpose == "place" and pose is not None:
            taken = {place.name.casefold() for place in self._state.places.value}
            if name.casefold() in taken:
                another = tr("{place} is already on the map: choose another name").format(place=name)
                self._ask_place_name(pose, another, name)
                return
            self._console.do(intents.SavePlace(name, pose))
        elif purpose == "save_map":
            self._console.do(intents.SaveMap(name))
        elif purpose == "load_map":
            self._console.do(intents.LoadMap(name))
        self._view.setFocus(Qt.FocusReason.OtherFocusReason)

    def go_to(self, place: str) -> None:
        self._console.do(intents.GoToPlace(place))

    def pose_now(self) -> Pose2D | None:
        pose: RobotPose | None = self._state.pose.value
        return None if pose is None else pose.pose_in_map

    @property
    def may_go(self) -> bool:
        """Whether commands are possible; never in a replay, whose table has no marks either."""
        return self._drives and self._table.spec("mark") is not None

    def can_navigate(self) -> bool:
        robot: RobotProfile | None = self._state.robot.value
        return robot is None or robot.navigation is not None

    def _can_set_pose(self) -> bool:
        robot: RobotProfile | None = self._state.robot.value
        return robot is not None and robot.initial_pose is not None

    def _refuse_place(self) -> bool:
        """Refuse a point in the odometry frame: the robot cannot be sent there."""
        if self.by_odometry:
            self.reported.emit(tr("Goals and places need a map"), "warning", _NO_PLACE_SHOWN_S)
        return self.by_odometry
