"""Tiers derived from a recording: speech, driving, marks, people, and every other event type.

An event type without a rule here gets a tier of point events, or of intervals if it has ``start_ns`` and ``end_ns``.
Names and states are English in files and translated for display; texts by people are not translated.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, get_args

from caris_desktop.domain.actor import CONSOLE, WIZARD
from caris_desktop.domain.events import (
    AlarmChanged,
    AnswerUsed,
    CommandSent,
    CommandSource,
    EmergencyStopChanged,
    GuardChanged,
    LinkChanged,
    LinkQuality,
    LlmExchange,
    PersonAppeared,
    PersonIdentified,
    PersonLeft,
    PhotoDeleted,
    PhotoTaken,
    ResponseTimed,
    ScenarioOpened,
    SessionEnded,
    SessionStarted,
    StepTicked,
    SuggestionChanged,
    TrafficMeasured,
    UtteranceOrigin,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.streams import BY_NAME, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import LONGEST_VALUE, MOMENT_MS, plain_text
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.session.session_conversation import unheard
from caris_desktop.recording.session.session_data import FOLDED, SessionData, read_data
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.recording.session.session_protocol import StepVisit, read_scenario
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_robot import NavigationGoal, commanded
from caris_desktop.recording.session.session_visits import seen_throughout

WIZARD_ERRORS = (QT_TR_NOOP("slip"), QT_TR_NOOP("late"), QT_TR_NOOP("wrong branch"))

STATES_IN_WORDS = (
    QT_TR_NOOP("standing"), QT_TR_NOOP("forward"), QT_TR_NOOP("backward"), QT_TR_NOOP("sideways"),
    QT_TR_NOOP("turning"), QT_TR_NOOP("keyboard"), QT_TR_NOOP("gamepad"), QT_TR_NOOP("onscreen"),
    QT_TR_NOOP("rehearsal"), QT_TR_NOOP("stop"), QT_TR_NOOP("lease"), QT_TR_NOOP("none"), QT_TR_NOOP("typed"),
    QT_TR_NOOP("phrase"), QT_TR_NOOP("filler"), QT_TR_NOOP("assistant"), QT_TR_NOOP("suggestion"),
    QT_TR_NOOP("heard"), QT_TR_NOOP("dictated"), QT_TR_NOOP("own_voice"), QT_TR_NOOP("said"), QT_TR_NOOP("edited"),
    QT_TR_NOOP("dismissed"), QT_TR_NOOP("unheard"), QT_TR_NOOP("requested"), QT_TR_NOOP("active"),
    QT_TR_NOOP("reached"), QT_TR_NOOP("cancelled"), QT_TR_NOOP("failed"), QT_TR_NOOP("answered"),
    QT_TR_NOOP("control"), QT_TR_NOOP("media"), QT_TR_NOOP("connecting"), QT_TR_NOOP("trouble"), QT_TR_NOOP("lost"),
    QT_TR_NOOP("slowing"), QT_TR_NOOP("blocked"), QT_TR_NOOP("blind"), QT_TR_NOOP("overridden"), QT_TR_NOOP("wizard"),
    QT_TR_NOOP("robot"), QT_TR_NOOP("console"), QT_TR_NOOP("model"), QT_TR_NOOP("script"),
    QT_TR_NOOP("present"), QT_TR_NOOP("paused"), QT_TR_NOOP("unspecified"),
)  # fmt: skip
"""All words for states on a tier, for translators of the timeline."""


def state(word: str) -> str:
    """State for the file and for ``tr``; an unknown word, such as another wizard's name, stays as it is."""
    return localized(word) if word in STATES_IN_WORDS else word


def error_words(label: str) -> str:
    """Wizard error label; a wizard's own wording is not translated."""
    return localized(label) if label in WIZARD_ERRORS else label


def step_words(visit: StepVisit) -> str:
    skipped = visit.left == "skipped"
    return localized(QT_TR_NOOP("{step} (skipped)"), step=visit.title) if skipped else visit.title or visit.step_id


