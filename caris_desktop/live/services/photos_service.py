"""Photo service: photos of this session and those taken without one; tagging, deletion, questions."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from caris_desktop.domain import clock, intents
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import PhotoDeleted, PhotoTagged, PhotoTaken, SessionEnded, SessionStarted
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.replay_video import DisplayFrames
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext
from caris_desktop.live.services.assistant_service import AssistantService
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.status import PhotoEntry
from caris_desktop.recording.photo_file import (
    CAMERA,
    PEOPLE,
    PREVIEW_PX,
    TAGS,
    THUMBNAIL_PX,
    PhotoFileError,
    change_texts,
    jpegs_of,
    move_photo,
    previews,
    remove_all,
    remove_photos,
    texts_of,
)
from caris_desktop.scenario.scenario_model import Scenario

_log = logging.getLogger(__name__)
MAX_TAGS, MAX_TAG_CHARACTERS = 12, 40
_FOR_MODEL_PX = 1024
_LISTED_AT_MOST = 200
_LIST_AFTER_MS = 4000
"""Window, robot and models come first."""
_FOLDER, _ASIDE = "photos", ".deleted"


class _StoredPhoto(Value):
    """Location of a photo: in ``folder``, or in the trash if deleted."""

    entry: PhotoEntry
    folder: Path
    of_session: bool

    @property
    def path(self) -> Path:
        return self.folder / self.entry.file_name


class PhotosService(ContextService):
    """Maintains ``state.photos``, newest first. Files are accessed in a background thread (``slow_work``).

    A deleted photo leaves its folder at once, so that the session's checksums stay correct; until the session ends it
    can be restored from the trash. Photos deleted without a session are removed when the program ends.
    """

    def __init__(
        self,
        context: ServiceContext,
        recording: RecordingService,
        assistant: AssistantService,
        *,
        frames: DisplayFrames,
        study: Path,
    ) -> None:
        super().__init__(context)
        self._recording = recording
        self._assistant = assistant
        assistant.use_pictures(self._read_for_model)
        self._frames = frames
        self._study = study
        self._aside = study / _FOLDER / _ASIDE
        self._stored: dict[str, _StoredPhoto] = {}
        self._session: Path | None = None
        self._permitted = False
        self._listed = False
        self._listing = new_timer(self, self.list_earlier, _LIST_AFTER_MS, single_shot=True)

    def handlers(self) -> Handlers:
        return {
            intents.TagPhoto: self._tag,
            intents.DeletePhoto: self._delete,
            intents.RestorePhoto: self._restore,
            intents.AskAboutPhoto: self._ask,
        }

    def follows(self) -> Follows:
        return {
            PhotoTaken: self._on_taken,
            SessionStarted: self._on_session_started,
            SessionEnded: self._on_session_ended,
        }

    def use_scenario(self, scenario: Scenario) -> None:
        self._permitted = scenario.permissions.photos
        if self._permitted and not self._listed and not self._listing.isActive():
            self._listing.start()
        self._show()

    def stop(self) -> None:
        self._listing.stop()
        self._permitted = False

    def end(self) -> None:
        remove_all(self._aside)

    # List

    def list_earlier(self) -> None:
        """List photos in the study's folder one by one, so that other work is not blocked."""
        if not self._permitted or self._listed:
            return
        self._listed = True

        def names() -> list[str]:
            remove_all(self._aside)  # of an interrupted run
            found = sorted((self._study / _FOLDER).glob("*.png"), key=lambda path: path.stat().st_mtime, reverse=True)
            return [f"{_FOLDER}/{path.name}" for path in found[:_LISTED_AT_MOST]]

        self._slow_work.do(names, self._read_next, self._bus.answer)

    def _read_next(self, names: list[str]) -> None:
        names = [name for name in names if name not in self._stored]
        if not names or not self._permitted:
            return

        def done(entry: PhotoEntry | None) -> None:
            if entry is not None and entry.file_name not in self._stored:
                self._persist(_StoredPhoto(entry, self._study, of_session=False))
            self._read_next(names[1:])

        self._slow_work.do(lambda: _earlier(self._study, names[0]), done, self._bus.answer)

    def _on_taken(self, event: PhotoTaken) -> None:
        folder, of_session = (self._study, False) if self._session is None else (self._session, True)
        utc_ns = ClockAnchor.take().utc_ns_at(event.stamp_ns)
        entry = PhotoEntry(event.file_name, utc_ns, event.camera, event.person_ids, event.pose_in_map)

        def done(entry: PhotoEntry) -> None:
            if of_session and folder != self._session:
                return  # of a session that has ended meanwhile
            self._persist(_StoredPhoto(entry, folder, of_session))

        self._slow_work.do(lambda: _with_pictures(entry, folder), done, self._bus.answer)

    def _on_session_started(self, _event: SessionStarted) -> None:
        """Hide the former participant's photos."""
        self._session = self._recording.session_folder
        self._stored = {name: photo for name, photo in self._stored.items() if not photo.of_session}
        self._show()

    def _on_session_ended(self, _event: SessionEnded) -> None:
        self._session = None
        deleted = [photo for photo in self._stored.values() if photo.of_session and photo.entry.deleted]
        for photo in deleted:
            del self._stored[photo.entry.file_name]
        self._stored = {
            name: replace(photo, entry=replace(photo.entry, changeable=False)) if photo.of_session else photo
            for name, photo in self._stored.items()
        }
        self._show()
        if deleted:
            lie_aside = [self._lies_aside(photo) for photo in deleted]
            self._slow_work.do(lambda: remove_photos(lie_aside), lambda _: None, self._bus.answer)

    def _persist(self, photo: _StoredPhoto) -> None:
        self._stored[photo.entry.file_name] = photo
        self._show()

    def _update(self, file_name: str, **changes: Any) -> None:
        """Update the current entry, which may have changed or been removed."""
        photo = self._stored.get(file_name)
        if photo is not None:
            self._persist(replace(photo, entry=replace(photo.entry, **changes)))

    def _show(self) -> None:
        entries = (photo.entry for photo in self._stored.values()) if self._permitted else ()
        self._state.photos.set(tuple(sorted(entries, key=lambda entry: entry.utc_ns, reverse=True)))

    # Intents

    def _tag(self, intent: intents.TagPhoto) -> None:
        cleaned = (" ".join(tag.replace(",", " ").split()) for tag in intent.tags)
        tags = tuple(dict.fromkeys(tag for tag in cleaned if tag))
        if len(tags) > MAX_TAGS or any(len(tag) > MAX_TAG_CHARACTERS for tag in tags):
            raise RefusedError(
                tr("The photo was not tagged."),
                tr("The photo's tags are unchanged."),
                tr("Use at most {most} tags of up to {longest} characters each.").format(
                    most=MAX_TAGS, longest=MAX_TAG_CHARACTERS
                ),
            )
        photo = self._changeable(intent.file_name, tr("The photo was not tagged."))

        def done(_: None) -> None:
            self._update(intent.file_name, tags=tags)
            self._bus.publish(PhotoTagged(clock.now_ns(), intent.file_name, tags, intent.actor))

        self._change(lambda: change_texts(photo.path, {TAGS: ", ".join(tags)}), done, tr("The photo was not tagged."))

    def _delete(self, intent: intents.DeletePhoto) -> None:
        photo = self._changeable(intent.file_name, tr("The photo was not deleted."))

        self._change(
            lambda: move_photo(photo.path, self._lies_aside(photo)),
            lambda _: self._note_deleted(photo, intent.actor, deleted=True),
            tr("The photo was not deleted."),
        )

    def _restore(self, intent: intents.RestorePhoto) -> None:
        photo = self._stored.get(intent.file_name)
        if photo is None or not photo.entry.deleted:
            raise RefusedError(
                tr("There is no deleted photo to restore."),
                tr("Deleted photos are removed permanently when their session ends."),
                tr("Take another one if it is needed."),
            )
        self._change(
            lambda: move_photo(self._lies_aside(photo), photo.path),
            lambda _: self._note_deleted(photo, intent.actor, deleted=False),
            tr("The photo was not restored."),
        )

    def _note_deleted(self, photo: _StoredPhoto, actor: str, *, deleted: bool) -> None:
        self._update(photo.entry.file_name, deleted=deleted)
        self._bus.publish(PhotoDeleted(clock.now_ns(), photo.entry.file_name, not deleted, actor))

    def _ask(self, intent: intents.AskAboutPhoto) -> None:
        if not self._permitted:
            raise RefusedError(
                tr("This scenario does not allow photos."),
                tr("The assistant was not asked."),
                tr("Ask without a photo."),
            )
        photo = self._found(intent.file_name)
        question = intent.question.strip() or tr("What is in this picture?")
        self._assistant.ask(intents.Ask(question, pictures=(photo.entry.file_name,), actor=intent.actor))

    def _read_for_model(
        self, names: Sequence[str], done: Callable[[list[bytes]], None], failed: Callable[[UserFacingError], None]
    ) -> None:
        """Read images for a question, as ``ReadPictures``."""
        readers = [self._reader_for_model(name) for name in names]
        self._slow_work.do(lambda: [read() for read in readers], done, failed)

    def _reader_for_model(self, name: str) -> Callable[[], bytes]:
        if not name.startswith(intents.CAMERA_PICTURE):
            path = self._found(name).path
            return lambda: _pictures(path, _FOR_MODEL_PX)[0]
        stream = self._state.frame_of(name.removeprefix(intents.CAMERA_PICTURE))
        image_bgr = self._frames.read_to_give(stream.value) if stream.freshness == "fresh" else None
        if image_bgr is None:
            raise RefusedError(
                tr("That camera has no video now."), tr("The assistant was not asked."),
                tr("Ask without the picture."),
            )  # fmt: skip
        return lambda: jpegs_of(image_bgr, _FOR_MODEL_PX)[0]

    def _found(self, file_name: str) -> _StoredPhoto:
        photo = self._stored.get(file_name)
        if photo is None or photo.entry.deleted:
            raise RefusedError(
                tr("The photo does not exist."), tr("It was deleted, or belongs to another session."),
                tr("Choose another one."),
            )  # fmt: skip
        return photo

    def _changeable(self, file_name: str, if_not: str) -> _StoredPhoto:
        photo = self._found(file_name)
        if not photo.entry.changeable:
            raise RefusedError(
                if_not,
                tr("Its session has ended, and the checksums cover every file."),
                tr("Note it in the session's annotations."),
            )
        return photo

    def _change(self, work: Callable[[], object], done: Callable[[None], None], what: str) -> None:
        def change() -> None:
            try:
                work()
            except (OSError, PhotoFileError) as error:
                _log.exception("a photo")
                raise UserFacingError(
                    what,
                    tr("The file cannot be changed ({error}).").format(error=error),
                    tr("Free some disk space, or make the study's folder writable, then try again."),
                ) from error

        self._slow_work.do(change, done, self._bus.answer)

    def _lies_aside(self, photo: _StoredPhoto) -> Path:
        owner = photo.folder.name if photo.of_session else "study"
        return self._aside / f"{owner} {Path(photo.entry.file_name).name}"


