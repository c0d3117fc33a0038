"""Photos in a replay: those that existed at the displayed time, and none of other sessions."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.domain.events import PhotoDeleted, PhotoTagged, PhotoTaken
from caris_desktop.live.replay_console import ReplayPhotos
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.recording.session.session_reader import open_session
from tests.recording.told_session import at, tell
from tests.support.polling import wait_for

ONE, TWO, AWAY = "photos/0001.png", "photos/0002.png", "../../outside.png"


def taken(seconds: float, file_name: str) -> PhotoTaken:
    return PhotoTaken(at(seconds), "front", 1, file_name, "wizard", "", ("p-1",))


@pytest.mark.logs("names a photo outside of the session")
def test_at_each_moment_the_photos_are_there_that_had_been_taken(qapp: QApplication, tmp_path: Path) -> None:
    folder = tmp_path / "study" / "sessions" / "s"
    events = [
        taken(1.0, ONE), PhotoTagged(at(2.0), ONE, ("door",)), taken(3.0, TWO), taken(3.5, AWAY),
        PhotoDeleted(at(4.0), TWO), PhotoDeleted(at(5.0), TWO, restored=True), PhotoDeleted(at(6.0), ONE),
    ]  # fmt: skip
    tell(folder, events, lasts_s=10)
    (folder / "photos").mkdir(exist_ok=True)
    picture = np.full((90, 160, 3), 200, np.uint8)
    for path in (folder / ONE, folder / TWO, folder.parent.parent / "outside.png"):
        cv2.imwrite(str(path), picture)
    now_ns = at(0.0)
    session = open_session(folder)
    owner = QObject()
    state = LiveState(owner, present=PresentClock(lambda: now_ns, session.clock.anchor, live=False))
    photos = ReplayPhotos(session, state, owner)
    photos.start()

    def until(seen: Callable[[], Any]) -> None:
        def look() -> Any:
            QApplication.processEvents()
            return seen()

        wait_for(look, "the photos", timeout_s=10.0)

    try:
        until(lambda: len(photos._pictures) == 3)
        there = []
        for seconds in (0.5, 1.5, 2.5, 3.2, 4.5, 5.5, 6.5):
            now_ns = at(seconds)
            state.time_jumped.emit(())
            there.append({entry.file_name: entry for entry in state.photos.value})
        assert [sorted(set(shown) - {AWAY}) for shown in there] == [
            [],
            [ONE],
            [ONE],
            [ONE, TWO],
            [ONE],
            [ONE, TWO],
            [TWO],
        ]
        assert (there[1][ONE].tags, there[2][ONE].tags) == ((), ("door",))
        shown = cv2.imdecode(np.frombuffer(there[1][ONE].preview_jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert shown.shape == picture.shape and not there[1][ONE].changeable
        assert there[5][AWAY].preview_jpeg == b"", "nothing is read outside of the session"
    finally:
        photos.close()
        state.close()
