"""The link processes: what runs in the children that hold the sockets to the robot."""

from dataclasses import dataclass
from multiprocessing.connection import Connection

from caris_desktop.domain.ports import FrameWriter
from caris_desktop.robot.profile import RobotProfile


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """What a link process is started with. ``address`` replaces the profile's own."""

    profile: RobotProfile
    address: str


def run_control_link(connection: Connection, settings: LinkSettings) -> None:
    """Body of the control link process.

    Takes ``domain.commands`` values from ``connection`` and sends ``domain`` values back. Returns after CloseLink or
    when the other end of ``connection`` is gone.
    """
    raise NotImplementedError


def run_media_link(connection: Connection, settings: LinkSettings, frames: FrameWriter) -> None:
    """Body of the media link process: camera frames into ``frames``, FrameRef and OccupancyGrid over ``connection``."""
    raise NotImplementedError


def check_robot(profile: RobotProfile, address: str, timeout_s: float = 5.0) -> list[str]:
    """What is wrong with the robot at ``address``, one sentence for the wizard each; empty when all is well."""
    raise NotImplementedError
