"""Stub capabilities of a robot model (gestures, docks, displays): recorded and answered, without effect."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from caris_desktop.ros import action_messages
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.dialect import Dialect, action_type_name
from caris_desktop.ros.message_fields import MessageError
from caris_desktop.simulator import typedefs
from caris_desktop.simulator.actionlib import ActionlibServer
from caris_desktop.simulator.robot_interface import Order
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import Action, Message

ACTION_TAKES_S = 1.0
_REMEMBERED = 50


class OrdersOnRos:
    """Offers a model's stub capabilities. Actions take one second, can be cancelled, and then succeed."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._taken: deque[dict[str, Any]] = deque(maxlen=_REMEMBERED)
        self._under_way: dict[str, asyncio.TimerHandle] = {}
        self._servers: list[ActionlibServer] = []
        for order in wiring.dress.orders:
            match order.kind:
                case "topic":
                    wiring.obeys(order.name, order.package, order.type, self._noting(order))
                case "service":
                    wiring.serves(order.name, order.package, order.type, self._answering(order))
                case "action" if wiring.dialect is Dialect.ROS1:
                    self._offer_actionlib(order)
                case "action":
                    self._offer_action(order)

    @property
    def taken(self) -> list[dict[str, Any]]:
        """Newest commands, oldest first: name and content."""
        return list(self._taken)

    def publish_due(self) -> None:
        """Publish due messages; called after every simulation step."""
        for server in self._servers:
            server.publish_due()

    def stop(self) -> None:
        """Cancel pending work."""
        for timer in self._under_way.values():
            timer.cancel()

    def _note(self, order: Order, content: Message) -> None:
        self._taken.append({"name": self._wiring.dress.absolute(order.name), "content": content})

    def _noting(self, order: Order) -> Callable[[Message], None]:
        return lambda message: self._note(order, message)

    def _answering(self, order: Order) -> Callable[[Message], Message]:
        def call(arguments: Message) -> Message:
            self._note(order, arguments)
            answer = typedefs.blank(self._wiring.dialect, f"{order.package}/{order.type}", part=1)
            return answer | ({"success": True} if "success" in answer else {})

        return call

    def _offer_actionlib(self, order: Order) -> None:
        dialect, goal_type = self._wiring.dialect, f"{order.package}/{order.type}Goal"
        result = typedefs.blank(dialect, f"{order.package}/{order.type}Result")

        def on_goal(goal_id: str, goal: Message) -> None:
            problem = typedefs.misfit(dialect, goal_type, goal)
            if problem is not None:
                raise MessageError(problem)
            self._note(order, goal)
            server.accept(goal_id)
            self._begin(goal_id, lambda: server.finish(GoalStatus(goal_id, action_messages.SUCCEEDED), result))

        def on_cancel(wanted: str) -> None:
            for goal_id in [wanted] if wanted else list(self._under_way):
                if self._end(goal_id):
                    server.finish(GoalStatus(goal_id, action_messages.PREEMPTED), result)

        server = ActionlibServer(
            self._wiring, order.name, order.package, order.type, on_goal=on_goal, on_cancel=on_cancel
        )
        self._servers.append(server)

    def _offer_action(self, order: Order) -> None:
        type_ = action_type_name(Dialect.ROS2, order.package, order.type)
        values = typedefs.blank(Dialect.ROS2, type_, part=1)
        replies: dict[str, Callable[[Message], None]] = {}

        def finish(goal_id: str, status: int) -> None:
            replies.pop(goal_id)({"op": "action_result", "values": values, "status": status, "result": True})

        def start(goal_id: str, goal: Message, reply: Callable[[Message], None]) -> None:
            problem = typedefs.misfit(Dialect.ROS2, type_, goal)
            if problem is not None:
                raise MessageError(problem)
            self._note(order, goal)
            replies[goal_id] = reply
            self._begin(goal_id, lambda: finish(goal_id, action_messages.ROS2_SUCCEEDED))

        def cancel(goal_id: str) -> None:
            if self._end(goal_id):
                finish(goal_id, action_messages.ROS2_CANCELED)

        self._wiring.server.actions[self._wiring.dress.absolute(order.name)] = Action(type_, start, cancel)

    def _begin(self, goal_id: str, finish: Callable[[], None]) -> None:
        def done() -> None:
            del self._under_way[goal_id]
            finish()

        if goal_id in self._under_way:
            raise MessageError(f"a goal with the id '{goal_id}' is already active")
        self._under_way[goal_id] = asyncio.get_running_loop().call_later(ACTION_TAKES_S, done)

    def _end(self, goal_id: str) -> bool:
        timer = self._under_way.pop(goal_id, None)
        if timer is not None:
            timer.cancel()
        return timer is not None
