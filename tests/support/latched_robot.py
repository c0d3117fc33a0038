"""Robot that publishes its map, camera info, odometry, pose and static transforms once, latched.

``python -m tests.support.latched_robot`` prints its address, and exits at the end of its standard input.
"""

import asyncio
import sys

import numpy as np

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import OccupancyGrid, Odometry
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect
from caris_desktop.simulator.ros_context import offer_rosapi
from caris_desktop.simulator.server import ROBOT_NODE, BridgeServer, Message, Topic

READY = "Latched robot ready at "
STAMP_NS = 7_000_000_000
PROFILE = """\
version: 1
ros: 1
velocity: {topic: /cmd_vel}
odometry: {topic: /odom, latched: true}
pose: {topic: /amcl_pose, latched: true}
tf_static: {topic: /tf_static}
map: {topic: /map}
cameras: [{name: front, topic: /image/compressed, info: /camera_info}]
"""


def latched_messages() -> dict[str, tuple[str, Message]]:
    ros, here = Dialect.ROS1, Pose2D(1.0, 2.0, 0.5)
    grid = OccupancyGrid(0, None, 0.05, Pose2D(-1.0, -2.0, 0.0), np.zeros((200, 300), np.int8))
    odometry = Odometry(0, None, here, Twist2D())
    return {
        "/map": ("nav_msgs/OccupancyGrid", message_conversion.encode_occupancy_grid(ros, grid, stamp_ns=STAMP_NS)),
        "/odom": ("nav_msgs/Odometry", message_conversion.encode_odometry(ros, odometry, stamp_ns=STAMP_NS)),
        "/amcl_pose": (
            "geometry_msgs/PoseWithCovarianceStamped",
            message_conversion.encode_pose_with_covariance_stamped(ros, here, stamp_ns=STAMP_NS),
        ),
        "/tf_static": (
            "tf2_msgs/TFMessage",
            message_conversion.encode_tf_message(ros, [("base_link", "laser", here)], stamp_ns=STAMP_NS),
        ),
        "/camera_info": (
            "sensor_msgs/CameraInfo",
            message_conversion.encode_camera_info(
                ros, CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0), stamp_ns=STAMP_NS
            ),
        ),
    }


async def serve() -> None:
    server = BridgeServer(Dialect.ROS1)
    offer_rosapi(server, Dialect.ROS1)
    for name, (kind, message) in latched_messages().items():
        server.topics[name] = Topic(kind, latched=True, publishers={ROBOT_NODE})
        server.publish(name, message)
    port = await server.start("127.0.0.1", 0)
    sys.stdout.write(f"{READY}ws://127.0.0.1:{port}\n")
    sys.stdout.flush()
    await asyncio.to_thread(sys.stdin.read)
    await server.stop()


if __name__ == "__main__":
    asyncio.run(serve())
