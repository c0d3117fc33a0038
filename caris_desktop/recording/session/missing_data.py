"""Missing data of a session: differences between its header and its files."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from caris_desktop.domain.json_encoding import DERIVED_TOPICS
from caris_desktop.domain.streams import spec_of_topic
from caris_desktop.domain.translation import localized
from caris_desktop.recording.session import mcap_chunks
from caris_desktop.recording.session import repair_messages as words
from caris_desktop.recording.session.media_repair import content_of
from caris_desktop.recording.session.progress_counts import counts_of

_EVENTS = "events.mcap"
_MAX_TOLD = 5


def losses_of(folder: Path, header: Mapping[str, Any], missing: Mapping[str, int]) -> tuple[str, ...]:
    """A sentence for each known data loss; empty if there is none.

    Includes the findings of a repair, :func:`missing values <missing_values>`, and files that are missing or shorter
    than at the close. Other changes are a matter of checksums.
    """
    return (*recorded_losses(header), *missing_words(header, missing), *files_lacking(folder, header))


def missing_words(header: Mapping[str, Any], missing: Mapping[str, int]) -> tuple[str, ...]:
    """Sentence on the number of missing values; empty if none are."""
    count = sum(missing.values())
    if not count:
        return ()
    recorded = max(count, (counts_of(header.get("counts")) or Counter()).total())
    return (localized(words.lost_values_words(count, broken=False, early=False), recorded=recorded),)


def missing_values(folder: Path, header: Mapping[str, Any]) -> Counter[str]:
    """Missing values per stream: counted in the header of a closed session and no longer in its log.

    Excludes those that a repair found missing, since it counted the rest. Raises OSError.
    """
    expected = counts_of(header.get("counts"))
    if header.get("ended_ns") is None or expected is None:
        return Counter()
    return expected - _values_in(folder / _EVENTS, expected)


def _values_in(path: Path, named: Counter[str]) -> Counter[str]:
    """Readable values per stream; unknown streams by the names in ``named``."""
    index = mcap_chunks.read_index(path)
    of_channel: Counter[int] = Counter()
    with path.open("rb") as file:
        for number in range(index.count):
            try:
                of_channel.update(mcap_chunks.channels_in(mcap_chunks.read_block(file, index, number)))
            except mcap_chunks.DamagedBlockError:
                continue
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


def recorded_losses(header: Mapping[str, Any]) -> tuple[str, ...]:
    """Missing data found by a repair, as sentences."""
    losses = header.get("losses")
    return tuple(words.read_loss(str(sentence)) for sentence in losses) if isinstance(losses, list) else ()


def lost_values(header: Mapping[str, Any]) -> dict[str, int]:
    """Number of lost values per stream, as found by a repair."""
    counts = header.get("lost")
    if not isinstance(counts, dict):
        return {}
    return {str(name): count for name, count in counts.items() if isinstance(count, int) and count > 0}


def files_lacking(folder: Path, header: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for each file that is missing or shorter than the header of a closed session says."""
    if header.get("ended_ns") is None:
        return ()
    sentences: list[str] = []
    others: list[str] = []
    for name, recorded_bytes in _recorded_files(header):
        path = folder / name
        try:
            found_bytes = path.stat().st_size
        except (OSError, ValueError):
            found_bytes = -1
        if found_bytes >= recorded_bytes:
            continue
        problem = _medium(path, header, found_bytes, recorded_bytes)
        if problem:
            sentences.append(problem)
        else:
            left = words.FILE_MISSING if found_bytes < 0 else words.FILE_SHORTER
            others.append(localized(left, file=name, left=found_bytes, all=recorded_bytes))
    sentences += others[:_MAX_TOLD]
    if len(others) > _MAX_TOLD:
        sentences.append(words.further_files_words(len(others) - _MAX_TOLD))
    return tuple(sentences)


def recorded_bytes_of(header: Mapping[str, Any], name: str) -> int | None:
    """Size of a file when the session was closed; None if the header lacks it."""
    return next((size for recorded, size in _recorded_files(header) if recorded == name), None)


def _recorded_files(header: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    files = header.get("files")
    for entry in files if isinstance(files, list) else ():
        if not isinstance(entry, dict):
            continue
        name, size = entry.get("name"), entry.get("bytes")
        if not isinstance(name, str) or not isinstance(size, int) or not name:
            continue
        pure = PurePosixPath(name)
        if not pure.is_absolute() and ".." not in pure.parts:
            yield name, size


def _medium(path: Path, header: Mapping[str, Any], found_bytes: int, recorded_bytes: int) -> str:
    """Loss of a video or audio file in frames and seconds; empty for other files."""
    video = _entry(header, "videos", path.name)
    if video is not None:
        values = {"file": path.name, "count": video.get("frames"), "camera": video.get("camera")}
        if found_bytes < 0:
            return localized(words.VIDEO_MISSING, **values)
        content = content_of(path)
        left = 0 if content is None else len(content.times_s)
        return localized(words.pictures_left_words(left), **values)
    sound = _entry(header, "audio", path.name)
    if sound is None:
        return ""
    try:
        lasts_s = float(sound["samples"]) / float(sound["sample_rate_hz"])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        lasts_s = 0.0
    if found_bytes < 0:
        return localized(words.SOUND_MISSING, file=path.name, seconds=f"{lasts_s:.1f}")
    left_s = lasts_s * found_bytes / max(1, recorded_bytes)
    return localized(words.SOUND_CUT_OFF, file=path.name, seconds=f"{lasts_s:.1f}", left=f"{left_s:.1f}")


def _entry(header: Mapping[str, Any], key: str, file_name: str) -> dict[str, Any] | None:
    entries = header.get(key)
    for entry in entries if isinstance(entries, list) else ():
        if isinstance(entry, dict) and entry.get("file_name") == file_name:
            return entry
    return None
