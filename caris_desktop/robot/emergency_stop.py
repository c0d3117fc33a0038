"""The latched emergency stop: the console's own, and the robot's where it has one."""

import logging
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, Literal, Protocol

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.commands import SetEmergencyStop
from caris_desktop.domain.events import EmergencyStopChanged, Problem
from caris_desktop.domain.translation import QT_TR_NOOP, filled
from caris_desktop.robot.preflight import RobotInventory
from caris_desktop.robot.profile import EmergencyStopInterface
from caris_desktop.robot.transport import SafeRos, SafeTopic, ServiceCallError
from caris_desktop.robot.watched import WatchedTopics
from caris_desktop.ros.dialect import Dialect, service_type_name, type_name
from caris_desktop.ros.messages import decode_bool, encode_bool

logger = logging.getLogger(__name__)
_REFUSED = QT_TR_NOOP("it refused")


class StoppedByIt(Protocol):
    """What the emergency stop acts on. Called on the loop."""

    def hold_still(self, held: bool, actor: Actor) -> None:
        """Nothing may move from now on, or it may again. Comes again with every latch, also when held already."""

    def cancel_goals(self, reason: str, actor: Actor) -> None:
        """Cancel whatever the robot does by itself."""


class EmergencyStop:
    """Two latches, the wizard's and the robot's; the stop is set while either is.

    ``emit`` gets an EmergencyStopChanged for each change but the one that the wizard asked for by latching it, and a
    Problem where the robot does not follow.
    """

    def __init__(
        self,
        ros: SafeRos,
        dialect: Dialect,
        interface: EmergencyStopInterface | None,
        stopped: StoppedByIt,
        watched: WatchedTopics,
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
        self._asked = 0
        self._asked_by: Actor = ""
        self._command: SafeTopic | None = None
        bool_type = type_name(dialect, "std_msgs", "Bool")
        if self._interface.topic is not None:
            state = SafeTopic(ros, self._interface.topic, bool_type, queue_length=20, every_message=True)
            # Robots tell it when it changes: what they told before this console was there counts too.
            watched.subscribe(state, self._take_state)
        if self._interface.command_topic is not None:
            # Latched: who subscribes a moment later must learn of it too.
            self._command = SafeTopic(ros, self._interface.command_topic, bool_type, latch=True, queue_size=1)
            self._command.advertise()

    @property
    def latched(self) -> bool:
        return self._wizard_latched or self._robot_latched

    def set(self, command: SetEmergencyStop) -> None:
        """The wizard latches or clears it."""
        self._asked += 1
        self._asked_by = command.actor
        if command.latched:
            self._latch(wizard=True, by="wizard")
            self._stopped.cancel_goals("emergency stop", command.actor)
            # Said again on every request: the wizard must see that it is set.
            if self._ros.is_connected:
                self._tell_robot(latched=True)
            else:
                self._emit(
                    Problem(
                        now_ns(),
                        "error",
                        QT_TR_NOOP("The emergency stop did not reach the robot: it is not connected."),
                        QT_TR_NOOP(
                            "It is set here and will be told to the robot when it is back; until then the robot"
                            " decides."
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
                    QT_TR_NOOP("The emergency stop was not cleared: the robot is not connected."),
                    QT_TR_NOOP("It stays set."),
                    QT_TR_NOOP("Clear it when the robot is connected again."),
                    until="connected",
                    cause="emergency_stop",
                )
            )
            self._emit(EmergencyStopChanged(now_ns(), self.latched, "robot"))
        else:
            self._tell_robot(latched=False)

    def link_connected(self) -> None:
        """A robot that comes back is told again what the wizard wants."""
        if self._wizard_latched:
            self._tell_robot(latched=True)

    def learn(self, inventory: RobotInventory) -> None:
        """Services that the robot does not have are not asked for: the stop is the console's alone then."""

        def offered(service: str | None) -> str | None:
            return service if service is not None and inventory.has_service(service) else None

        self._interface = replace(
            self._interface,
            service=offered(self._interface.service),
            set_service=offered(self._interface.set_service),
            clear_service=offered(self._interface.clear_service),
        )

    def _latch(self, *, by: Literal["wizard", "robot"], wizard: bool | None = None, robot: bool | None = None) -> None:
        before = self.latched
        self._wizard_latched = self._wizard_latched if wizard is None else wizard
        self._robot_latched = self._robot_latched if robot is None else robot
        # A robot only says again what the wizard latched.
        actor = self._asked_by if by == "wizard" or self._wizard_latched else ""
        if self.latched or before:
            self._stopped.hold_still(self.latched, actor)
        # That the wizard latched it is told where it was pressed, with a link or without.
        if self.latched != before and not (self.latched and by == "wizard"):
            self._emit(EmergencyStopChanged(now_ns(), self.latched, by, actor))

    def _clear_here(self) -> None:
        self._latch(wizard=False, by="wizard")
        if self.latched:
            self._emit(
                Problem(
                    now_ns(),
                    "warning",
                    QT_TR_NOOP("The robot's own emergency stop is still set."),
                    QT_TR_NOOP("It does not move."),
                    QT_TR_NOOP("Release it at the robot."),
                    until="released",
                    cause="emergency_stop",
                )
            )
            # Who asked may show it as cleared already.
            self._emit(EmergencyStopChanged(now_ns(), True, "robot"))

    def _tell_robot(self, *, latched: bool) -> None:
        interface = self._interface
        if self._command is not None:
            if self._command.publish(encode_bool(latched)):
                self._told(latched=latched, reason="")
            else:
                self._told(latched=latched, reason=QT_TR_NOOP("it is not connected"))
        elif interface.service is not None:
            kind = service_type_name(self._dialect, "std_srvs", "SetBool")
            request = {interface.service_field: latched is interface.service_stop_value}
            self._call(interface.service, kind, request, latched=latched)
        elif (service := interface.set_service if latched else interface.clear_service) is not None:
            package, _, name = interface.service_type.partition("/")
            kind = service_type_name(self._dialect, package, name)
            self._call(service, kind, {}, latched=latched)
        elif not latched:
            self._clear_here()

    def _call(self, service: str, kind: str, request: dict[str, Any], *, latched: bool) -> None:
        self._in_background(self._call_now(service, kind, request, latched=latched, asked=self._asked))

    async def _call_now(self, service: str, kind: str, request: dict[str, Any], *, latched: bool, asked: int) -> None:
        try:
            answer = await self._ros.ask(service, kind, request)
            reason = "" if answer.get("success", True) else str(answer.get("message") or _REFUSED)
        except ServiceCallError as error:
            reason = str(error)
        # The wizard may have changed her mind while the robot thought about it; the last word counts.
        if asked == self._asked:
            self._told(latched=latched, reason=reason)

    def _told(self, *, latched: bool, reason: str) -> None:
        if reason:
            logger.warning("Emergency stop: %s", reason)
            refused, meaning = (
                (
                    QT_TR_NOOP("The robot did not set its emergency stop ({reason})."),
                    QT_TR_NOOP("It is set in this console only; the console sends no motion."),
                )
                if latched
                else (
                    QT_TR_NOOP("The robot did not clear its emergency stop ({reason})."),
                    QT_TR_NOOP("It is still set; the console sends no motion."),
                )
            )
            self._emit(
                Problem(
                    now_ns(),
                    "error",
                    filled(refused, reason=reason),
                    meaning,
                    QT_TR_NOOP("Use the robot's own emergency stop.")
                    if latched
                    else QT_TR_NOOP("Try again, or clear it at the robot."),
                    until="released",
                    cause="emergency_stop",
                )
            )
            # Who asked may show it as cleared already.
            self._emit(EmergencyStopChanged(now_ns(), True, "robot"))
        elif not latched:
            # Its topic will say the same a moment later; the wizard need not wait for it.
            self._latch(wizard=False, robot=False, by="wizard")

    def _take_state(self, message: Any) -> None:
        latched = decode_bool(message) is not self._interface.inverted
        if latched == self._robot_latched:
            return
        self._latch(robot=latched, by="robot")
        if latched:
            self._stopped.cancel_goals("the robot's emergency stop", "")
