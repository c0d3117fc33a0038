"""Values of a session and the records that follow from them, for tables, measures, report and timeline."""

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, TypeVar

from caris_desktop.domain.events import (
    AlarmChanged,
    AnswerUsed,
    CommandSent,
    GoalChanged,
    LlmExchange,
    Marked,
    PhotoDeleted,
    PhotoTaken,
    RecordingPaused,
    ResponseTimed,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.recording.session.session_conversation import (
    LlmAnswer,
    Response,
    ShownReply,
    SpokenUtterance,
    answers_of,
    replies_of,
    reply_answers_of,
    responses_of,
    spoken_utterances,
)
from caris_desktop.recording.session.session_header import pauses_of
from caris_desktop.recording.session.session_marks import FinalMark, final_marks_of
from caris_desktop.recording.session.session_protocol import (
    PROTOCOL_EVENTS,
    StepRecord,
    StepVisit,
    step_visits_of,
    steps_of,
)
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_robot import (
    AlarmRecord,
    Drive,
    NavigationGoal,
    alarms_of,
    drives_of,
    navigation_goals,
)
from caris_desktop.recording.session.session_visits import VISIT_EVENTS, Visit, seen_throughout, visits_of

T = TypeVar("T")
FOLDED: tuple[type[Any], ...] = (
    AlarmChanged, AnswerUsed, CommandSent, GoalChanged, LlmExchange, Marked, PhotoDeleted, PhotoTaken,
    RecordingPaused, ResponseTimed, SuggestionChanged, UtteranceChanged, UtteranceCorrected,
    *VISIT_EVENTS, *PROTOCOL_EVENTS,
)  # fmt: skip
"""Types of the values that the records follow from."""


class SessionData:
    """Values of a session, added in recording order, and the records that follow from them.

    The records are made when first asked for, after the last value was added.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._values: dict[type[Any], list[Any]] = {}
        self._number = 0
        self._numbers: dict[type[Any], list[int]] = {}

    def add(self, value: Any) -> None:
        self._values.setdefault(type(value), []).append(value)
        self._numbers.setdefault(type(value), []).append(self._number)
        self._number += 1

    def of(self, kind: type[T]) -> list[T]:
        """Values of one type in recording order."""
        return self._values.get(kind, [])

    def of_any(self, kinds: Iterable[type[Any]]) -> list[Any]:
        """Values of several types in recording order."""
        numbered = [pair for kind in kinds for pair in zip(self._numbers.get(kind, ()), self.of(kind), strict=True)]
        return [value for _, value in sorted(numbered, key=lambda pair: pair[0])]

    @cached_property
    def pauses(self) -> list[tuple[int, int]]:
        """Start and end of each pause, in session time."""
        return pauses_of(self.of(RecordingPaused), ended_ns=self.session.ended_ns)

    @cached_property
    def visits(self) -> tuple[Visit, ...]:
        return visits_of(
            self.of_any(VISIT_EVENTS),
            started_ns=self.session.started_ns,
            ended_ns=self.session.ended_ns,
            pauses=self.pauses,
        )

    @cached_property
    def utterances(self) -> tuple[SpokenUtterance, ...]:
        return spoken_utterances(
            self.of_any((UtteranceChanged, UtteranceCorrected)),
            ended_ns=self.session.ended_ns,
            paused_ns=[event.stamp_ns for event in self.of(RecordingPaused) if event.paused],
            visits=self.visits or seen_throughout(self.session),
        )

    @cached_property
    def responses(self) -> tuple[Response, ...]:
        return responses_of(self.utterances, self.of(ResponseTimed), self.pauses)

    @cached_property
    def marks(self) -> tuple[FinalMark, ...]:
        return final_marks_of(self.of(Marked), ended_ns=self.session.ended_ns)

    @cached_property
    def goals(self) -> tuple[NavigationGoal, ...]:
        return navigation_goals(self.of(GoalChanged), started_ns=self.session.started_ns, pauses=self.pauses)

    @cached_property
    def drives(self) -> tuple[Drive, ...]:
        return drives_of(self.of(CommandSent), ended_ns=self.session.ended_ns, pauses=self.pauses)

    @cached_property
    def alarms(self) -> tuple[AlarmRecord, ...]:
        return alarms_of(self.of(AlarmChanged), ended_ns=self.session.ended_ns, pauses=self.pauses)

    @cached_property
    def answers(self) -> tuple[LlmAnswer, ...]:
        return answers_of(self.of(LlmExchange), self.of(AnswerUsed), self.utterances)

    @cached_property
    def exchanges(self) -> list[LlmAnswer]:
        """The answers, and the exchanges for suggested replies with their use, in order of their end."""
        replies = reply_answers_of(self.of(LlmExchange), self.suggestions, self.utterances)
        return sorted((*self.answers, *replies), key=lambda answer: answer.exchange.stamp_ns)

    @cached_property
    def suggestions(self) -> tuple[ShownReply, ...]:
        """Suggested replies that were shown, with what became of them."""
        paused_ns = [begin_ns for begin_ns, _ in self.pauses]
        return replies_of(self.of(SuggestionChanged), ends_ns=(*paused_ns, self.session.ended_ns))

    @cached_property
    def step_visits(self) -> tuple[StepVisit, ...]:
        return step_visits_of(
            self.of_any(PROTOCOL_EVENTS),
            ended_ns=self.session.ended_ns,
            pauses=self.pauses,
            scenario=self.session.header.scenario.file,
        )

    @cached_property
    def steps(self) -> tuple[StepRecord, ...]:
        scenario = self.session.header.scenario.file  # of events before the first that names one
        return steps_of(self.of_any(PROTOCOL_EVENTS), self.step_visits, scenario=scenario)

    @cached_property
    def photos(self) -> tuple[PhotoTaken, ...]:
        """Photos without deleted ones."""
        deleted = {event.file_name: not event.restored for event in self.of(PhotoDeleted)}
        return tuple(photo for photo in self.of(PhotoTaken) if not deleted.get(photo.file_name))


def spoken(session: Session) -> tuple[SpokenUtterance, ...]:
    """Utterances of a session in order of their start (or request). Raises SessionError."""
    return read_data(session, (UtteranceChanged, UtteranceCorrected, RecordingPaused, *VISIT_EVENTS)).utterances


def read_data(
    session: Session, kinds: Iterable[type[Any]] = FOLDED, progress: Callable[[float], None] = lambda _: None
) -> SessionData:
    """Read the values of these types in one pass. ``progress`` may raise to cancel. Raises SessionError."""
    data = SessionData(session)
    span_ns = max(1, session.ended_ns - session.started_ns)
    for number, (_, value) in enumerate(session.values(*(BY_TYPE[kind].name for kind in dict.fromkeys(kinds)))):
        data.add(value)
        if number % 2000 == 0:
            progress(min(1.0, max(0.0, (value.stamp_ns - session.started_ns) / span_ns)))
    return data
