"""Missing data of a session as sentences for reports, where a gap must not look like silence."""

from collections import Counter

from caris_desktop.domain.events import Gap, LinkQuality
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.recording.measures.session_measures import Measures
from caris_desktop.recording.session.session_data import SessionData

_MAX_STREAMS = 8
_STREAMS = {
    "frame": "video frames",
    "audio": "audio chunks",
    "scan": "LIDAR scans",
    "odometry": "odometry values",
    "pose": "poses",
    "map": "maps",
    "people": "lists of people in view",
    "transcription": "audio chunks for the transcript",
}


def data_quality_problems(facts: SessionData, measures: Measures) -> tuple[str, ...]:
    """A sentence for each kind of missing data; empty if the recording is complete."""
    session = facts.session
    sentences = []
    if not session.closed_properly:
        sentences.append("The recording was cut off: everything after the last saved value is missing.")
    sentences += [*session.header.repairs, *session.losses]
    sentences += _lost_since(facts)
    if session.reason == "disk_full":
        sentences.append("The recording ended because the disk was full.")
    if pauses := measures["pauses"]:
        times = "once" if pauses == 1 else f"{pauses} times"
        sentences.append(f"The recording was paused {times}, for {measures['paused_s']:.1f} s in total.")
    sentences += _gaps(facts)
    if not any(utterance.said and utterance.speaker == "participant" for utterance in facts.utterances):
        sentences.append("The recording contains no participant speech, so there are no response times.")
    if not _has_recording(facts, "videos", "video-*"):
        sentences.append("There is no video.")
    if not _has_recording(facts, "audio", "audio-*"):
        sentences.append("There is no audio.")
    if not facts.of(Odometry):
        sentences.append(
            (
                "The robot reported no odometry: the distance is unknown, because the pose in the map jumps with "
                "each correction."
            )
            if facts.of(RobotPose)
            else "The robot reported neither odometry nor pose: there is no distance and no trajectory."
        )
    if all(quality.clock_offset_ms is None for quality in facts.of(LinkQuality)):
        sentences.append("The offset of the robot's clock was not measured: the robot's timestamps cannot be compared.")
    return tuple(sentences)


def stream_words(stream: str) -> str:
    """Name of a stream's values for display."""
    return _STREAMS.get(stream, f"values of {stream.removeprefix('event/').replace('_', ' ')}")


def _lost_since(facts: SessionData) -> list[str]:
    lost = facts.session.lost
    if not lost:
        return []
    named = [f"{count} {stream_words(stream)}" for stream, count in sorted(lost.items(), key=lambda entry: -entry[1])]
    rest = f" and values of {len(named) - _MAX_STREAMS} other kinds" if len(named) > _MAX_STREAMS else ""
    return [f"Missing from the recording: {', '.join(named[:_MAX_STREAMS])}{rest}."]


def _gaps(facts: SessionData) -> list[str]:
    missing: Counter[tuple[str, str]] = Counter()
    for gap in facts.of(Gap):
        missing[(gap.stream, gap.reason)] += gap.count
    return [f"{count} {stream_words(stream)} are missing: {reason}." for (stream, reason), count in missing.items()]


def _has_recording(facts: SessionData, header_key: str, pattern: str) -> bool:
    return bool(getattr(facts.session.header, header_key)) or any(facts.session.folder.glob(pattern))