def _with_pictures(entry: PhotoEntry, folder: Path) -> PhotoEntry:
    """Entry with its images. Raises UserFacingError."""
    large, small = _pictures(folder / entry.file_name, PREVIEW_PX, THUMBNAIL_PX)
    return replace(entry, preview_jpeg=large, thumbnail_jpeg=small)


def _pictures(path: Path, *most_px: int) -> list[bytes]:
    """Images as from ``photo_file``. Raises UserFacingError."""
    try:
        return previews(path, *most_px)
    except (OSError, PhotoFileError) as error:
        what = tr("{name} cannot be read ({error}).").format(name=path.name, error=error)
        raise RefusedError(
            tr("A photo cannot be shown."),
            what,
            tr("The photo is left unchanged. Check whether another program can show the file."),
        ) from error


def _earlier(study: Path, file_name: str) -> PhotoEntry | None:
    """Photo taken without a session; None for another file."""
    path = study / file_name
    try:
        texts = texts_of(path.read_bytes())
        utc_ns = path.stat().st_mtime_ns
        tags = tuple(tag for tag in texts.get(TAGS, "").split(", ") if tag)
        people = tuple(texts.get(PEOPLE, "").split())
        return _with_pictures(PhotoEntry(file_name, utc_ns, texts.get(CAMERA, ""), people, None, tags), study)
    except (OSError, PhotoFileError, UserFacingError):
        _log.warning("%s is passed over", path, exc_info=True)
        return None
