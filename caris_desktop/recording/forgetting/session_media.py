"""Redaction of a person in the video, audio and photos of one session."""

import logging
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, ROBOT_VOICE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.forgetting import media
from caris_desktop.recording.forgetting.journal import Journal
from caris_desktop.recording.forgetting.media import UnreadableMediaError
from caris_desktop.recording.forgetting.person_tracks import WHOLE, Area, PersonTracks, messages_of
from caris_desktop.recording.forgetting.speech_erasure import AROUND_VISIT_NS
from caris_desktop.recording.photo_file import PEOPLE, PhotoFileError, texts_of
from caris_desktop.recording.session.media_files import FrameTimes, index_path, read_frame_times
from caris_desktop.recording.session.session_conversation import SpokenUtterance, spoken
from caris_desktop.recording.session.session_header import inside
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
_PHOTO = "/event/photo_taken"
_ASIDE = ".deleted"
# A photo is the newest frame at its request, hence slightly older than the request.
_PHOTO_FROM_NS, _PHOTO_UNTIL_NS, _PHOTO_STEP_NS = -700_000_000, 200_000_000, 100_000_000
_SOUND_AROUND_NS = 300_000_000
# Speaking time per letter, where only the end of an utterance is known.
_SPEAKS_NS, _LEAST_SPOKEN_NS = 90_000_000, 2_000_000_000
_FILM = (".mp4",)


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
        videos = [video for video in self._recorded_entries("videos") if self._tracks.seen_by(str(video.get("camera")))]
        recorded_names = {str(video.get("file_name")) for video in self._recorded_entries("videos")}
        for number, video in enumerate(videos):
            path = self._folder / str(video.get("file_name"))
            if not path.is_file():
                continue
            if how == "remove":
                self._remove_video(path)
            else:

                def report(done: float, *, number: int = number, name: str = path.name) -> None:
                    progress((number + done) / len(videos), name)

                self._cover_video(path, video, report)
        if self._tracks.any and isinstance(self._session.header.as_read.get("videos"), list):
            self._treat_other_videos(recorded_names)
        self._treat_photos(how)

    def _recorded_entries(self, section: str) -> list[dict[str, Any]]:
        entries = self._session.header.as_read.get(section)
        return [
            entry
            for entry in (entries if isinstance(entries, list) else ())
            if isinstance(entry, dict) and inside(self._folder, str(entry.get("file_name")))
        ]

    # Film

    def _cover_video(self, path: Path, video: dict[str, Any], progress: Callable[[float], None]) -> None:
        if self._journal.was_done(path, "video"):
            return
        camera = str(video.get("camera"))
        try:
            times = read_frame_times(index_path(path))
        except (OSError, ValueError) as error:
            _log.warning("%s: %s", path, error)
            times = FrameTimes.none()
        first_stamp_ns = int(video.get("first_stamp_ns") or self._session.started_ns)
        try:
            self._journal.replace(
                path,
                "video",
                lambda part: media.covered_video(
                    path,
                    part,
                    times,
                    first_stamp_ns,
                    lambda at_ns: _cover_of(self._tracks.areas_at(camera, at_ns)),
                    progress=progress,
                ),
            )
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
            film = path.suffix.lower() in _FILM and path.is_file() and not path.is_symlink()
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
        for _, data in messages_of(self._folder / "events.mcap", lambda topic: topic == _PHOTO):
            try:
                photo = parse_json(data)
                path = self._folder / str(photo["file_name"])
                stamp_ns, camera = int(photo["stamp_ns"]), str(photo["camera"])
            except (ValueError, KeyError, TypeError):
                continue
            if not path.resolve().is_relative_to(self._folder.resolve()):
                continue
            recorded_paths.add(path)
            if not path.exists():
                path = path.with_name(_ASIDE) / path.name
                recorded_paths.add(path)
            moments = range(stamp_ns + _PHOTO_FROM_NS, stamp_ns + _PHOTO_UNTIL_NS + 1, _PHOTO_STEP_NS)
            areas = {area for at_ns in moments for area in self._tracks.areas_at(camera, at_ns)}
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
        theirs = _without_spans(visits, [_exactly(utterance) for utterance in audible])
        for sound in self._recorded_entries("audio"):
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

    def of(section: str, *, is_known: Callable[[dict[str, Any]], bool] = lambda _entry: True) -> Iterator[Path]:
        entries = session.header.as_read.get(section)
        for entry in entries if isinstance(entries, list) else ():
            if isinstance(entry, dict) and is_known(entry):
                yield folder / str(entry.get("file_name"))

    def was_looked_at(entry: dict[str, Any]) -> bool:
        # A camera without detection is covered entirely while a person was present.
        return tracks.any or bool(tracks.detections_ns.get(str(entry.get("camera"))))

    photos = [path for path in folder.rglob("*.png") if names_people(path)]
    for _, data in messages_of(folder / "events.mcap", lambda topic: topic == _PHOTO):
        try:
            photo = parse_json(data)
            path, camera = folder / str(photo["file_name"]), str(photo["camera"])
        except (ValueError, KeyError, TypeError):
            continue
        if tracks.any or tracks.detections_ns.get(camera):
            photos += [path, path.with_name(_ASIDE) / path.name]
    return frozenset((*of("videos", is_known=was_looked_at), *of("audio"), *photos))


def names_people(photo: Path) -> bool:
    """True if the photo lists the people in it. Raises OSError."""
    try:
        return bool(texts_of(photo.read_bytes()).get(PEOPLE))
    except PhotoFileError:
        return False


def photos_of(folder: Path, person_ids: frozenset[str]) -> list[Path]:
    """Photos in a folder that list one of these people. Raises OSError."""
    found = []
    for path in sorted(folder.rglob("*.png")):
        try:
            people = texts_of(path.read_bytes()).get(PEOPLE, "").split()
        except PhotoFileError:
            continue
        if not person_ids.isdisjoint(people):
            found.append(path)
    return found


def _cover_of(areas: tuple[Area, ...]) -> media.Cover | None:
    return partial(media.cover_areas, areas) if areas else None


def _covered(path: Path, areas: tuple[Area, ...], part: Path) -> int:
    media.covered_picture(path, part, partial(media.cover_areas, areas))
    return len(areas)


def _silenced(path: Path, first_stamp_ns: int, spans: list[tuple[int, int]], part: Path) -> int:
    media.silenced_sound(path, part, first_stamp_ns, spans)
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


def _exactly(utterance: SpokenUtterance) -> tuple[int, int]:
    begin_ns, end_ns = sound_span_of(utterance)
    return begin_ns + _SOUND_AROUND_NS, end_ns - _SOUND_AROUND_NS


def sound_span_of(utterance: SpokenUtterance) -> tuple[int, int]:
    """Session time of an utterance in a sound file, with a margin."""
    start_ns = utterance.start_ns if utterance.start_ns is not None else utterance.requested_ns or 0
    end_ns = utterance.end_ns if utterance.end_ns is not None else start_ns
    if end_ns <= start_ns:
        start_ns = end_ns - max(_LEAST_SPOKEN_NS, len(utterance.text) * _SPEAKS_NS)
    return start_ns - _SOUND_AROUND_NS, end_ns + _SOUND_AROUND_NS
