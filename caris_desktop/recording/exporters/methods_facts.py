"""Data of a study for the methods sheet; each session is read once."""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from caris_desktop.domain.actor import in_words
from caris_desktop.domain.events import (
    ControlUsed,
    HeadMoved,
    LlmExchange,
    PreflightChecked,
    RobotChosen,
    ScenarioOpened,
)
from caris_desktop.domain.streams import spec_of_topic
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.exporters.methods_words import distinct
from caris_desktop.recording.measures.session_measures import Measures, ModelUse, measure, read_facts
from caris_desktop.recording.session import mcap_chunks
from caris_desktop.recording.session.responses import Response
from caris_desktop.recording.session.robot_clock_mapping import ClockSummary, robot_clock
from caris_desktop.recording.session.scenario_text import ScenarioText, read_scenario
from caris_desktop.recording.session.session_checks import Preflight, preflight_of
from caris_desktop.recording.session.session_header import SessionError, read_header, reading
from caris_desktop.recording.session.session_protocol import StepRecord
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.studies.study_index import session_folders

_log = logging.getLogger(__name__)
PRACTICE = "practice"


@dataclass(frozen=True, slots=True, eq=False)
class KnownSession:
    """Data of one session for the sheet, without the values themselves. ``utterances_by_actor`` counts robot utterances
    by who triggered them, as text.
    """

    session: Session
    measures: Measures
    scenarios: tuple[ScenarioText, ...]
    robots: tuple[str, ...]
    exchanges: tuple[LlmExchange, ...]
    photos: int
    streams: frozenset[str]
    clock: ClockSummary | None
    participant_spoke: bool
    utterances_by_actor: dict[str, int]
    voices: frozenset[str]
    head_moves: int
    controls: int
    preflight: Preflight


def read_known(session: Session, progress: Callable[[float], None]) -> KnownSession:
    facts = read_facts(session, lambda fraction: progress(0.8 * fraction))
    opened, chosen = facts.of(ScenarioOpened), facts.of(RobotChosen)
    head = session.header
    robots = [event.title or event.name for event in chosen]
    if not robots and head.robot.profile:
        robots = [head.robot.profile]
    scenarios = [read_scenario(event) for event in opened]
    if not scenarios and head.scenario.title:
        scenarios = [ScenarioText(head.scenario.title, head.scenario.file, head.scenario.sha256)]
    rare = [value for _, value in session.values("event/head_moved", "event/control_used")]
    anchor = session.clock.anchor
    return KnownSession(
        session=session,
        measures=measure(facts),
        scenarios=tuple(scenarios),
        robots=tuple(dict.fromkeys(robots)),
        exchanges=tuple(facts.of(LlmExchange)),
        photos=len(facts.photos),
        streams=_streams(session),
        clock=robot_clock(session).summary(
            utc_ns_at=anchor.utc_ns_at(session.started_ns), session_ns_at=session.started_ns
        ),
        participant_spoke=any(item.speaker == "participant" for item in facts.utterances),
        utterances_by_actor=Counter(
            in_words(item.actor) for item in facts.utterances if item.speaker == "robot" and item.said
        ),
        voices=frozenset(item.voice for item in facts.utterances if item.speaker == "robot" and item.voice),
        head_moves=sum(isinstance(value, HeadMoved) for value in rare),
        controls=sum(isinstance(value, ControlUsed) and value.state == "requested" for value in rare),
        preflight=preflight_of(facts.of(PreflightChecked)),
    )


def _streams(session: Session) -> frozenset[str]:
    with reading(session.folder):
        channels = mcap_chunks.read_index(session.folder / "events.mcap").channels.values()
    specs = (spec_of_topic(channel.topic) for channel in channels)
    return frozenset(spec.name for spec in specs if spec is not None)


@dataclass(frozen=True, slots=True)
class PracticeSession:
    """Practice session of a wizard. ``score`` (0..100) of the guided exercise; None without it."""

    wizard: str
    started_utc_ns: int
    duration_s: float
    score: int | None = None


def practice_available(sessions: Sequence[Session]) -> list[PracticeSession]:
    """Practice sessions in the parent folders of ``sessions``."""
    found: dict[Any, PracticeSession] = {}
    for parent in sorted({session.folder.absolute().parent for session in sessions}):
        try:
            folders = session_folders(parent)
        except OSError as error:
            _log.warning("practice sessions are not looked for in %s: %s", parent, error)
            continue
        for folder in folders:
            try:
                if _head_purpose(folder) != PRACTICE:
                    continue
                session = open_session(folder, repair=False)
            except SessionError as error:
                _log.info("not counted as practice: %s", error)
                continue
            utc_ns = session.clock.anchor.utc_ns_at(session.started_ns)
            # Copies count once.
            wizard = sessions[0].wizard_name(wizard_of(session))
            found.setdefault(session.identity, PracticeSession(wizard, utc_ns, session.duration_s, _score(session)))
    return list(found.values())


