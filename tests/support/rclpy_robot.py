"""Robot on the real rclpy, for the Python of a ROS 2 installation: ``rclpy_robot.py LOG``.

It logs what it executes: velocities, emergency stops, and how goals of ``/spin`` (test_msgs/action/Fibonacci) end,
which turn the robot until they are cancelled. ``/refuse`` refuses goals, ``/slow`` answers after ten seconds. Odometry
and scan are sent with best effort, the map lasts. It ends with its standard input.
"""

import json
import math
import os
import sys
import threading
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from test_msgs.action import Fibonacci

EVERY_S, SCAN_EVERY = 1 / 30, 3
SPIN_RADPS = 0.4


class Robot(Node):
    def __init__(self, log: str) -> None:
        super().__init__("robot")
        self._log = Path(log).open("a", buffering=1)  # noqa: SIM115 - until the end
        group = ReentrantCallbackGroup()
        self._v_mps = self._w_radps = self._x_m = self._heading_rad = 0.0
        self._spinning = 0
        self._count = 0
        self.create_subscription(Twist, "/cmd_vel", self._on_velocity, 10)
        self.create_subscription(String, "/tts", lambda message: self._write(said=message.data), 10)
        self._odometry = self.create_publisher(Odometry, "/odom", qos_profile_sensor_data)
        self._scan = self.create_publisher(LaserScan, "/scan", qos_profile_sensor_data)
        lasting = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._map = self.create_publisher(OccupancyGrid, "/map", lasting)
        grid = OccupancyGrid()
        grid.header.frame_id = "map"
        grid.info.resolution, grid.info.width, grid.info.height = 0.05, 40, 40
        grid.info.origin.orientation.w = 1.0
        grid.data = [0] * 1600
        self._map.publish(grid)
        self.create_service(SetBool, "/e_stop", self._on_stop, callback_group=group)
        self.create_service(Trigger, "/slow", self._on_slow, callback_group=group)
        ActionServer(
            self,
            Fibonacci,
            "/spin",
            self._spin,
            callback_group=group,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )
        ActionServer(
            self, Fibonacci, "/refuse", self._spin, callback_group=group,
            goal_callback=lambda _goal: GoalResponse.REJECT,
        )  # fmt: skip
        self.create_timer(EVERY_S, self._step)

    def _write(self, **line: object) -> None:
        self._log.write(json.dumps({"at_ns": time.monotonic_ns(), **line}) + "\n")

    def _on_velocity(self, message: Twist) -> None:
        self._v_mps, self._w_radps = message.linear.x, message.angular.z
        self._write(velocity=[message.linear.x, message.angular.z])

    def _on_stop(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._write(stop=request.data)
        response.success = True
        return response

    def _on_slow(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        time.sleep(10.0)
        response.success = True
        return response

    def _spin(self, goal: object) -> Fibonacci.Result:
        self._spinning += 1
        self._write(goal="begun")
        try:
            while not goal.is_cancel_requested:  # type: ignore[attr-defined]
                goal.publish_feedback(Fibonacci.Feedback(sequence=[1, 2]))  # type: ignore[attr-defined]
                time.sleep(0.02)
            goal.canceled()  # type: ignore[attr-defined]
        finally:
            self._spinning -= 1
            self._write(goal="cancelled")
        return Fibonacci.Result(sequence=[3])

    def _step(self) -> None:
        turn_radps = self._w_radps + (SPIN_RADPS if self._spinning else 0.0)
        self._heading_rad += turn_radps * EVERY_S
        self._x_m += self._v_mps * EVERY_S
        self._count += 1
        odometry = Odometry()
        odometry.header.stamp = self.get_clock().now().to_msg()
        odometry.header.frame_id, odometry.child_frame_id = "odom", "base_link"
        odometry.pose.pose.position.x = self._x_m
        odometry.pose.pose.orientation.z = math.sin(self._heading_rad / 2)
        odometry.pose.pose.orientation.w = math.cos(self._heading_rad / 2)
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self._v_mps, turn_radps
        self._odometry.publish(odometry)
        if self._count % SCAN_EVERY == 0:
            scan = LaserScan(range_min=0.1, range_max=20.0, angle_min=-math.pi, angle_max=math.pi)
            scan.header.stamp, scan.header.frame_id = odometry.header.stamp, "base_link"
            scan.angle_increment = 2 * math.pi / 360
            scan.ranges = [math.inf if beam % 50 == 0 else 9.0 for beam in range(360)]
            self._scan.publish(scan)


def main() -> None:
    rclpy.init(args=[])
    executor = MultiThreadedExecutor(8)
    executor.add_node(Robot(sys.argv[1]))
    threading.Thread(target=executor.spin, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()
