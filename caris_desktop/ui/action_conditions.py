"""Conditions on the action table from robot, places, video and recording: which rows exist and which are enabled."""

from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.live.state import LiveState
from caris_desktop.live.status import SuggestionsStatus
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_spec import Condition, Feature
from caris_desktop.ui.people.pending_identity_question import PendingIdentityQuestion
from caris_desktop.ui.step_intents import present_step


class ActionConditions(QObject):
    """Updates ``actions`` whenever ``state`` changes."""

    def __init__(self, actions: Actions, state: LiveState) -> None:
        super().__init__(actions)
        self._actions = actions
        self._state = state
        state.robot.changed.connect(self._on_robot_changed)
        state.places.changed.connect(self._on_places_changed)
        state.frame.freshness_changed.connect(self._on_video_freshness_changed)
        state.recording.changed.connect(self._offer_photo)
        state.cameras.changed.connect(self._on_cameras_changed)
        state.face.changed.connect(self._on_face_changed)
        state.controls.changed.connect(self._on_controls_changed)
        for live_value in (state.asked_person, state.proposal):
            live_value.changed.connect(self._on_asked_changed)
        state.suggestions.changed.connect(self._on_suggestions_changed)
        state.speech.changed.connect(self._on_speech_changed)
        for about_steps in (state.protocol, state.scenario):
            about_steps.changed.connect(self._on_step_changed)
        PendingIdentityQuestion(state, self)
        self._on_robot_changed(state.robot.value)
        self._on_places_changed(state.places.value)
        self._on_controls_changed(state.controls.value)
        self._on_video_freshness_changed(state.frame.freshness)
        self._on_cameras_changed(state.cameras.value)
        self._on_step_changed(None)
        self._expressions: tuple[str, ...] = ()
        self._on_face_changed(state.face.value)

    def _on_robot_changed(self, robot: Any) -> None:
        features: list[Feature] = []
        if robot is not None and robot.holonomic:
            features.append("sideways")
        if robot is not None and robot.head is not None:
            features.append("head")
        self._actions.use_features(features)

    def _on_places_changed(self, places: Any) -> None:
        self._actions.use_places([place.name for place in places])

    def _on_controls_changed(self, controls: Any) -> None:
        self._actions.use_controls(control.id for control in controls)

    def _on_face_changed(self, face: Any) -> None:
        if face.expressions != self._expressions:
            self._expressions = face.expressions
            self._actions.use_expressions(face.expressions)

    def _on_cameras_changed(self, cameras: Any) -> None:
        self._actions.set_condition("cameras", len(cameras) > 1)

    def _on_video_freshness_changed(self, freshness: str) -> None:
        self._actions.set_condition("video", freshness == "fresh")
        self._offer_photo()

    def _on_asked_changed(self, _value: Any) -> None:
        state = self._state
        pending = state.asked_person.value is not None or bool(state.proposal.value.proposal_id)
        self._actions.set_condition("asked", pending)

    def _on_suggestions_changed(self, status: SuggestionsStatus) -> None:
        self._actions.set_condition("suggested", bool(status.cards) or status.filler_ns is not None)

    def _on_step_changed(self, _value: Any) -> None:
        status, scenario = self._state.protocol.value, self._state.scenario.value
        step = None if scenario is None else present_step(scenario, self._state)
        behind = status.ended or status.number > 1 or bool(status.done or status.skipped)
        steps: dict[Condition, bool] = {
            "step": step is not None,
            "step_ahead": bool(status.steps) and not status.ended,
            "step_back": behind,
            "step_branches": step is not None and bool(step.branches),
            "step_says": step is not None and bool(step.say),
            "step_goes": step is not None and bool(step.go_to),
        }
        self._actions.set_conditions(steps)

    def _on_speech_changed(self, speech: Any) -> None:
        self._actions.set_condition("queued", bool(speech.waiting))

    def _offer_photo(self) -> None:
        """Disable photos while the recording is paused: nothing about people may be saved then."""
        paused = self._state.recording.value.state == "paused"
        self._actions.set_condition("photo", self._state.frame.freshness == "fresh" and not paused)
