"""Photos panel: grid, search, enlarged view, and actions."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.status import PhotoEntry
from caris_desktop.scenario.scenario_model import AssistantSettings, PanelLeaf, Permissions, Scenario, SplitNode
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.photos_panel import LargePhoto, PhotosPanel
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole

RED, GREEN = (0, 0, 220), (0, 200, 0)
NOON_NS = 1_700_000_000_000_000_000


def jpeg(color_bgr: tuple[int, int, int], width_px: int = 320) -> bytes:
    image = np.full((width_px * 3 // 4, width_px, 3), color_bgr, np.uint8)
    return bytes(cv2.imencode(".jpg", image)[1].tobytes())


def photo(number: int, color_bgr: tuple[int, int, int] = RED, **fields: Any) -> PhotoEntry:
    return PhotoEntry(
        f"photos/{number:04d}.png", NOON_NS + number * 1_000_000_000,
        **{"camera": "front", "preview_jpeg": jpeg(color_bgr), "thumbnail_jpeg": jpeg(color_bgr, 200), **fields},
    )  # fmt: skip


def scenario(**changes: Any) -> Scenario:
    layout = SplitNode("horizontal", (PanelLeaf("video"), PanelLeaf("photos")))
    return replace(samples.TOUR, layout=layout, **changes)


def panel_of(qtbot: QtBot, settings: MemorySettings, theme: Theme, of: Scenario) -> tuple[MainWindow, PhotosPanel]:
    window = open_window(qtbot, FakeConsole(of), settings, theme)
    panel = window.panels["photos"]
    assert isinstance(panel, PhotosPanel)
    return window, panel


@pytest.fixture
def panel(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> PhotosPanel:
    return panel_of(qtbot, settings, theme, scenario(assistant=AssistantSettings(model="openai:m", pictures=True)))[1]


def shown(panel: PhotosPanel) -> list[str]:
    return [entry.file_name for entry in panel.model.values]


def color_at(widget: QWidget, x: int, y: int) -> tuple[int, int, int]:
    color = widget.grab().toImage().pixelColor(x, y)
    return color.blue(), color.green(), color.red()


def reddish(color_bgr: tuple[int, int, int]) -> bool:
    return color_bgr[2] > 180 and color_bgr[1] < 60


def test_without_photos_the_panel_says_how_one_is_taken(panel: PhotosPanel) -> None:
    key = panel.table.key_text("photo")
    text = find(panel, "photos_empty").text()  # type: ignore[attr-defined]
    assert key and text == f"No photos yet.\n{key} takes a photo of the current picture."
    assert not panel.search.isVisible()


def test_the_newest_photo_comes_first_and_is_seen(panel: PhotosPanel) -> None:
    panel.state.photos.set((photo(2), photo(1, GREEN)))
    assert shown(panel) == ["photos/0002.png", "photos/0001.png"]
    assert panel.fact[0] == "2 photos"
    first = panel.grid.visualRect(panel.model.index(0, 0)).center()
    assert reddish(color_at(panel.grid.viewport(), first.x(), first.y() - 20))


@pytest.mark.parametrize(
    ("text", "found"),
    [("", [1, 2, 3]), ("door", [2]), ("FRONT", [1, 2]), ("door rear", []), ("ada", [3]), ("ada arm", [3]), ("xyz", [])],
)
def test_photos_are_found_by_name_tag_and_camera(panel: PhotosPanel, text: str, found: list[int]) -> None:
    ada = panel.state.persons.value[0]
    panel.state.persons.set((replace(ada, name="Ada"),))
    panel.state.photos.set(
        (photo(1), photo(2, tags=("door",)), photo(3, camera="rear", tags=("robot arm",), person_ids=(ada.person_id,)))
    )
    panel.search.setText(text)
    assert shown(panel) == [f"photos/{number:04d}.png" for number in found]


def test_one_choice_shows_those_with_a_person_or_a_tag(panel: PhotosPanel) -> None:
    ada = panel.state.persons.value[0]
    panel.state.persons.set((replace(ada, name="Ada"),))
    panel.state.photos.set((photo(1, tags=("door",)), photo(2, person_ids=(ada.person_id,))))
    offered = [panel.choice.itemText(row) for row in range(panel.choice.count())]
    assert offered == ["All photos", "Ada", "Tag: door", "Front camera"]
    for row, expected in ((1, 2), (2, 1)):
        panel.choice.setCurrentIndex(row)
        panel.choice.activated.emit(row)
        assert shown(panel) == [f"photos/{expected:04d}.png"]
    panel.state.photos.set((photo(3), *panel.state.photos.value))
    assert shown(panel) == ["photos/0001.png"], "a new photo does not undo the choice"


def test_a_click_shows_it_large_and_escape_goes_back_and_stops(qtbot: QtBot, panel: PhotosPanel) -> None:
    panel.state.photos.set((photo(1, person_ids=("p-unknown",), pose_in_map=Pose2D(1.24, 2.0, 0.0)),))
    at = panel.grid.visualRect(panel.model.index(0, 0)).center()
    QTest.mouseClick(panel.grid.viewport(), Qt.MouseButton.LeftButton, pos=at)
    assert panel.large.isVisible() and not panel.grid.isVisible()
    assert panel.large.about.text().endswith("Front camera · 1 person · robot at 1.2, 2.0 m")
    picture = panel.large.picture
    assert reddish(color_at(picture, picture.width() // 2, picture.height() // 2))
    QTest.keyClick(panel.window(), Qt.Key.Key_Escape)
    assert panel.grid.isVisible()
    assert panel.console.named("stop") == [None]  # type: ignore[attr-defined]


def test_in_a_low_panel_the_picture_is_next_to_its_words(theme: Theme, qtbot: QtBot) -> None:
    large = LargePhoto(theme, can_ask=True)
    qtbot.addWidget(large)
    large.show_photo(photo(1), {})
    for width, height, least_px in ((345, 190, 110), (345, 420, 200)):
        large.resize(width, height)
        large.show()
        QTest.qWait(1)
        assert large.picture.height() >= least_px and large.picture.width() >= 140


def test_tags_are_given_by_enter(panel: PhotosPanel) -> None:
    panel.state.photos.set((photo(1),))
    panel.open("photos/0001.png")
    panel.large.tags.setFocus()
    QTest.keyClicks(panel.large.tags, "robot arm, door,")
    QTest.keyClick(panel.large.tags, Qt.Key.Key_Return)
    assert panel.console.named("tag_photo") == [("photos/0001.png", ("robot arm", "door"))]  # type: ignore[attr-defined]
    assert panel.large.tags.text() == "robot arm, door"


def test_a_deleted_photo_is_not_shown_and_can_be_brought_back(qtbot: QtBot, panel: PhotosPanel) -> None:
    panel.state.photos.set((photo(1), photo(2)))
    panel.open("photos/0001.png")
    button = find(panel, "photo_delete")
    click(qtbot, button)
    assert panel.large.picture.image.isNull()
    assert panel.fact[0] == "1 photo"
    click(qtbot, button)
    assert not panel.large.picture.image.isNull()
    called = [name for name, _ in panel.console.calls]  # type: ignore[attr-defined]
    assert called == ["delete_photo", "restore_photo"]


def test_the_assistant_is_asked_about_it(panel: PhotosPanel) -> None:
    panel.state.photos.set((photo(1),))
    panel.open("photos/0001.png")
    panel.large.question.setFocus()
    QTest.keyClicks(panel.large.question, "What is this?")
    QTest.keyClick(panel.large.question, Qt.Key.Key_Return)
    assert "Assistant panel" in panel.large.question.placeholderText()
    assert panel.console.named("ask_about_photo") == [("photos/0001.png", "What is this?")]  # type: ignore[attr-defined]


def test_of_an_ended_session_nothing_is_changed(panel: PhotosPanel) -> None:
    panel.state.photos.set((photo(1, changeable=False, tags=("door",)),))
    panel.open("photos/0001.png")
    assert panel.large.tags.isReadOnly()
    assert not [each for each in panel.findChildren(QWidget, "photo_delete") if each.isVisible()]


def test_without_pictures_for_the_model_nothing_can_be_asked(
    qtbot: QtBot, settings: MemorySettings, theme: Theme
) -> None:
    _, panel = panel_of(qtbot, settings, theme, scenario(assistant=AssistantSettings(model="openai:m")))
    panel.state.photos.set((photo(1),))
    panel.open("photos/0001.png")
    assert not panel.large.question.isVisible()


def test_without_the_permission_there_is_no_panel(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    window = open_window(qtbot, FakeConsole(scenario(permissions=Permissions(photos=False))), settings, theme)
    assert "photos" not in window.panels
