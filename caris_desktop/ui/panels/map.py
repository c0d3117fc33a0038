"""Map: floor plan, LIDAR, people, places, goal, and the robot as a pin that shows where it looks."""

import math
import time
from collections.abc import Callable

from PySide6.QtCore import QPoint, QPointF, QSize, Qt, QTimer
from PySide6.QtGui import QKeyEvent, QResizeEvent
from PySide6.QtWidgets import QMenu, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid, Odometry, PeopleInMap, PlannedPath, RobotPose
from caris_desktop.live.state import LiveStream
from caris_desktop.live.status import DriveStatus, LinkStatus, MapStatus
from caris_desktop.robot.profile import RobotProfile
from caris_desktop.scenario.model import Place
from caris_desktop.ui import words
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.floating_card import ChoiceCard, NameCard
from caris_desktop.ui.widgets.map_drawing import Tool
from caris_desktop.ui.widgets.map_view import MapView

GOAL_ENDED_SHOWN_S = 8.0
_UNDO_SHOWN_MS = 10_000
_PATH_BEFORE_GOAL_NS = 500_000_000  # the goal's own event may come a little after its first path
# A robot that has a map tells soon after its odometry where it is in it.
_PLACE_AWAITED_NS = 3_000_000_000
_NO_PLACE_SHOWN_S = 5.0
_GIVE_UP = "Esc gives up"
_HINTS: dict[Tool, str] = {
    "look": "",
    "goal": f"Press where to go, drag to where to look · {_GIVE_UP}",
    "pose": f"Press where it stands, drag to where it looks · {_GIVE_UP}",
    "place": f"Press where the place is, drag to where to look · {_GIVE_UP}",
}
_BUSY = {
    "save": "Saving the map…", "load": "Loading the map…", "start_mapping": "Switching to building the map…",
    "start_localization": "Switching to finding the place only…",
}  # fmt: skip


