"""ROS context of the simulated robot's parts: server, robot model, clock, and topic registration."""

import time
from collections.abc import Callable
from dataclasses import field
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros.dialect import Dialect, service_type_name, type_name
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.robot_interface import RobotInterface
from caris_desktop.simulator.robot_simulation import Robot
from caris_desktop.simulator.server import ROBOT_NODE, BridgeServer, Message, SimulatedService, Topic

# Clock of the simulated robot: this computer's, one with offset and drift, or simulation time.

_NS_PER_S = 1_000_000_000


class RobotClock:
    """Robot time.

    Parameters
    ----------
    simulated_s
        Simulation time, where the robot goes by that; None for this computer's clock.
    """

    def __init__(self, simulated_s: Callable[[], float] | None = None) -> None:
        self._simulated_s = simulated_s
        self._offset_ns = 0
        self._drift = 0.0
        self._drifts_from_ns = 0

    def now_ns(self) -> int:
        """Time for stamps."""
        true_ns = self._true_ns()
        return true_ns + self._offset_ns + round((true_ns - self._drifts_from_ns) * self._drift)

    def now_s(self) -> float:
        return self.now_ns() / _NS_PER_S

    def disagree(self, *, offset_s: float = 0.0, drift_ppm: float = 0.0) -> None:
        """Set an offset of ``offset_s`` and a drift of ``drift_ppm``."""
        self._offset_ns = round(offset_s * _NS_PER_S)
        self._drift = drift_ppm * 1e-6
        self._drifts_from_ns = self._true_ns()

    def _true_ns(self) -> int:
        return time.time_ns() if self._simulated_s is None else round(self._simulated_s() * _NS_PER_S)


_WRONG_FRAME = "nowhere"


@dataclass(slots=True)
class RosContext:
    """``faults`` are the present ones. Names are those of the model: relative ones are in its namespace."""

    robot: Robot
    server: BridgeServer
    model: RobotInterface
    clock: RobotClock
    faults: Faults = field(default_factory=Faults)
    _steps: int = 0
    _periodic: list[tuple[int, str, Callable[[], None]]] = field(default_factory=list)

    @property
    def dialect(self) -> Dialect:
        return self.model.dialect

    def stamp_ns(self) -> int:
        return self.clock.now_ns()

    def frame(self, name: str) -> str:
        """Frame for a header: the true one, unless that fault is injected."""
        return _WRONG_FRAME if self.faults.frames_wrong else name

    def publishes(self, name: str, package: str, kind: str, *, latched: bool = False) -> str:
        """Register a topic that the robot publishes; return its absolute name."""
        absolute = self.model.absolute(name)
        self.server.topics[absolute] = Topic(type_name(self.dialect, package, kind), latched, publishers={ROBOT_NODE})
        return absolute

    def obeys(
        self,
        name: str,
        package: str,
        kind: str,
        on_message: Callable[[Message], None],
        *,
        other_types: tuple[str, ...] = (),
    ) -> None:
        """Register a topic that the robot subscribes to, with type checks as in rosbridge."""
        type_ = type_name(self.dialect, package, kind)
        self.server.topics[self.model.absolute(name)] = Topic(type_, on_message=on_message, other_types=other_types)

    def serves(self, name: str, package: str, kind: str, call: Callable[[Message], Message]) -> None:
        """Register a service, with type checks as in rosbridge."""
        self.server.services[self.model.absolute(name)] = SimulatedService(
            service_type_name(self.dialect, package, kind), call
        )

    def every(self, steps: int, publish: Callable[[], None], topic: str = "") -> None:
        """Call ``publish`` every ``steps`` simulation steps; with a ``topic``, only while that has subscribers."""
        self._periodic.append((steps, topic, publish))

    def publish_due(self) -> None:
        """Publish due messages, in the order of :meth:`every`; called after every simulation step."""
        self._steps += 1
        for steps, topic, publish in self._periodic:
            if self._steps % steps == 0 and (not topic or self.wanted(topic)):
                publish()

    def wanted(self, name: str) -> bool:
        """True if the topic (absolute name) has subscribers."""
        return self.server.has_subscribers(name)

    def publish(self, name: str, message: Message) -> None:
        """Publish by absolute name."""
        self.server.publish(name, message)

    def publish_stamped(
        self, name: str, encode: Callable[..., Message], content: Any, *, frame: str = "", **options: Any
    ) -> None:
        """Publish ``content`` as an encoder of :mod:`caris_desktop.ros` writes it, stamped with the present time."""
        header = {"stamp_ns": self.stamp_ns(), "frame_id": self.frame(frame)}
        self.publish(name, encode(self.dialect, content, **header, **options))
