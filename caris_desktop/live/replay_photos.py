"""Photos of a recorded session at the replay's position."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.domain.events import PhotoDeleted, PhotoTagged, PhotoTaken
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PhotoEntry
from caris_desktop.recording.photo_file import PREVIEW_PX, THUMBNAIL_PX, previews
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
_STREAMS = ("event/photo_taken", "event/photo_tagged", "event/photo_deleted")
_AT_MOST = 500


class ReplayPhotos(QObject):
    """Maintains ``state.photos``. Photos are read one by one in a background thread."""

    def __init__(self, session: Session, state: LiveState, parent: QObject) -> None:
        super().__init__(parent)
        self._session = session
        self._state = state
        self._events: list[Any] = []
        self._pictures: dict[str, tuple[bytes, bytes]] = {}
        self._slow_work = BackgroundWorker(self)
        state.event_happened.connect(self._on_event)
        state.time_jumped.connect(self._show)

    def start(self) -> None:
        def read() -> list[Any]:
            return [value for _, value in self._session.values(*_STREAMS)]

        def done(events: list[Any]) -> None:
            self._events = events
            self._show()
            self._read_next([event.file_name for event in events if isinstance(event, PhotoTaken)][:_AT_MOST])

        self._slow_work.do(read, done, self._on_failed)

    def close(self) -> None:
        self._slow_work.finish(lambda _what, work: work())

    def _read_next(self, file_names: list[str]) -> None:
        if not file_names:
            return

        def done(pictures: tuple[bytes, bytes]) -> None:
            self._pictures[file_names[0]] = pictures
            self._show()
            self._read_next(file_names[1:])

        self._slow_work.do(lambda: _pictures(self._session.folder, file_names[0]), done, self._on_failed)

    def _on_failed(self, failure: UserFacingError) -> None:
        _log.warning("%s %s", failure.what, failure.meaning)

    def _on_event(self, event: object) -> None:
        if isinstance(event, PhotoTaken | PhotoTagged | PhotoDeleted):
            self._show()

    def _show(self, _events: object = None) -> None:
        now_ns, utc_ns_at = self._state.present.now_ns(), self._session.clock.anchor.utc_ns_at
        entries: dict[str, PhotoEntry] = {}
        for event in self._events:
            if event.stamp_ns > now_ns:
                continue
            entry = entries.get(event.file_name)
            if isinstance(event, PhotoTaken):
                large, small = self._pictures.get(event.file_name, (b"", b""))
                entries[event.file_name] = PhotoEntry(
                    event.file_name, utc_ns_at(event.stamp_ns), event.camera, event.person_ids, event.pose_in_map,
                    preview_jpeg=large, thumbnail_jpeg=small, changeable=False,
                )  # fmt: skip
            elif entry is not None and isinstance(event, PhotoTagged):
                entries[event.file_name] = replace(entry, tags=event.tags)
            elif entry is not None:
                entries[event.file_name] = replace(entry, deleted=not event.restored)
        there = (entry for entry in entries.values() if not entry.deleted)
        self._state.photos.set(tuple(sorted(there, key=lambda entry: entry.utc_ns, reverse=True)))


def _pictures(folder: Path, file_name: str) -> tuple[bytes, bytes]:
    """Preview and thumbnail; empty for a missing or deleted photo, or one outside the session folder."""
    try:
        path = (folder / file_name).resolve()
        if not path.is_relative_to(folder.resolve()):
            _log.warning("%s names a photo outside of the session: %.200r", folder, file_name)
            return b"", b""
        large, small = previews(path, PREVIEW_PX, THUMBNAIL_PX)
    except (OSError, ValueError) as error:  # PhotoFileError is a ValueError, as is an impossible file name
        _log.info("%.200r is not shown: %.200s", file_name, error)
        return b"", b""
    return large, small
