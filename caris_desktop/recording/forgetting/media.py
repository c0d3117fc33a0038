"""Redaction of a person in media: covered areas in video and photos, silence in audio, over one session."""

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import no_room
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.media_checks import FILM_OPTIONS, PictureError, decoded
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, ROBOT_VOICE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.erasure_files import Journal
from caris_desktop.recording.forgetting.person_tracks import WHOLE, Area, PersonTracks, messages_of
from caris_desktop.recording.forgetting.text_erasure import AROUND_VISIT_NS
from caris_desktop.recording.photo_file import PEOPLE, PhotoFileError, texts_of, with_texts
from caris_desktop.recording.recorder.video_writer import MUXER, TICKS_PER_S, add_stream, x264
from caris_desktop.recording.session.media_files import FrameTimes, WavReader, frame_times_of, index_path
from caris_desktop.recording.session.session_conversation import SpokenUtterance
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_header import inside
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
# A single colour: the covered content cannot be reconstructed from it.
_COVER_BGR = (112, 112, 112)
ENCODER = x264("veryfast")
_COPIED_BYTES = 1 << 20


Cover = Callable[[NDArray[np.uint8]], None]
"""Covers people in an image in place: uint8, shape (height, width, 3) or as the photo has it."""


class UnreadableMediaError(Exception):
    """File without readable video, audio or image; the text is for people."""


def covered_video(
    source: Path,
    target: Path,
    first_stamp_ns: int,
    cover_at: Callable[[int], Cover | None],
    *,
    progress: Callable[[float], None],
) -> int:
    """Rewrite the video ``source`` to ``target``: same frames, times and key frames, each covered as ``cover_at`` its
    arrival says; None leaves it.

    Returns the number of frames covered in part or whole. Raises OSError, UnreadableMediaError.
    """
    import av

    covered, times = 0, frame_times_of(source)
    try:
        with DiskFile(target) as file, av.open(str(source), options=FILM_OPTIONS) as old:
            stream = old.streams.video[0]
            # An encoder for every player takes even sizes only.
            width_px, height_px = stream.codec_context.width // 2 * 2, stream.codec_context.height // 2 * 2
            count = max(1, times.count)
            new = av.open(file, "w", format="mp4", options=MUXER)
            written = add_stream(new, ENCODER, width_px, height_px)
            for number, frame in enumerate(old.decode(stream)):
                if frame.pts is None:
                    raise ValueError("its frames have no times")  # noqa: TRY301 - reported below, like its other errors
                at_s = float(frame.pts * frame.time_base)
                cover = cover_at(_stamp_of(times, number, at_s, first_stamp_ns))
                picture = frame
                if cover is not None:
                    image_bgr = frame.to_ndarray(format="bgr24")
                    cover(image_bgr)
                    picture = av.VideoFrame.from_ndarray(image_bgr, "bgr24")
                    picture.pts, picture.time_base = frame.pts, frame.time_base
                    covered += 1
                picture.pts = round(at_s * TICKS_PER_S)
                picture.time_base = Fraction(1, TICKS_PER_S)
                kinds = av.video.frame.PictureType
                picture.pict_type = kinds.I if frame.key_frame else kinds.NONE
                new.mux(written.encode(picture))
                progress(min(1.0, number / count))
            new.mux(written.encode(None))
            new.close()
            file.sync()
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        if isinstance(error, OSError) and no_room(error):
            raise
        raise UnreadableMediaError(
            localized(QT_TR_NOOP("{file} cannot be read as a video: {error}"), file=source.name, error=error)
        ) from error
    return covered


def _stamp_of(times: FrameTimes, number: int, at_s: float, first_stamp_ns: int) -> int:
    """Arrival time of a frame by its index line; the last frames of an interrupted recording may lack one."""
    if number < times.count:
        return int(times.stamps_ns[number])
    if times.count:
        return int(times.stamps_ns[-1]) + round((at_s - float(times.video_s[-1])) * 1e9)
    return first_stamp_ns + round(at_s * 1e9)