def goal_words(goal: NavigationGoal) -> str:
    target = goal.place or f"({goal.target_in_map.x_m:.2f}, {goal.target_in_map.y_m:.2f})"
    return localized(QT_TR_NOOP("{place}: {state}"), place=target, state=state(goal.state))


def answer_words(exchange: LlmExchange) -> str:
    """Answer of the language model, or the reason why there is none."""
    reason = localized(
        QT_TR_NOOP("({outcome}: {detail})"), outcome=state(exchange.outcome), detail=localized(exchange.detail)
    )
    answer = localized(QT_TR_NOOP("{answer} (cut off)"), answer=exchange.answer) if exchange.cut else exchange.answer
    return answer if exchange.answer else reason


def link_words(change: LinkChanged) -> str:
    message = QT_TR_NOOP("{link}: {state} ({detail})") if change.detail else QT_TR_NOOP("{link}: {state}")
    return localized(message, link=state(change.link), state=state(change.state), detail=localized(change.detail))


def emergency_words(change: EmergencyStopChanged) -> str:
    return localized(QT_TR_NOOP("set by {whom}"), whom=state(change.actor or change.by))


MARKS_VOCABULARY = QT_TR_NOOP("Wizard marks")
ERRORS_VOCABULARY = QT_TR_NOOP("Wizard errors")
UNNAMED = state("unspecified")  # an unlabelled mark
MOST_PEOPLE = 12  # with more people, only their number gets a tier
_STILL_MPS, _STILL_RADPS = 0.02, 0.05
_TROUBLE = ("connecting", "trouble", "lost")
_SPEECH = {
    "participant": QT_TR_NOOP("Participant speech"),
    "robot": QT_TR_NOOP("Robot speech"),
    "wizard": QT_TR_NOOP("Wizard speech"),
    "": QT_TR_NOOP("Somebody’s speech"),
}
_MOTIONS = {
    "standing": "No velocity was commanded.",
    "forward": f"At least {_STILL_MPS} m/s forward, turning or not; or slower, if no other motion is faster.",
    "backward": f"At least {_STILL_MPS} m/s backward, turning or not; or slower, if no other motion is faster.",
    "sideways": f"At least {_STILL_MPS} m/s to the side, not forward or backward; or slower, if no other is faster.",
    "turning": f"At least {_STILL_RADPS} rad/s on the spot; or slower, if no other motion is faster.",
}
_ANSWER_USES = {
    "said": "",
    "edited": "",
    "dismissed": "",
    "unheard": "It was requested but stopped before anything was heard.",
}
# Periodic measurements, and the ends of the timeline: shown in tables, not as tiers.
_NO_TIERS: tuple[type[Any], ...] = (LinkQuality, TrafficMeasured, SessionStarted, SessionEnded)


SHOWN = frozenset(
    (*FOLDED, LinkChanged, GuardChanged, EmergencyStopChanged, ScenarioOpened)
) - {AlarmChanged, PhotoDeleted, PhotoTaken, ResponseTimed, SuggestionChanged}  # fmt: skip
"""Types with tiers of their own."""


def session_tiers(session: Session, progress: Callable[[float], None] = lambda _: None) -> AnnotationDocument:
    """Derive read-only tiers (``coder`` is empty) from the recording; empty ones are left out.

    Overlapping intervals continue on a second tier with the same name and a number. ``progress`` gets 0..1. Raises
    SessionError.
    """
    return tiers_of(read_data(session, types_of_tiers(), progress))


def types_of_tiers() -> tuple[type[Any], ...]:
    """Types of the values that tiers follow from: events, also those that were declared later."""
    events = (spec.value_type for spec in BY_NAME.values() if spec.delivery is Delivery.LOSSLESS)
    return tuple(kind for kind in events if kind not in _NO_TIERS)


class _TierInterval(Value):
    """Interval on a tier; ``end_ns`` None: a point event."""

    start_ns: int
    end_ns: int | None
    value: str


