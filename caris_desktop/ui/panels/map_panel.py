"""Map panel: floor plan, LIDAR, people, places, goal and robot pose."""

import html
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from PySide6.QtCore import QPoint, QRect, QSize, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QLabel, QMenu, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.sensing import OccupancyGrid, Odometry, PeopleInMap, PlannedPath, RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import DriveStatus, MapStatus
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import PanelSettings, Place
from caris_desktop.ui import event_messages, layouts, text_formatting, tokens
from caris_desktop.ui.map.map_state import Layer, legend
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.people.shown_people import as_permitted
from caris_desktop.ui.robot_motion import nearest_words
from caris_desktop.ui.widgets.accessible_descriptions import (
    TOLD_EVERY_MS,
    ThrottledAccessibleDescription,
    sentences,
    warnings_in,
)
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.labels import named

GOAL_ENDED_SHOWN_S = 8.0
_PATH_BEFORE_GOAL_NS = 500_000_000  # the goal event may follow its first path
# A localised robot reports its map pose soon after its odometry.
_PLACE_AWAITED_NS = 3_000_000_000
_LOW_PX = 200
"""Height below which the buttons are beside the map instead of below it, without a legend."""

_LAYERS: dict[Layer, str] = {
    "lidar": QT_TR_NOOP("Show LIDAR"), "people": QT_TR_NOOP("Show people"), "places": QT_TR_NOOP("Show places"),
    "trail": QT_TR_NOOP("Show the driven path"),
}  # fmt: skip
_BUSY = {
    "save": QT_TR_NOOP("Saving the map…"), "load": QT_TR_NOOP("Loading the map…"),
    "start_mapping": QT_TR_NOOP("Switching to mapping…"),
    "start_localization": QT_TR_NOOP("Switching to localisation only…"),
}  # fmt: skip
_WORKS = QT_TR_NOOP("The robot is working on its map…")


