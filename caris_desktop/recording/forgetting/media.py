"""Redaction of people in media files: covered areas in video and photos, silence in audio."""

import logging
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import no_room
from caris_desktop.domain.picture_checks import PictureError, decoded
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.video_files import FILM_OPTIONS
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.person_tracks import WHOLE, Area
from caris_desktop.recording.photo_file import PhotoFileError, texts_of, with_texts
from caris_desktop.recording.recorder.video_encoders import MUXER, TICKS_PER_S, add_stream, x264
from caris_desktop.recording.session.media_files import FrameTimes, wav_layout

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
    times: FrameTimes,
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

    covered = 0
    file = DiskFile(target)
    try:
        with av.open(str(source), options=FILM_OPTIONS) as old:
            stream = old.streams.video[0]
            width_px, height_px = stream.codec_context.width, stream.codec_context.height
            count = max(1, times.count)
            new = av.open(file, "w", format="mp4", options=MUXER)
            written = add_stream(new, ENCODER, width_px, height_px)
            for number, frame in enumerate(old.decode(stream)):
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
    finally:
        file.close()
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
    file = DiskFile(target)
    try:
        file.write(written)
        file.sync()
    finally:
        file.close()


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


def silenced_sound(source: Path, target: Path, first_stamp_ns: int, spans_ns: Iterable[tuple[int, int]]) -> None:
    """Rewrite a WAV file with silence in these intervals. Raises OSError, UnreadableMediaError."""
    with source.open("rb") as old:
        try:
            wav = wav_layout(old)
        except ValueError as error:
            raise UnreadableMediaError(localized(QT_TR_NOOP("{file} contains no audio"), file=source.name)) from error
        begin, rate_hz, frame_bytes = wav.offset_bytes, wav.sample_rate_hz, wav.frame_bytes
        quiet = sorted(
            (
                begin + max(0, (from_ns - first_stamp_ns) * rate_hz // 1_000_000_000) * frame_bytes,
                begin + max(0, -((first_stamp_ns - until_ns) * rate_hz // 1_000_000_000)) * frame_bytes,
            )
            for from_ns, until_ns in spans_ns
        )
        file = DiskFile(target)
        try:
            old.seek(0)
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
        finally:
            file.close()