class _Row(Value):
    """Tier before sorting and resolution of overlaps."""

    name: str
    stretches: list[_TierInterval]
    vocabulary: str = ""
    participant: str = ""


def tiers_of(data: SessionData) -> AnnotationDocument:
    """Tiers of data that were read, at least those of :func:`types_of_tiers`."""
    visits = data.step_visits
    stretches = [_TierInterval(visit.start_ns, visit.end_ns, step_words(visit)) for visit in visits]
    rows = [
        *_speech_rows(data),
        _Row(QT_TR_NOOP("Protocol"), stretches, participant="Wizard"),
        *_mark_rows(data),
        *_driving_rows(data),
        *_people_rows(data),
        *_assistant_rows(data),
        *_console_rows(data),
    ]
    for kind in types_of_tiers():
        if kind not in SHOWN - {StepTicked}:
            rows.append(_Row(type_in_words(kind), [_of_event(value) for value in data.of(kind)]))
    return _document(data, rows)


def _speech_rows(data: SessionData) -> Iterable[_Row]:
    spoken = [item for item in data.utterances if item.said]
    who = {"participant": data.session.trial.get("participant", ""), "robot": "Robot", "wizard": "Wizard", "": ""}
    for speaker, participant in who.items():
        mine = [item for item in spoken if item.speaker == speaker]
        yield _Row(
            _SPEECH[speaker],
            [_TierInterval(item.start_ns or 0, item.end_ns, item.text) for item in mine],
            participant=participant,
        )
        if speaker == "robot":
            yield _Row(
                QT_TR_NOOP("Robot speech origin"),
                [_TierInterval(item.start_ns or 0, item.end_ns, state(item.origin)) for item in mine],
                "Speech origin",
                participant,
            )

    corrected = [item for item in spoken if item.heard_text is not None]
    yield _Row(
        QT_TR_NOOP("Speech before correction"),
        [_TierInterval(item.start_ns or 0, item.end_ns, item.heard_text or "") for item in corrected],
    )
    tagged = [item for item in spoken if item.tags]
    yield _Row(
        QT_TR_NOOP("Speech tags"),
        [_TierInterval(item.start_ns or 0, item.end_ns, ", ".join(item.tags)) for item in tagged],
    )


def _mark_rows(data: SessionData) -> Iterable[_Row]:
    marks = data.marks
    labelled = [mark for mark in marks if mark.kind == "mark"]
    errors = [mark for mark in marks if mark.kind == "wizard_error"]
    yield _Row(MARKS_VOCABULARY, [_of_mark(mark, mark.label or UNNAMED) for mark in labelled], MARKS_VOCABULARY)
    yield _Row(
        ERRORS_VOCABULARY,
        [_of_mark(mark, error_words(mark.label) or UNNAMED) for mark in errors],
        ERRORS_VOCABULARY,
        participant="Wizard",
    )
    notes = [(mark, mark.note or (mark.label if mark.kind == "note" else "")) for mark in marks]
    yield _Row(QT_TR_NOOP("Notes"), [_of_mark(mark, text) for mark, text in notes if text])


def _driving_rows(data: SessionData) -> Iterable[_Row]:
    ended_ns = data.session.ended_ns
    commands, pauses = data.of(CommandSent), data.pauses
    driven = commanded(commands, ended_ns=ended_ns, pauses=pauses)
    motion = _joined([_TierInterval(start_ns, end_ns, motion_of(one.twist)) for start_ns, end_ns, one in driven])
    if commands:
        # No command means standing: before the first one and wherever commands stopped.
        filled: list[_TierInterval] = []
        at_ns = data.session.started_ns
        fixed = sorted([*motion, *(_TierInterval(*pause, "") for pause in pauses)], key=attrgetter("start_ns"))
        for run in [*fixed, _TierInterval(ended_ns, ended_ns, "")]:
            if run.start_ns > at_ns:
                filled.append(_TierInterval(at_ns, run.start_ns, "standing"))
            filled.append(run)
            at_ns = max(at_ns, run.end_ns or run.start_ns)
        motion = [run for run in _joined(filled) if run.value]
    sources = [_TierInterval(drive.start_ns, drive.end_ns, drive.source) for drive in data.drives]
    yield _Row(QT_TR_NOOP("Motion"), _in_states(motion), "Motion", "Robot")
    yield _Row(QT_TR_NOOP("Driving source"), _in_states(sources), "Driving source", "Wizard")
    goals = [
        _TierInterval(goal.start_ns, ended_ns if goal.end_ns is None else goal.end_ns, goal_words(goal))
        for goal in data.goals
    ]
    yield _Row(QT_TR_NOOP("Navigation goals"), goals, "", "Robot")


