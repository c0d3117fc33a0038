"""Robot panel controls: publish, call or send goals on use; readings are sent back."""

import asyncio
import logging
import math
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, Literal

import numpy as np

from caris_desktop.domain import translation
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import (
    CallService,
    ControlEffect,
    ControlValue,
    PublishMessage,
    RobotControl,
    SendActionGoal,
    decided,
    fill_template,
    is_velocity,
)
from caris_desktop.domain.events import ControlUsed, RequestState
from caris_desktop.domain.link_commands import UseControl
from caris_desktop.domain.sensing import ControlReadings
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.robot.action_client import FATE_UNKNOWN, FATE_WITHIN_S, make_action_client
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.profile_model import interface_names
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.action_messages import Ending, action_package_and_name
from caris_desktop.ros.definitions import (
    Definition,
    MessageMismatchError,
    coerce_to_definition,
    definition_from_rosapi,
    shipped_definition,
)
from caris_desktop.ros.dialect import Dialect, action_type_name, package_and_name, service_type_name, type_name
from caris_desktop.ros.message_fields import Message, MessageError, message_of

logger = logging.getLogger(__name__)

READINGS_EVERY_S = 0.2
# A gesture may start late; a missing server never does.
NO_ANSWER_S = 4.0
# A newly advertised publisher reaches its subscribers with a delay.
CANCEL_AGAIN_S = (0.0, 0.3, 1.0)
SERVICE_WAIT_S = 20.0
LONGEST_TEXT_SHOWN = 500
_NOT_CONNECTED = QT_TR_NOOP("the robot is not connected")
_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[0-9]{1,6}\])*)")
_INDEX = re.compile(r"\[([0-9]+)\]")

Path = tuple[str | int, ...]
TypeKind = Literal["message", "service", "goal"]


@cache
def parse_path(text: str) -> Path:
    """Parse ``status[0].level`` to ("status", 0, "level").

    Raises
    ------
    ValueError
        When it is not a path to a field.
    """
    steps: list[str | int] = []
    for piece in text.split("."):
        found = _STEP.fullmatch(piece)
        if found is None:
            raise ValueError(f"{text!r} is not a path to a field")
        steps.append(found[1])
        steps += [int(index) for index in _INDEX.findall(found[2])]
    return tuple(steps)


def value_at(message: Any, path: Path, scale: float) -> ControlValue | None:
    """Displayed value of a message; None if it is not finite.

    Raises
    ------
    MessageError
        When the message has no such field, or something else than one value there.
    """
    value = message
    for step in path:
        try:
            if isinstance(step, str):
                value = message_of(value, "the message")[step]
            elif isinstance(value, (list, np.ndarray, bytes)):
                value = value[step]
            else:
                raise MessageError(f"there is no list with an entry {step}")
        except (KeyError, IndexError) as error:
            raise MessageError(f"there is no field {step!r}") from error
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (bool, str)):
        return value[:LONGEST_TEXT_SHOWN] if isinstance(value, str) else value
    if value is None:
        return None
    if not isinstance(value, (int, float)):
        raise MessageError("the field contains more than one value")
    try:
        number = float(value) * scale
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


class MessageTypes:
    """Type definitions of one robot: queried once per connection, else the known standard ones."""

    def __init__(self, ros: RosbridgeClient) -> None:
        self._ros = ros
        self._learnt: dict[tuple[TypeKind, str], asyncio.Task[Definition | None]] = {}

    def forget(self) -> None:
        """Clear all, since another robot may answer after a link loss."""
        # Pending queries fail, and their callers continue then.
        self._learnt.clear()

    def known(self, kind: TypeKind, type_: str) -> bool:
        """True if :meth:`learn` returns at once."""
        task = self._learnt.get((kind, type_))
        return task is not None and task.done() and not task.cancelled()

    def definition_now(self, kind: TypeKind, type_: str) -> Definition | None:
        """Fields of a message, service request or action goal; None if not known, or not yet."""
        return self._learnt[kind, type_].result() if self.known(kind, type_) else None

    async def learn(self, kind: TypeKind, type_: str) -> None:
        """Query the definition, once."""
        task = self._learnt.get((kind, type_))
        if task is None:
            task = asyncio.get_running_loop().create_task(self._learn(kind, type_))
            self._learnt[kind, type_] = task
        await asyncio.shield(task)

    async def _learn(self, kind: TypeKind, type_: str) -> Definition | None:
        package, name = action_package_and_name(type_) if kind == "goal" else package_and_name(type_)
        service, spelled = "message_details", type_name(self._ros.dialect, package, name)
        if kind == "service":
            service, spelled = "service_request_details", service_type_name(self._ros.dialect, package, name)
        elif kind == "goal" and self._ros.dialect is Dialect.ROS1:
            spelled = type_name(self._ros.dialect, package, f"{name}Goal")
        elif kind == "goal":
            service, spelled = "action_goal_details", action_type_name(self._ros.dialect, package, name)
        try:
            answer = await self._ros.ask(f"/rosapi/{service}", f"rosapi/{service}", {"type": spelled})
            return definition_from_rosapi(answer.get("typedefs"))
        except (ServiceCallError, ValueError, TypeError) as error:
            logger.debug("%s: %s", spelled, error)
        return shipped_definition(f"{package}/{name}Goal" if kind == "goal" else f"{package}/{name}")


