"""Robot for CARIS Desktop: a dot that moves as it is told, behind no ROS at all."""

import math
import threading
import time

EVERY_S = 0.05


class DotRobot:
    """The contract is ``caris_desktop.robot.bridge_server.Robot``."""

    caris_interface = 1

    def __init__(self, target):
        self._x_m = self._y_m = self._heading_rad = self._forward_mps = self._turn_radps = 0.0
        self._deliver = []
        self._ended = threading.Event()
        threading.Thread(target=self._move, daemon=True).start()

    def interfaces(self):
        topics = {"/cmd_vel": "geometry_msgs/msg/Twist", "/odom": "nav_msgs/msg/Odometry"}
        return {"topics": topics, "services": {}, "actions": {}}

    def subscribe(self, topic, type_name, deliver, queue_length):
        if topic == "/odom":
            self._deliver.append(deliver)
        return lambda: deliver in self._deliver and self._deliver.remove(deliver)

    def publish(self, topic, type_name, message, *, latch):
        if topic == "/cmd_vel" and message is not None:
            self._forward_mps = message.get("linear", {}).get("x", 0.0)
            self._turn_radps = message.get("angular", {}).get("z", 0.0)

    def call(self, service, request, timeout_s):
        raise LookupError(f"{service} does not exist")

    def run_goal(self, action, type_name, goal, feedback, cancelled):
        raise LookupError(f"{action} does not exist")

    def close(self):
        self._ended.set()

    def _move(self):
        while not self._ended.wait(EVERY_S):
            self._heading_rad += self._turn_radps * EVERY_S
            self._x_m += self._forward_mps * math.cos(self._heading_rad) * EVERY_S
            self._y_m += self._forward_mps * math.sin(self._heading_rad) * EVERY_S
            half_rad, none = self._heading_rad / 2, {"x": 0.0, "y": 0.0, "z": 0.0}
            turned = none | {"z": math.sin(half_rad), "w": math.cos(half_rad)}
            pose = {"position": none | {"x": self._x_m, "y": self._y_m}, "orientation": turned}
            twist = {"linear": none | {"x": self._forward_mps}, "angular": none | {"z": self._turn_radps}}
            stamp = {"sec": int(time.time()), "nanosec": time.time_ns() % 10**9}
            message = {
                "header": {"stamp": stamp, "frame_id": "odom"},
                "pose": {"pose": pose},
                "twist": {"twist": twist},
            }
            for deliver in list(self._deliver):
                deliver(message)