def _people_rows(data: SessionData) -> Iterable[_Row]:
    present = _presence(data)
    changes = sorted(
        change for spans in present.values() for start_ns, end_ns in spans for change in ((start_ns, 1), (end_ns, -1))
    )
    counts, here, since_ns = [], 0, 0
    for stamp_ns, change in changes:
        if here and stamp_ns > since_ns:
            counts.append(_TierInterval(since_ns, stamp_ns, str(here)))
        here, since_ns = here + change, stamp_ns
    yield _Row(QT_TR_NOOP("People present"), counts)
    if len(present) > MOST_PEOPLE:
        return
    numbers = {visit.person_id: visit.number for visit in data.visits if visit.number}
    for person_id, spans in present.items():
        there = [_TierInterval(*span, state("present")) for span in spans]
        yield _Row(_person(person_id, numbers), there, "", person_id)


def _assistant_rows(data: SessionData) -> Iterable[_Row]:
    said = {(one.turn_id, one.revision): one.text for one in data.suggestions if one.was_said}
    exchanges = [
        # One that ended when a reply of it was taken was not cancelled in vain.
        _TierInterval(one.asked_ns, one.stamp_ns, said.get((one.turn_id, one.revision)) or answer_words(one))
        for one in data.of(LlmExchange)
    ]
    yield _Row(QT_TR_NOOP("LLM exchanges"), exchanges, participant="Assistant")
    uses = [
        _TierInterval(item.stamp_ns, None, state("unheard" if unheard(item, data.utterances) else item.use))
        for item in data.of(AnswerUsed)
    ]
    yield _Row(QT_TR_NOOP("LLM answer use"), uses, "Answer use")


def _console_rows(data: SessionData) -> Iterable[_Row]:
    ended_ns = data.session.ended_ns
    lasting = partial(_until_next, ended_ns=ended_ns, paused_ns=[begin_ns for begin_ns, _ in data.pauses])
    links = data.of(LinkChanged)
    yield _Row(
        QT_TR_NOOP("Link trouble"),
        [
            _TierInterval(change.stamp_ns, end_ns, link_words(change))
            for link in dict.fromkeys(change.link for change in links)
            for change, end_ns in lasting([change for change in links if change.link == link])
            if change.state in _TROUBLE
        ],
    )
    yield _Row(
        QT_TR_NOOP("Obstacle guard"),
        [
            _TierInterval(change.stamp_ns, end_ns, state(change.state))
            for change, end_ns in lasting(data.of(GuardChanged))
            if change.state not in ("absent", "clear")
        ],
    )
    yield _Row(
        QT_TR_NOOP("Emergency stop"),
        [
            _TierInterval(change.stamp_ns, end_ns, emergency_words(change))
            for change, end_ns in lasting(data.of(EmergencyStopChanged))
            if change.latched
        ],
    )
    yield _Row(QT_TR_NOOP("Pauses"), [_TierInterval(*span, state("paused")) for span in data.pauses])
    yield _Row(
        QT_TR_NOOP("Scenario"),
        [
            _TierInterval(opened.stamp_ns, end_ns, opened.title or opened.file_name)
            for opened, end_ns in _until_next(data.of(ScenarioOpened), ended_ns)
        ],
    )


