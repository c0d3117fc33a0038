"""The picture that a recorded value speaks of."""

from caris_desktop.recording.replay.video_reader import Picture, VideoReader

# Neighbouring frames of the fastest cameras are 4 ms apart; a video rounds its times to 11 µs.
_SAME_FRAME_NS = 1_500_000


def picture_of(videos: VideoReader, camera: str, stamp_ns: int) -> Picture | None:
    """The frame of ``camera`` stamped ``stamp_ns``; None where the video lacks it. Quickest in the order of time."""
    info = videos.info_at(camera, stamp_ns + _SAME_FRAME_NS)
    if info is None or abs(info.stamp_ns - stamp_ns) > _SAME_FRAME_NS:
        return None
    return videos.frame(camera, info.number)