class MapPanel(Panel):
    """The map, with a menu of places, the running goal, and tools that say where.

    A robot without a map is drawn where its odometry has it; goals and places need a map.
    """

    title = "Map"
    drives = True

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("map_panel")
        self._drives = self.console.scenario.permissions.driving
        self._ended = ("", "", 0.0)
        self._goal_id, self._goal_since_ns = "", 0
        self._by_odometry = False
        self._odometry_since_ns: int | None = None
        self._moving: str | None = None
        self._naming: tuple[str, Pose2D | None] = ("", None)
        self._removed: Place | None = None
        self.view = MapView(self.theme, self, self.state.places.value)
        self.view.setObjectName("map_view")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.view)
        self._make_title_widgets()
        self._tools = self._make_tools() if self._drives else {}
        self._card = ChoiceCard(self.theme, self.view, name="map_card")
        self._card.closed.connect(self._on_card_closed)
        self._undo = ChoiceCard(self.theme, self.view, name="map_undo")
        self._undo_ends = QTimer(self, singleShot=True, interval=_UNDO_SHOWN_MS)
        self._undo_ends.timeout.connect(self._undo.hide)
        self._name = NameCard(self.theme, self.view, name="map_name")
        self._name.named.connect(self._on_named)
        view = self.view
        view.follow_changed.connect(self._follow.setChecked)
        view.rotate_changed.connect(self._on_rotate_changed)
        view.place_clicked.connect(self._on_place_clicked)
        view.ground_clicked.connect(self._on_ground_clicked)
        view.aimed.connect(self._on_aimed)
        view.tool_changed.connect(self._on_tool_changed)
        view.moved.connect(self._card.hide)
        self._listen()
        self.every(250, self._refresh)
        self.hold.escape_pressed.connect(self._on_escape)
        self.theme.changed.connect(self._place_tools)

    def _listen(self) -> None:
        state = self.state
        state.map.changed.connect(self._on_map_changed)
        state.pose.changed.connect(self._on_pose_changed)
        state.odometry.changed.connect(self._on_odometry_changed)
        state.scan.changed.connect(self._on_scan_changed)
        state.path.changed.connect(self._on_path_changed)
        state.goal.changed.connect(self._on_goal_changed)
        self.table.rebuilt.connect(self._on_table_rebuilt)
        state.places.changed.connect(self._on_places_changed)
        state.people_in_map.changed.connect(self._on_people_changed)
        state.persons.changed.connect(self._on_people_changed)
        state.robot.changed.connect(self._on_robot_changed)
        state.mapping.changed.connect(self._on_mapping_changed)
        state.drive.changed.connect(self._on_drive_changed)
        state.link.changed.connect(self._on_link_changed)
        state.event_happened.connect(self._on_event)
        for stream in (state.map, state.pose, state.scan, state.people_in_map, state.path, state.odometry):
            stream.freshness_changed.connect(self._on_freshness_changed)
        self.catch_up()

    def catch_up(self) -> None:
        state, view = self.state, self.view
        if state.map.value is not None:
            view.show_map(state.map.value)
        if state.pose.value is not None:
            view.show_pose(state.pose.value)
        if state.scan.value is not None:
            view.show_scan(state.scan.value)
        self._on_robot_changed(state.robot.value)
        self._on_places_changed(state.places.value)
        self._on_drive_changed(state.drive.value)
        self._on_people_changed()
        self._on_goal_changed(state.goal.value)
        self._on_freshness_changed()

    def _make_title_widgets(self) -> None:
        self._go_menu = QMenu(self)
        self._go_menu.setObjectName("map_go_menu")
        self._go = ActionButton(self.theme, "Go to", icon="navigation-arrow", height_px=30, menu_arrow=True)
        self._go.setObjectName("map_go_button")
        self._go.clicked.connect(self._open_go_menu)
        self._cancel = ActionButton(self.theme, "Cancel", icon="x", height_px=30)
        self._cancel.setObjectName("goal_cancel")
        self._cancel.setToolTip("Do not go there any more")
        self._cancel.clicked.connect(lambda: self.console.do(intents.CancelGoal()))
        self._follow = self._icon_button("map_follow_button", "crosshair", "Follow the robot (F)")
        self._follow.setCheckable(True)
        self._follow.toggled.connect(self.view.set_follow)
        self._fit = self._icon_button("map_fit_button", "corners-out", "Show the whole map (Home)")
        self._fit.clicked.connect(self._on_fit_clicked)
        self._menu = QMenu(self)
        self._menu.setObjectName("map_menu")
        self._more = self._icon_button("map_menu_button", "dots-three-vertical", "More of the map")
        self._more.clicked.connect(self._open_menu)

    def _icon_button(self, name: str, icon: str, tip: str) -> ActionButton:
        button = ActionButton(self.theme, "", icon=icon, height_px=30)
        button.setObjectName(name)
        button.setAccessibleName(tip.split(" (", maxsplit=1)[0])
        button.setToolTip(tip)
        return button

    def _make_tools(self) -> dict[Tool, ActionButton]:
        tools: dict[Tool, ActionButton] = {}
        for tool, icon, tip in (
            ("goal", "navigation-arrow", "Go here: a place and a heading (G)"),
            ("place", "flag", "Add a place"),
            ("pose", "map-pin", "The robot is here: tell it where it stands"),
        ):
            button = self._icon_button(f"map_tool_{tool}", icon, tip)
            button.setParent(self.view)
            button.setCheckable(True)
            button.clicked.connect(self._tool_taker(tool))
            tools[tool] = button  # type: ignore[index]
        return tools

    def _tool_taker(self, tool: str) -> object:
        return lambda checked=False: self._take_tool(tool if checked else "look")  # type: ignore[arg-type]

    def title_widgets(self) -> list[QWidget]:
        shown: list[QWidget] = [self._follow, self._fit, self._more]
        return [self._go, self._cancel, *shown] if self._drives else shown

    def focus_target(self) -> QWidget:
        return self.view

    def sizeHint(self) -> QSize:
        return QSize(420, 300)

    def minimumSizeHint(self) -> QSize:
        return QSize(240, 96)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._place_tools()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if (
            event.key() == Qt.Key.Key_G
            and not event.modifiers()
            and self._may_go
            and not self._tools["goal"].isHidden()
        ):
            self._take_tool("look" if self.view.tool == "goal" else "goal")
            return
        super().keyPressEvent(event)

    def _place_tools(self) -> None:
        """Down the left edge, or along it where the panel is low."""
        left, top = 8, 8
        upright = self.height() >= 34 * len(self._tools) + 12
        for button in self._tools.values():
            if button.isHidden():
                continue
            size = button.sizeHint()
            button.setGeometry(left, top, size.width(), size.height())
            left, top = (left, top + 34) if upright else (left + size.width() + 4, top)
        self.view.left_px = 44 if upright and self._tools else 0

    # ---- menus

    def _go_to(self, place: str) -> None:
        self.console.do(intents.GoToPlace(place))

    def _open_go_menu(self) -> None:
        menu = self._go_menu
        menu.clear()
        if self._goal_speed():
            menu.addSection(self._goal_speed())
        for number, place in enumerate(self.state.places.value, start=1):
            action = menu.addAction(f"{place.name}\t{self.table.key_text(f'place_{number}')}".rstrip("\t"))
            action.triggered.connect(lambda _checked=False, name=place.name: self._go_to(name))
        menu.popup(self._go.mapToGlobal(QPoint(0, self._go.height() + 4)))

    def _open_menu(self) -> None:
        self.fill_menu()
        self._menu.popup(self._more.mapToGlobal(QPoint(0, self._more.height() + 4)))

    def fill_menu(self) -> QMenu:
        """The menu as it is now: view, trail, places, and what the robot's mapping offers."""
        menu, view = self._menu, self.view
        menu.clear()
        rotate = menu.addAction("Turn with the robot\tR")
        rotate.setCheckable(True)
        rotate.setChecked(view.rotate)
        rotate.toggled.connect(view.set_rotate)
        menu.addAction("Closer\t+").triggered.connect(lambda _checked=False: view.zoom(1.25))
        menu.addAction("Farther\t−").triggered.connect(lambda _checked=False: view.zoom(0.8))
        menu.addSeparator()
        trail = menu.addAction("Show where it has driven")
        trail.setCheckable(True)
        trail.setChecked(view.show_trail)
        trail.toggled.connect(view.set_trail_shown)
        clear = menu.addAction("Forget where it has driven")
        clear.setEnabled(len(view.trail) > 0)
        clear.triggered.connect(lambda _checked=False: view.clear_trail())
        if not self._may_go:
            return menu
        menu.addSeparator()
        here = menu.addAction("Add a place where the robot is…")
        here.setEnabled(self._pose_now() is not None)
        here.triggered.connect(lambda _checked=False: self._name_robot_place())
        mapping: MapStatus = self.state.mapping.value
        if mapping.can_save or mapping.can_load or mapping.can_switch:
            menu.addSeparator()
        if mapping.can_save:
            save = menu.addAction("Save map…")
            save.setEnabled(not mapping.busy)
            save.triggered.connect(lambda _checked=False: self._ask_map_name("save_map"))
        if mapping.can_load:
            load = menu.addAction("Load map…")
            load.setEnabled(not mapping.busy)
            load.triggered.connect(lambda _checked=False: self._ask_map_name("load_map"))
        if mapping.can_switch:
            for building, text in ((True, "Build the map on"), (False, "Only find the place in it")):
                action = menu.addAction(text)
                action.setCheckable(True)
                action.setChecked(mapping.mapping is building)
                action.setEnabled(not mapping.busy)
                action.triggered.connect(self._mapping_setter(mapping=building))
        return menu

    def _go_to_point(self, target: Pose2D) -> None:
        self.console.do(intents.GoToPoint(target))

    def _mapping_setter(self, *, mapping: bool) -> Callable[[], None]:
        def set_mapping() -> None:
            self.console.do(intents.SetMapping(mapping))

        return set_mapping

    def _on_fit_clicked(self) -> None:
        self._follow.setChecked(False)
        self.view.fit()

    def _on_rotate_changed(self, rotate: bool) -> None:
        self._refresh()

    # ---- what the wizard says on the map

    def _take_tool(self, tool: Tool, *, at: QPointF | None = None) -> None:
        self._moving = None
        self._card.hide()
        self._name.hide()
        if tool != "look" and self._refuse_place():
            tool = "look"
        self.view.set_tool(tool, at=at)
        self.view.setFocus(Qt.FocusReason.OtherFocusReason)
        self._on_tool_changed(self.view.tool)

    def _on_tool_changed(self, tool: str) -> None:
        for name, button in self._tools.items():
            button.setChecked(name == tool)
        if tool == "look":
            self.view.show_hint("")
        elif self.view.aim is not None and self.view.aim.anchored:
            self.view.show_hint(f"Click where it should look from there · {_GIVE_UP}")
        elif self._moving is not None:
            self.view.show_hint(f"Press where {self._moving} is now, drag to where to look · {_GIVE_UP}")
        else:
            self.view.show_hint(_HINTS[self.view.tool])

    def _on_escape(self) -> None:
        self._moving = None
        self.view.give_up()
        for card in (self._card, self._undo):
            card.hide()
        if not self._name.isHidden():
            self._name.hide()
            self.view.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_place_clicked(self, name: str, where: QPointF) -> None:
        if not self._may_go:
            return
        choices = [
            ("map_place_move", "Move", "arrows-out-cardinal", lambda: self._begin_moving(name)),
            ("map_place_remove", "Remove", "trash", lambda: self._remove(name)),
        ]
        if self._can_navigate():
            go = (f"go_to_{name}", f"Go to {name}", "navigation-arrow", lambda: self._go_to(name))
            self._card.offer(where, self._goal_speed(), [go, *choices])
        else:
            self._card.offer(where, name, choices, per_row=2)

    def _goal_speed(self) -> str:
        """How fast a goal is driven to; said before one is chosen."""
        text, _as_drive_says = words.goal_speed(self.state.robot.value, self.state.drive.value)
        return text[:1].upper() + text[1:]

    def _on_ground_clicked(self, at: QPointF, where: QPointF) -> None:
        if not self._may_go or self._refuse_place():
            return
        if not self._card.isHidden():
            self._card.hide()
            return
        refusal = self.view.grid.refusal_at(at)
        pose = self._pose_now()
        line = refusal
        if not refusal and pose is not None:
            speed, _as_drive_says = words.goal_speed(self.state.robot.value, self.state.drive.value)
            away = f"{math.dist((at.x(), at.y()), (pose.x_m, pose.y_m)):.1f} m from the robot"
            line = " · ".join(part for part in (away, speed if self._can_navigate() else "") if part)
            if self.state.map.value is not None and self.view.grid.value_at(at) is None:
                line += ", not on the map yet"
        choices = []
        if not refusal:
            target = Pose2D(at.x(), at.y(), self.view.heading_towards(at))
            if self._can_navigate():
                choices.append(("map_go_here", "Go here", "navigation-arrow", lambda: self._go_to_point(target)))
                choices.append(
                    ("map_go_heading", "Choose heading", "compass", lambda: self._take_tool("goal", at=at))
                )  # fmt: skip
            choices.append(("map_add_place", "Add place", "flag", lambda: self._take_tool("place", at=at)))
            if self._can_set_pose():
                choices.append(("map_robot_here", "Robot is here", "map-pin", lambda: self._take_tool("pose", at=at)))
        self._card.offer(where, line, choices, per_row=2 if self._can_navigate() else 1)
        self.view.show_mark(at)

    def _on_card_closed(self) -> None:
        self.view.show_mark(None)

    def _on_aimed(self, tool: str, pose: Pose2D, headed: bool) -> None:
        moving, self._moving = self._moving, None
        match tool:
            case "goal":
                self.console.do(intents.GoToPoint(pose))
            case "pose":
                self.console.do(intents.SetInitialPose(pose))
                self._ended = (f"The robot was told that it is here{'' if headed else ' (heading as before)'}", "hint",
                               time.monotonic() + GOAL_ENDED_SHOWN_S)  # fmt: skip
            case "place" if moving is not None:
                old = next((place for place in self.state.places.value if place.name == moving), None)
                if old is not None and not headed:
                    pose = Pose2D(pose.x_m, pose.y_m, old.pose_in_map.heading_rad)
                self.console.do(intents.SavePlace(moving, pose))
            case "place":
                self._ask_place_name(pose)
        self._refresh()

    def _begin_moving(self, name: str) -> None:
        self._take_tool("place")
        self._moving = name
        self._on_tool_changed("place")

    def _remove(self, name: str) -> None:
        self._removed = next((place for place in self.state.places.value if place.name == name), None)
        self.console.do(intents.RemovePlace(name))
        middle = QPointF(self.view.width() / 2, self.view.height())
        self._undo.offer(
            middle, f"{name} was removed", [("map_undo_button", "Put back", "arrow-u-up-left", self._put_back)]
        )
        self._undo_ends.start()

    def _put_back(self) -> None:
        if self._removed is not None:
            self.console.do(intents.SavePlace(self._removed.name, self._removed.pose_in_map))
            self._removed = None

    def _name_robot_place(self) -> None:
        pose = self._pose_now()
        if pose is not None:
            self._ask_place_name(pose)

    def _ask_place_name(self, pose: Pose2D, line: str = "What is the place called?", text: str = "") -> None:
        self._naming = ("place", pose)
        self._name.ask(self.view.to_view(pose.x_m, pose.y_m), line, verb="Add", text=text)

    def _ask_map_name(self, operation: str) -> None:
        self._naming = (operation, None)
        saving = operation == "save_map"
        line = "Save the robot's map under which name?" if saving else "Load which saved map of the robot?"
        middle = QPointF(self.view.width() / 2, self.view.height() / 3)
        self._name.ask(middle, line, verb="Save" if saving else "Load")

    def _on_named(self, name: str) -> None:
        what, pose = self._naming
        if what == "place" and pose is not None:
            taken = {place.name.casefold() for place in self.state.places.value}
            if name.casefold() in taken:
                self._ask_place_name(pose, f"{name} is on the map already: another name?", name)
                return
            self.console.do(intents.SavePlace(name, pose))
        elif what == "save_map":
            self.console.do(intents.SaveMap(name))
        elif what == "load_map":
            self.console.do(intents.LoadMap(name))
        self.view.setFocus(Qt.FocusReason.OtherFocusReason)

    # ---- what the console tells

    def _pose_now(self) -> Pose2D | None:
        pose: RobotPose | None = self.state.pose.value
        return None if pose is None else pose.pose_in_map

    @property
    def _may_go(self) -> bool:
        """Never in a replay, whose table has no marks to set either."""
        return self._drives and self.table.spec("mark") is not None

    def _on_table_rebuilt(self) -> None:
        self._on_robot_changed(self.state.robot.value)

    def _can_navigate(self) -> bool:
        robot: RobotProfile | None = self.state.robot.value
        return robot is None or robot.navigation is not None

    def _can_set_pose(self) -> bool:
        robot: RobotProfile | None = self.state.robot.value
        return robot is not None and robot.initial_pose is not None

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        self.view.show_robot(robot.footprint_outline_m if robot is not None else ())
        if self._tools:
            self._tools["goal"].setVisible(self._may_go and self._can_navigate())
            self._tools["place"].setVisible(self._may_go)
            self._tools["pose"].setVisible(self._may_go and self._can_set_pose())
            self._place_tools()
        self._on_goal_changed(self.state.goal.value)

    def _on_places_changed(self, places: tuple[Place, ...]) -> None:
        self.view.show_places(() if self._by_odometry else places)
        self._on_goal_changed(self.state.goal.value)

    def _on_map_changed(self, grid: OccupancyGrid) -> None:
        self._draw_by_odometry(False)
        if self.in_view:
            self.view.show_map(grid)

    def _on_scan_changed(self, scan: LaserScan) -> None:
        if self.in_view:
            self.view.show_scan(scan)

    def _on_pose_changed(self, pose: RobotPose) -> None:
        self._draw_by_odometry(False)
        self._show_pose(pose)

    def _show_pose(self, pose: RobotPose) -> None:
        if self.in_view:
            self.view.show_pose(pose)
        else:
            self.view.trail.add(pose.pose_in_map)

    def _on_odometry_changed(self, odometry: Odometry) -> None:
        if self.state.pose.value is not None or self.state.map.value is not None:
            self._odometry_since_ns = None
            return
        if self._odometry_since_ns is None:
            self._odometry_since_ns = odometry.stamp_ns
        if odometry.stamp_ns - self._odometry_since_ns >= _PLACE_AWAITED_NS:
            self._draw_by_odometry(True)
        if self._by_odometry:
            self._show_pose(RobotPose(odometry.stamp_ns, odometry.robot_stamp_ns, odometry.pose_in_odom))

    def _draw_by_odometry(self, by_odometry: bool) -> None:
        """What is drawn in one frame of reference has no place in the other."""
        if by_odometry == self._by_odometry:
            return
        self._by_odometry = by_odometry
        self._odometry_since_ns = None if not by_odometry else self._odometry_since_ns
        self.view.show_pose(None)
        self.view.show_scan(None)
        self.view.clear_trail()
        self.view.set_follow(by_odometry)
        if not by_odometry:
            self.view.fit()
        self._on_places_changed(self.state.places.value)
        self._on_freshness_changed()

    def _refuse_place(self) -> bool:
        """A point of what odometry drew is none that the robot could be sent to."""
        if self._by_odometry:
            self._ended = ("Goals and places need a map", "warning", time.monotonic() + _NO_PLACE_SHOWN_S)
            self._refresh()
        return self._by_odometry

    def _on_path_changed(self, _path: PlannedPath | None = None) -> None:
        if not self.in_view:
            return
        goal: GoalChanged | None = self.state.goal.value
        path: PlannedPath | None = self.state.path.value
        under_way = goal is not None and goal.state in words.UNDER_WAY
        # The path of an earlier goal stays latched; what is newer than the present goal belongs to it.
        belongs = path is not None and under_way and path.stamp_ns >= self._goal_since_ns - _PATH_BEFORE_GOAL_NS
        self.view.show_path(path.points_in_map if belongs and path is not None else None)

    def _on_people_changed(self, _value: object = None) -> None:
        if not self.in_view:
            return
        people: PeopleInMap | None = self.state.people_in_map.value
        rows = {person.person_id: person for person in self.state.persons.value}
        shown = []
        for person in people.people if people is not None else ():
            row = rows.get(person.person_id)
            name = words.person_name(row) if row is not None else "Person"
            shown.append((person, name, row is not None and words.has_given_name(row)))
        self.view.show_people(tuple(shown), self.state.people_in_map.freshness)

    def _on_goal_changed(self, goal: GoalChanged | None) -> None:
        going = goal is not None and goal.state in words.UNDER_WAY
        if goal is not None and goal.goal_id != self._goal_id:
            self._goal_id, self._goal_since_ns = goal.goal_id, goal.stamp_ns
        if not self.in_view:
            return
        self.view.show_goal(goal if going else None)
        self._on_path_changed()
        show_part(self._cancel, going and self._may_go)
        show_part(self._go, self._may_go and not going and bool(self.state.places.value) and self._can_navigate())
        self._refresh()

    def _on_event(self, event: object) -> None:
        if isinstance(event, GoalChanged) and event.state not in words.UNDER_WAY:
            told = words.event_sentence(event, str)
            role = {"reached": "good", "failed": "bad"}.get(event.state, "hint")
            if told is not None:
                self._ended = (told[1], role, time.monotonic() + GOAL_ENDED_SHOWN_S)
            self._refresh()

    def _on_mapping_changed(self, _mapping: MapStatus) -> None:
        self._refresh()

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if not self.in_view:
            return
        self.view.show_guard(drive.guard, drive.guard_distance_m)

    def _on_link_changed(self, _link: LinkStatus) -> None:
        self._refresh()

    def _on_freshness_changed(self, _freshness: str = "") -> None:
        if not self.in_view:
            return
        state = self.state
        if state.map.freshness == "none":
            self.view.show_map(None)
        if self._by_odometry and state.odometry.freshness == "none":
            self._draw_by_odometry(False)
        if state.pose.freshness == "none" and not self._by_odometry:
            self.view.show_pose(None)
        if state.scan.freshness == "none":
            self.view.show_scan(None)
        pose = state.odometry if self._by_odometry else state.pose
        self.view.show_freshness(pose=pose.freshness, scan=state.scan.freshness)
        self._on_people_changed()
        self._on_path_changed()
        self._refresh()

    def _aging_layers(self) -> tuple[tuple[str, LiveStream], ...]:
        state = self.state
        position = state.odometry if self._by_odometry else state.pose
        return (("LIDAR", state.scan), ("Position", position), ("People", state.people_in_map))

    def _chips(self) -> list[tuple[str, str]]:
        """What the map must say besides what it draws: ages of what is stale, how the last goal ended."""
        state = self.state
        chips = [
            (f"{name} {words.age(stream.age_s() or 0.0)} old", "warning")
            for name, stream in self._aging_layers()
            if stream.freshness in ("stale", "lost")
        ]
        if self._by_odometry:
            chips.append(("No map: drawn by odometry", "hint"))
        if state.mapping.value.busy:
            chips.append((_BUSY.get(state.mapping.value.busy, "The robot works on its map…"), "hint"))
        if time.monotonic() < self._ended[2] and not self._cancel.isVisibleTo(self):
            chips.append(self._ended[:2])
        return chips

    def _refresh(self) -> None:
        if not self.in_view:
            return
        state = self.state
        self.view.show_chips(self._chips())
        reachable = state.link.value.state in ("connected", "trouble")
        waiting = "Waiting for the map" if reachable else "No map: the robot is out of reach"
        if not state.present.live:
            waiting = "No map was recorded until this moment"
        self.view.show_waiting("" if self._by_odometry else waiting)
        scan_age_s = state.scan.age_s()
        match state.scan.freshness:
            case "fresh":
                text, role = f"LIDAR {words.age(scan_age_s or 0.0)}", "dim"
            case "stale" | "lost":
                text, role = f"LIDAR silent for {words.age(scan_age_s or 0.0)}", "amber"
            case _:
                text, role = "no LIDAR yet" if state.present.live else "no LIDAR", "dim"
        goal: GoalChanged | None = state.goal.value
        if goal is not None and goal.state in words.UNDER_WAY:
            left = f" · {goal.distance_left_m:.1f} m left" if goal.distance_left_m is not None else ""
            text, role = f"going to {goal.place or 'a point'}{left}", "green"
        elif self.view.follow:
            text += " · follows robot"
        elif state.mapping.value.mapping:
            text += " · building the map"
        self.set_fact(text, role)