def _score(session: Session) -> int | None:
    """Score of the last guided exercise."""
    scores = [event.score for _, event in session.values("event/practice_ended")]
    return scores[-1] if scores else None


def _head_purpose(folder: Path) -> str:
    """Purpose from the session header alone, since there may be hundreds of sessions. Raises SessionError."""
    return purpose_of(read_header(folder).trial)


def purpose_of(trial: dict[str, Any]) -> str:
    return str(trial.get("purpose") or "").strip().casefold()


def wizard_of(session: Session) -> str:
    return session.trial.get("wizard", "").strip()


class StudyFacts:
    """Sessions that count, in chronological order, and their aggregates.

    ``practice`` sessions and ``copies`` of sessions do not count.
    """

    def __init__(self, known: Sequence[KnownSession], practice: Sequence[PracticeSession], copies: int = 0) -> None:
        self.copies = copies
        self.known = sorted(known, key=lambda one: one.session.clock.anchor.utc_ns_at(one.session.started_ns))
        self.practice = practice
        self.models = _merged([model for one in known for model in one.measures.models])

    def wizards(self) -> list[str]:
        return distinct(wizard_of(one.session) for one in self.known)

    def training(self) -> dict[str, list[PracticeSession]]:
        """Each wizard's practice before the first session that counts."""
        first_ns: dict[str, int] = {}
        for one in reversed(self.known):
            session = one.session
            first_ns[wizard_of(session).casefold()] = session.clock.anchor.utc_ns_at(session.started_ns)
        practised: dict[str, list[PracticeSession]] = {}
        for name in self.wizards():
            own = [
                item
                for item in self.practice
                if item.wizard.casefold() == name.casefold() and item.started_utc_ns < first_ns[name.casefold()]
            ]
            if own:
                practised[name] = own
        return practised

    def robots(self) -> list[str]:
        return distinct(name for one in self.known for name in one.robots)

    def steps(self) -> dict[tuple[str, str], list[StepRecord]]:
        """Each protocol step with its records in all sessions that had it, by scenario file and id."""
        found: dict[tuple[str, str], list[StepRecord]] = {}
        for one in self.known:
            for step in one.measures.steps:
                found.setdefault((step.scenario, step.step_id), []).append(step)
        return found

    def recorded_s(self) -> float:
        return sum(one.measures["recorded_s"] for one in self.known)

    def gaps(self) -> list[Response]:
        """All answers of all sessions."""
        return [response for one in self.known for response in one.measures.gaps]

    def responses(self) -> list[float]:
        return [seconds for one in self.known for seconds in one.measures.response_times_s]

    def system_prompts(self) -> dict[str, int]:
        """Number of requests per system prompt."""
        prompts: Counter[str] = Counter()
        for one in self.known:
            for exchange in one.exchanges:
                text = "\n\n".join(message.content for message in exchange.messages if message.role == "system")
                if text:
                    prompts[text] += 1
        return dict(prompts)

    def counted(self, measure: str) -> dict[str, int]:
        """Sum of the parts of a measure over all sessions, most frequent first."""
        totals: Counter[str] = Counter()
        for one in self.known:
            totals.update({label: int(count) for label, count in one.measures.of(measure).items()})
        return dict(totals.most_common())

    def total(self, measure: str) -> float:
        """Sum of a measure over all sessions."""
        return sum(one.measures[measure] for one in self.known)

    def each(self, measure: str) -> list[float]:
        """Values of a measure in the sessions that have it."""
        return [value for one in self.known if (value := one.measures.values[measure]) is not None]


def _merged(models: Iterable[ModelUse]) -> list[ModelUse]:
    groups: dict[tuple[str, str, str, str], list[ModelUse]] = {}
    for model in models:
        groups.setdefault((model.provider, model.model, model.version, model.place), []).append(model)
    return [
        ModelUse(
            provider=provider,
            model=name,
            version=version,
            place=place,
            asked=sum(one.asked for one in group),
            answered=sum(one.answered for one in group),
            cancelled=sum(one.cancelled for one in group),
            failed=sum(one.failed for one in group),
            said=sum(one.said for one in group),
            edited=sum(one.edited for one in group),
            dismissed=sum(one.dismissed for one in group),
            unused=sum(one.unused for one in group),
            first_token_s=tuple(seconds for one in group for seconds in one.first_token_s),
            answer_s=tuple(seconds for one in group for seconds in one.answer_s),
            settings=tuple(text for one in group for text in one.settings),
        )
        for (provider, name, version, place), group in groups.items()
    ]
