"""Status tap: records status values of the console, and restores them in a replay."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject

from caris_desktop.domain import clock
from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.events import GoalChanged, TrafficMeasured
from caris_desktop.domain.recorded_messages import retranslate
from caris_desktop.domain.schema import from_jsonable, require_recordable, to_jsonable
from caris_desktop.domain.schema_fields import data_of, value_from
from caris_desktop.domain.sensing import StatusShown
from caris_desktop.live.state import LiveState, LiveValue
from caris_desktop.live.status import (
    AssistantStatus,
    ControlStatus,
    DriveStatus,
    FaceStatus,
    GamepadStatus,
    HeadStatus,
    LevelsStatus,
    LinkStatus,
    ListeningStatus,
    LoadStatus,
    MapStatus,
    MarksStatus,
    MicrophoneStatus,
    PerceptionStatus,
    PreflightCheck,
    ProposalStatus,
    ProtocolStatus,
    RecordingStatus,
    SoundStatus,
    SpeechStatus,
    SuggestionsStatus,
)
from caris_desktop.people.presence import PersonRow, is_unnamed_label
from caris_desktop.scenario.scenario_model import Place

_log = logging.getLogger(__name__)

# Recorded values of LiveState and their types; ``scenario`` and ``robot`` are recorded as events.
STATUS_TYPES: dict[str, Any] = {
    "recording": RecordingStatus,
    "link": LinkStatus,
    "drive": DriveStatus,
    "speech": SpeechStatus,
    "assistant": AssistantStatus,
    "levels": LevelsStatus,
    "suggestions": SuggestionsStatus,
    "proposal": ProposalStatus,
    "perception": PerceptionStatus,
    "load": LoadStatus,
    "face": FaceStatus,
    "goal": GoalChanged | None,
    "persons": tuple[PersonRow, ...],
    "selected_person": str,
    "places": tuple[Place, ...],
    "look": HeadStatus,
    "mapping": MapStatus,
    "controls": tuple[RobotControl, ...],
    "control_states": dict[str, ControlStatus],
    "traffic": dict[str, TrafficMeasured],
    "gamepad": GamepadStatus,
    "marks": MarksStatus,
    "protocol": ProtocolStatus,
    "preflight": tuple[PreflightCheck, ...],
    "cameras": tuple[str, ...],
    "camera": str,
    "microphone": MicrophoneStatus,
    "wizard_microphone": MicrophoneStatus,
    "sound": SoundStatus,
    "listening": ListeningStatus,
}

require_recordable(*(kind for name, kind in STATUS_TYPES.items() if name != "controls"))

_REASONS = ("detail", "reason", "cap_reason", "guard_detail")


class StatusTap(QObject):
    """Passes every change to ``record``, and the initial values."""

    def __init__(self, state: LiveState, record: Callable[[StatusShown], None], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._record = record
        self._watches = [_Watch(name, getattr(state, name), self._on_changed, self) for name in STATUS_TYPES]

    def _on_changed(self, name: str, value: Any) -> None:
        self._record(StatusShown(clock.now_ns(), name, content_of(name, value)))


class _Watch(QObject):
    """Observer of one value, which knows its name."""

    def __init__(self, name: str, value: LiveValue, report: Callable[[str, Any], None], parent: QObject) -> None:
        super().__init__(parent)
        self._name = name
        self._report = report
        value.changed.connect(self._on_changed)
        report(name, value.value)

    def _on_changed(self, value: Any) -> None:
        self._report(self._name, value)


def show_status(state: LiveState, status: StatusShown, *, name_of: Callable[[str], str | None]) -> None:
    """Restore a recorded status. ``name_of``: names not in the recording, if known."""
    kind = STATUS_TYPES.get(status.name)
    if kind is None:
        return
    try:
        value = _value_of(status.name, kind, _retranslated(status.content))
    except (ValueError, KeyError, TypeError) as error:
        _log.warning("a recorded status %s is not shown: %s", status.name, error)
        return
    if status.name == "persons":
        value = tuple(_with_names(row, name_of) for row in value)
    getattr(state, status.name).set(value)


def _retranslated(content: Any) -> Any:
    """Recorded reasons converted for translation into another language."""
    if isinstance(content, list):
        return list(map(_retranslated, content))
    if not isinstance(content, dict):
        return content
    return {
        key: retranslate(value) if key in _REASONS and isinstance(value, str) else _retranslated(value)
        for key, value in content.items()
    }


def _with_names(row: PersonRow, name_of: Callable[[str], str | None]) -> PersonRow:
    """The row with names; suggestions of an erased person are dropped."""
    suggestions = (
        replace(suggested, name=suggested.name or name_of(suggested.person_id) or "") for suggested in row.suggestions
    )
    return replace(
        row,
        name=row.name or name_of(row.person_id) or "",
        suggestions=tuple(suggested for suggested in suggestions if suggested.name),
    )


def content_of(name: str, value: Any) -> Any:
    """Serialised value, without data excluded from recordings."""
    if name == "controls":
        # As in files: the generic form would not distinguish the kinds of a control's action.
        return data_of(tuple[RobotControl, ...], value)
    return to_jsonable(_for_the_record(value))


def _value_of(name: str, kind: Any, content: Any) -> Any:
    if name == "controls":
        return value_from(tuple[RobotControl, ...], content)
    return from_jsonable(kind, content)


def _for_the_record(value: Any) -> Any:
    """Value without names of people, which stay in the study's database, and without local paths."""
    if isinstance(value, RecordingStatus):
        return replace(value, folder=None)
    if isinstance(value, DriveStatus):
        return replace(value, driver="")  # another wizard's name; commands carry it, and exports leave it out
    if isinstance(value, tuple) and value and isinstance(value[0], PersonRow):
        return tuple(map(_without_words, value))
    return value


def _without_words(row: PersonRow) -> PersonRow:
    """Row with opaque ids, positions and times only."""
    name = row.name if is_unnamed_label(row.name) else ""
    suggestions = tuple(
        suggested if is_unnamed_label(suggested.name) else replace(suggested, name="") for suggested in row.suggestions
    )
    return replace(row, name=name, group="", tags=(), note="", summary="", portrait="", suggestions=suggestions)
