"""What robot, places, picture and recording make of the table of actions: which rows there are, which can be run."""

from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.live.state import LiveState
from caris_desktop.ui.actions import Actions, Feature
from caris_desktop.ui.people.asked import WhoIsAsked


class ActionConditions(QObject):
    """Tells ``actions`` what ``state`` says, from now on."""

    def __init__(self, actions: Actions, state: LiveState) -> None:
        super().__init__(actions)
        self._actions = actions
        self._state = state
        state.robot.changed.connect(self._on_robot_changed)
        state.places.changed.connect(self._on_places_changed)
        state.frame.freshness_changed.connect(self._on_video_freshness_changed)
        state.recording.changed.connect(self._offer_photo)
        state.cameras.changed.connect(self._on_cameras_changed)
        state.asked_person.changed.connect(self._on_asked_changed)
        WhoIsAsked(state, self)
        self._on_robot_changed(state.robot.value)
        self._on_places_changed(state.places.value)
        self._on_video_freshness_changed(state.frame.freshness)
        self._on_cameras_changed(state.cameras.value)

    def _on_robot_changed(self, robot: Any) -> None:
        features: list[Feature] = []
        if robot is not None and robot.holonomic:
            features.append("sideways")
        if robot is not None and robot.head is not None:
            features.append("head")
        self._actions.use_features(features)

    def _on_places_changed(self, places: Any) -> None:
        self._actions.use_places([place.name for place in places])

    def _on_cameras_changed(self, cameras: Any) -> None:
        self._actions.set_condition("cameras", len(cameras) > 1)

    def _on_video_freshness_changed(self, freshness: str) -> None:
        self._actions.set_condition("video", freshness == "fresh")
        self._offer_photo()

    def _on_asked_changed(self, asked: Any) -> None:
        self._actions.set_condition("asked", asked is not None)

    def _offer_photo(self) -> None:
        """In a pause nothing is to be kept of whoever is there."""
        paused = self._state.recording.value.state == "paused"
        self._actions.set_condition("photo", self._state.frame.freshness == "fresh" and not paused)
