"""Speed limit of the robot's navigation, if it supports one."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import NavigationSpeedChanged, Problem
from caris_desktop.domain.link_commands import LimitGoals
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.profile_model import NavigationServer
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect, service_type_name, type_name
from caris_desktop.ros.message_conversion import NO_LIMIT, decode_reconfigured, encode_reconfigure, encode_speed_limit
from caris_desktop.ros.message_fields import MessageError

logger = logging.getLogger(__name__)
RESTORED_WITHIN_S = 0.5
# Some planners store parameters with few decimals.
_SAME_MPS = 0.005


class NavigationSpeed:
    """Sends the wizard's limit to navigation: on connection, before each goal and at each change.

    ``emit`` gets a NavigationSpeedChanged when the effective limit is known, and one Problem per connection if it
    cannot be set. A goal does not wait for the answer: the limit is sent first and arrives sooner than the robot can
    exceed it from standstill.
    """

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        server: NavigationServer | None,
        *,
        emit: Callable[[NavigationSpeedChanged | Problem], None],
        in_background: Callable[[Coroutine[Any, Any, None]], None],
    ) -> None:
        self._ros = ros
        self._dialect = dialect
        self._server = server
        self._emit = emit
        self._in_background = in_background
        self._requested_mps: float | None = None
        self._requested_by: Actor = CONSOLE
        self._limit_mps: float | None = None
        self._reported_failure = False
        self._attempt = 0
        self._topic: RosbridgeTopic | None = None
        interface = server.speed_limit if server is not None else None
        self._reconfigure = interface.reconfigure if interface is not None else None
        self._parameters = interface.parameters if interface is not None else ()
        if interface is not None and interface.topic is not None:
            self._topic = RosbridgeTopic(
                ros, interface.topic, type_name(dialect, "nav2_msgs", "SpeedLimit"), queue_size=1
            )
            self._topic.advertise()

    def limit(self, command: LimitGoals) -> None:
        """Apply the limit of manual driving to goals too."""
        if math.isfinite(command.forward_mps) and command.forward_mps > 0.0:
            self._requested_mps, self._requested_by = command.forward_mps, command.actor
            self.apply()

    def link_connected(self) -> None:
        self._reported_failure = False
        self.apply()

    def link_lost(self) -> None:
        # Others may set the robot's limit meanwhile.
        self._attempt += 1
        self._persist(None, CONSOLE)

    def apply(self) -> None:
        """Send the limit, if the robot is connected."""
        if self._requested_mps is None or not self._ros.is_connected:
            return
        self._attempt += 1
        limit_mps = self._requested_mps
        if self._server is not None and self._server.max_mps is not None:
            limit_mps = min(limit_mps, self._server.max_mps)
        if self._topic is not None:
            self._topic.publish(encode_speed_limit(limit_mps))
            self._in_background(self._check_listeners(limit_mps, self._topic.name, attempt=self._attempt))
        elif self._reconfigure is not None:
            answer = self._ask_for(limit_mps, self._reconfigure)
            self._in_background(self._await_answer(answer, limit_mps, self._reconfigure, attempt=self._attempt))

    async def restore(self) -> None:
        """Restore the robot's own limit when the console leaves."""
        self._attempt += 1
        if self._limit_mps is None or not self._ros.is_connected:
            return
        if self._topic is not None:
            self._topic.publish(encode_speed_limit(NO_LIMIT))
        elif self._reconfigure is not None and self._server is not None and self._server.max_mps is not None:
            try:
                async with asyncio.timeout(RESTORED_WITHIN_S):
                    await self._ask_for(self._server.max_mps, self._reconfigure)
            except (TimeoutError, ServiceCallError) as error:
                logger.info("The navigation's speed stays as it was told: %s", error)

    async def _check_listeners(self, limit_mps: float, topic: str, *, attempt: int) -> None:
        package = "rosapi" if self._dialect is Dialect.ROS1 else "rosapi_msgs"
        kind = service_type_name(self._dialect, package, "Subscribers")
        try:
            listeners = (await self._ros.ask("/rosapi/subscribers", kind, {"topic": topic})).get("subscribers")
            nobody = localized(QT_TR_NOOP("nothing subscribes to {topic}"), topic=topic)
            reason = "" if isinstance(listeners, list) and listeners else nobody
        except ServiceCallError as error:
            unknown = QT_TR_NOOP("the subscribers of {topic} are unknown: {why}")
            reason = localized(unknown, topic=topic, why=error)
        self._settle(limit_mps, reason, attempt=attempt)

    async def _await_answer(self, answer: Awaitable[Any], limit_mps: float, node: str, *, attempt: int) -> None:
        try:
            now = decode_reconfigured(await answer, self._parameters)
        except (ServiceCallError, MessageError) as error:
            self._settle(limit_mps, str(error), attempt=attempt)
            return
        fastest = max(now.values(), default=math.inf)
        refused = localized(QT_TR_NOOP("{node} did not accept {names}"), node=node, names=", ".join(self._parameters))
        reason = "" if fastest <= limit_mps + _SAME_MPS else refused
        self._settle(limit_mps, reason, attempt=attempt)

    def _ask_for(self, limit_mps: float, node: str) -> Awaitable[Any]:
        kind = service_type_name(self._dialect, "dynamic_reconfigure", "Reconfigure")
        request = encode_reconfigure(dict.fromkeys(self._parameters, limit_mps))
        return self._ros.ask(f"{node}/set_parameters", kind, request)

    def _settle(self, limit_mps: float, reason: str, *, attempt: int) -> None:
        if attempt != self._attempt:
            return  # a newer limit was sent meanwhile; its answer counts
        self._persist(None if reason else limit_mps, self._requested_by)
        if not reason or self._reported_failure:
            return
        self._reported_failure = True
        logger.warning("The navigation's speed: %s", reason)
        profile_max_mps = self._server.max_mps if self._server is not None else None
        self._emit(
            Problem(
                now_ns(),
                "warning",
                localized(
                    QT_TR_NOOP("The speed limit could not be sent to the robot's navigation: {reason}."), reason=reason
                ),
                QT_TR_NOOP(
                    "When navigating, the robot drives at its own configured speed, regardless of the limit in Drive."
                )
                if profile_max_mps is None
                else localized(
                    QT_TR_NOOP(
                        "When navigating, the robot drives at up to {speed} m/s, as set in its profile, "
                        "regardless of the limit in Drive."
                    ),
                    speed=f"{profile_max_mps:.2f}",
                ),
                QT_TR_NOOP(
                    "Watch the robot; press Esc to stop it. Correct 'speed_limit' under 'navigation' in the "
                    "robot profile."
                ),
                cause="robot_speed",
            )
        )

    def _persist(self, speed_mps: float | None, actor: Actor) -> None:
        if speed_mps != self._limit_mps:
            self._limit_mps = speed_mps
            self._emit(NavigationSpeedChanged(now_ns(), speed_mps, actor))
