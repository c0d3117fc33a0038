"""LiveState: current value of every stream and its age. In the GUI thread; the only state that panels read."""

import logging
from collections.abc import Callable
from dataclasses import field, replace
from functools import partial
from typing import Any

from PySide6.QtCore import QObject, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor, StampAge
from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.events import (
    GoalChanged,
    LinkChanged,
    LinkQuality,
    PeopleMerged,
    PersonForgotten,
    PersonIdentified,
    PersonRejected,
    TrafficMeasured,
)
from caris_desktop.domain.recorded_messages import retranslate
from caris_desktop.domain.schema import from_jsonable, require_recordable, to_jsonable
from caris_desktop.domain.schema_fields import data_of, value_from
from caris_desktop.domain.sensing import CameraState, FrameRef, People, PeopleInMap, PersonPlace, StatusShown
from caris_desktop.domain.sound_values import Hearing
from caris_desktop.domain.streams import (
    BY_NAME,
    BY_TYPE,
    STATE_STREAMS,
    STREAMS_OF_LINK,
    Delivery,
    Freshness,
    StreamSpec,
    streams_voided_by,
)
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.child_process import Health
from caris_desktop.live.status import (
    AssistantSetup,
    AssistantStatus,
    ControlStatus,
    CrashRecoveryStatus,
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
    PracticeStatus,
    PreflightCheck,
    ProposalStatus,
    ProtocolStatus,
    RecordingStatus,
    SoundStatus,
    SpeechStatus,
    SuggestionsStatus,
    VoiceStatus,
)
from caris_desktop.people.presence import PersonRow, is_unnamed_label
from caris_desktop.people.visit_log import Portraits
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.scenario.scenario_model import Place

LOST_AFTER_S = 2.0
_FRESHNESS_CHECK_MS = 100
# Other cameras have a lower detection rate, yet count as simultaneous on the map.
_SAME_MOMENT_NS = 1_000_000_000


class PresentClock(Value):
    """Clock of the panels: now, or a replay's position. ``anchor`` maps it to UTC.

    ``live`` is False in a replay, where nothing is pending.
    """

    now_ns: Callable[[], int] = clock.now_ns
    anchor: ClockAnchor = field(default_factory=ClockAnchor.take)
    live: bool = True


