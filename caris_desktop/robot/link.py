"""Entry points of the link processes, which hold the sockets to the robot.

The console imports this module, so heavy imports happen in the processes only.
"""

import os
from multiprocessing.connection import Connection

from caris_desktop.domain.ports import FrameWriter
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import RobotProfile

MOST_PIXELS = 2**24
_CHECKED_WITHIN_S = 5.0


class LinkSettings(Value):
    """Settings of a link process. ``address`` overrides the profile's.

    ``follows_crash``: the previous process crashed, so the robot may still have its goals.
    """

    profile: RobotProfile
    address: str
    follows_crash: bool = False


def run_control_link(connection: Connection, settings: LinkSettings) -> None:
    """Entry point of the control link process.

    Receives ``domain.link_commands`` values from ``connection`` and sends ``domain`` values. Returns after CloseLink or
    when ``connection`` closes; in both cases the robot is stopped first.
    """
    from caris_desktop.robot.control_link import ControlLink
    from caris_desktop.robot.link_process import run_link
    from caris_desktop.robot.real_time import request_realtime_priority

    request_realtime_priority()
    run_link(
        connection,
        lambda outbox: ControlLink(settings.profile, settings.address, outbox, follows_crash=settings.follows_crash),
    )


def run_media_link(connection: Connection, settings: LinkSettings, frames: FrameWriter) -> None:
    """Entry point of the media link process: camera frames into ``frames``, FrameRef and OccupancyGrid over
    ``connection``.

    Its only command is CloseLink.
    """
    # Read by OpenCV at import: a small file must not decode to gigabytes of pixels.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
    from caris_desktop.robot.link_process import run_link
    from caris_desktop.robot.media_link import MediaLink

    run_link(connection, lambda outbox: MediaLink(settings.profile, settings.address, outbox, frames))


def check_robot(profile: RobotProfile, address: str) -> list[str]:
    """Problems of the robot at ``address``, one sentence each for the wizard; empty if there are none.

    Blocks for up to 12 s and must not be called from a running asyncio loop.
    """
    import asyncio

    from caris_desktop.robot.robot_checks import check

    return asyncio.run(check(profile, address, _CHECKED_WITHIN_S))


def robot_queue_advice(profile: RobotProfile, address: str) -> str:
    """Advice on a rosbridge that handles operations sequentially; else empty. Blocks."""
    import asyncio

    from caris_desktop.robot.robot_checks import queue_advice

    return asyncio.run(queue_advice(profile, address, _CHECKED_WITHIN_S))
