"""Missing data of a session: differences between its header and its files."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from caris_desktop.domain.json_encoding import DERIVED_TOPICS
from caris_desktop.domain.streams import spec_of_topic
from caris_desktop.domain.translation import localized
from caris_desktop.recording.session import mcap_chunks
from caris_desktop.recording.session import repair_messages as words
from caris_desktop.recording.session.media_repair import content_of
from caris_desktop.recording.session.session_header import SessionHeader

_EVENTS = "events.mcap"
_MAX_TOLD = 5


def losses_of(folder: Path, header: SessionHeader, missing: Mapping[str, int]) -> tuple[str, ...]:
    """A sentence for each known data loss; empty if there is none.

    Includes the findings of a repair, :func:`missing values <missing_values>`, and files that are missing or shorter
    than at the close. Other changes are a matter of checksums.
    """
    return (*header.losses, *missing_words(header, missing), *_files_lacking(folder, header))


def missing_words(header: SessionHeader, missing: Mapping[str, int]) -> tuple[str, ...]:
    """Sentence on the number of missing values; empty if none are."""
    count = sum(missing.values())
    if not count:
        return ()
    recorded = max(count, sum(header.counts.values()))
    return (localized(words.lost_values_words(count, broken=False, early=False), recorded=recorded),)


def missing_values(folder: Path, header: SessionHeader) -> Counter[str]:
    """Missing values per stream: counted in the header of a closed session and no longer in its log.

    Excludes those that a repair found missing, since it counted the rest. Raises OSError.
    """
    if header.ended_ns is None or not header.counts:
        return Counter()
    expected = Counter(header.counts)
    return expected - _values_in(folder / _EVENTS, expected)


def _values_in(path: Path, named: Counter[str]) -> Counter[str]:
    """Readable values per stream; unknown streams by the names in ``named``."""
    index = mcap_chunks.read_index(path)
    of_channel: Counter[int] = Counter()
    with path.open("rb") as file:
        for content in mcap_chunks.intact_blocks(file, index):
            of_channel.update(mcap_chunks.channels_in(content))
    found: Counter[str] = Counter()
    for channel, count in of_channel.items():
        its = index.channels.get(channel)
        if its is None or its.topic in DERIVED_TOPICS:
            continue
        spec = spec_of_topic(its.topic)
        name = its.topic.removeprefix("/") if spec is None else spec.name
        if spec is None:
            name = next((one for one in named if name.startswith(f"{one}/")), name)
        found[name] += count
    return found


def _files_lacking(folder: Path, header: SessionHeader) -> tuple[str, ...]:
    """A sentence for each file that is missing or shorter than the header of a closed session says."""
    sentences: list[str] = []
    others: list[str] = []
    for recorded in header.files if header.ended_ns is not None else ():
        pure = PurePosixPath(recorded.name)
        if not recorded.name or pure.is_absolute() or ".." in pure.parts:
            continue
        path = folder / recorded.name
        try:
            found_bytes = path.stat().st_size
        except (OSError, ValueError):
            found_bytes = -1
        if found_bytes >= recorded.bytes:
            continue
        problem = _medium(path, header, found_bytes, recorded.bytes)
        if problem:
            sentences.append(problem)
        else:
            left = words.FILE_MISSING if found_bytes < 0 else words.FILE_SHORTER
            others.append(localized(left, file=recorded.name, left=found_bytes, all=recorded.bytes))
    sentences += others[:_MAX_TOLD]
    if len(others) > _MAX_TOLD:
        sentences.append(words.further_files_words(len(others) - _MAX_TOLD))
    return tuple(sentences)


def _medium(path: Path, header: SessionHeader, found_bytes: int, recorded_bytes: int) -> str:
    """Loss of a video or audio file in frames and seconds; empty for other files."""
    for video in header.videos:
        if video.file_name == path.name:
            content = content_of(path) if found_bytes >= 0 else None
            left = 0 if content is None else len(content.times_s)
            message = words.VIDEO_MISSING if found_bytes < 0 else words.pictures_left_words(left)
            return localized(message, file=path.name, count=video.frames, camera=video.camera)
    for sound in header.audio:
        if sound.file_name == path.name:
            lasts_s = sound.samples / max(1, sound.sample_rate_hz)
            left_s = lasts_s * found_bytes / max(1, recorded_bytes)
            message = words.SOUND_MISSING if found_bytes < 0 else words.SOUND_CUT_OFF
            return localized(message, file=path.name, seconds=f"{lasts_s:.1f}", left=f"{left_s:.1f}")
    return ""