class MapPanel(Panel):
    """Map view with a menu of places, the current goal and the placing tools.

    Without a map the robot is drawn in the odometry frame; goals and places need a map.
    """

    title = QT_TR_NOOP("Map")
    preferred_size, least_size = QSize(420, 300), QSize(240, 96)
    reads = ("permissions.driving",)
    drives = True

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("map_panel")
        self._ended = ("", "", 0.0)
        self._goal_id, self._goal_since_ns = "", 0
        self._odometry_since_ns: int | None = None
        self._follows_on_map = False  # in the odometry frame the view always follows the robot
        # The panel manager imports pyqtgraph in the background before.
        from caris_desktop.ui.map.map_tools import MapTools
        from caris_desktop.ui.map.map_view import MapView

        self.view = named(MapView(self.theme, self, self.state.places.value), "map_view")
        self._description = ThrottledAccessibleDescription(self.view, self._accessible_text, every_ms=TOLD_EVERY_MS)
        self.tools = MapTools(self, self.view)
        self.tools.reported.connect(self._on_reported)
        self.tools.changed.connect(self._refresh)
        self._go_menu = named(QMenu(self), "map_go_menu")
        button = partial(ActionButton, self.theme, height_px=30, may_lose_words=True)
        self._go = button(tr("Go to"), icon="navigation-arrow", menu_arrow=True, objectName="map_go_button")
        self._go.setToolTip(tr("Send the robot to a place"))
        self._go.clicked.connect(self._open_go_menu)
        self._cancel = button(tr("Cancel"), icon="x", objectName="goal_cancel", toolTip=tr("Cancel this goal"))
        self._cancel.clicked.connect(lambda: self.console.do(intents.CancelGoal()))
        self._legend: list[QLabel] = []
        self._menu = named(QMenu(self), "map_menu")
        self._more = button(icon="dots-three-vertical", objectName="map_menu_button", toolTip=tr("Map tools and view"))
        self._more.clicked.connect(self._open_menu)
        self._below = FlowRow()
        layouts.vbox(self, (self.view, 1), self._below, margins_px=(8, 6, 8, 8), spacing_px=6)
        self._confirm = ActionButton(self.theme, tr("Confirm position"), icon="check", role="primary", height_px=32)
        self._confirm.setObjectName("map_confirm")
        self._confirm.setToolTip(tr("The robot is where the map shows it"))
        self._confirm.setParent(self.view)
        self._confirm.clicked.connect(lambda: self.console.do(intents.ConfirmAsBefore("map")))
        self._confirm.hide()
        view = self.view
        view.follow_changed.connect(self._refresh)
        view.rotate_changed.connect(self._refresh)
        view.refreshed.connect(self._show_legend)
        self.theme.changed.connect(self._show_legend)
        view.follow_changed.connect(self.report_choices)
        view.rotate_changed.connect(self.report_choices)
        self._listen()
        self.every(250, self._refresh)

    def _listen(self) -> None:
        state = self.state
        state.map.changed.connect(self._on_map_changed)
        state.pose.changed.connect(self._on_pose_changed)
        state.odometry.changed.connect(self._on_odometry_changed)
        state.goal.changed.connect(self._on_goal_changed)
        self.table.rebuilt.connect(self._on_robot_changed)
        state.places.changed.connect(self._on_places_changed)
        state.robot.changed.connect(self._on_robot_changed)
        state.event_happened.connect(self._on_event)
        self.watch(self.view.show_scan, state.scan.changed)
        self.watch(self._on_path_changed, state.path.changed)
        people = (state.people_in_map.changed, state.persons.changed, state.selected_person.changed)
        self.watch(self._on_people_changed, *people)
        self.watch(self._refresh, state.mapping.changed, state.link.changed)
        self.watch(self._on_drive_changed, state.drive.changed)
        self.watch(self._show_unconfirmed, state.going_on.changed)
        streams = (state.map, state.pose, state.scan, state.people_in_map, state.path, state.odometry)
        self.watch(self._on_freshness_changed, *(stream.freshness_changed for stream in streams))
        self.update_view()

    def update_view(self) -> None:
        state, view = self.state, self.view
        if state.map.value is not None:
            view.show_map(state.map.value)
        if state.pose.value is not None:
            view.show_pose(state.pose.value)
        if state.scan.value is not None:
            view.show_scan(state.scan.value)
        self._on_robot_changed()
        self._on_places_changed(state.places.value)
        self._on_drive_changed(state.drive.value)
        self._on_people_changed()
        self._on_goal_changed(state.goal.value)
        self._show_unconfirmed()
        self._on_freshness_changed()

    def show_scenario(self) -> None:
        self._on_people_changed()

    def use_settings(self, settings: PanelSettings) -> None:
        map_settings, view = settings.map, self.view
        self._set_follow(map_settings.follow)
        view.set_rotate(map_settings.up == "robot")
        view.show_layer("trail", map_settings.trail)

    def _show_unconfirmed(self, _status: object = None) -> None:
        """Mark the pose as unconfirmed after a crash: the robot may have been moved."""
        unconfirmed = "map" in self.state.going_on.value.unconfirmed
        self.view.update_state(unconfirmed=unconfirmed)
        show_part(self._confirm, unconfirmed)
        self._place_confirm()
        self._refresh()

    def _place_confirm(self) -> None:
        size = self._confirm.sizeHint()
        # The other corner has the scale.
        at = QPoint(8, self.view.height() - size.height() - 8)
        self._confirm.setGeometry(QRect(at, size))

    def title_widgets(self) -> list[QWidget]:
        return [self._go, self._cancel, self._more]

    def _show_legend(self) -> None:
        """Show what the colours mean, where the panel is high enough."""
        entries = legend(self.view.map_state, has_grid=self.view.grid.newest is not None)
        if self.height() < _LOW_PX:
            entries = []
        line = self.theme.color("line_strong").name()
        texts = []
        for role, symbol, word in entries:
            color = self.theme.color(role).name()
            look = f"color:{line}; background:{color}" if role == "map_unknown" else f"color:{color}"
            texts.append(
                f'<span style="font-size:{tokens.STATUS_PX - 1}px"><span style="{look}">{symbol}</span>&nbsp;'
                f"{html.escape(word)}</span>"
            )
        while len(self._legend) < len(texts):
            label = named(QLabel(self._below, textFormat=Qt.TextFormat.RichText), "map_legend")
            self._legend.append(label)
            self._below.add(label)
        for number, label in enumerate(self._legend):
            label.setVisible(number < len(texts))
            if number < len(texts) and label.text() != texts[number]:
                label.setText(texts[number])
                label.setAccessibleName(entries[number][2])

    def focus_target(self) -> QWidget:
        return self.view

    def fit(self) -> None:
        self._show_legend()
        self._place_confirm()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_G and not event.modifiers() and self.tools.toggle_goal():
            return
        super().keyPressEvent(event)

    # ---- menus

    def choices(self) -> dict[str, Any]:
        map_state = self.view.map_state
        follow = self._follows_on_map if self.tools.by_odometry else self.view.follow
        return {"follow": follow, "rotate": map_state.rotate, "trail": "trail" not in map_state.hidden}

    def use_choices(self, stored: Mapping[str, Any]) -> None:
        view = self.view
        show_trail = partial(view.show_layer, "trail")
        for name, use in (("rotate", view.set_rotate), ("follow", self._set_follow), ("trail", show_trail)):
            if isinstance(stored.get(name), bool):
                use(stored[name])

    def _set_follow(self, follow: bool) -> None:
        followed, self._follows_on_map = self.view.follow, follow
        if self.tools.by_odometry:
            return
        self.view.set_follow(follow)
        if followed and not follow:
            self.view.fit()

    def _open_go_menu(self) -> None:
        menu = self._go_menu
        menu.clear()
        if self.tools.goal_speed():
            menu.addSection(self.tools.goal_speed())
        for number, place in enumerate(self.state.places.value, start=1):
            action = menu.addAction(
                f"{text_formatting.in_menu(place.name)}\t{self.table.key_text(f'place_{number}')}".rstrip("\t")
            )
            action.triggered.connect(lambda _checked=False, name=place.name: self.tools.go_to(name))
        menu.popup(self._go.mapToGlobal(QPoint(0, self._go.height() + 4)))

    def _open_menu(self) -> None:
        self.fill_menu()
        self._menu.popup(self._more.mapToGlobal(QPoint(0, self._more.height() + 4)))

    def fill_menu(self) -> QMenu:
        """Fill the menu: tools, view, layers, places, mapping."""
        from caris_desktop.ui.map.map_tools import add_action

        menu, view, hidden = self._menu, self.view, self.view.map_state.hidden
        add = partial(add_action, menu)
        menu.clear()
        self.tools.fill_menu(menu)
        menu.addSeparator()
        follow, rotate = view.follow, view.map_state.rotate
        add("map_follow", tr("Follow the robot"), partial(view.set_follow, not follow), key="F", checked=follow)
        add("map_rotate", tr("Rotate with the robot"), partial(view.set_rotate, not rotate), key="R", checked=rotate)
        add("map_fit", tr("Show the whole map"), self._on_fit_chosen, key="Home")
        add("map_zoom_in", tr("Zoom in"), partial(view.zoom, 1.25), key="+")
        add("map_zoom_out", tr("Zoom out"), partial(view.zoom, 0.8), key="−")
        menu.addSeparator()
        for layer, text in _LAYERS.items():
            add(f"map_layer_{layer}", tr(text), partial(self._toggle_layer, layer), checked=layer not in hidden)
        add("map_clear_trail", tr("Clear the driven path"), view.clear_trail, enabled=len(view.map_state.trail) > 0)
        if not self.tools.may_go:
            return menu
        menu.addSeparator()
        here = tr("Add a place at the robot's position…")
        add("map_add_here", here, self.tools.name_robot_place, enabled=self.tools.pose_now() is not None)
        mapping: MapStatus = self.state.mapping.value
        add = partial(add, enabled=not mapping.busy)
        menu.addSeparator()
        if mapping.can_save:
            add("map_save", tr("Save map…"), partial(self.tools.ask_map_name, "save_map"))
        if mapping.can_load:
            add("map_load", tr("Load map…"), partial(self.tools.ask_map_name, "load_map"))
        if mapping.can_switch:
            for build, text in ((True, tr("Extend the map")), (False, tr("Localise only"))):
                use = partial(self.console.do, intents.SetMapping(build))
                add("map_extend" if build else "map_localise", text, use, checked=mapping.mapping is build)
        return menu

    def _toggle_layer(self, layer: Layer) -> None:
        self.view.show_layer(layer, layer in self.view.map_state.hidden)
        self.report_choices()

    def _on_fit_chosen(self) -> None:
        self.view.set_follow(False)
        self.view.fit()

    # ---- state

    def _on_robot_changed(self, _robot: object = None) -> None:
        robot: RobotProfile | None = self.state.robot.value
        self.view.update_state(outline_m=robot.footprint_outline_m if robot is not None else ())
        self._on_goal_changed(self.state.goal.value)

    def _on_places_changed(self, places: tuple[Place, ...]) -> None:
        self.view.update_state(places=() if self.tools.by_odometry else places)
        self._on_goal_changed(self.state.goal.value)

    def _on_map_changed(self, grid: OccupancyGrid) -> None:
        self._draw_by_odometry(False)
        if self.in_view:
            self.view.show_map(grid)

    def _on_pose_changed(self, pose: RobotPose) -> None:
        self._draw_by_odometry(False)
        self._show_pose(pose)

    def _show_pose(self, pose: RobotPose) -> None:
        if self.in_view:
            self.view.show_pose(pose)
        else:
            self.view.map_state.trail.add(pose.pose_in_map)

    def _on_odometry_changed(self, odometry: Odometry) -> None:
        if self.state.pose.value is not None or self.state.map.value is not None:
            self._odometry_since_ns = None
            return
        if self._odometry_since_ns is None:
            self._odometry_since_ns = odometry.stamp_ns
        if odometry.stamp_ns - self._odometry_since_ns >= _PLACE_AWAITED_NS:
            self._draw_by_odometry(True)
        if self.tools.by_odometry:
            self._show_pose(RobotPose(odometry.stamp_ns, odometry.robot_stamp_ns, odometry.pose_in_odom))

    def _draw_by_odometry(self, by_odometry: bool) -> None:
        """Switch the frame of reference; items of the other frame are cleared."""
        if by_odometry == self.tools.by_odometry:
            return
        self.tools.by_odometry = by_odometry
        self._odometry_since_ns = None if not by_odometry else self._odometry_since_ns
        self.view.show_pose(None)
        self.view.show_scan(None)
        self.view.clear_trail()
        if by_odometry:
            self._follows_on_map = self.view.follow
        with self.preferences_blocked():
            self.view.set_follow(by_odometry or self._follows_on_map)
        if not self.view.follow:
            self.view.fit()
        self._on_places_changed(self.state.places.value)
        self._on_freshness_changed()

    def _on_path_changed(self, _path: PlannedPath | None = None) -> None:
        if not self.in_view:
            return
        goal: GoalChanged | None = self.state.goal.value
        path: PlannedPath | None = self.state.path.value
        under_way = goal is not None and goal.state in text_formatting.UNDER_WAY
        # The path of an earlier goal stays latched; only a newer path belongs to this goal.
        belongs = path is not None and under_way and path.stamp_ns >= self._goal_since_ns - _PATH_BEFORE_GOAL_NS
        points = path.points_in_map if belongs and path is not None else ()
        self.view.update_state(path_m=points if len(points) > 1 else None)

    def _on_people_changed(self, _value: object = None) -> None:
        if not self.in_view:
            return
        people: PeopleInMap | None = self.state.people_in_map.value
        naming = self.console.scenario.permissions.naming_people
        rows = {person.person_id: person for person in as_permitted(self.state.persons.value, naming=naming)}
        markers = []
        for person in people.people if people is not None else ():
            row = rows.get(person.person_id)
            name = text_formatting.person_name(row) if row is not None else tr("Person")
            markers.append((person, name, row is not None and text_formatting.has_given_name(row)))
        selected = self.state.selected_person.value
        freshness = self.state.people_in_map.freshness
        self.view.update_state(people=tuple(markers), people_freshness=freshness, selected=selected)

    def _on_goal_changed(self, goal: GoalChanged | None) -> None:
        going = goal is not None and goal.state in text_formatting.UNDER_WAY
        if goal is not None and goal.goal_id != self._goal_id:
            self._goal_id, self._goal_since_ns = goal.goal_id, goal.stamp_ns
        if not self.in_view:
            return
        self.view.update_state(goal=goal if going else None)
        self._on_path_changed()
        show_part(self._cancel, going and self.tools.may_go)
        show_part(
            self._go, self.tools.may_go and not going and bool(self.state.places.value) and self.tools.can_navigate()
        )
        self._refresh()

    def _on_reported(self, text: str, role: str, duration_s: float) -> None:
        self._ended = (text, role, time.monotonic() + duration_s)
        self._refresh()

    def _on_event(self, event: object) -> None:
        if isinstance(event, GoalChanged) and event.state not in text_formatting.UNDER_WAY:
            sentence = event_messages.event_sentence(event, str)
            role = {"reached": "good", "failed": "bad"}.get(event.state, "hint")
            if sentence is not None:
                self._ended = (sentence[1], role, time.monotonic() + GOAL_ENDED_SHOWN_S)
            self._refresh()

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        self.view.update_state(guard=(drive.guard, drive.guard_distance_m))

    def _on_freshness_changed(self, _freshness: str = "") -> None:
        if not self.in_view:
            return
        state = self.state
        if state.map.freshness == "none":
            self.view.show_map(None)
        if self.tools.by_odometry and state.odometry.freshness == "none":
            self._draw_by_odometry(False)
        if state.pose.freshness == "none" and not self.tools.by_odometry:
            self.view.show_pose(None)
        if state.scan.freshness == "none":
            self.view.show_scan(None)
        pose = state.odometry if self.tools.by_odometry else state.pose
        self.view.update_state(pose_freshness=pose.freshness, scan_freshness=state.scan.freshness)
        self._on_people_changed()
        self._on_path_changed()
        self._refresh()

    def _chips(self) -> list[tuple[str, str]]:
        """Map labels: ages of stale layers, and the outcome of the last goal."""
        state = self.state
        position = state.odometry if self.tools.by_odometry else state.pose
        layers = ((tr("LIDAR"), state.scan), (tr("Position"), position), (tr("People"), state.people_in_map))
        chips = [
            (tr("{layer} {age} old").format(layer=name, age=text_formatting.age(stream.age_s() or 0.0)), "warning")
            for name, stream in layers
            if stream.freshness in ("stale", "lost")
        ]
        if self.view.map_state.unconfirmed:
            chips.insert(0, (tr("Position not confirmed"), "warning"))
        if self.tools.by_odometry:
            chips.append((tr("No map: position from odometry"), "hint"))
        if state.mapping.value.busy:
            busy = _BUSY.get(state.mapping.value.busy, _WORKS)
            chips.append((tr(busy), "hint"))
        if time.monotonic() < self._ended[2] and not self._cancel.isVisibleTo(self):
            chips.append(self._ended[:2])
        return chips

    def _accessible_text(self) -> str:
        """Robot position and goal, nearest obstacle, people, places and warnings. Metres in the map."""
        scan = self.state.scan
        state, parts = self.view.map_state, list[str]()
        if state.pose is not None:
            # Rounded to half a metre: small changes are noise to a listener.
            at = {"x": round(state.pose.x_m * 2) / 2, "y": round(state.pose.y_m * 2) / 2}
            parts.append(tr("The robot is at {x:.1f} m, {y:.1f} m").format(**at))
        else:
            parts.append(tr("The robot's position is unknown"))
        if state.goal is not None:
            parts.append(tr("The robot is going to {place}").format(place=state.goal.place or tr("a point")))
        if scan.freshness == "fresh":
            parts.append(nearest_words(scan.value))
        if state.people:
            parts.append(tr("People: {names}").format(names=", ".join(name for _place, name, _named in state.people)))
        if state.places:
            parts.append(tr("Places: {names}").format(names=", ".join(place.name for place in state.places)))
        return sentences((*parts, *warnings_in(state.chips)))

    def _refresh(self) -> None:
        if not self.in_view:
            return
        state = self.state
        reachable = state.link.value.state in ("connected", "trouble")
        waiting = tr("Waiting for the map") if reachable else tr("No map")
        if not state.present.live:
            waiting = tr("No map recorded up to this moment")
        self.view.update_state(chips=self._chips(), waiting="" if self.tools.by_odometry else waiting)
        self._description.changed()
        text = ""  # the map has the age of an old scan
        if state.scan.freshness == "none" and (reachable or not state.present.live):
            text = tr("no LIDAR yet") if state.present.live else tr("no LIDAR")
        elif state.scan.freshness == "fresh" and not state.scan.age_known:
            text = tr("LIDAR {age}").format(age=text_formatting.stream_age(state.scan))
        # The picture or the status bar says where the robot goes; the map draws it, but not whether the robot agreed.
        goal: GoalChanged | None = state.goal.value
        if goal is not None and goal.state == "requested":
            text = tr("goal not accepted yet")
        elif self.view.follow:
            text = " · ".join(filter(None, (text, tr("following robot"))))
        elif state.mapping.value.mapping:
            text = " · ".join(filter(None, (text, tr("mapping"))))
        self.set_fact(text)