class _Server:
    """Action server used by controls, with our goals. A ``GoalListener``."""

    def __init__(
        self, ros: RosbridgeClient, action: str, type_: str, emit: Callable[[UseControl, RequestState, str], None]
    ) -> None:
        self.goals: dict[str, UseControl] = {}
        self.answered: set[str] = set()
        self.lost: tuple[str, ...] = ()
        self._emit = emit
        self.client = make_action_client(ros, action, type_, self)

    def goal_pending(self, wire_id: str) -> None:
        """Reported when it begins."""

    def goal_active(self, wire_id: str) -> None:
        if wire_id in self.goals:
            self.answered.add(wire_id)

    def goal_feedback(self, wire_id: str, _: Message) -> None:
        self.goal_active(wire_id)

    def goal_ended(self, wire_id: str, ending: Ending, detail: str) -> None:
        command = self.goals.pop(wire_id, None)
        if command is not None:
            state: RequestState = "succeeded" if ending == "reached" else "failed"
            self._emit(command, state, detail or (QT_TR_NOOP("it was cancelled") if ending == "cancelled" else ""))


class RobotControls:
    """Executes UseControl for the profile's controls and the scenario's.

    It sends a ControlUsed for each step of a use, ControlReadings at most five times per second, and a Problem if a
    message lacks the value of a control.
    """

    def __init__(self, link: LinkContext) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = link.ros
        self._profile = link.profile
        self._robot = interface_names(link.profile)
        self._emit = link.put
        self._problems = link.report.problems
        self._in_background = link.in_background
        self._types = MessageTypes(link.ros)
        self._watched = link.watched
        self._controls: dict[str, RobotControl] = {}
        self._publishers: dict[tuple[str, str], RosbridgeTopic] = {}
        self._servers: dict[tuple[str, str], _Server] = {}
        self._readings: list[RosbridgeTopic] = []
        self._values: dict[str, ControlValue] = {}
        self._reported_s = -math.inf
        self._timer: asyncio.TimerHandle | None = None
        self._held = False
        self._driving_permitted = True
        self.offer(())

    # Inventory

    def offer(self, controls: tuple[RobotControl, ...], *, driving_permitted: bool = True) -> None:
        """Set the scenario's controls in addition to the profile's; equal ids replace these."""
        self._driving_permitted = driving_permitted
        if not driving_permitted:
            self.cancel_goals(QT_TR_NOOP("the scenario does not permit driving"))
        offered = {control.id: decided(control, self._robot) for control in (*self._profile.controls, *controls)}
        if offered == self._controls:
            # A repeated offer comes from a receiver that lost the values.
            self._report_values_soon()
            return
        self._controls = offered
        self._listen()
        # Velocity topics are not even advertised: that would set a type chosen by the control.
        effects = [control.effect for control in offered.values() if not self._sends_velocity(control)]
        topics = {(effect.topic, effect.type) for effect in effects if isinstance(effect, PublishMessage)}
        for key in [key for key in self._publishers if key not in topics]:
            self._publishers.pop(key).unadvertise()
        for topic, type_ in topics - self._publishers.keys():
            # In advance: a publisher reaches its subscribers with a delay.
            publisher = RosbridgeTopic(self._ros, topic, type_)
            publisher.advertise()
            self._publishers[topic, type_] = publisher
        actions = {(effect.action, effect.type) for effect in effects if isinstance(effect, SendActionGoal)}
        for key in [key for key in self._servers if key not in actions]:
            server = self._servers.pop(key)
            self._fail_goals(server, QT_TR_NOOP("the scenario has changed"))
            server.client.close()
        for action, type_ in actions - self._servers.keys():
            self._servers[action, type_] = _Server(self._ros, action, type_, self._notify)
        self._learn_types()

    def link_connected(self) -> None:
        self._learn_types()
        for server in self._servers.values():
            # Earlier goals do not continue after the gap.
            lost, server.lost = server.lost, ()
            for wire_id in lost:
                for delay_s in CANCEL_AGAIN_S:
                    self._loop.call_later(delay_s, server.client.cancel, wire_id)
                self._loop.call_later(FATE_WITHIN_S, self._give_up_fate, server, wire_id)

    def link_lost(self) -> None:
        self._types.forget()
        self._values.clear()
        for server in self._servers.values():
            server.lost += tuple(server.goals)
            for wire_id in server.goals:
                self._loop.call_later(FATE_WITHIN_S, self._give_up_lost, server, wire_id)

    def close(self) -> None:
        """The link ends."""
        if self._timer is not None:
            self._timer.cancel()

    def set_emergency_stop(self, held: bool) -> None:
        """Emergency stop: cancel the robot's own activity, and send nothing that could move it."""
        self._held = held
        if held:
            self.cancel_goals(QT_TR_NOOP("the emergency stop was activated"))

    def cancel_goals(self, reason: str) -> None:
        """Cancel the goals of controls."""
        for server in self._servers.values():
            self._fail_goals(server, reason)

    def cancel_left_goals(self) -> None:
        """Cancel goals left by a process that crashed."""
        for server in self._servers.values():
            for delay_s in CANCEL_AGAIN_S:
                self._loop.call_later(delay_s, self._cancel_left_goal, server)

    def _cancel_left_goal(self, server: _Server) -> None:
        if not server.goals and self._ros.is_connected:
            server.client.cancel_all()

    def _learn_types(self) -> None:
        if self._ros.is_connected:
            interfaces = {_kind_and_type(control.effect) for control in self._controls.values() if control.effect}
            for kind, type_ in sorted(interfaces):
                self._in_background(self._types.learn(kind, type_))

    # Uses

    def use(self, command: UseControl) -> None:
        """Start a use of a control."""
        self._notify(command, "requested", "")
        control = self._controls.get(command.control)
        if control is None or control.effect is None:
            self._notify(command, "failed", QT_TR_NOOP("neither the robot profile nor the scenario has this control"))
            return
        if refusal := self._refusal(control):
            self._notify(command, "failed", refusal)
        elif self._types.known(*_kind_and_type(control.effect)):
            self._check_and_do(command, control, control.effect)
        else:
            self._in_background(self._learn_and_do(command, control, control.effect))

    def may_move(self, control_id: str) -> bool:
        """True if the robot may move because of this control."""
        control = self._controls.get(control_id)
        return control is not None and control.is_motion and not self._refusal(control)

    async def _learn_and_do(self, command: UseControl, control: RobotControl, effect: ControlEffect) -> None:
        await self._types.learn(*_kind_and_type(effect))
        # Meanwhile the link may have been lost or the emergency stop set.
        if refusal := self._refusal(control):
            self._notify(command, "failed", refusal)
        else:
            self._check_and_do(command, control, effect)

    def _refusal(self, control: RobotControl) -> str:
        """Reason why this control must not send anything now; empty if it may."""
        if self._sends_velocity(control):
            return QT_TR_NOOP("it publishes velocities, which only driving may send")
        if control.releases_stop:
            return QT_TR_NOOP("it would release the emergency stop, which only the wizard may do")
        if control.is_held_by_stop and self._held:
            return QT_TR_NOOP("the emergency stop is active")
        if control.is_motion and not self._driving_permitted:
            return QT_TR_NOOP("the scenario does not permit driving, and this control may move the robot")
        if not self._ros.is_connected:
            return _NOT_CONNECTED
        return ""

    def _sends_velocity(self, control: RobotControl) -> bool:
        effect = control.effect
        velocity = self._profile.velocity.topic
        return isinstance(effect, PublishMessage) and is_velocity(effect.topic, effect.type, velocity)

    def _check_and_do(self, command: UseControl, control: RobotControl, effect: ControlEffect) -> None:
        try:
            definition = self._types.definition_now(*_kind_and_type(effect))
            content = fill_template(_template(effect), command.value)
            message = coerce_to_definition(content, definition, rounds=control.kind == "slider")
        except MessageMismatchError as error:
            logger.warning("Control %s: %s", control.id, error)
            reason = translation.localized(QT_TR_NOOP("nothing was sent: {why}"), why=error)
            self._notify(command, "failed", reason)
            return
        match effect:
            case PublishMessage(topic=topic, type=type_):
                sent = self._publishers[topic, type_].publish(message)
                self._notify(command, "succeeded" if sent else "failed", "" if sent else _NOT_CONNECTED)
            case CallService():
                self._in_background(self._call(command, control, effect, message))
            case SendActionGoal():
                server = self._servers[effect.action, effect.type]
                wire_id = server.client.send(command.control, message)
                if wire_id is None:
                    self._notify(command, "failed", _NOT_CONNECTED)
                    return
                server.goals[wire_id] = command
                # A goal without a server gets no answer; through rosbridge neither does a refused goal of ROS 2.
                self._loop.call_later(NO_ANSWER_S, lambda: self._give_up(server, wire_id))

    async def _call(self, command: UseControl, control: RobotControl, effect: CallService, request: Message) -> None:
        if refusal := self._refusal(control):
            # The emergency stop came at the same time.
            self._notify(command, "failed", refusal)
            return
        try:
            answer = await self._ros.ask(effect.service, effect.type, request, timeout_s=SERVICE_WAIT_S)
        except ServiceCallError as error:
            self._notify(command, "failed", str(error))
            return
        # Field of Trigger, SetBool and similar services.
        succeeded = answer.get("success", True) is not False
        message = answer.get("message")
        detail = message[:LONGEST_TEXT_SHOWN] if isinstance(message, str) else ""
        refused = "" if succeeded else QT_TR_NOOP("the robot refused")
        self._notify(command, "succeeded" if succeeded else "failed", detail or refused)

    def _give_up(self, server: _Server, wire_id: str) -> None:
        if wire_id in server.goals.keys() - server.answered - set(server.lost):
            command = server.goals.pop(wire_id)
            server.client.give_up(wire_id)
            late = translation.localized(
                QT_TR_NOOP("the robot did not respond within {time} s"), time=f"{NO_ANSWER_S:g}"
            )
            self._notify(command, "failed", late)

    def _give_up_lost(self, server: _Server, wire_id: str) -> None:
        if not self._ros.is_connected:
            self._give_up_fate(server, wire_id)

    def _give_up_fate(self, server: _Server, wire_id: str) -> None:
        command = server.goals.pop(wire_id, None)
        if command is not None:
            self._notify(command, "failed", FATE_UNKNOWN)

    def _fail_goals(self, server: _Server, detail: str) -> None:
        goals, server.goals = server.goals, {}
        for wire_id, command in goals.items():
            server.client.cancel(wire_id)
            self._notify(command, "failed", detail)

    def _notify(self, command: UseControl, state: RequestState, detail: str) -> None:
        self._emit(
            ControlUsed(now_ns(), command.request_id, command.control, command.value, state, detail, command.actor)
        )

    # Readings

    def _listen(self) -> None:
        for topic in self._readings:
            self._watched.unsubscribe(topic)
        self._readings.clear()
        self._values = {name: value for name, value in self._values.items() if name in self._controls}
        by_topic: dict[tuple[str, str], list[RobotControl]] = {}
        for control in self._controls.values():
            if control.reading is not None:
                by_topic.setdefault((control.reading.topic, control.reading.type), []).append(control)
        for (name, type_), controls in by_topic.items():
            throttle_ms = min(control.reading.throttle_ms for control in controls if control.reading is not None)
            topic = RosbridgeTopic(self._ros, name, type_, throttle_rate=throttle_ms)
            self._readings.append(topic)
            self._watched.subscribe(topic, partial(self._read, controls))

    def _read(self, controls: list[RobotControl], message: Any) -> None:
        """Process a message of one topic for all controls with readings from it."""
        for control in controls:
            if control.reading is None:
                continue
            try:
                value = value_at(message, parse_path(control.reading.field), control.reading.scale)
            except MessageError as error:
                unusable = QT_TR_NOOP("{count} message(s) from the robot cannot be shown as {title}: {reason}.")
                self._problems.count(
                    f"reading {control.title}",
                    severity="warning",
                    what=translation.localized(unusable, title=control.title, reason=str(error)),
                    meaning=QT_TR_NOOP("The Robot panel continues to show the last value."),
                    advice=QT_TR_NOOP("Check the control's topic and field in the robot profile or the scenario."),
                )
            else:
                if value is not None and self._values.get(control.id) != value:
                    self._values[control.id] = value
                    self._report_values_soon()

    def _report_values_soon(self) -> None:
        if self._timer is None:
            self._timer = self._loop.call_at(
                max(self._reported_s + READINGS_EVERY_S, self._loop.time()), self._report_values
            )

    def _report_values(self) -> None:
        self._timer = None
        if self._values:
            self._reported_s = self._loop.time()
            self._emit(ControlReadings(now_ns(), dict(self._values)))


def _kind_and_type(effect: ControlEffect) -> tuple[TypeKind, str]:
    match effect:
        case PublishMessage(type=type_):
            return "message", type_
        case CallService(type=type_):
            return "service", type_
        case SendActionGoal(type=type_):
            return "goal", type_


def _template(effect: ControlEffect) -> Mapping[str, Any]:
    match effect:
        case PublishMessage(message=template) | CallService(request=template) | SendActionGoal(goal=template):
            return template
