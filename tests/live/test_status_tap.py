"""Displayed states are recorded completely and restored unchanged, without names of people."""

import dataclasses
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.control_definitions import CallService, RobotControl
from caris_desktop.domain.events import GoalChanged, Marked, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema import from_jsonable, to_jsonable
from caris_desktop.domain.sensing import StatusShown
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.state import STATUS_TYPES, LiveState, show_status, tap_status
from caris_desktop.live.status import (
    ControlStatus,
    DriveStatus,
    LoadStatus,
    MarksStatus,
    PreflightCheck,
    RecordingStatus,
    SpeechStatus,
)
from caris_desktop.people.presence import PersonRow, Suggestion
from caris_desktop.scenario.scenario_model import Place

pytestmark = pytest.mark.usefixtures("qapp")


def _put_back(shown: list[StatusShown], *, names: dict[str, str]) -> LiveState:
    state = LiveState()
    for status in shown:
        show_status(state, status, name_of=names.get)
    return state


def test_everything_that_changed_comes_back() -> None:
    state, shown = LiveState(), list[StatusShown]()
    tap_status(state, shown.append)
    assert {status.name for status in shown} == set(STATUS_TYPES), "each as it stands when the recording begins"
    saying = UtteranceChanged(5, "u1", "robot", "Hello", "typed", "started")
    state.drive.set(DriveStatus(allowed=True, reason="", target_forward_mps=0.3))
    state.speech.set(SpeechStatus(ready=True, now=saying, waiting=(replace(saying, utterance_id="u2"),)))
    state.goal.set(GoalChanged(6, "g1", "active", Pose2D(1.0, 2.0, 0.5), "Kitchen"))
    state.places.set((Place("Kitchen", Pose2D(1.0, 2.0, 0.5)),))
    state.controls.set((RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {})),))
    state.control_states.set({"wave": ControlStatus("succeeded", True)})
    state.preflight.set((PreflightCheck("by hand: Form", "Form", "passed", manual=True, actor="wizard", checked_ns=5),))
    state.marks.set(MarksStatus(Marked(7, "Laughs", mark_id="m1"), ()))
    back = _put_back(shown, names={})
    for name in STATUS_TYPES:
        assert getattr(back, name).value == getattr(state, name).value, name


def test_shed_load_is_recorded_and_shown_in_a_replay() -> None:
    state, shown = LiveState(), list[StatusShown]()
    tap_status(state, shown.append)
    load = LoadStatus(2, "people detection less often")
    state.load.set(load)
    assert shown[-1].name == "load" and shown[-1].content == {"step": 2, "detail": "people detection less often"}
    assert _put_back(shown, names={}).load.value == load


def _with_reason(kind: Any, why: str) -> Any:
    """Value of the type with ``why`` as each reason; None if it has none."""
    if not dataclasses.is_dataclass(kind):
        return None
    reasons = {"detail", "reason", "cap_reason", "guard_detail"}.intersection(each.name for each in fields(kind))
    return kind(**dict.fromkeys(reasons, why)) if reasons else None


@pytest.mark.usefixtures("trial_language")
def test_reasons_are_english_in_the_record_and_translated_for_each_watcher() -> None:
    why = localized(QT_TR_NOOP("no fresh {stream} for {age} s"), stream=QT_TR_NOOP("LIDAR"), age="1.5")
    state, shown = LiveState(), list[StatusShown]()
    tap_status(state, shown.append)
    reasoned = {name: value for name, kind in STATUS_TYPES.items() if (value := _with_reason(kind, why)) is not None}
    assert {"link", "drive", "speech", "assistant", "suggestions", "perception", "microphone"} < {*reasoned}
    for name, value in reasoned.items():
        getattr(state, name).set(value)
    state.control_states.set({"wave": ControlStatus("failed", True, why)})
    state.goal.set(GoalChanged(6, "g1", "failed", Pose2D(1.0, 2.0, 0.5), "Kitchen", detail=why))
    recorded = json.loads(json.dumps([to_jsonable(status) for status in shown]))
    back = _put_back([from_jsonable(StatusShown, status) for status in recorded], names={})
    for name, value in reasoned.items():
        assert getattr(back, name).value == value, name
        texts = [getattr(getattr(back, name).value, each.name) for each in fields(value)]
        assert tr(why) in [tr(each) for each in texts if isinstance(each, str)], name
    assert tr(back.control_states.value["wave"].detail) == tr(back.goal.value.detail) == tr(why) != why


def test_names_and_paths_stay_out() -> None:
    state, shown = LiveState(), list[StatusShown]()
    tap_status(state, shown.append)
    state.persons.set((PersonRow("p-1", 4, "Ada", True, 10, 20), PersonRow("p-2", 5, "Person 2", True, 10, 20)))
    state.recording.set(RecordingStatus("recording", Path("/home/ada/study/session"), 9))
    assert "Ada" not in repr(shown) and "/home/ada" not in repr(shown)
    assert [row.name for row in _put_back(shown, names={"p-1": "Ada"}).persons.value] == ["Ada", "Person 2"]
    assert [row.name for row in _put_back(shown, names={}).persons.value] == ["", "Person 2"]


def test_a_replay_says_who_was_suggested_then_as_far_as_the_study_still_knows_them() -> None:
    state, shown = LiveState(), list[StatusShown]()
    tap_status(state, shown.append)
    suggestions = (Suggestion("p-ada", "Ada", 0.8), Suggestion("p-bo", "Bo", 0.1))
    state.persons.set((PersonRow("p-2", 5, "Person 2", True, 10, 20, suggestions=suggestions, group="G1", note="Shy"),))
    state.selected_person.set("p-2")
    assert not [word for word in ("Ada", "Bo", "G1", "Shy") if word in repr(shown)]
    back = _put_back(shown, names={"p-ada": "Ada"})
    (row,) = back.persons.value
    assert [(each.name, each.confidence) for each in row.suggestions] == [("Ada", 0.8)], "who is forgotten is nobody"
    assert back.selected_person.value == "p-2"


@pytest.mark.logs("a recorded status .* is not shown")
def test_a_status_of_another_version_is_left_out() -> None:
    state = LiveState()
    show_status(state, StatusShown(1, "drive", ["no", "object"]), name_of={}.get)
    show_status(state, StatusShown(1, "weather", {"sunny": True}), name_of={}.get)
    assert state.drive.value == DriveStatus()
    state.close()
