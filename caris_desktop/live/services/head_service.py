"""Head service: input to joint targets within the neck's limits. GUI thread."""

from dataclasses import replace

from PySide6.QtCore import QObject, Qt, QTimer

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.link_commands import MoveHead
from caris_desktop.domain.ports import RobotPort
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import HeadStatus
from caris_desktop.robot.profile import HeadInterface, RobotProfile
from caris_desktop.scenario.scenario_model import Scenario

MOVE_EVERY_MS = 50
# A stalled GUI must not lead to one large motion.
_LONGEST_STEP_S = 0.1
_NOD_RAD, _NOD_MS = 0.25, 450


class HeadService(Service):
    """Maintains ``state.look``, and sends MoveHead at 20 Hz while input is held. The link reports the commanded
    angles.

    The head stops on release, under the emergency stop, without a link, and when the GUI stalls: each target is one
    step ahead, never the end of the range.
    """

    def __init__(self, state: LiveState, robot: RobotPort, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._robot = robot
        self._head: HeadInterface | None = None
        self._pan = self._tilt = 0.0
        self._actor: Actor = CONSOLE
        self._stepped_ns = 0
        self._moving = QTimer(self)
        self._moving.setTimerType(Qt.TimerType.PreciseTimer)
        self._moving.setInterval(MOVE_EVERY_MS)
        self._moving.timeout.connect(self._step)
        self._nodded_from = (0.0, 0.0)
        self._nodding = QTimer(self, singleShot=True, interval=_NOD_MS)
        self._nodding.timeout.connect(self._end_nod)
        self._on_robot_changed(state.robot.value)
        state.robot.changed.connect(self._on_robot_changed)
        state.link.changed.connect(self._on_condition_changed)
        state.drive.changed.connect(self._on_condition_changed)

    def handlers(self) -> Handlers:
        return {
            intents.LookAt: lambda intent: self.turn_to(
                pan_rad=intent.pan_rad, tilt_rad=intent.tilt_rad, actor=intent.actor
            ),
            intents.TurnHead: lambda intent: self.turn_head(pan=intent.pan, tilt=intent.tilt, actor=intent.actor),
            intents.Nod: lambda intent: self.nod(intent.actor),
        }

    def use_scenario(self, scenario: Scenario) -> None:
        if not scenario.permissions.driving:
            self.release()

    def stop(self) -> None:
        self._nodding.stop()
        self.release()

    def turn_to(self, *, pan_rad: float, tilt_rad: float, actor: Actor = CONSOLE) -> None:
        """Turn the head to these angles, clamped to its range; ends a held turn."""
        self._moving.stop()
        self._nodding.stop()
        self._pan = self._tilt = 0.0
        if self._may_move():
            self._actor = actor
            self._move_to(pan_rad, tilt_rad)

    def turn_head(self, *, pan: float, tilt: float, actor: Actor = CONSOLE) -> None:
        """Turn at -1..1 of the head's speed, pan left and tilt down positive; zero stops. Call on each change."""
        was_turning = self._moving.isActive()
        self._pan, self._tilt = _unit(pan), _unit(tilt)
        if not (self._pan or self._tilt):
            self._end_turn()
        elif self._may_move():
            self._nodding.stop()
            self._actor = actor
            if not was_turning:
                self._take_measured_angles()
                self._stepped_ns = clock.now_ns() - MOVE_EVERY_MS * 1_000_000
                self._moving.start()
                self._step()
        else:
            self._end_turn()

    def nod(self, actor: Actor = CONSOLE) -> None:
        """Nod down and back; any other head command ends it."""
        if self._moving.isActive() or self._nodding.isActive() or not self._may_move():
            return
        self._take_measured_angles()
        head = self._state.look.value
        self._actor = actor
        self._nodded_from = head.pan_rad, head.tilt_rad
        if self._move_to(head.pan_rad, head.tilt_rad + _NOD_RAD):
            self._nodding.start()

    def _end_nod(self) -> None:
        pan_rad, tilt_rad = self._nodded_from
        if self._may_move():
            self._move_to(pan_rad, tilt_rad)

    def release(self) -> None:
        """Stop turning: the head keeps its target."""
        self.turn_head(pan=0.0, tilt=0.0)

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        self._end_turn()
        self._head = robot.head if robot is not None else None
        self._state.look.set(HeadStatus(present=self._head is not None))

    def _on_condition_changed(self, _value: object = None) -> None:
        if self._moving.isActive() and not self._may_move():
            self._end_turn()

    def _may_move(self) -> bool:
        return (
            self._head is not None
            and self._state.link.value.state == "connected"
            and not self._state.drive.value.emergency_stop
        )

    def _take_measured_angles(self) -> None:
        """Start from the measured angles: something else may have turned the head."""
        if self._state.head.freshness == "fresh":
            measured = self._state.head.value
            self._state.look.set(replace(self._state.look.value, pan_rad=measured.pan_rad, tilt_rad=measured.tilt_rad))

    def _step(self) -> None:
        head = self._head
        if head is None:
            return
        now_ns = clock.now_ns()
        stretch_rad = head.speed_radps * min((now_ns - self._stepped_ns) / 1e9, _LONGEST_STEP_S)
        self._stepped_ns = now_ns
        commanded = self._state.look.value
        if not self._move_to(
            commanded.pan_rad + self._pan * stretch_rad, commanded.tilt_rad + self._tilt * stretch_rad
        ):
            self._end_turn()

    def _move_to(self, pan_rad: float, tilt_rad: float) -> bool:
        head = self._head
        if head is None:
            return False
        pan_rad = min(max(pan_rad, head.pan_range_rad[0]), head.pan_range_rad[1])
        tilt_rad = min(max(tilt_rad, head.tilt_range_rad[0]), head.tilt_range_rad[1])
        if not self._robot.send(MoveHead(clock.now_ns(), pan_rad, tilt_rad, self._actor)):
            return False
        self._state.look.set(replace(self._state.look.value, pan_rad=pan_rad, tilt_rad=tilt_rad))
        return True

    def _end_turn(self) -> None:
        self._pan = self._tilt = 0.0
        self._moving.stop()


def _unit(value: float) -> float:
    return min(max(value, -1.0), 1.0)