def _presence(data: SessionData) -> dict[str, list[tuple[int, int]]]:
    """Intervals of presence per person."""
    spans: dict[str, list[tuple[int, int]]] = {}
    for visit in data.visits or seen_throughout(data.session):
        spans.setdefault(visit.person_id, []).append((visit.start_ns, visit.end_ns))
    # People of older recordings; the others are listed there under the ids of their visits, too.
    known = {event.person_id for event in data.of_any((PersonAppeared, PersonLeft, PersonIdentified))}
    for visit in seen_throughout(data.session):
        if visit.person_id not in known:
            spans.setdefault(visit.person_id, [(visit.start_ns, visit.end_ns)])
    return spans


def _document(data: SessionData, rows: list[_Row]) -> AnnotationDocument:
    duration_ms = max(1, -(-(data.session.ended_ns - data.session.started_ns) // 1_000_000))
    tiers: list[Tier] = []
    annotations: list[Annotation] = []
    for row in rows:
        lanes = _lanes(
            row.stretches, started_ns=data.session.started_ns, duration_ms=duration_ms, joined=not row.vocabulary
        )
        for number, lane in enumerate(lanes, start=1):
            name = row.name
            if number > 1:
                name = localized(QT_TR_NOOP("{tier} ({number})"), tier=localized(row.name), number=number)
            tier_id = "record-" + re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
            tiers.append(Tier(tier_id, name, "", row.vocabulary, plain_text(row.participant)))
            for start_ms, end_ms, value in lane:
                annotations.append(Annotation(f"r{len(annotations) + 1}", tier_id, start_ms, end_ms, value))
    document = AnnotationDocument(tuple(tiers), (), tuple(annotations), duration_ms)
    return dataclasses.replace(document, vocabularies=_vocabularies(data, document.values_used()))


def _vocabularies(data: SessionData, used: Mapping[str, Iterable[str]]) -> tuple[Vocabulary, ...]:
    labels = dict.fromkeys(
        " ".join(plain_text(label).split())
        for opened in data.of(ScenarioOpened)
        for label in read_scenario(opened).labels
    )
    known: dict[str, tuple[str, dict[str, str]]] = {
        MARKS_VOCABULARY: ("The labels of the marks, from the scenario.", dict.fromkeys(labels, "")),
        ERRORS_VOCABULARY: ("Errors made by the wizard.", dict.fromkeys(WIZARD_ERRORS, "")),
        "Motion": ("Motion that was commanded.", _MOTIONS),
        "Driving source": ("Source of the commanded velocity.", dict.fromkeys(get_args(CommandSource), "")),
        "Speech origin": ("Origin of the utterance.", dict.fromkeys(get_args(UtteranceOrigin), "")),
        "Answer use": ("Use of the answer.", _ANSWER_USES),
    }
    vocabularies = []
    for name, (description, entries) in known.items():
        if name in used or (name == MARKS_VOCABULARY and labels):
            # Wizards also mark with labels of their own, or without one.
            others = dict.fromkeys(sorted({*used.get(name, ())} - set(entries)), "")
            vocabularies.append(
                Vocabulary(name, tuple(VocabularyEntry(*entry) for entry in {**entries, **others}.items()), description)
            )
    return tuple(vocabularies)


def _person(person_id: str, numbers: dict[str, int]) -> str:
    """Person as the wizard saw them. The id is added, or used alone, where the number is unknown or ambiguous: people
    of another study are numbered from 1 again.
    """
    number = numbers.get(person_id)
    if number is None:
        return localized(QT_TR_NOOP("Person {number}"), number=person_id)
    first = next(other for other, its_number in numbers.items() if its_number == number)
    if first == person_id:
        return localized(QT_TR_NOOP("Person {number}"), number=number)
    return localized(QT_TR_NOOP("Person {number} {id}"), number=number, id=person_id)


def _of_event(event: Any) -> _TierInterval:
    start_ns, end_ns = getattr(event, "start_ns", None), getattr(event, "end_ns", None)
    if isinstance(start_ns, int) and isinstance(end_ns, int):
        return _TierInterval(start_ns, max(start_ns, end_ns), summary_of(event))
    return _TierInterval(event.stamp_ns, None, summary_of(event))


def motion_of(twist: Twist2D) -> str:
    """Motion as a word of the vocabulary Motion. However slow, it is not "standing": the largest component counts."""
    parts = {
        "forward" if twist.forward_mps > 0 else "backward": abs(twist.forward_mps) / _STILL_MPS,
        "sideways": abs(twist.left_mps) / _STILL_MPS,
        "turning": abs(twist.turn_radps) / _STILL_RADPS,
    }
    if not any(parts.values()):
        return "standing"
    return next((word for word, size in parts.items() if size >= 1.0), max(parts, key=lambda word: parts[word]))


def _joined(runs: list[_TierInterval]) -> list[_TierInterval]:
    """Merge contiguous intervals of equal value; drop empty ones."""
    joined: list[_TierInterval] = []
    for run in runs:
        before = joined[-1] if joined else None
        if before is not None and run.value == before.value and before.end_ns == run.start_ns:
            joined[-1] = dataclasses.replace(before, end_ns=run.end_ns)
        else:
            joined.append(run)
    return [run for run in joined if (run.end_ns or 0) > run.start_ns]


def _until_next(changes: list[Any], ended_ns: int, paused_ns: Sequence[int] = ()) -> list[tuple[Any, int]]:
    """Each state change with the time of the next one, or of the next pause, which ends the state."""
    ends_ns = [*(change.stamp_ns for change in changes[1:]), ended_ns][: len(changes)]
    return [
        (change, min([max(change.stamp_ns, end_ns), *(one for one in paused_ns if one >= change.stamp_ns)]))
        for change, end_ns in zip(changes, ends_ns, strict=True)
    ]


def _of_mark(mark: FinalMark, value: str) -> _TierInterval:
    return _TierInterval(
        mark.start_ns, mark.end_ns, value if isinstance(value, LocalizedText) else " ".join(value.split())
    )


def _in_states(stretches: list[_TierInterval]) -> list[_TierInterval]:
    return [dataclasses.replace(one, value=state(one.value)) for one in stretches]


def _lanes(
    stretches: list[_TierInterval], *, started_ns: int, duration_ms: int, joined: bool
) -> list[list[tuple[int, int, str]]]:
    """Distribute intervals over as few rows of (start, end, value) as needed without overlap.

    Point events are MOMENT_MS wide, less if the next one on the row follows sooner; ``joined`` merges point events of
    the same millisecond. Times are clamped to the session.
    """
    lanes: list[list[tuple[int, int, str]]] = []
    # For each lane, the true end of its last item: its widened part may be cut again.
    ends_ms: list[int] = []
    for stretch in sorted(stretches, key=attrgetter("start_ns")):
        value = plain_text(stretch.value)[:LONGEST_VALUE]
        if value == stretch.value:
            value = stretch.value  # translatable: text and values are separate
        start_ms = min(max((stretch.start_ns - started_ns) // 1_000_000, 0), duration_ms - 1)
        moment = stretch.end_ns is None or stretch.end_ns <= stretch.start_ns
        end_ms = start_ms if moment else min(((stretch.end_ns or 0) - started_ns) // 1_000_000, duration_ms)
        shown_ms = min(start_ms + MOMENT_MS, duration_ms) if moment else max(end_ms, start_ms + 1)
        for number, lane in enumerate(lanes):
            last_start_ms, last_shown_ms, last_value = lane[-1]
            if joined and moment and last_start_ms == start_ms and ends_ms[number] == start_ms:
                if value != last_value:
                    lane[-1] = (last_start_ms, last_shown_ms, f"{last_value} | {value}"[:LONGEST_VALUE])
                break
            # An item is at least a millisecond wide; a following interval starts later for that.
            begin_ms = start_ms if moment else max(start_ms, last_start_ms + 1)
            if ends_ms[number] <= start_ms and last_start_ms < begin_ms < shown_ms:
                lane[-1] = (last_start_ms, min(last_shown_ms, begin_ms), last_value)
                lane.append((begin_ms, shown_ms, value))
                ends_ms[number] = end_ms
                break
        else:
            lanes.append([(start_ms, shown_ms, value)])
            ends_ms.append(end_ms)
    return lanes


_LONGEST_SUMMARY = 300


EVENTS_IN_WORDS = (
    QT_TR_NOOP("Drive ended"), QT_TR_NOOP("Movement changed"), QT_TR_NOOP("Stop requested"),
    QT_TR_NOOP("Navigation speed changed"), QT_TR_NOOP("Initial pose set"), QT_TR_NOOP("Map request changed"),
    QT_TR_NOOP("Mapping changed"), QT_TR_NOOP("Places changed"), QT_TR_NOOP("Head moved"), QT_TR_NOOP("Control used"),
    QT_TR_NOOP("Gamepad changed"), QT_TR_NOOP("Response timed"), QT_TR_NOOP("Suggestion changed"),
    QT_TR_NOOP("Proposal changed"), QT_TR_NOOP("Level changed"), QT_TR_NOOP("Voice changed"),
    QT_TR_NOOP("Assistant changed"), QT_TR_NOOP("Face changed"), QT_TR_NOOP("Person renamed"),
    QT_TR_NOOP("Person suggested"), QT_TR_NOOP("Person described"), QT_TR_NOOP("Consent noted"),
    QT_TR_NOOP("Person attended"), QT_TR_NOOP("Photo taken"), QT_TR_NOOP("Photo tagged"), QT_TR_NOOP("Photo deleted"),
    QT_TR_NOOP("Step ticked"), QT_TR_NOOP("Preflight checked"), QT_TR_NOOP("Robot chosen"),
    QT_TR_NOOP("Layout changed"), QT_TR_NOOP("Gap"), QT_TR_NOOP("Problem"), QT_TR_NOOP("Alarm changed"),
    QT_TR_NOOP("Trial resumed"), QT_TR_NOOP("Confirmed as before"), QT_TR_NOOP("Practice step ended"),
    QT_TR_NOOP("Practice ended"),
)  # fmt: skip
"""Texts of ``type_in_words`` for events whose tier has no other name, for translators of the timeline."""


def summary_of(value: Any) -> str:
    """Summarise an event: its fields except times and ids, without the field name if there is only one, and the actor
    unless it is the wizard or the console.
    """
    parts = [
        (field.name, _cell(getattr(value, field.name)))
        for field in dataclasses.fields(value)
        if not field.name.endswith(("_ns", "_id")) and field.name not in ("sequence", "actor")
    ]
    parts = [(name, text) for name, text in parts if text]
    named = (f"{name.replace('_', ' ')}: {_short(text)}" for name, text in parts)
    text = parts[0][1] if len(parts) == 1 else ", ".join(named)
    text = " ".join(text.split()) or type_in_words(type(value))
    actor = getattr(value, "actor", "")
    if actor not in ("", WIZARD, CONSOLE):
        text = f"{text} (by {actor})"
    return text if len(text) <= _LONGEST_SUMMARY else f"{text[: _LONGEST_SUMMARY - 1]}…"


def _short(text: str) -> str:
    """First line, shortened; texts may be whole files."""
    first, _, rest = text.strip().partition("\n")
    return f"{first[:79]}…" if rest or len(first) > 80 else first


def _cell(value: Any) -> str:
    match value:
        case None | "":
            return ""
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.3g}"
        case Pose2D():
            return f"({value.x_m:.2f}, {value.y_m:.2f})"
        case tuple() | list() | dict():
            return f"{len(value)}" if value else ""
        case _:
            return str(value)


def type_in_words(event_type: type[Any]) -> str:
    """``StopRequested`` as ``Stop requested``."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", event_type.__name__).capitalize()