def covered_picture(source: Path, target: Path, cover: Cover) -> None:
    """Rewrite a photo covered, preserving its PNG texts and nothing else that is not a pixel.

    Raises OSError, UnreadableMediaError.
    """
    import cv2

    content = source.read_bytes()
    try:
        image = decoded(content, cv2.IMREAD_UNCHANGED)
    except PictureError as error:
        raise UnreadableMediaError(
            localized(QT_TR_NOOP("{file} cannot be read as an image"), file=source.name)
        ) from error
    if image.dtype != np.uint8:
        image = (image >> 8).astype(np.uint8)
    cover(image)
    done, coded = cv2.imencode(source.suffix.lower(), image)
    if not done:
        raise UnreadableMediaError(
            localized(QT_TR_NOOP("{file} cannot be written as an image again"), file=source.name)
        )
    written: bytes = coded.tobytes()
    try:
        written = with_texts(written, texts_of(content))
    except PhotoFileError:
        _log.debug("%s is no PNG: it tells nothing of itself", source)
    with DiskFile(target) as file:
        file.write(written)
        file.sync()


def cover_areas(areas: Iterable[Area], image: NDArray[np.uint8]) -> None:
    """Cover these areas in a single colour, in place."""
    height_px, width_px = image.shape[:2]
    for area in areas:
        left, top = int(area.left * width_px), int(area.top * height_px)
        right, bottom = -int(-area.right * width_px // 1), -int(-area.bottom * height_px // 1)
        if area == WHOLE:
            left, top, right, bottom = 0, 0, width_px, height_px
        part = image[max(0, top) : bottom, max(0, left) : right]
        part[...] = _COVER_BGR[: part.shape[2]] if part.ndim == 3 and part.shape[2] <= 3 else _COVER_BGR[0]


def opened_sound(path: Path) -> WavReader:
    """Reader of the WAV file ``path``. Raises OSError, UnreadableMediaError."""
    try:
        return WavReader(path)
    except ValueError as error:
        raise UnreadableMediaError(localized(QT_TR_NOOP("{file} contains no audio"), file=path.name)) from error


def silenced_sound(source: Path, target: Path, first_stamp_ns: int, spans_ns: Iterable[tuple[int, int]]) -> None:
    """Rewrite a WAV file with silence in these intervals. Raises OSError, UnreadableMediaError."""
    with opened_sound(source) as wav:
        begin, rate_hz, frame_bytes = wav.offset_bytes, wav.sample_rate_hz, 2 * wav.channels
    quiet = sorted(
        (
            begin + max(0, (from_ns - first_stamp_ns) * rate_hz // 1_000_000_000) * frame_bytes,
            begin + max(0, -((first_stamp_ns - until_ns) * rate_hz // 1_000_000_000)) * frame_bytes,
        )
        for from_ns, until_ns in spans_ns
    )
    with source.open("rb") as old, DiskFile(target) as file:
        at = 0
        while block := old.read(_COPIED_BYTES):
            changed = bytearray(block)
            for from_byte, until_byte in quiet:
                first, last = max(from_byte - at, 0), min(until_byte - at, len(block))
                if first < last:
                    changed[first:last] = bytes(last - first)
            file.write(bytes(changed))
            at += len(block)
        file.sync()


_PHOTO = "/event/photo_taken"
_ASIDE = ".deleted"
# A photo is the newest frame at its request, hence slightly older than the request.
PHOTO_NS = range(-700_000_000, 200_000_001, 100_000_000)
_SOUND_AROUND_NS = 300_000_000
# Speaking time per letter, where only the end of an utterance is known.
_SPEAKS_NS, _LEAST_SPOKEN_NS = 90_000_000, 2_000_000_000


class SessionMedia:
    """Media of one session, with its folder held. ``problems`` collects sentences on failures."""

    def __init__(self, session: Session, tracks: PersonTracks, person_ids: frozenset[str], journal: Journal) -> None:
        self._session = session
        self._folder = session.folder
        self._tracks = tracks
        self._ids = person_ids
        self._journal = journal
        self.problems: list[str] = []

    def treat_pictures(self, how: Literal["mask", "remove"], *, progress: Callable[[float, str], None]) -> None:
        """Redact video and photos. Raises OSError."""
        recorded = _recorded_entries(self._session, "videos")
        videos = [video for video in recorded if self._tracks.seen_by(str(video.get("camera")))]
        recorded_names = {str(video.get("file_name")) for video in recorded}
        for number, video in enumerate(videos):
            path = self._folder / str(video.get("file_name"))

            def report(done: float, *, number: int = number, name: str = path.name) -> None:
                progress((number + done) / len(videos), name)

            if path.is_file() and how == "remove":
                self._remove_video(path)
            elif path.is_file():
                self._cover_video(path, video, report)
        if self._tracks.any and isinstance(self._session.header.as_read.get("videos"), list):
            self._treat_other_videos(recorded_names)
        self._treat_photos(how)

    # Film

    def _cover_video(self, path: Path, video: dict[str, Any], progress: Callable[[float], None]) -> None:
        if self._journal.was_done(path, "video"):
            return
        first_stamp_ns = int(video.get("first_stamp_ns") or self._session.started_ns)

        def cover_at(at_ns: int) -> Cover | None:
            areas = self._tracks.areas_at(str(video.get("camera")), at_ns)
            return partial(cover_areas, areas) if areas else None

        cover = partial(covered_video, path, first_stamp_ns=first_stamp_ns, cover_at=cover_at, progress=progress)
        try:
            self._journal.replace(path, "video", cover)
        except UnreadableMediaError as error:
            self.problems.append(
                localized(
                    QT_TR_NOOP("{why}. It may show the person: remove the file, or try again with --remove-media."),
                    why=error,
                )
            )

    def _remove_video(self, path: Path) -> None:
        self._journal.remove(path, "video")
        index = index_path(path)
        if index.is_file():
            self._journal.remove(index, "video")

    def _treat_other_videos(self, recorded_names: set[str]) -> None:
        """Remove videos that a repair set aside: the times of their frames are unknown."""
        for path in sorted(self._folder.rglob("*")):
            film = path.suffix.lower() == ".mp4" and path.is_file() and not path.is_symlink()
            outside = path.relative_to(self._folder).parts[0].startswith("export-")
            if film and not outside and not (path.parent == self._folder and path.name in recorded_names):
                self._remove_video(path)

    # Photos

    def _treat_photos(self, how: Literal["mask", "remove"]) -> None:
        for path, areas in self._photos():
            if not areas or not path.is_file() or self._journal.was_done(path, "photo"):
                continue
            if how == "remove":
                self._journal.remove(path, "photo")
                continue
            try:
                self._journal.replace(path, "photo", partial(_covered, path, areas))
            except UnreadableMediaError as error:
                self.problems.append(localized(QT_TR_NOOP("{why}; it was removed."), why=error))
                self._journal.remove(path, "photo")

    def _photos(self) -> Iterator[tuple[Path, tuple[Area, ...]]]:
        """Each photo, with the person's areas in it."""
        recorded_paths: set[Path] = set()
        for photo in _photo_events(self._folder):
            path, camera, stamp_ns = self._folder / photo["file_name"], photo["camera"], photo["stamp_ns"]
            if not path.resolve().is_relative_to(self._folder.resolve()):
                continue
            recorded_paths.add(path)
            if not path.exists():
                path = path.with_name(_ASIDE) / path.name
                recorded_paths.add(path)
            areas = {area for since_ns in PHOTO_NS for area in self._tracks.areas_at(camera, stamp_ns + since_ns)}
            meant = (str(photo.get("person_id") or ""), *map(str, photo.get("person_ids") or ()))
            if not areas and self._ids.intersection(meant):
                areas = {WHOLE}
            yield path, tuple(sorted(areas))
        for path in photos_of(self._folder / "photos", self._ids):
            if path not in recorded_paths:
                yield path, (WHOLE,)

    # Sound

    def treat_sound(
        self, how: Literal["mask", "remove"], silent: frozenset[str], audible: Iterable[SpokenUtterance]
    ) -> None:
        """Silence the utterances ``silent``, in which the person spoke or was named, and all else that a participant's
        microphone recorded during their presence, except ``audible``. Raises OSError.
        """
        spans = [sound_span_of(utterance) for utterance in spoken(self._session) if utterance.utterance_id in silent]
        visits = [
            (from_ns - AROUND_VISIT_NS, until_ns + AROUND_VISIT_NS) for from_ns, until_ns in self._tracks.visits_ns
        ]
        exact = [
            (from_ns + _SOUND_AROUND_NS, to_ns - _SOUND_AROUND_NS) for from_ns, to_ns in map(sound_span_of, audible)
        ]
        theirs = _without_spans(visits, exact)
        for sound in _recorded_entries(self._session, "audio"):
            path = self._folder / str(sound.get("file_name"))
            if not path.is_file():
                continue
            if how == "remove" and self._tracks.any and sound.get("source") != ROBOT_VOICE:
                self._journal.remove(path, "sound")
                continue
            quiet = [*spans, *(theirs if sound.get("source") in PARTICIPANT_SOURCES else ())]
            if quiet:
                first_stamp_ns = int(sound.get("first_stamp_ns") or self._session.started_ns)
                try:
                    self._journal.replace(path, "sound", partial(_silenced, path, first_stamp_ns, quiet))
                except UnreadableMediaError as error:
                    self.problems.append(
                        localized(
                            QT_TR_NOOP(
                                "{why}. It may name the person: remove the file, or try again with --remove-media."
                            ),
                            why=error,
                        )
                    )


def examined_media(session: Session, tracks: PersonTracks | None) -> frozenset[Path]:
    """Media files for which the recording shows whether the person is in them. Raises OSError."""
    if tracks is None or not tracks.detections_ns:
        return frozenset()
    folder = session.folder

    def was_looked_at(entry: dict[str, Any]) -> bool:
        # A camera without detection is covered entirely while a person was present.
        return tracks.any or bool(tracks.detections_ns.get(str(entry.get("camera"))))

    media = [*filter(was_looked_at, _recorded_entries(session, "videos")), *_recorded_entries(session, "audio")]
    photos = [path for path in folder.rglob("*.png") if people_in(path)]
    for path in (folder / photo["file_name"] for photo in _photo_events(folder) if was_looked_at(photo)):
        photos += [path, path.with_name(_ASIDE) / path.name]
    return frozenset((*(folder / str(entry.get("file_name")) for entry in media), *photos))


def _recorded_entries(session: Session, section: str) -> list[dict[str, Any]]:
    """Entries of the session header on videos or audio in the session's folder."""
    entries = session.header.as_read.get(section)
    return [
        entry
        for entry in (entries if isinstance(entries, list) else ())
        if isinstance(entry, dict) and inside(session.folder, str(entry.get("file_name")))
    ]


def _photo_events(folder: Path) -> Iterator[dict[str, Any]]:
    """Recorded photos with their file, camera and time. Raises OSError."""
    for _, data in messages_of(folder / "events.mcap", lambda topic: topic == _PHOTO):
        with suppress(ValueError, KeyError, TypeError):
            photo = parse_json(data)
            known = {"file_name": str(photo["file_name"]), "camera": str(photo["camera"])}
            yield photo | known | {"stamp_ns": int(photo["stamp_ns"])}


def people_in(photo: Path) -> frozenset[str]:
    """Ids of the people that a photo lists. Raises OSError."""
    try:
        return frozenset(texts_of(photo.read_bytes()).get(PEOPLE, "").split())
    except PhotoFileError:
        return frozenset()


def photos_of(folder: Path, person_ids: frozenset[str]) -> list[Path]:
    """Photos in a folder that list one of these people. Raises OSError."""
    return [path for path in sorted(folder.rglob("*.png")) if not person_ids.isdisjoint(people_in(path))]


def _covered(path: Path, areas: tuple[Area, ...], part: Path) -> int:
    covered_picture(path, part, partial(cover_areas, areas))
    return len(areas)


def _silenced(path: Path, first_stamp_ns: int, spans: list[tuple[int, int]], part: Path) -> int:
    silenced_sound(path, part, first_stamp_ns, spans)
    return len(spans)


def _without_spans(spans: Iterable[tuple[int, int]], holes: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    left = list(spans)
    for from_ns, until_ns in holes:
        left = [
            part
            for begin_ns, end_ns in left
            for part in ((begin_ns, min(end_ns, from_ns)), (max(begin_ns, until_ns), end_ns))
            if part[0] < part[1]
        ]
    return left


def sound_span_of(utterance: SpokenUtterance) -> tuple[int, int]:
    """Session time of an utterance in a sound file, with a margin."""
    start_ns = utterance.start_ns if utterance.start_ns is not None else utterance.requested_ns or 0
    end_ns = utterance.end_ns if utterance.end_ns is not None else start_ns
    if end_ns <= start_ns:
        start_ns = end_ns - max(_LEAST_SPOKEN_NS, len(utterance.text) * _SPEAKS_NS)
    return start_ns - _SOUND_AROUND_NS, end_ns + _SOUND_AROUND_NS
