"""Discovery of cameras connected to this computer."""

import re
from pathlib import Path

from caris_desktop.perception.cameras.oak_camera import oak_devices

_V4L = Path("/sys/class/video4linux")


def found_cameras(v4l: Path = _V4L) -> list[str]:
    """Selection strings, with names where known: ``0 (HD Webcam)``, ``oak:14442C10D13EABCE00``."""
    return [*_devices(v4l), *(f"oak:{device}" for device in oak_devices())]


def _devices(v4l: Path) -> list[str]:
    """Video4Linux devices. A camera has several nodes; the one with index 0 delivers images."""
    found = {}
    for folder in v4l.glob("video*"):
        number = re.fullmatch(r"video(\d+)", folder.name)
        try:
            if number is not None and (folder / "index").read_text().strip() == "0":
                found[int(number[1])] = (folder / "name").read_text().strip()
        except OSError:
            continue
    return [f"{number} ({name})" if name else str(number) for number, name in sorted(found.items())]
