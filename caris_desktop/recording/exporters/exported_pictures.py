"""Video frames that recorded values refer to, and a rate limit on them."""

from caris_desktop.recording.replay.video_reader import RecordedFrame, VideoPicture, VideoReader
from caris_desktop.recording.session.media_files import in_file_names

# Neighbouring frames of the fastest cameras are 4 ms apart; a video rounds its times to 11 µs.
_SAME_FRAME_NS = 1_500_000


def info_of(videos: VideoReader, camera: str, stamp_ns: int) -> RecordedFrame | None:
    """Info of the frame of ``camera`` stamped ``stamp_ns``; None if the video lacks it."""
    info = videos.info_at(camera, stamp_ns + _SAME_FRAME_NS)
    return None if info is None or abs(info.stamp_ns - stamp_ns) > _SAME_FRAME_NS else info


def picture_of(videos: VideoReader, camera: str, stamp_ns: int) -> VideoPicture | None:
    """Frame of ``camera`` stamped ``stamp_ns``; None if the video lacks it. Fastest in order of time."""
    info = info_of(videos, camera, stamp_ns)
    return None if info is None else videos.frame(camera, info.number)


def camera_file_name(camera: str) -> str:
    """Camera name as part of a file name."""
    return in_file_names(camera) or "camera"


class Pace:
    """Rate limit per camera; unlimited if ``most_hz`` is None."""

    def __init__(self, most_hz: float | None) -> None:
        self._every_ns = 0 if most_hz is None else round(1e9 / most_hz)
        self._due_ns: dict[str, int] = {}

    def is_due(self, camera: str, stamp_ns: int) -> bool:
        return stamp_ns >= self._due_ns.get(camera, stamp_ns)

    def take(self, camera: str, stamp_ns: int) -> None:
        """Count this moment."""
        # Half a period of slack, so that a camera of the same rate is not halved by its jitter.
        steady_ns = self._due_ns.get(camera, 0) + self._every_ns
        self._due_ns[camera] = max(steady_ns, stamp_ns + self._every_ns // 2)
