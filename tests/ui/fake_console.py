"""Console double without robot, threads and files: records every intent and updates a real LiveState."""

import dataclasses
import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.conversation_transcript import Transcript, UtteranceReport
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.events import (
    AssistanceLevel,
    AssistedFunction,
    CommandSource,
    ConsentKind,
    ConsentNoted,
    EmergencyStopChanged,
    GoalChanged,
    Marked,
    MarkKind,
    PeopleMerged,
    PeopleUndone,
    PersonAttended,
    PersonDescribed,
    PersonDetail,
    PersonForgotten,
    PersonIdentified,
    PersonRejected,
    PersonRenamed,
    PersonSplit,
    Problem,
    RecordingPaused,
    StopRequested,
    TrialDetails,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
    VoiceOutput,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.sound_values import Role, TalkTo
from caris_desktop.live.services.alarms_service import AlarmsService
from caris_desktop.live.services.protocol_service import ProtocolService
from caris_desktop.live.state import LiveState, LiveValue
from caris_desktop.live.status import (
    AssistantStatus,
    ControlStatus,
    ExportStatus,
    HeadStatus,
    LibraryStatus,
    MarksStatus,
    PersonHistory,
    RecordingStatus,
    VoiceStatus,
)
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.csv_cells import SHOWN, CsvStyle
from caris_desktop.recording.session.session_marks import final_marks_of, notes_among
from caris_desktop.recording.studies.study_query import SearchHit, SessionEntry, SessionQuery
from caris_desktop.robot.profile import ListedProfile
from caris_desktop.scenario.scenario_model import Place, Scenario, layout_from_data


class FakeFrames:
    """Frames by sequence number."""

    def __init__(self) -> None:
        self.images: dict[int, NDArray[np.uint8]] = {}

    def add(self, image_bgr: NDArray[np.uint8], *, stamp_ns: int | None = None, camera: str = "front") -> FrameRef:
        sequence = len(self.images) + 1
        self.images[sequence] = image_bgr
        return FrameRef(
            stamp_ns=clock.now_ns() if stamp_ns is None else stamp_ns,
            robot_stamp_ns=None,
            camera=camera,
            ring="fake",
            slot=0,
            sequence=sequence,
            width_px=image_bgr.shape[1],
            height_px=image_bgr.shape[0],
        )

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        image_bgr = self.images.get(ref.sequence)
        return None if image_bgr is None else image_bgr.copy()


class FakeConsole:
    """Implements WizardConsole; ``calls`` holds (name, arguments) of every intent in order, else (type name, intent).

    Its methods have the effects of the services; tests may call them for events from outside the window.
    """

    def __init__(self, scenario: Scenario, other_scenarios: dict[Path, Scenario] | None = None) -> None:
        self.state = LiveState()
        self.state.places.set(scenario.places)
        self.state.controls.set(scenario.controls)
        self.scenario = scenario
        self.state.scenario.set(scenario)
        self.frames = FakeFrames()
        self.suggested = TrialDetails()
        self.bytes_per_hour: float | None = None
        self.free: int | None = None
        self.disk_is_slow = False
        self.told_failures: list[UserFacingError] = []
        self._asked_of_disk: list[tuple[Callable[[], Any], Callable[[Any], None], Any]] = []
        self.inputs: tuple[str, ...] = ()
        self.input: str | None = None
        self.wizard_input: str | None = ""
        self.marks: dict[str, Marked] = {}
        self._told_marks: list[Marked] = []
        self.transcript = Transcript()
        self.history: dict[str, tuple[HistoryEntry, ...]] = {}
        self.protocol = ProtocolService(self.state, self.state.add)
        self.protocol.use_scenario(scenario)
        self.calls: list[tuple[str, Any]] = []
        self.refuses_speech = self.began_anyway = False
        self.asked_with: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._others = other_scenarios or {}
        self.is_replay = False
        self.ahead_ns = 0  # time added to the clock, for alarms
        self.alarms = AlarmsService(
            self.state, self.state.event_happened.emit, now_ns=lambda: clock.now_ns() + self.ahead_ns
        )
        self.state.event_happened.connect(self._on_event)

    def report(self, problem: Problem) -> None:
        self.state.event_happened.emit(problem)

    def _on_event(self, event: object) -> None:
        if isinstance(event, Problem) and not self.is_replay:
            self.alarms.add(event)

    def dismiss_alarm(self, alarm_id: str) -> None:
        self.calls.append(("dismiss_alarm", alarm_id))
        self.alarms.dismiss(intents.DismissAlarm(alarm_id))

    def named(self, name: str) -> list[Any]:
        """Arguments of every call of ``name``."""
        return [arguments for called, arguments in self.calls if called == name]

    def do(self, intent: Intent) -> str:
        values = {each.name: getattr(intent, each.name) for each in dataclasses.fields(intent)}
        del values["actor"]
        if type(intent) in self.protocol.handlers():
            self.calls.append(("protocol", intent))
            try:
                self.protocol.handlers()[type(intent)](intent)
            except UserFacingError as failure:
                return failure.what
            return ""
        name = _METHODS.get(type(intent))
        if name is None:  # it affects the window only through the state
            self.calls.append((type(intent).__name__, intent))
            return ""
        return "refused" if getattr(self, name)(**values) is False else ""

    def drive(self, forward: float, left: float, turn: float, source: CommandSource) -> None:
        self.calls.append(("drive", (forward, left, turn, source)))

    def release_drive(self, reason: str = "") -> None:
        self.calls.append(("release_drive", reason))

    def set_speed_fraction(self, fraction: float) -> None:
        self.calls.append(("set_speed_fraction", fraction))
        self._set_drive(speed_fraction=fraction)

    def stop(self) -> None:
        self.calls.append(("stop", None))
        self.state.add(StopRequested(clock.now_ns()))

    def emergency_stop(self) -> None:
        self.calls.append(("emergency_stop", None))
        self._set_drive(emergency_stop=True)
        self.state.add(EmergencyStopChanged(clock.now_ns(), latched=True, by="wizard"))

    def clear_emergency_stop(self) -> None:
        self.calls.append(("clear_emergency_stop", None))
        self._set_drive(emergency_stop=False)

    def go_to_place(self, place: str) -> None:
        self.calls.append(("go_to_place", place))
        pose = next(each.pose_in_map for each in self.scenario.places if each.name == place)
        goal = GoalChanged(clock.now_ns(), "goal-1", "active", pose, place=place, distance_left_m=3.2)
        self.state.goal.set(goal)

    def go_to(self, target_in_map: Pose2D) -> None:
        self.calls.append(("go_to", target_in_map))
        self.state.goal.set(GoalChanged(clock.now_ns(), "goal-1", "active", target_in_map, distance_left_m=3.2))

    def set_guard(self, on: bool) -> None:
        self.calls.append(("set_guard", on))
        self._set_drive(guard="clear" if on else "overridden")

    def look_at(self, pan_rad: float, tilt_rad: float) -> None:
        self.calls.append(("look_at", (pan_rad, tilt_rad)))
        self.state.look.set(HeadStatus(True, pan_rad, tilt_rad))

    def turn_head(self, pan: float, tilt: float) -> None:
        self.calls.append(("turn_head", (pan, tilt)))

    def nod(self) -> None:
        self.calls.append(("nod", None))

    def set_initial_pose(self, pose_in_map: Pose2D) -> None:
        self.calls.append(("set_initial_pose", pose_in_map))

    def save_place(self, place: str, pose_in_map: Pose2D) -> None:
        self.calls.append(("save_place", (place, pose_in_map)))
        others = tuple(each for each in self.state.places.value if each.name != place)
        self.state.places.set((*others, Place(place, pose_in_map)))

    def remove_place(self, place: str) -> None:
        self.calls.append(("remove_place", place))
        self.state.places.set(tuple(each for each in self.state.places.value if each.name != place))

    def save_map(self, name: str) -> None:
        self.calls.append(("save_map", name))

    def load_map(self, name: str) -> None:
        self.calls.append(("load_map", name))

    def set_mapping(self, mapping: bool) -> None:
        self.calls.append(("set_mapping", mapping))
        self.state.mapping.set(dataclasses.replace(self.state.mapping.value, mapping=mapping))

    def use_control(self, control: str, value: ControlValue) -> None:
        self.calls.append(("use_control", (control, value)))
        states = dict(self.state.control_states.value)
        states[control] = ControlStatus("requested", value)
        self.state.control_states.set(states)

    def robots(self) -> list[ListedProfile]:
        return [
            ListedProfile("simulated", "Simulated robot", "ws://127.0.0.1:9090"),
            ListedProfile("tiago", "TIAGo", "ws://tiago:9090"),
        ]

    def use_robot(self, robot: str) -> bool:
        self.calls.append(("use_robot", robot))
        return any(each.name == robot for each in self.robots())

    def cancel_goal(self) -> None:
        self.calls.append(("cancel_goal", None))
        self.state.goal.set(None)

    def say(self, text: str, origin: UtteranceOrigin, person_id: str = "", gesture: str = "", face: str = "") -> bool:
        self.calls.append(("say", (text, origin)))
        if self.refuses_speech:
            return False
        if origin == "typed":
            self.state.speech_history.set((*self.state.speech_history.value, text))
        self.state.add(UtteranceChanged(clock.now_ns(), f"u{len(self.calls)}", "robot", text, origin, "started"))
        return True

    def fill_gap(self, words: str) -> None:
        self.calls.append(("fill_gap", words))
        self.state.speech.set(dataclasses.replace(self.state.speech.value, gap=None))

    def set_voice(self, output: VoiceOutput, name: str, language: str, rate: float, volume: float) -> None:
        self.calls.append(("set_voice", (output, name, language, rate, volume)))
        voice = self.state.voice.value
        self.state.voice.set(VoiceStatus(output, name, language, rate, volume, voice.used, voice.choices))

    def move_queued(self, utterance_id: str, place: int) -> None:
        self.calls.append(("move_queued", (utterance_id, place)))
        waiting = list(self.state.speech.value.waiting)
        moved = next(each for each in waiting if each.utterance_id == utterance_id)
        waiting.remove(moved)
        waiting.insert(place, moved)
        self.state.speech.set(dataclasses.replace(self.state.speech.value, waiting=tuple(waiting)))

    def edit_queued(self, utterance_id: str, text: str) -> bool:
        self.calls.append(("edit_queued", (utterance_id, text)))
        waiting = self.state.speech.value.waiting
        changed = tuple(
            dataclasses.replace(each, text=text) if each.utterance_id == utterance_id else each for each in waiting
        )
        self.state.speech.set(dataclasses.replace(self.state.speech.value, waiting=changed))
        return changed != waiting

    def cancel_queued(self, utterance_id: str) -> None:
        self.calls.append(("cancel_queued", utterance_id))
        left = tuple(each for each in self.state.speech.value.waiting if each.utterance_id != utterance_id)
        self.state.speech.set(dataclasses.replace(self.state.speech.value, waiting=left))

    def silence(self) -> None:
        self.calls.append(("silence", None))

    def say_suggestion(self, rank: int, suggestion_id: str) -> None:
        self.calls.append(("say_suggestion", (rank, suggestion_id)))

    def say_edited_suggestion(self, suggestion_id: str, text: str) -> None:
        self.calls.append(("say_edited_suggestion", (suggestion_id, text)))

    def dismiss_suggestions(self) -> None:
        self.calls.append(("dismiss_suggestions", None))

    def confirm_proposal(self, proposal_id: str) -> None:
        self.calls.append(("confirm_proposal", proposal_id))

    def veto_proposal(self, proposal_id: str) -> None:
        self.calls.append(("veto_proposal", proposal_id))

    def set_level(self, function: AssistedFunction, level: AssistanceLevel) -> None:
        self.calls.append(("set_level", (function, level)))
        self.state.levels.set(dataclasses.replace(self.state.levels.value, **{function: level}))

    def correct_utterance(self, utterance_id: str, **corrected: Any) -> None:
        made = {name: value for name, value in corrected.items() if value is not None}
        self.calls.append(("correct_utterance", (utterance_id, made)))
        self.say_turn(UtteranceCorrected(clock.now_ns(), utterance_id, **corrected))

    def say_turn(self, *events: UtteranceReport) -> None:
        """Add speech events to the transcript and the state."""
        for event in events:
            self.transcript.add(event)
            self.state.add(event)
        self.state.transcript.reset_value(self.transcript.turns)

    def ask_assistant(self, question: str, leave_out: tuple[str, ...] = (), pictures: tuple[str, ...] = ()) -> None:
        self.calls.append(("ask_assistant", question))
        self.asked_with = (leave_out, pictures)
        self.state.assistant.set(AssistantStatus("answering", "SmolLM2", f"x{len(self.calls)}", question))

    def cancel_assistant(self, exchange_id: str = "") -> None:
        self.calls.append(("cancel_assistant", exchange_id))
        self.state.assistant.set(dataclasses.replace(self.state.assistant.value, state="ready"))

    def say_answer(self, text: str, exchange_id: str = "") -> None:
        self.calls.append(("say_answer", text))

    def dismiss_answer(self, exchange_id: str) -> None:
        self.calls.append(("dismiss_answer", exchange_id))

    def add_model(self, file: Path) -> None:
        self.calls.append(("add_model", file))

    def choose_model(self, model: str) -> None:
        self.calls.append(("choose_model", model))
        self.state.assistant_setup.set(dataclasses.replace(self.state.assistant_setup.value, model=model))

    def choose_prompt(self, kind: str, name: str) -> None:
        self.calls.append(("choose_prompt", (kind, name)))
        self.state.assistant_setup.set(dataclasses.replace(self.state.assistant_setup.value, **{kind: name}))

    def edit_prompt(self, kind: str, text: str, name: str = "") -> None:
        self.calls.append(("edit_prompt", (kind, name, text)))

    def reset_prompts(self) -> None:
        self.calls.append(("reset_prompts", None))

    def rename_person(self, person_id: str, name: str) -> None:
        self.calls.append(("rename_person", (person_id, name)))
        self.state.persons.set(
            tuple(
                dataclasses.replace(person, name=name) if person.person_id == person_id else person
                for person in self.state.persons.value
            )
        )
        self.state.add(PersonRenamed(clock.now_ns(), person_id, WIZARD))

    def attend_person(self, person_id: str) -> None:
        self.calls.append(("attend_person", person_id))
        self.state.selected_person.set(person_id)
        self.state.add(PersonAttended(clock.now_ns(), person_id, WIZARD))

    def confirm_person(self, person_id: str, is_person_id: str) -> None:
        self.calls.append(("confirm_person", (person_id, is_person_id)))
        known = self._person(is_person_id)
        seen = self._person(person_id)
        self._replace_persons(
            {
                person_id: dataclasses.replace(
                    known, track=seen.track, here=seen.here, since_ns=seen.since_ns, last_seen_ns=seen.last_seen_ns,
                    camera=seen.camera, visit_id=person_id, number=seen.number,
                ),
                is_person_id: None,
            }
        )  # fmt: skip
        self.state.add(PersonIdentified(clock.now_ns(), person_id, is_person_id, "wizard", 0.82, actor=WIZARD))

    def reject_person(self, person_id: str, is_person_id: str) -> None:
        self.calls.append(("reject_person", (person_id, is_person_id)))
        self._replace_persons({person_id: dataclasses.replace(self._person(person_id), suggestions=())})
        self.state.add(PersonRejected(clock.now_ns(), person_id, is_person_id, WIZARD))

    def set_person_group(self, person_id: str, group: str) -> None:
        self.calls.append(("set_person_group", (person_id, group)))
        self._describe(person_id, "group", group=group)

    def tag_person(self, person_id: str, tags: tuple[str, ...]) -> None:
        self.calls.append(("tag_person", (person_id, tags)))
        self._describe(person_id, "tags", tags=tags)

    def note_person(self, person_id: str, note: str) -> None:
        self.calls.append(("note_person", (person_id, note)))
        self._describe(person_id, "note", note=note)

    def merge_people(self, person_id: str, into_person_id: str) -> None:
        self.calls.append(("merge_people", (person_id, into_person_id)))
        self._replace_persons({person_id: None})
        self.state.add(PeopleMerged(clock.now_ns(), person_id, into_person_id, WIZARD))

    def split_person(self, person_id: str, visit_id: str) -> None:
        self.calls.append(("split_person", person_id))
        self.state.add(PersonSplit(clock.now_ns(), f"{person_id}-new", person_id, WIZARD))

    def note_consent(self, person_id: str, kind: ConsentKind, given: bool) -> None:
        self.calls.append(("note_consent", (person_id, kind, given)))
        self.state.add(ConsentNoted(clock.now_ns(), person_id, kind, given, WIZARD))

    def undo_people(self) -> None:
        self.calls.append(("undo_people", None))
        self.state.add(PeopleUndone(clock.now_ns(), "p1", "named", actor=WIZARD))

    def forget_person(self, person_id: str) -> None:
        self.calls.append(("forget_person", person_id))
        self._replace_persons({person_id: None})
        self.state.add(PersonForgotten(clock.now_ns(), person_id, WIZARD))

    def look_up_person(self, person_id: str, text: str) -> None:
        self.calls.append(("look_up_person", (person_id, text)))
        found = tuple(entry for entry in self.history.get(person_id, ()) if text.casefold() in entry.text.casefold())
        self.state.person_history.reset_value(PersonHistory(person_id, text, found))

    def _person(self, person_id: str) -> PersonRow:
        rows = (*self.state.persons.value, *self.state.everybody.value)
        return next(person for person in rows if person.person_id == person_id)

    def _describe(self, person_id: str, detail: PersonDetail, **changes: Any) -> None:
        self._replace_persons({person_id: dataclasses.replace(self._person(person_id), **changes)})
        self.state.add(PersonDescribed(clock.now_ns(), person_id, detail, WIZARD))

    def _replace_persons(self, changes: dict[str, PersonRow | None]) -> None:
        for live in (self.state.persons, self.state.everybody):
            rows = (changes.get(person.person_id, person) for person in live.value)
            live.set(tuple(row for row in rows if row is not None))

    def take_photo(self) -> None:
        self.calls.append(("take_photo", None))

    def mark(self, label: str, kind: MarkKind = "mark", earlier_s: float = 0.0, mark_id: str = "") -> str:
        self.calls.append(("mark", (label, kind)))
        now_ns = clock.now_ns()
        start_ns = now_ns - round(earlier_s * 1e9) if earlier_s else None
        mark_id = mark_id or f"m{len(self.marks) + 1}"
        return self._keep_mark(Marked(now_ns, label, kind, mark_id, start_ns))

    def begin_mark(self, label: str, kind: MarkKind = "mark", earlier_s: float = 0.0, mark_id: str = "") -> str:
        self.calls.append(("begin_mark", (label, kind)))
        now_ns = clock.now_ns()
        mark_id = mark_id or f"m{len(self.marks) + 1}"
        return self._keep_mark(Marked(now_ns, label, kind, mark_id, now_ns - round(earlier_s * 1e9), state="open"))

    def stretch_mark(self, mark_id: str) -> None:
        self.calls.append(("stretch_mark", mark_id))
        mark = self.marks[mark_id]
        self._keep_mark(dataclasses.replace(mark, start_ns=mark.start_ns or mark.stamp_ns, state="open"))

    def end_mark(self, mark_id: str) -> None:
        self.calls.append(("end_mark", mark_id))
        now_ns = clock.now_ns()
        self._keep_mark(dataclasses.replace(self.marks[mark_id], stamp_ns=now_ns, end_ns=now_ns, state="done"))

    def change_mark(self, mark_id: str, label: str | None = None, earlier_s: float = 0.0) -> None:
        self.calls.append(("change_mark", (mark_id, label, earlier_s)))
        mark = self.marks[mark_id]
        began_ns = mark.stamp_ns if mark.start_ns is None else mark.start_ns
        self._keep_mark(
            dataclasses.replace(
                mark,
                stamp_ns=clock.now_ns(),
                start_ns=began_ns - round(earlier_s * 1e9),
                label=mark.label if label is None else label,
            )
        )

    def withdraw_mark(self, mark_id: str) -> None:
        self.calls.append(("withdraw_mark", mark_id))
        self._keep_mark(dataclasses.replace(self.marks[mark_id], stamp_ns=clock.now_ns(), state="withdrawn"))

    def add_note(self, text: str, earlier_s: float = 0.0, note_id: str = "") -> bool:
        self.calls.append(("add_note", text))
        if self.state.recording.value.state != "recording":
            return False
        now_ns = clock.now_ns()
        self._keep_mark(Marked(now_ns, "", "note", note_id, now_ns - round(earlier_s * 1e9), note=text))
        return True

    def change_note(self, note_id: str, text: str) -> None:
        self.calls.append(("change_note", (note_id, text)))
        mark = self.marks[note_id]
        moment_ns = mark.stamp_ns if mark.start_ns is None else mark.start_ns
        self._keep_mark(dataclasses.replace(mark, stamp_ns=clock.now_ns(), start_ns=moment_ns, note=text))

    def remove_note(self, note_id: str) -> None:
        self.calls.append(("remove_note", note_id))
        self._keep_mark(dataclasses.replace(self.marks[note_id], stamp_ns=clock.now_ns(), state="withdrawn"))

    def restore_note(self, note_id: str) -> None:
        self.calls.append(("restore_note", note_id))
        self._keep_mark(dataclasses.replace(self.marks[note_id], stamp_ns=clock.now_ns(), state="done"))

    def _keep_mark(self, mark: Marked) -> str:
        self.marks[mark.mark_id] = mark
        self._told_marks.append(mark)
        self.state.add(mark)
        going_on = tuple(each for each in self.marks.values() if each.state == "open")
        self.state.marks.set(MarksStatus(None if mark.state == "withdrawn" else mark, going_on))
        self.state.notes.set(notes_among(final_marks_of(self._told_marks, ended_ns=mark.stamp_ns)))
        return mark.mark_id

    def check_before_recording(self, told: Callable[[BeforeRecording], None]) -> None:
        self.run_in_background(lambda: BeforeRecording(self.suggested, self.bytes_per_hour, self.free), told)

    def run_in_background(
        self,
        read: Callable[[], Any],
        done: Callable[[Any], None],
        failed: Callable[[UserFacingError], None] | None = None,
    ) -> None:
        """Run at once, as with a fast disk; while ``disk_is_slow`` at ``answer_of_disk``."""
        self._asked_of_disk.append((read, done, failed))
        if not self.disk_is_slow:
            self.answer_of_disk()

    def answer_of_disk(self) -> None:
        while self._asked_of_disk:
            read, done, failed = self._asked_of_disk.pop(0)
            try:
                found = read()
            except UserFacingError as failure:
                (failed or self.told_failures.append)(failure)
            else:
                done(found)

    def microphones(self) -> Sequence[str]:
        return self.inputs

    @property
    def microphone(self) -> str | None:
        return self.input

    @property
    def wizard_microphone(self) -> str | None:
        return self.wizard_input

    def push_to_talk(self, on: bool, to: TalkTo) -> None:
        self.calls.append(("push_to_talk", (on, to)))
        self.state.sound.set(dataclasses.replace(self.state.sound.value, talking=to if on else ""))

    def hear_robot(self, on: bool, volume: float) -> None:
        self.calls.append(("hear_robot", (on, volume)))
        self.state.sound.set(dataclasses.replace(self.state.sound.value, hearing=on, volume=volume))

    def use_microphone(self, microphone: str | None, role: Role) -> None:
        self.calls.append(("use_microphone", (microphone, role)))
        if role == "participant":
            self.input = microphone
        else:
            self.wizard_input = microphone

    def pause_session(self, paused: bool) -> None:
        self.calls.append(("pause_session", paused))
        self.state.add(RecordingPaused(clock.now_ns(), paused))
        self.state.recording.set(
            dataclasses.replace(self.state.recording.value, state="paused" if paused else "recording")
        )

    def tag_photo(self, file_name: str, tags: tuple[str, ...]) -> None:
        self.calls.append(("tag_photo", (file_name, tags)))
        self._change_photo(file_name, tags=tags)

    def delete_photo(self, file_name: str) -> None:
        self.calls.append(("delete_photo", file_name))
        self._change_photo(file_name, deleted=True)

    def restore_photo(self, file_name: str) -> None:
        self.calls.append(("restore_photo", file_name))
        self._change_photo(file_name, deleted=False)

    def ask_about_photo(self, file_name: str, question: str) -> None:
        self.calls.append(("ask_about_photo", (file_name, question)))

    def _change_photo(self, file_name: str, **changes: Any) -> None:
        self.state.photos.set(
            tuple(
                dataclasses.replace(entry, **changes) if entry.file_name == file_name else entry
                for entry in self.state.photos.value
            )
        )

    def keep_layout(self, layout: str) -> None:
        self.calls.append(("keep_layout", layout_from_data(json.loads(layout))))

    def tick_check(self, check_id: str, done: bool) -> None:
        self.calls.append(("tick_check", (check_id, done)))
        self.state.preflight.set(
            tuple(
                dataclasses.replace(
                    check, state="passed" if done else "not checked", actor=WIZARD if done else "",
                    checked_ns=clock.now_ns() if done else None,
                ) if check.id == check_id else check
                for check in self.state.preflight.value
            )
        )  # fmt: skip

    def try_microphone(self, on: bool) -> None:
        self.calls.append(("try_microphone", on))

    def start_session(self, details: TrialDetails, anyway: bool = False) -> None:
        self.calls.append(("start_session", details))
        self.began_anyway = anyway
        self.suggested = details
        self.state.recording.set(
            RecordingStatus("recording", Path("/sessions/2026-11-21_14-02-11_P07"), clock.now_ns(), 0, 41_000_000_000)
        )

    def stop_session(self) -> None:
        self.calls.append(("stop_session", None))
        self.state.recording.set(dataclasses.replace(self.state.recording.value, state="idle"))

    def save_scenario(self, text: str, path: Path, edited: Path | None, replaces: str) -> None:
        self.calls.append(("save_scenario", (text, path, edited, replaces)))

    def open_scenario(self, path: Path) -> bool:
        self.calls.append(("open_scenario", path))
        if path not in self._others:
            return False
        self.scenario = self._others[path]
        self.protocol.use_scenario(self.scenario)
        self.state.places.set(self.scenario.places)
        self.state.controls.set(self.scenario.controls)
        self.state.scenario.reset_value(self.scenario)
        return True

    def _set_drive(self, **changes: Any) -> None:
        self.state.drive.set(dataclasses.replace(self.state.drive.value, **changes))


_METHODS: dict[type[Intent], str] = {
    intents.Drive: "drive",
    intents.ReleaseDrive: "release_drive",
    intents.SetSpeed: "set_speed_fraction",
    intents.Stop: "stop",
    intents.EmergencyStop: "emergency_stop",
    intents.ReleaseEmergencyStop: "clear_emergency_stop",
    intents.SetGuard: "set_guard",
    intents.LookAt: "look_at",
    intents.TurnHead: "turn_head",
    intents.Nod: "nod",
    intents.GoToPlace: "go_to_place",
    intents.GoToPoint: "go_to",
    intents.CancelGoal: "cancel_goal",
    intents.SetInitialPose: "set_initial_pose",
    intents.SavePlace: "save_place",
    intents.RemovePlace: "remove_place",
    intents.SaveMap: "save_map",
    intents.LoadMap: "load_map",
    intents.SetMapping: "set_mapping",
    intents.UseControl: "use_control",
    intents.UseRobot: "use_robot",
    intents.Say: "say",
    intents.FillGap: "fill_gap",
    intents.SetVoice: "set_voice",
    intents.MoveQueued: "move_queued",
    intents.EditQueued: "edit_queued",
    intents.CancelQueued: "cancel_queued",
    intents.Silence: "silence",
    intents.CorrectUtterance: "correct_utterance",
    intents.Ask: "ask_assistant",
    intents.CancelAnswer: "cancel_assistant",
    intents.DismissAnswer: "dismiss_answer",
    intents.AddModel: "add_model",
    intents.ChooseModel: "choose_model",
    intents.ChoosePrompt: "choose_prompt",
    intents.EditPrompt: "edit_prompt",
    intents.ResetPrompts: "reset_prompts",
    intents.SayAnswer: "say_answer",
    intents.SaySuggestion: "say_suggestion",
    intents.SayEditedSuggestion: "say_edited_suggestion",
    intents.DismissSuggestions: "dismiss_suggestions",
    intents.ConfirmProposal: "confirm_proposal",
    intents.VetoProposal: "veto_proposal",
    intents.SetLevel: "set_level",
    intents.NamePerson: "rename_person",
    intents.AttendPerson: "attend_person",
    intents.ConfirmPerson: "confirm_person",
    intents.RejectPerson: "reject_person",
    intents.SetPersonGroup: "set_person_group",
    intents.TagPerson: "tag_person",
    intents.NotePerson: "note_person",
    intents.MergePeople: "merge_people",
    intents.SplitPerson: "split_person",
    intents.NoteConsent: "note_consent",
    intents.UndoPeople: "undo_people",
    intents.ForgetPerson: "forget_person",
    intents.LookUpPerson: "look_up_person",
    intents.StartRecording: "start_session",
    intents.TickCheck: "tick_check",
    intents.TryMicrophone: "try_microphone",
    intents.StopRecording: "stop_session",
    intents.PauseRecording: "pause_session",
    intents.UseMicrophone: "use_microphone",
    intents.PushToTalk: "push_to_talk",
    intents.HearRobot: "hear_robot",
    intents.TakePhoto: "take_photo",
    intents.TagPhoto: "tag_photo",
    intents.DeletePhoto: "delete_photo",
    intents.RestorePhoto: "restore_photo",
    intents.AskAboutPhoto: "ask_about_photo",
    intents.KeepLayout: "keep_layout",
    intents.OpenScenario: "open_scenario",
    intents.SaveScenario: "save_scenario",
    intents.DismissAlarm: "dismiss_alarm",
    intents.Mark: "mark",
    intents.BeginMark: "begin_mark",
    intents.StretchMark: "stretch_mark",
    intents.EndMark: "end_mark",
    intents.ChangeMark: "change_mark",
    intents.WithdrawMark: "withdraw_mark",
    intents.AddNote: "add_note",
    intents.ChangeNote: "change_note",
    intents.RemoveNote: "remove_note",
    intents.RestoreNote: "restore_note",
}


class FakeLibrary:
    """Stands in for LiveSessionLibrary with ``sessions`` and ``hits``; ``calls`` holds the requests."""

    def __init__(self, sessions: Sequence[SessionEntry] = (), hits: Sequence[SearchHit] = ()) -> None:
        self.found = LiveValue(LibraryStatus())
        self.export = LiveValue(ExportStatus())
        self.sessions = tuple(sessions)
        self.hits = tuple(hits)
        self.calls: list[tuple[str, Any]] = []

    def named(self, name: str) -> list[Any]:
        """Arguments of every call of ``name``."""
        return [arguments for called, arguments in self.calls if called == name]

    def find(self, query: SessionQuery) -> None:
        self.calls.append(("find", query))
        hits = tuple(hit for hit in self.hits if query.text and query.text.casefold() in hit.snippet.casefold())
        folders = {hit.folder for hit in hits}
        found = tuple(
            entry
            for entry in self.sessions
            if (not query.text or entry.folder in folders)
            and all(
                getattr(query, name) in ("", getattr(entry, name))
                for name in ("participant", "condition", "wizard", "scenario", "purpose")
            )
        )
        shown = hits[: query.places]
        places = dict(Counter(hit.folder for hit in hits))
        self.found.set(LibraryStatus(query, found, shown, len(self.sessions), places=places))

    def open_replay(self, folder: Path, *, at_ns: int | None = None) -> None:
        self.calls.append(("open_replay", (folder, at_ns)))

    def choose_export_folder(
        self, sessions: Sequence[Path], told: Callable[[Path], None], *, chosen: Path | None = None
    ) -> None:
        """Answer at once, as with a fast disk."""
        name = sessions[0].name if len(sessions) == 1 else "several"
        told(Path("/exports") / name if chosen is None else chosen / name if any(chosen.iterdir()) else chosen)

    def start_export(
        self,
        sessions: Sequence[Path],
        formats: Sequence[str],
        out: Path,
        *,
        licence: str = "",
        with_names: bool = False,
        csv: CsvStyle = SHOWN,
    ) -> None:
        self.calls.append(("start_export", (tuple(sessions), tuple(formats), out, licence, with_names, csv)))
        self.export.set(ExportStatus("running", 0.0, f"{sessions[0].name}: {formats[0]}"))

    def cancel_export(self) -> None:
        self.calls.append(("cancel_export", None))
        self.export.set(dataclasses.replace(self.export.value, state="cancelled"))