class LiveStream(QObject):
    """Stream value: ``changed(value)`` per value processed in the GUI thread, ``freshness_changed(str)`` as it ages."""

    changed = Signal(object)
    freshness_changed = Signal(str)

    def __init__(self, spec: StreamSpec, present: PresentClock, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.spec = spec
        self._present = present
        self.value: Any = None
        self.freshness: Freshness = "none"
        self.arrivals = 0
        self.robot_clock: LinkQuality | None = None
        self._stamps = StampAge()

    def age_s(self, *, at_ns: int | None = None) -> float | None:
        """Age of the value in s, now or ``at_ns`` of the session clock; None before the first.

        Time since arrival plus the known transport delay: a slow network delivers old measurements at full rate.
        """
        silent_s = self.silent_s(at_ns=at_ns)
        return None if silent_s is None else silent_s + self._stamps.delay_s(*self._offset())

    def silent_s(self, *, at_ns: int | None = None) -> float | None:
        """Time in s since the last arrival."""
        if self.value is None:
            return None
        arrived_ago_s: float = ((self._present.now_ns() if at_ns is None else at_ns) - self.value.stamp_ns) / 1e9
        return arrived_ago_s

    @property
    def age_known(self) -> bool:
        """False if the robot's stamp is implausible: the age is then at least :meth:`age_s`."""
        return self.value is None or self._stamps.is_known(*self._offset())

    @property
    def arrives_late(self) -> bool:
        """Whether values arrive at the usual rate but are old."""
        silent_s, stale_after_s = self.silent_s(), self.spec.stale_after_s
        if silent_s is None or stale_after_s is None:
            return False
        return silent_s <= stale_after_s and self.freshness in ("stale", "lost")

    def _offset(self) -> tuple[float | None, float]:
        """Offset of the robot's clock from ours, and its uncertainty, in ns."""
        quality = self.robot_clock
        if quality is None or quality.clock_offset_ms is None:
            return None, 0.0
        return quality.clock_offset_ms * 1e6, (quality.clock_uncertainty_ms or 0.0) * 1e6

    def update_value(self, value: Any) -> None:
        self.value = value
        self._stamps.add(getattr(value, "robot_stamp_ns", None), arrival_ns=value.stamp_ns)
        self.arrivals += 1
        self.update_freshness()
        self.changed.emit(value)

    def clear(self) -> None:
        """Clear the value, so that nothing old is shown as live."""
        self.value = None
        self._stamps = StampAge()
        self.update_freshness()

    def update_freshness(self) -> None:
        age_s = self.age_s()
        stale_after_s = self.spec.stale_after_s
        freshness: Freshness
        if age_s is None:
            freshness = "none"
        elif stale_after_s is None or age_s <= stale_after_s:
            freshness = "fresh"
        else:
            freshness = "stale" if age_s <= LOST_AFTER_S else "lost"
        if freshness != self.freshness:
            self.freshness = freshness
            self.freshness_changed.emit(freshness)


class LiveValue(QObject):
    """Status value of the console: ``value`` and ``changed(value)``."""

    changed = Signal(object)

    def __init__(self, value: Any, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.value = value

    def follow(self, slot: Callable[[Any], object]) -> None:
        """Call ``slot`` now and on each change."""
        self.changed.connect(slot)
        slot(self.value)

    def set(self, value: Any) -> None:
        if value != self.value:
            self.reset_value(value)

    def update(self, **changes: Any) -> None:
        """Set the value with these fields changed."""
        self.set(replace(self.value, **changes))

    def reset_value(self, value: Any) -> None:
        """Set and emit ``changed`` even if the value is equal."""
        self.value = value
        self.changed.emit(value)


class LiveState(QObject):
    """All state that panels may show: LiveStreams of the stream table, and LiveValues. Values whose first one does not
    show their type:

    ``goal`` (GoalChanged or None), ``persons`` and ``everybody`` (tuples of PersonRow: people present, and also former
    and known ones), ``robot`` (RobotProfile or None), ``scenario`` (Scenario, None before the first), ``places`` (tuple
    of Place), ``controls`` (tuple of RobotControl), ``control_states`` (dict of control id to ControlStatus),
    ``traffic`` (dict of link name to TrafficMeasured), ``notes`` (tuple of FinalMark), ``preflight`` (tuple of
    PreflightCheck), ``photos`` (tuple of PhotoEntry, newest first), ``transcript`` (tuple of Turn), ``asked_person``
    (IdentityQuestion that keys answer, or None), ``person_history`` (PersonHistory of the last lookup, or None).
    Transcript and notes are those of the session, in a replay all of it.

    ``cameras`` are the names of cameras with video, ``camera`` is the one on display: ``frame`` and ``people`` belong
    to it, ``people_in_map`` and ``persons`` to all. :meth:`frame_of`, :meth:`people_of` and :meth:`state_of` are
    streams per camera, with their own age. ``own_cameras`` are those of this computer, a CameraModel or None by name.
    ``face_drawing`` is the face's current contents (Drawing, image array, JPEG data, or None) and ``face_page`` the
    secret address of its page. ``selected_person`` and ``named_person`` are ids, empty for none; ``portraits`` maps the
    keys in rows of people to images. ``speech_history`` (sentences, oldest first) includes earlier sessions;
    ``phrase_group`` is the index of the group on the phrase keys, ``fillers_spoken`` a count. ``chosen_utterance`` is
    the id of the utterance selected in the queue, ``held_marks`` are the ids of marks whose key is down.

    ``event_happened(event)`` carries each event once. ``time_jumped(events)`` reports a seek in a replay: accumulated
    data is void, and these are the newest events before that time, oldest first.
    """

    event_happened = Signal(object)
    time_jumped = Signal(object)

    def __init__(self, parent: QObject | None = None, *, present: PresentClock | None = None) -> None:
        super().__init__(parent)
        self.present = PresentClock() if present is None else present
        self._streams = {spec.name: LiveStream(spec, self.present, self) for spec in STATE_STREAMS}
        self.scan = self._streams["scan"]
        self.odometry = self._streams["odometry"]
        self.pose = self._streams["pose"]
        self.map = self._streams["map"]
        self.battery = self._streams["battery"]
        self.people = self._streams["people"]
        self.people_in_map = self._streams["people_in_map"]
        self.path = self._streams["path"]
        self.head = self._streams["head"]
        self.readings = self._streams["readings"]
        self.frame = self._streams["frame"]
        self.link = LiveValue(LinkStatus(), self)
        self.drive = LiveValue(DriveStatus(), self)
        self.recording = LiveValue(RecordingStatus(), self)
        self.speech = LiveValue(SpeechStatus(), self)
        self.voice = LiveValue(VoiceStatus(), self)
        self.speech_history = LiveValue((), self)
        self.phrase_group = LiveValue(0, self)
        self.fillers_spoken = LiveValue(0, self)
        self.chosen_utterance = LiveValue("", self)
        self.held_marks = LiveValue(frozenset(), self)
        self.assistant = LiveValue(AssistantStatus(), self)
        self.levels = LiveValue(LevelsStatus(), self)
        self.suggestions = LiveValue(SuggestionsStatus(), self)
        self.proposal = LiveValue(ProposalStatus(), self)
        self.assistant_setup = LiveValue(AssistantSetup(), self)
        self.load = LiveValue(LoadStatus(), self)
        self.health = LiveValue(dict[str, Health](), self)
        self.face = LiveValue(FaceStatus(), self)
        self.face_drawing = LiveValue(None, self)
        self.face_page = LiveValue("", self)
        self.perception = LiveValue(PerceptionStatus(), self)
        self.goal = LiveValue(None, self)
        self.persons = LiveValue((), self)
        self.everybody = LiveValue((), self)
        self.portraits = Portraits()
        self.selected_person = LiveValue("", self)
        self.named_person = LiveValue("", self)
        self.asked_person = LiveValue(None, self)
        self.person_history = LiveValue(None, self)
        self.robot = LiveValue(None, self)
        self.scenario = LiveValue(None, self)
        self.saved_scenario = LiveValue(None, self)
        self.import_question = LiveValue(None, self)
        self.file_question = LiveValue(None, self)
        self.places = LiveValue((), self)
        self.look = LiveValue(HeadStatus(), self)
        self.mapping = LiveValue(MapStatus(), self)
        self.controls = LiveValue((), self)
        self.control_states = LiveValue({}, self)
        self.traffic = LiveValue({}, self)
        self.gamepad = LiveValue(GamepadStatus(), self)
        self.marks = LiveValue(MarksStatus(), self)
        self.notes = LiveValue((), self)
        self.alarms = LiveValue((), self)
        self.protocol = LiveValue(ProtocolStatus(), self)
        self.preflight = LiveValue((), self)
        self.cameras = LiveValue((), self)
        self.camera = LiveValue("", self)
        self.own_cameras = LiveValue({}, self)
        self.microphone = LiveValue(MicrophoneStatus(), self)
        self.sound = LiveValue(SoundStatus(), self)
        self.wizard_microphone = LiveValue(MicrophoneStatus(role="wizard"), self)
        self.listening = LiveValue(ListeningStatus(), self)
        self.photos = LiveValue((), self)
        self.transcript = LiveValue((), self)
        self.going_on = LiveValue(CrashRecoveryStatus(), self)
        self.practice = LiveValue(PracticeStatus(), self)
        self._camera_by_hand = False
        self._camera_preferred = ""
        self._of_camera: dict[tuple[str, str], LiveStream] = {}
        self._robot_clock: LinkQuality | None = None
        self._places_by_camera: dict[str, PeopleInMap] = {}
        self._aging = new_timer(self, self.check_freshness)
        self._aging.start(_FRESHNESS_CHECK_MS)

    def close(self) -> None:
        """Stop ageing; all values stay readable."""
        self._aging.stop()

    def stream(self, name: str) -> LiveStream:
        """Stream by its name in the stream table."""
        return self._streams[name]

    def frame_of(self, camera: str) -> LiveStream:
        """Frames of this camera."""
        return self._stream_of("frame", camera)

    def people_of(self, camera: str) -> LiveStream:
        """People detected by this camera."""
        return self._stream_of("people", camera)

    def state_of(self, camera: str) -> LiveStream:
        """State of this camera of this computer."""
        return self._stream_of("camera_state", camera)

    def hearing_of(self, source: str) -> LiveStream:
        """Partial recognition results of this microphone."""
        return self._stream_of("hearing", source)

    def _stream_of(self, name: str, camera: str) -> LiveStream:
        stream = self._of_camera.get((name, camera))
        if stream is None:
            stream = self._of_camera[name, camera] = LiveStream(BY_NAME[name], self.present, self)
            stream.robot_clock = self._robot_clock
        return stream

    def _all_streams(self) -> tuple[LiveStream, ...]:
        return (*self._streams.values(), *self._of_camera.values())

    def add(self, value: Any) -> None:
        """Publish a value or event to the panels. GUI thread only."""
        spec = BY_TYPE[type(value)]
        if isinstance(value, CameraState):
            self.state_of(value.camera).update_value(value)
        has_reason = (
            isinstance(value, CameraState) and value.state != "ended" and value.camera in self.own_cameras.value
        )
        if isinstance(value, FrameRef) or has_reason:  # a camera that never sent a frame has a reason
            self._note_camera(value.camera)
        if isinstance(value, (FrameRef, People)):
            self._stream_of(spec.name, value.camera).update_value(value)
            if self.camera.value not in ("", value.camera):
                return
        if isinstance(value, Hearing):
            self.hearing_of(value.source).update_value(value)
        if isinstance(value, PeopleInMap):
            value = self._people_of_all_cameras(value)
        if isinstance(value, LinkQuality):
            self._robot_clock = value
            for stream in self._all_streams():
                stream.robot_clock = value
        if spec.delivery is Delivery.LOSSLESS:
            # Keep the selection on the same person when their identity changes.
            selected = self.selected_person.value
            match value:
                case PersonIdentified(person_id=before, is_person_id=now) if before == selected:
                    self.selected_person.set(now)
                case PersonRejected(person_id=now, is_person_id=before) if before == selected:
                    self.selected_person.set(now)
                case PeopleMerged(person_id=before, into_person_id=now) if before == selected:
                    self.selected_person.set(now)
                case PersonForgotten(person_id=before) if before == selected:
                    self.selected_person.set("")
            self.event_happened.emit(value)
        else:
            self._streams[spec.name].update_value(value)

    def choose_camera(self, name: str) -> None:
        """Show another camera; ``frame`` and ``people`` follow it."""
        if name in self.cameras.value:
            self._camera_by_hand = True
            self._show_camera(name)

    def prefer_camera(self, name: str) -> None:
        """Show this camera once it is available, until another is chosen. Without a name: the first one, unless one was
        chosen already.
        """
        self._camera_preferred = name
        self._camera_by_hand = self._camera_by_hand and not name
        if not self._camera_by_hand:
            self._show_camera(self._usual_camera())

    def _usual_camera(self) -> str:
        names: tuple[str, ...] = self.cameras.value
        return self._camera_preferred if self._camera_preferred in names else names[0] if names else ""

    @property
    def chosen_camera(self) -> str:
        """Camera chosen by the wizard; empty if it is the default."""
        return str(self.camera.value) if self._camera_by_hand else ""

    def choose_phrases(self, group: int) -> None:
        """Set the group of the phrase keys, wrapping around."""
        scenario = self.scenario.value
        groups = phrase_groups(scenario.phrases) if scenario is not None else ()
        self.phrase_group.set(group % len(groups) if groups else 0)

    def choose_next_camera(self) -> None:
        """Show the next camera."""
        names: tuple[str, ...] = self.cameras.value
        if self.camera.value in names:
            self.choose_camera(names[(names.index(self.camera.value) + 1) % len(names)])

    def forget_cameras(self) -> None:
        """Remove the robot's cameras; those of this computer stay."""
        for name in self.cameras.value:
            if name not in self.own_cameras.value:
                self.forget_camera(name)

    def forget_camera(self, name: str) -> None:
        """Remove a camera that is no longer used."""
        names = tuple(camera for camera in self.cameras.value if camera != name)
        self._places_by_camera.pop(name, None)
        for stream in (self.frame_of(name), self.people_of(name), self.state_of(name)):
            stream.clear()
        self.cameras.set(names)
        if name == self.camera.value:
            self._camera_by_hand = False
            self._show_camera(self._usual_camera())

    def _show_camera(self, name: str) -> None:
        if name != self.camera.value:
            self.frame.clear()
            self.people.clear()
            self.camera.set(name)
            # Use its known state and age at once, without waiting for its next frame.
            for shown, its in ((self.frame, self.frame_of(name)), (self.people, self.people_of(name))):
                if its.value is not None:
                    shown.update_value(its.value)

    def _note_camera(self, name: str) -> None:
        """Add a camera: the robot's first, then this computer's in order; the first or preferred one is shown until the
        wizard chooses.
        """
        if name in self.cameras.value:
            if not self.camera.value:
                self.camera.set(name)
            return
        robot = self.robot.value
        order = [camera.name for camera in robot.cameras] if robot is not None else []
        place = {camera: number for number, camera in enumerate(order)}
        place.update({camera: len(order) + 1 + number for number, camera in enumerate(self.own_cameras.value)})
        names = sorted((*self.cameras.value, name), key=lambda camera: place.get(camera, len(order)))
        self.cameras.set(tuple(names))
        if not self._camera_by_hand:
            self._show_camera(self._usual_camera())

    def _people_of_all_cameras(self, places: PeopleInMap) -> PeopleInMap:
        """People of this camera, merged with those of others at about the same time."""
        self._places_by_camera[places.camera] = places
        together = [
            one for one in self._places_by_camera.values() if abs(one.stamp_ns - places.stamp_ns) <= _SAME_MOMENT_NS
        ]
        if len(together) == 1:
            return places
        # A person seen by two cameras is placed by the more certain one; an unidentified one may be anybody.
        best: dict[str, PersonPlace] = {}
        for number, person in enumerate(person for one in together for person in one.people):
            key = person.person_id or f"{number}"
            if key not in best or person.spread_m < best[key].spread_m:
                best[key] = person
        return PeopleInMap(places.stamp_ns, tuple(best.values()))

    def check_freshness(self) -> None:
        for stream in self._all_streams():
            stream.update_freshness()

    def forget_received(self, event: LinkChanged) -> None:
        """Clear the latched values of a lost link, so that nothing old is shown as live."""
        for name in streams_voided_by(event):
            if name != "frame":
                self._streams[name].clear()
                continue
            # A camera of this computer does not depend on the link.
            for camera in self.cameras.value:
                if camera not in self.own_cameras.value:
                    self.frame_of(camera).clear()
            if self.camera.value not in self.own_cameras.value:
                self.frame.clear()

    def clear_robot_streams(self) -> None:
        """Clear all values of the lost or replaced robot."""
        for name in STREAMS_OF_LINK["control"]:
            self._streams[name].clear()


# Status tap: records status values of the console, and restores them in a replay.

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


def tap_status(state: LiveState, record: Callable[[StatusShown], None]) -> None:
    """Pass the present values and every change to ``record``."""

    def report(name: str, value: Any) -> None:
        record(StatusShown(clock.now_ns(), name, content_of(name, value)))

    for name in STATUS_TYPES:
        value: LiveValue = getattr(state, name)
        value.changed.connect(partial(report, name))
        report(name, value.value)


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
