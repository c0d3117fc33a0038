"""Robot service: link processes, goals, maps, head, and controls of the Robot panel. GUI thread. Driving is a separate
service.
"""

import asyncio
import logging
import math
import secrets
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from PySide6.QtCore import Qt, Signal

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, WIZARD, Actor
from caris_desktop.domain.control_definitions import ControlValue, RobotControl, decided
from caris_desktop.domain.control_effects import NO_NAMES
from caris_desktop.domain.events import (
    ANSWER,
    ControlUsed,
    Event,
    GoalChanged,
    LinkChanged,
    LinkQuality,
    MapOperation,
    MappingChanged,
    MapRequestChanged,
    ProblemEnd,
    RobotChosen,
    TrafficMeasured,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import UseRobot, UseSimulatedRobot
from caris_desktop.domain.link_commands import (
    CancelGoal,
    GoTo,
    ListenToRobot,
    OfferControls,
    PlayOnRobot,
    RequestMap,
    RobotCommand,
    SetEmergencyStop,
    SetInitialPose,
    UseControl,
)
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingToWrite
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.service import ContextService, Follows, Handlers, Restarts, ServiceContext
from caris_desktop.live.services.cameras_service import CameraSelection
from caris_desktop.live.services.drive_service import DriveService
from caris_desktop.live.services.people_service import PeopleService
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.status import ControlStatus, LinkStatus, MapStatus
from caris_desktop.robot.link import LinkSettings
from caris_desktop.robot.profile import profile_text
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile, interface_names
from caris_desktop.scenario.scenario_model import Place, Scenario

_log = logging.getLogger(__name__)
_RESTART_AFTER_MS = 1000
# A control link that had worked is restarted at once, since the robot may be moving; one that fails immediately waits.
_RESTART_AT_ONCE_AFTER_NS = 5_000_000_000
_SETTLE_AGAIN_S = 1.0
_MAP_WORDS: dict[MapOperation, str] = {
    "save": QT_TR_NOOP("The map was not saved."),
    "load": QT_TR_NOOP("The map was not loaded."),
    "start_mapping": QT_TR_NOOP("The robot did not start mapping."),
    "start_localization": QT_TR_NOOP("The robot did not stop mapping."),
}


class RobotConnection(Value):
    """Robot connection; the bodies are the link processes' entry points.

    ``settle`` is set while the ROS version is unknown: it queries the robot and returns the final connection, or raises
    UserFacingError without an answer.
    """

    name: str
    address: str
    profile: RobotProfile
    control: ProcessSpec
    media: ProcessSpec | None
    settle: Callable[[], Coroutine[Any, Any, "RobotConnection"]] | None = None


class RobotService(ContextService):
    """Runs the links and maintains ``state.link``, ``goal``, ``robot``, ``controls``, ``mapping`` and ``traffic``."""

    _settled = Signal(object, object)

    def __init__(
        self,
        context: ServiceContext,
        ring: FrameRing,
        *,
        new_child: Callable[[ProcessSpec], ChildProcess],
        before_goal: Callable[[], None],
        selected_cameras: Callable[[Scenario], CameraSelection],
        asyncio_thread: AsyncioThread,
    ) -> None:
        """``before_goal`` ends teleoperation."""
        super().__init__(context)
        self._ring = ring
        self._new_child = new_child
        self._publish, self._problem = context.bus.publish, context.bus.problem
        self._before_goal = before_goal
        self._cameras_of = selected_cameras
        self._cameras = CameraSelection()
        self._asyncio = asyncio_thread
        self._settling: Future[None] | None = None
        self._settled.connect(self._on_settled, Qt.ConnectionType.QueuedConnection)
        self.connection: RobotConnection | None = None
        self._chosen_by: Actor = WIZARD
        self._links: dict[str, ChildProcess] = {}
        self._scenario_controls: tuple[RobotControl, ...] = ()
        self._driving_permitted = True
        self._control_is_new = False
        self._control_since_ns = 0
        self._reported_no_timeout_of = ""
        self._left = False
        self._closed = False
        # Unlimited: a session needs its robot, which may stand where nobody can reach it.
        self._restarts = {name: Restarts(at_most=math.inf) for name in ("control", "media")}

    @property
    def links(self) -> dict[str, ChildProcess]:
        """Running link processes by name, ``control`` and ``media``."""
        return dict(self._links)

    def handlers(self) -> Handlers:
        return {
            intents.GoToPlace: lambda intent: self.go_to_place(intent.place, intent.actor),
            intents.GoToPoint: lambda intent: self.go_to(intent.target_in_map, intent.actor),
            intents.CancelGoal: lambda intent: self.cancel_goal(intent.actor),
            intents.SetInitialPose: lambda intent: self.set_initial_pose(intent.pose_in_map, intent.actor),
            intents.SaveMap: lambda intent: self.request_map("save", intent.name, intent.actor),
            intents.LoadMap: lambda intent: self.request_map("load", intent.name, intent.actor),
            intents.SetMapping: lambda intent: self.request_map(
                "start_mapping" if intent.mapping else "start_localization", actor=intent.actor
            ),
            intents.UseControl: lambda intent: self.use_control(intent.control, intent.value, intent.actor),
        }

    def follows(self) -> Follows:
        events = (
            LinkChanged, LinkQuality, GoalChanged, TrafficMeasured, MappingChanged, MapRequestChanged, ControlUsed,
        )  # fmt: skip
        return dict.fromkeys(events, self.on_event)

    def processes(self) -> dict[str, ChildProcess]:
        return self.links

    def restarts(self) -> dict[str, Restarts]:
        return self._restarts

    def use_scenario(self, scenario: Scenario) -> None:
        self._use_cameras(self._cameras_of(scenario))
        driving = scenario.permissions.driving
        if not driving:
            self.cancel_goal()
        self.offer_controls(scenario.controls, driving_permitted=driving)

    def state_events(self) -> list[Event]:
        """Initial events of a recording about this robot."""
        return [] if self.connection is None else [self._chosen(self.connection)]

    # Links

    def connect_robot(self, connection: RobotConnection, actor: Actor = WIZARD) -> None:
        """Connect a robot, leaving a former one stopped."""
        if self._closed:
            return
        self.leave_for(connection)()
        self._left = False
        self.connection = connection
        self._chosen_by = actor
        profile = self._profile(connection)
        if profile != self._state.robot.value:
            self._state.robot.set(profile)
            self._publish(self._chosen(connection))
        self._show_controls()
        if connection.settle is not None:
            self._settling = self._asyncio.submit(self._settle(connection, connection.settle))
            return
        self._start_link("control")
        self._start_link("media")

    def leave_for_one_that_starts(self) -> Callable[[], None] | None:
        """Like ``leave_for``, while another robot's program starts: an unresponsive robot is given up."""
        if self.connection is None or self._state.link.value.state == "connected":
            return None
        return self.leave_for(self.connection, starts=True)

    def leave_for(self, connection: RobotConnection, *, starts: bool = False) -> Callable[[], None]:
        """End the links to the current robot in favour of ``connection``, leaving it stopped.

        The returned function waits for their end, in any thread; until then they may still send values.
        """
        self._left = True
        ending = [self._links.pop(name) for name in ("control", "media") if name in self._links]
        for child in ending:
            child.ask_to_end()  # in parallel: it takes as long as the slower one
        if self._settling is not None:
            self._settling.cancel()
            self._settling = None
        self._state.clear_robot_streams()
        self._state.forget_cameras()
        self._state.map.clear()
        self._state.goal.set(None)
        self._state.mapping.set(MapStatus())
        self._state.control_states.set({})
        self._state.traffic.set({})
        self._reported_no_timeout_of = ""  # the alarm ends with the robot and returns with it
        self._state.link.set(
            LinkStatus(state="connecting", robot=connection.name, address=connection.address, starts=starts)
        )

        def wait() -> None:
            for child in ending:
                child.stop(grace_s=1.0)

        return wait

    async def _settle(
        self, connection: RobotConnection, settle: Callable[[], Coroutine[Any, Any, RobotConnection]]
    ) -> None:
        reported = False
        while True:
            try:
                settled = await settle()
            except UserFacingError as refusal:
                if not reported:
                    reported = True
                    self._problem("error", refusal.what, refusal.meaning, refusal.advice, until="connected")
                await asyncio.sleep(_SETTLE_AGAIN_S)
            except Exception:
                # Nothing awaits this task, so its failure would go unnoticed.
                _log.exception("the robot's ROS version could not be asked for")
                return
            else:
                self._settled.emit(connection, settled)
                return

    def _on_settled(self, requested: RobotConnection, settled: RobotConnection) -> None:
        if self.connection is requested and not (self._left or self._closed):
            self.connect_robot(settled, self._chosen_by)

    def stop(self) -> None:
        """Stop the robot first; blocks two seconds at most."""
        self._closed = True
        if self._settling is not None:
            self._settling.cancel()
        control = self._links.pop("control", None)
        if control is not None:
            control.stop(grace_s=2.0)
        media = self._links.pop("media", None)
        if media is not None:
            media.stop(grace_s=1.5)

    def send(self, command: RobotCommand) -> bool:
        """Send to the control link without waiting; False if impossible."""
        control = self._links.get("control")
        return control is not None and control.send(command)

    def send_sound(self, command: ListenToRobot | PlayOnRobot) -> bool:
        """Send to the media link without waiting; False if impossible."""
        media = self._links.get("media")
        return media is not None and media.send(command)

    def on_child_ended(self, child: ChildProcess) -> None:
        """Restart a link that exited; the other one continues."""
        name = child.body.name
        if self._closed or self._links.get(name) is not child:
            return  # replaced while its exit was being reported
        del self._links[name]
        address = self.connection.address if self.connection is not None else ""
        goal = self._state.goal.value
        if name == "control" and goal is not None and goal.state in ("requested", "active"):
            # Nothing else reports its end.
            reason = QT_TR_NOOP("the connection process stopped; the goal is cancelled when the connection is back")
            self._publish(replace(goal, stamp_ns=clock.now_ns(), state="failed", detail=reason, actor=CONSOLE))
        self._publish(LinkChanged(clock.now_ns(), name, "lost", address, QT_TR_NOOP("the connection process stopped")))
        worked = name == "control" and clock.now_ns() - self._control_since_ns > _RESTART_AT_ONCE_AFTER_NS
        self._restarts[name].after_end(
            lambda _advice: self._report_ended(name),
            lambda: self._restart_link(name),
            after_ms=0 if worked else _RESTART_AFTER_MS,
            within=self,
        )

    def _report_ended(self, name: str) -> None:
        self._problem(
            "warning",
            tr("The connection to the robot failed inside the console.")
            if name == "control"
            else tr("The connection for the robot's video and map failed inside the console."),
            tr("The robot cannot be driven until the connection is back.")
            if name == "control"
            else tr("Driving continues without video and map."),
            tr("The console reconnects automatically; press the key again to drive.")
            if name == "control"
            else tr("The console reconnects automatically."),
            until="connected" if name == "control" else "picture",
        )

    def _start_link(self, name: str, *, follows_crash: bool = False) -> None:
        connection = self.connection
        if connection is None:
            return
        if name == "control":
            control = connection.control
            settings = (
                replace(each, follows_crash=follows_crash) if isinstance(each, LinkSettings) else each
                for each in control.arguments
            )
            body = replace(control, arguments=tuple(settings))
        elif connection.media is not None:
            settings = (
                replace(each, profile=self._profile(connection)) if isinstance(each, LinkSettings) else each
                for each in connection.media.arguments
            )
            body = replace(connection.media, arguments=(*settings, RingToWrite(self._ring.name)))
        else:
            return
        self._links[name] = self._new_child(body)
        if name == "control":
            self._control_is_new = True
            self._control_since_ns = clock.now_ns()

    def _restart_link(self, name: str) -> None:
        if not (self._left or self._closed) and name not in self._links:
            self._start_link(name, follows_crash=True)

    def _profile(self, connection: RobotConnection) -> RobotProfile:
        """Profile with the requested cameras only: others are not subscribed."""
        return replace(connection.profile, cameras=self._cameras.among(connection.profile.cameras))

    def _use_cameras(self, cameras: CameraSelection) -> None:
        self._cameras = cameras
        connection = self.connection
        if connection is None or self._profile(connection) == self._state.robot.value:
            return
        before = self._state.robot.value.cameras
        self._state.robot.set(self._profile(connection))
        self._forget_cameras(before)
        media = self._links.pop("media", None)
        if media is None:
            return

        def ended(_ended: None) -> None:
            self._forget_cameras(before)  # which its last frames may have brought back
            self._restart_link("media")

        media.ask_to_end()
        self._slow_work.do(lambda: media.stop(grace_s=1.0), ended, self._bus.answer)

    def _forget_cameras(self, cameras: tuple[CameraTopic, ...]) -> None:
        for camera in cameras:
            self._state.forget_camera(camera.name)

    # Robot messages

    def on_event(self, event: Any) -> None:
        """Handle an event before the panels do."""
        if isinstance(event, LinkChanged):
            self._on_link_changed(event)
        elif isinstance(event, LinkQuality):
            self._state.link.update(
                round_trip_ms=event.round_trip_ms,
                clock_offset_ms=event.clock_offset_ms,
                clock_uncertainty_ms=event.clock_uncertainty_ms,
            )
        elif isinstance(event, GoalChanged):
            self._state.goal.set(event)
        elif isinstance(event, TrafficMeasured):
            self._state.traffic.set({**self._state.traffic.value, event.link: event})
        elif isinstance(event, MappingChanged):
            self._state.mapping.update(
                mapping=event.mapping, can_save=event.can_save, can_load=event.can_load, can_switch=event.can_switch
            )
        elif isinstance(event, MapRequestChanged):
            self._on_map_request_changed(event)
        elif isinstance(event, ControlUsed):
            states = dict(self._state.control_states.value)
            states[event.control] = ControlStatus(event.state, event.value, event.detail)
            self._state.control_states.set(states)

    def _on_link_changed(self, event: LinkChanged) -> None:
        self._state.forget_received(event)
        if event.link == "media":
            return
        before = self._state.link.value.state
        self._state.link.update(
            state=event.state,
            address=event.address,
            detail=event.detail,
            round_trip_ms=None if event.state != "connected" else self._state.link.value.round_trip_ms,
        )
        if event.state in ("lost", "closed"):
            self._state.control_states.set({})
            self._state.mapping.set(MapStatus())
        elif event.state == "connected" and before not in ("connected", "trouble"):
            if self._control_is_new and self._state.drive.value.emergency_stop:
                # First of all: a new process or robot does not know about the latch.
                self.send(SetEmergencyStop(clock.now_ns(), latched=True, actor=CONSOLE))
            self._control_is_new = False
            self._offer_controls()
            self._report_timeout()

    def _report_timeout(self) -> None:
        """Warn once per robot: if its rosbridge dies, a base without a command timeout cannot be stopped."""
        connection = self.connection
        if connection is None or connection.profile.stops_by_itself:
            return
        if self._reported_no_timeout_of != connection.address and self._driving_permitted:
            self._reported_no_timeout_of = connection.address
            self._problem(
                "warning",
                tr("The profile does not specify whether this robot stops automatically when the connection is lost."),
                tr("The robot is driven at half speed. If the connection is lost while it moves, it may keep moving."),
                tr(
                    "Keep its own emergency stop within reach. If the robot does stop, specify this in its "
                    "profile (timeout_s)."
                ),
                cause="robot_timeout",
            )

    def _on_map_request_changed(self, event: MapRequestChanged) -> None:
        busy = event.operation if event.state == "requested" else ""
        self._state.mapping.update(busy=busy)
        if event.state == "failed":
            what = tr(_MAP_WORDS[event.operation])
            self._problem("warning", what, f"{tr(event.detail)}.", tr("The robot's map is unchanged."), cause=ANSWER)
        elif event.state == "succeeded" and event.operation in ("save", "load"):
            done = tr("The map {name} was saved.") if event.operation == "save" else tr("The map {name} was loaded.")
            self._problem("info", done.format(name=event.name), tr(event.detail), "", cause=ANSWER)

    # Goals

    def go_to_place(self, name: str, actor: Actor = CONSOLE) -> None:
        places: tuple[Place, ...] = self._state.places.value
        place = next((place for place in places if place.name == name), None)
        if place is None:
            self._problem(
                "warning",
                tr("The robot cannot go to {place}.").format(place=name),
                tr("No goal was sent: this scenario has no such place."),
                tr("Choose one of its places, or a point on the map."),
                cause=ANSWER,
            )
        else:
            self._go(place.pose_in_map, place.name, actor)

    def go_to(self, target_in_map: Pose2D, actor: Actor = CONSOLE) -> None:
        self._go(target_in_map, None, actor)

    def cancel_goal(self, actor: Actor = CONSOLE) -> None:
        self.send(CancelGoal(clock.now_ns(), actor))

    def _go(self, target_in_map: Pose2D, place: str | None, actor: Actor) -> None:
        where = place or tr("that point")
        status = self._state.drive.value
        if not status.allowed:
            what = tr("The robot cannot go to {place}.").format(place=where)
            reason = tr("No goal was sent. {why}.").format(why=tr(status.reason))
            self._problem("warning", what, reason, tr("Send the goal again when this has changed."), cause=ANSWER)
            return
        self._before_goal()
        now_ns = clock.now_ns()
        if not self.send(GoTo(now_ns, f"g-{now_ns:x}", target_in_map, place, actor)):
            self._problem(
                "warning",
                tr("The robot could not be sent to {place}.").format(place=where),
                tr("No goal was sent."),
                tr("Send the goal again when the robot is connected again."),
                until="connected",
                cause=ANSWER,
            )

    # Map

    def set_initial_pose(self, pose_in_map: Pose2D, actor: Actor = CONSOLE) -> None:
        self._send_or_report(
            SetInitialPose(clock.now_ns(), pose_in_map, actor=actor), tr("The robot's position was not set.")
        )

    def request_map(self, operation: MapOperation, name: str = "", actor: Actor = CONSOLE) -> None:
        request_id = f"m-{secrets.token_hex(4)}"
        self._send_or_report(RequestMap(clock.now_ns(), request_id, operation, name, actor), tr(_MAP_WORDS[operation]))

    # Controls

    def offer_controls(self, controls: tuple[RobotControl, ...], *, driving_permitted: bool) -> None:
        """Set the scenario's controls, in addition to the profile's. Without driving permission, moving ones are
        absent.
        """
        self._scenario_controls, self._driving_permitted = controls, driving_permitted
        self._show_controls()
        self._offer_controls()

    def _offer_controls(self) -> None:
        self.send(OfferControls(clock.now_ns(), self._scenario_controls, self._driving_permitted))

    def use_control(self, control_id: str, value: ControlValue, actor: Actor = CONSOLE) -> None:
        control = next((one for one in self._state.controls.value if one.id == control_id), None)
        if control is None:
            return
        request_id = f"c-{secrets.token_hex(4)}"
        self._send_or_report(
            UseControl(clock.now_ns(), request_id, control_id, value, actor),
            tr("{control}: nothing was sent to the robot.").format(control=control.title),
        )

    def _show_controls(self) -> None:
        robot_controls = self.connection.profile.controls if self.connection is not None else ()
        names = {control.id for control in self._scenario_controls}
        # A scenario may redefine a control of the profile.
        robot = interface_names(self.connection.profile) if self.connection is not None else NO_NAMES
        every = [
            decided(control, robot)
            for control in (*(one for one in robot_controls if one.id not in names), *self._scenario_controls)
        ]
        self._state.controls.set(tuple(one for one in every if self._driving_permitted or not one.is_motion))

    def _send_or_report(self, command: RobotCommand, what: str) -> None:
        if self._state.link.value.state != "connected" or not self.send(command):
            self._problem(
                "warning", what, tr("The robot is not connected, and nothing is queued."),
                tr("Try again when the robot is connected again."),
                until="connected", cause=ANSWER,
            )  # fmt: skip

    def _chosen(self, connection: RobotConnection) -> RobotChosen:
        profile = self._profile(connection)
        return RobotChosen(
            clock.now_ns(), profile.name, connection.name, connection.address, profile_text(profile), self._chosen_by
        )


# Robot connection service: switches robots, leaving the former one stopped and its state cleared.


class AnotherRobotService(ContextService):
    """Connects the robot requested last; finding and leaving one may take a while.

    ``by_name`` reads files in a background thread and raises UserFacingError. ``simulated`` starts the simulated robot
    if necessary and connects it for the actor once ready; raises UserFacingError on failure.
    """

    def __init__(
        self,
        context: ServiceContext,
        *,
        by_name: Callable[[str], RobotConnection],
        simulated: Callable[[Actor], None],
        robot: RobotService,
        drive: DriveService,
        recording: RecordingService,
        people: PeopleService,
    ) -> None:
        super().__init__(context)
        self._by_name = by_name
        self._simulated = simulated
        self._robot = robot
        self._drive = drive
        self._recording = recording
        self._people = people
        self._token: object = None
        self._requested: RobotConnection | None = None
        self._stopped = False

    def handlers(self) -> Handlers:
        return {
            UseRobot: lambda intent: self.use(lambda: self._by_name(intent.robot), intent.actor),
            UseSimulatedRobot: lambda intent: self._use_simulated(intent.actor),
        }

    def _use_simulated(self, actor: Actor) -> None:
        if (leave := self._robot.leave_for_one_that_starts()) is not None:
            self._slow_work.do(leave, lambda _left: None, self._bus.answer)
        self._simulated(actor)

    def use(self, find: Callable[[], RobotConnection], actor: Actor = WIZARD, *, until: ProblemEnd = "") -> None:
        """Connect the robot returned by ``find``, unless another one is requested meanwhile. A robot given at program
        start counts as the wizard's choice.

        ``find`` runs in a background thread; its UserFacingError is reported (``until`` as in Problem).
        """
        token = self._token = object()

        def found(connection: RobotConnection) -> None:
            if token is self._token:
                self.connect_to(connection, actor)

        self._slow_work.do(find, found, lambda failure: self._bus.answer(failure, until))

    def connect_to(self, connection: RobotConnection, actor: Actor = WIZARD) -> None:
        """Connect a robot, leaving a former one stopped; the last request wins."""
        if self._stopped:
            return
        self._token = None
        self._requested = connection
        self._drive.release(QT_TR_NOOP("Another robot is connected"))
        leave = self._robot.leave_for(connection)
        self._slow_work.do(leave, lambda _left: self._connect(connection, actor), self._bus.answer)

    def _connect(self, connection: RobotConnection, actor: Actor) -> None:
        if self._stopped or connection is not self._requested:
            return
        # Process the last values of the former robot first, so that they are not taken for the new one's.
        self._bus.take_in()
        self._recording.forget_robot()
        self._people.forget_robot()
        self._robot.connect_robot(connection, actor)

    def stop(self) -> None:
        self._stopped = True
