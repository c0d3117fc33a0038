"""Latched emergency stop: the console's own, and the robot's if it has one."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any, Literal, Protocol

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import EmergencyStopChanged, Problem
from caris_desktop.domain.link_commands import SetEmergencyStop
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.profile_model import EmergencyStopInterface
from caris_desktop.robot.robot_checks import RobotInventory, absolute_name
from caris_desktop.robot.subscription_watchdog import SubscriptionWatchdog
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect, service_type_name, type_name
from caris_desktop.ros.message_conversion import decode_bool, encode_bool

logger = logging.getLogger(__name__)
_REFUSED = QT_TR_NOOP("the robot refused")
# A newly started rosbridge does not know the robot's services yet.
TRIED_AGAIN_AFTER_S, OFTEN_WITHIN_S = 0.1, 3.0
_SEARCH_EVERY_S = 2.0
_TRIED_AGAIN_EVERY_S = 30.0


class Stoppable(Protocol):
    """Part that the emergency stop acts on. Called on the loop."""

    def set_emergency_stop(self, held: bool, actor: Actor) -> None:
        """Forbid or allow motion. Repeated with every latch, even if already held."""

    def cancel_goals(self, reason: str, actor: Actor) -> None:
        """Cancel the robot's own activity."""


class EmergencyStop:
    """Two latches, the wizard's and the robot's; the stop is set while either is.

    A wizard's stop that did not reach the robot, because its receiver is missing or does not answer, is repeated until
    it does or the wizard clears it.

    ``emit`` gets an EmergencyStopChanged for each change except the wizard's own latching, and a Problem if the robot
    does not follow.
    """

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        interface: EmergencyStopInterface | None,
        stopped: Stoppable,
        watched: SubscriptionWatchdog,
        *,
        emit: Callable[[Any], None],
        in_background: Callable[[Coroutine[Any, Any, None]], None],
    ) -> None:
        self._ros = ros
        self._dialect = dialect
        self._interface = interface or EmergencyStopInterface()
        self._stopped = stopped
        self._emit = emit
        self._in_background = in_background
        self._wizard_latched = False
        self._robot_latched = False
        self._attempt = 0
        self._requested_by: Actor = ""
        # None before the robot has listed them.
        self._services: frozenset[str] | None = None
        self._reached = False
        self._reported_unreached = False
        self._again: asyncio.TimerHandle | None = None
        self._again_after_s = TRIED_AGAIN_AFTER_S
        self._connected_s = 0.0
        self._command: RosbridgeTopic | None = None
        bool_type = type_name(dialect, "std_msgs", "Bool")
        if self._interface.topic is not None:
            state = RosbridgeTopic(ros, self._interface.topic, bool_type, queue_length=20, every_message=True)
            # Robots publish changes only: a state published before this console connected counts too.
            watched.subscribe(state, self._on_state)
        if self._interface.command_topic is not None:
            # Latched, for late subscribers.
            self._command = RosbridgeTopic(
                ros, self._interface.command_topic, bool_type, latch=True, queue_size=1, motion=True
            )
            self._command.advertise()
        interface = self._interface
        services = (interface.service, interface.set_service, interface.clear_service)
        ros.factory.urgent_services.update(service for service in services if service is not None)

    @property
    def latched(self) -> bool:
        return self._wizard_latched or self._robot_latched

    def set(self, command: SetEmergencyStop) -> None:
        """Latch or clear by the wizard."""
        self._attempt += 1
        self._requested_by = command.actor
        if command.latched:
            self._reached = self._reported_unreached = False
            self._latch(wizard=True, by="wizard")
            self._stopped.cancel_goals("emergency stop", command.actor)
            # Reported for every request: the wizard must see that it is set.
            if self._ros.is_connected:
                self._report_robot(latched=True)
            else:
                self._emit(
                    Problem(
                        now_ns(),
                        "error",
                        QT_TR_NOOP("The emergency stop did not reach the robot: the robot is not connected."),
                        QT_TR_NOOP(
                            "It is active in this console and will be sent when the robot is connected "
                            "again. Until then, the robot acts on its own."
                        ),
                        QT_TR_NOOP("Use the robot's own emergency stop."),
                        until="connected",
                        cause="emergency_stop",
                    )
                )
        elif not self._interface.commands_robot:
            self._clear_here()
        elif not self._ros.is_connected:
            self._emit(
                Problem(
                    now_ns(),
                    "warning",
                    QT_TR_NOOP("The emergency stop was not released: the robot is not connected."),
                    QT_TR_NOOP("It stays active."),
                    QT_TR_NOOP("Release it when the robot is connected again."),
                    until="connected",
                    cause="emergency_stop",
                )
            )
            self._emit(EmergencyStopChanged(now_ns(), self.latched, "robot"))
        else:
            self._report_robot(latched=False)

    def link_connected(self) -> None:
        """Repeat the wizard's state to a reconnected robot."""
        self._connected_s = asyncio.get_running_loop().time()
        if self._wizard_latched:
            self._report_robot(latched=True)

    def link_lost(self) -> None:
        self._services = None
        self._reached = False
        self._try_no_more()

    def on_inventory(self, inventory: RobotInventory) -> None:
        """Missing services are not called until the robot has them."""
        self._services = inventory.services
        if self._again is not None:
            self._try_no_more()
            self._report_robot(latched=True)

    def close(self) -> None:
        """The link ends."""
        self._try_no_more()

    def _offered(self, service: str | None) -> str | None:
        if service is None or self._services is None or absolute_name(service) in self._services:
            return service
        return None

    def _try_again_later(self) -> None:
        if self._again is None and self._wizard_latched:
            loop = asyncio.get_running_loop()
            self._again = loop.call_later(self._again_after_s, self._try_again)
            if loop.time() - self._connected_s > OFTEN_WITHIN_S:
                # Each unanswered service call occupies a part of rosbridge.
                self._again_after_s = min(2.0 * self._again_after_s, _TRIED_AGAIN_EVERY_S)

    def _try_no_more(self) -> None:
        self._again_after_s = TRIED_AGAIN_AFTER_S
        if self._again is not None:
            self._again.cancel()
            self._again = None

    def _try_again(self) -> None:
        self._again = None
        if self._wizard_latched and not self._reached and self._ros.is_connected:
            self._in_background(
                self._call_available_service() if self._command is None else self._check_listeners(again=True)
            )

    async def _call_available_service(self) -> None:
        """Call the stop service, if it is available by now."""
        if self._services is not None:
            try:
                answer = await self._ros.ask("/rosapi/services", "rosapi/Services")
            except ServiceCallError as error:
                logger.info("Emergency stop: %s", error)
            else:
                self._services = frozenset(absolute_name(str(name)) for name in answer.get("services") or ())
                self._again_after_s = min(self._again_after_s, _SEARCH_EVERY_S)
        if self._wizard_latched and not self._reached and self._ros.is_connected:
            self._report_robot(latched=True)

    async def _check_listeners(self, *, again: bool) -> None:
        """Check for subscribers of the command topic; ``again`` publishes the latched stop to them."""
        command = self._command
        if command is None:
            return
        try:
            answer = await self._ros.ask("/rosapi/subscribers", "rosapi/Subscribers", {"topic": command.name})
        except ServiceCallError as error:
            # Unknown without rosapi.
            logger.info("Emergency stop: %s", error)
            return
        if not self._wizard_latched or self._reached:
            return
        self._reached = bool(answer.get("subscribers"))
        if not self._reached:
            self._again_after_s = min(self._again_after_s, _SEARCH_EVERY_S)
            self._not_reached(command.name)
        elif again:
            command.publish(encode_bool(True))

    def _not_reached(self, name: str) -> None:
        """No receiver on the robot accepts the latched stop."""
        self._try_again_later()
        if self._reported_unreached:
            return
        self._reported_unreached = True
        self._emit(
            Problem(
                now_ns(),
                "error",
                localized(
                    QT_TR_NOOP("Nothing on the robot receives the emergency stop ({name} is missing)."), name=name
                ),
                QT_TR_NOOP(
                    "It is active in this console, which sends no drive commands; the robot itself is not "
                    "stopped. It is sent as soon as the robot can receive it."
                ),
                QT_TR_NOOP("Use the robot's own emergency stop."),
                until="released",
                cause="emergency_stop",
            )
        )

    def _latch(self, *, by: Literal["wizard", "robot"], wizard: bool | None = None, robot: bool | None = None) -> None:
        before = self.latched
        self._wizard_latched = self._wizard_latched if wizard is None else wizard
        self._robot_latched = self._robot_latched if robot is None else robot
        # The robot only repeats what the wizard latched.
        actor = self._requested_by if by == "wizard" or self._wizard_latched else ""
        if self.latched or before:
            self._stopped.set_emergency_stop(self.latched, actor)
        # The wizard's latching is reported where it was pressed, with or without a link.
        if self.latched != before and not (self.latched and by == "wizard"):
            self._emit(EmergencyStopChanged(now_ns(), self.latched, by, actor))

    def _clear_here(self) -> None:
        self._try_no_more()
        self._latch(wizard=False, by="wizard")
        if self.latched:
            self._emit(
                Problem(
                    now_ns(),
                    "warning",
                    QT_TR_NOOP("The robot's own emergency stop is still active."),
                    QT_TR_NOOP("The console sends no drive commands."),
                    QT_TR_NOOP("Release it on the robot."),
                    until="released",
                    cause="emergency_stop",
                )
            )
            # The requester may already show it as cleared.
            self._emit(EmergencyStopChanged(now_ns(), True, "robot"))

    def _report_robot(self, *, latched: bool) -> None:
        interface = self._interface
        if self._command is not None:
            if self._command.publish(encode_bool(latched)):
                self._report_result(latched=latched, reason="")
                if latched:
                    self._in_background(self._check_listeners(again=False))
            else:
                self._report_result(latched=latched, reason=QT_TR_NOOP("the robot is not connected"))
            return
        default_service = interface.service or (interface.set_service if latched else interface.clear_service)
        # rosapi's list may be outdated: the stop service is called in any case.
        service = default_service if latched or self._reached else self._offered(default_service)
        if service is not None and interface.service is not None:
            kind = service_type_name(self._dialect, "std_srvs", "SetBool")
            request = {interface.service_field: latched is interface.service_stop_value}
            self._call(service, kind, request, latched=latched)
        elif service is not None:
            package, _, name = interface.service_type.partition("/")
            kind = service_type_name(self._dialect, package, name)
            self._call(service, kind, {}, latched=latched)
        elif not latched:
            self._clear_here()

    def _call(self, service: str, kind: str, request: dict[str, Any], *, latched: bool) -> None:
        self._in_background(self._call_now(service, kind, request, latched=latched, attempt=self._attempt))

    async def _call_now(self, service: str, kind: str, request: dict[str, Any], *, latched: bool, attempt: int) -> None:
        try:
            answer = await self._ros.ask(service, kind, request)
            reason, unanswered = "" if answer.get("success", True) else str(answer.get("message") or _REFUSED), False
        except ServiceCallError as error:
            reason, unanswered = str(error), True
        # The wizard may have changed the state in the meantime; the last request counts.
        if attempt != self._attempt:
            return
        if latched and unanswered and self._offered(service) is None:
            self._not_reached(service)
            return
        again = latched and self._reported_unreached
        if latched:
            self._reached = not unanswered
            if unanswered:
                self._reported_unreached = True
                self._try_again_later()
            else:
                self._try_no_more()
        if not (reason and again):
            self._report_result(latched=latched, reason=reason)

    def _report_result(self, *, latched: bool, reason: str) -> None:
        if reason:
            logger.warning("Emergency stop: %s", reason)
            refused, meaning = (
                (
                    QT_TR_NOOP("The robot did not activate its emergency stop ({reason})."),
                    QT_TR_NOOP("It is active in this console only; the console sends no drive commands."),
                )
                if latched
                else (
                    QT_TR_NOOP("The robot did not release its emergency stop ({reason})."),
                    QT_TR_NOOP("It is still active; the console sends no drive commands."),
                )
            )
            self._emit(
                Problem(
                    now_ns(),
                    "error",
                    localized(refused, reason=reason),
                    meaning,
                    QT_TR_NOOP("Use the robot's own emergency stop.")
                    if latched
                    else QT_TR_NOOP("Try again, or release it on the robot."),
                    until="released",
                    cause="emergency_stop",
                )
            )
            # The requester may already show it as cleared.
            self._emit(EmergencyStopChanged(now_ns(), True, "robot"))
        elif not latched:
            self._try_no_more()
            # Its topic will follow a moment later; the wizard need not wait for it.
            self._latch(wizard=False, robot=False, by="wizard")

    def _on_state(self, message: Any) -> None:
        latched = decode_bool(message) is not self._interface.inverted
        if latched == self._robot_latched:
            return
        self._latch(robot=latched, by="robot")
        if latched:
            self._stopped.cancel_goals("the robot's emergency stop", "")
