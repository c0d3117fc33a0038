"""What all parts of the robot's face on ROS share: the server, the dress, the clock, and how topics are offered."""

from collections.abc import Callable
from dataclasses import field
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros.dialect import Dialect, service_type_name, type_name
from caris_desktop.simulator.dress import Dress
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.robot import Robot
from caris_desktop.simulator.robot_clock import RobotClock
from caris_desktop.simulator.server import ROBOT_NODE, BridgeServer, Message, SimulatedService, Topic

_WRONG_FRAME = "nowhere"


@dataclass(slots=True)
class Wiring:
    """``faults`` are the present ones. Names are those of the dress: relative ones take its namespace."""

    robot: Robot
    server: BridgeServer
    dress: Dress
    clock: RobotClock
    faults: Faults = field(default_factory=Faults)

    @property
    def dialect(self) -> Dialect:
        return self.dress.dialect

    def stamp_ns(self) -> int:
        return self.clock.now_ns()

    def frame(self, name: str) -> str:
        """The frame to write into a header: the true one, unless that fault is injected."""
        return _WRONG_FRAME if self.faults.frames_wrong else name

    def publishes(self, name: str, package: str, kind: str, *, latched: bool = False) -> str:
        """Offer a topic that the robot publishes, and return its name on the wire."""
        absolute = self.dress.absolute(name)
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
        """Offer a topic that the robot listens to. What its type does not allow is refused as rosbridge does it."""
        type_ = type_name(self.dialect, package, kind)
        self.server.topics[self.dress.absolute(name)] = Topic(type_, on_message=on_message, other_types=other_types)

    def serves(self, name: str, package: str, kind: str, call: Callable[[Message], Message]) -> None:
        """Offer a service. What its type does not allow is refused as rosbridge does it."""
        self.server.services[self.dress.absolute(name)] = SimulatedService(
            service_type_name(self.dialect, package, kind), call
        )

    def wanted(self, name: str) -> bool:
        """Whether anybody takes this topic, by its name on the wire."""
        return self.server.has_subscribers(name)

    def publish(self, name: str, message: dict[str, Any]) -> None:
        """Publish by the name on the wire."""
        self.server.publish(name, message)
