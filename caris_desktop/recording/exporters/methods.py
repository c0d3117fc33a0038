"""Methods sheet export: reporting items of a Wizard-of-Oz study, as Markdown and as a page.

The questions of its template are those of the reporting guidelines of Riek, "Wizard of Oz Studies in HRI: A Systematic
Review and New Reporting Guidelines", Journal of Human-Robot Interaction 1(1), 2012, and what journals require on
language models. Nothing is invented: what the recording lacks is marked for the researcher.
"""

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from operator import attrgetter
from pathlib import Path
from typing import Any

from caris_desktop.domain.actor import WIZARD, in_words
from caris_desktop.domain.events import (
    LATE_FROM_S,
    ControlUsed,
    HeadMoved,
    LlmExchange,
    PreflightChecked,
    RobotChosen,
    ScenarioOpened,
)
from caris_desktop.domain.streams import spec_of_topic
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.exporters.templates import write_own_page, write_page
from caris_desktop.recording.measures.measure_definitions import MEASURES
from caris_desktop.recording.measures.session_measures import Measures, ModelUse, measure, read_facts
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.robot_clock_mapping import ClockSummary, clock_summary
from caris_desktop.recording.session.session_conversation import Response, SpokenUtterance
from caris_desktop.recording.session.session_header import SessionError, SessionHeader, read_header, reading
from caris_desktop.recording.session.session_protocol import (
    Preflight,
    ScenarioText,
    StepRecord,
    open_words,
    preflight_of,
    read_scenario,
)
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session.session_robot import AlarmRecord
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.studies.study_index import copies_among, session_folders
from caris_desktop.recording.study_file import write_citation

_log = logging.getLogger(__name__)
_PRACTICE = "practice"


class _Known(Value, eq=False):
    """A session and what the sheet needs of it, without the high-rate values."""

    session: Session
    utterances: tuple[SpokenUtterance, ...]
    exchanges: tuple[LlmExchange, ...]
    photos: int
    measures: Measures
    scenarios: tuple[ScenarioText, ...]
    robots: tuple[str, ...]
    streams: frozenset[str]
    clock: ClockSummary | None
    preflight: Preflight
    head_moves: int
    controls: int


def methods_facts(sessions: Sequence[Session], progress: Callable[[float], None] = lambda _: None) -> dict[str, Any]:
    """Facts on the sessions that count: copies and practice do not, unless all are practice.

    ``progress`` may raise to cancel. Raises SessionError.
    """
    copies = copies_among({str(session.folder): (session.identity, session.losses) for session in sessions})
    sessions = [session for session in sessions if str(session.folder) not in copies]
    counting = [session for session in sessions if _purpose(session.trial) != _PRACTICE] or sessions
    known = []
    for number, session in enumerate(sorted(counting, key=_started_utc_ns)):
        known.append(_read(session, lambda share, before=number: progress((before + share) / len(counting))))  # type: ignore[misc]
    practice = _practice(sessions)
    asking = [one for one in known if one.exchanges]
    measures = [one.measures for one in known]
    headers = [one.session.header for one in known]
    utterances = [item for one in known for item in one.utterances]
    robot_utterances = [item for item in utterances if item.speaker == "robot"]
    return {
        "name": known[0].session.folder.name if len(known) == 1 else "",
        "sessions": [
            {
                "name": one.session.folder.name,
                "participant": one.session.trial.get("participant", ""),
                "condition": one.session.trial.get("condition", ""),
                "wizard": _wizard(one.session),
                "started_utc_ns": _started_utc_ns(one.session),
                "closed": one.session.closed_properly,
                "losses": list(one.session.losses),
                "measures": one.measures.values,
            }
            for one in known
        ],
        "copies": len(copies),
        **_sums(measures),
        "wizards": Counter(_wizard(one.session) for one in known),
        "training": _training(known, practice),
        "practice": len(practice),
        "participants": distinct(one.session.trial.get("participant", "") for one in known),
        "conditions": Counter(name for one in known if (name := one.session.trial.get("condition", ""))),
        "robots": distinct(name for one in known for name in one.robots),
        "streams": {name for one in known for name in one.streams},
        "voices": sorted({item.voice for item in robot_utterances if item.voice}),
        "deciders": Counter(in_words(item.actor) for item in robot_utterances if item.said),
        "the_wizard": in_words(WIZARD),
        "transcribed": any(item.speaker == "participant" for item in utterances),
        "head_moves": sum(one.head_moves for one in known),
        "controls": sum(one.controls for one in known),
        "photos": sum(one.photos for one in known),
        **_scenarios([scenario for one in known for scenario in one.scenarios]),
        "steps": _steps([step for each in measures for step in each.steps]),
        "responses_s": [seconds for each in measures for seconds in each.response_times_s],
        "content_responses_s": [reply.delay_s for each in measures for reply in each.content_responses],
        "reactions_s": [reply.delay_s for each in measures for reply in each.reactions],
        "gaps_s": [seconds for each in measures for seconds in each.gaps_s],
        "gaps_by_means": by_means(response for each in measures for response in each.gaps),
        "checks": _checks([one.preflight for one in known if one.preflight.checks]),
        "alarms": _alarms(measures),
        "models": _merged([model for each in measures for model in each.models]),
        "asked_utc_ns": [_started_utc_ns(one.session) for one in asking],
        **_questions([exchange for one in asking for exchange in one.exchanges]),
        "clocks": _clocks([one.clock for one in known if one.clock is not None]),
        "versions": distinct(header.program_version for header in headers),
        "software": _software(headers),
    }


def _read(session: Session, progress: Callable[[float], None]) -> _Known:
    data = read_facts(session, lambda share: progress(0.8 * share))
    robots = [event.title or event.name for event in data.of(RobotChosen)]
    header = session.header
    scenarios = [read_scenario(event) for event in data.of(ScenarioOpened)]
    if not scenarios and header.scenario.title:
        scenarios = [ScenarioText(header.scenario.title, header.scenario.file, header.scenario.sha256)]
    rare = [value for _, value in session.values("event/head_moved", "event/control_used")]
    with reading(session.folder):
        channels = events_file.read_index(session.folder / "events.mcap").channels.values()
    specs = (spec_of_topic(channel.topic) for channel in channels)
    return _Known(
        session=session,
        utterances=data.utterances,
        exchanges=tuple(data.of(LlmExchange)),
        photos=len(data.photos),
        measures=measure(data),
        scenarios=tuple(scenarios),
        robots=tuple(distinct(robots or [header.robot.profile])),
        streams=frozenset(spec.name for spec in specs if spec is not None),
        clock=clock_summary(session),
        preflight=preflight_of(data.of(PreflightChecked)),
        head_moves=sum(isinstance(value, HeadMoved) for value in rare),
        controls=sum(isinstance(value, ControlUsed) and value.state == "requested" for value in rare),
    )


def _sums(measures: Sequence[Measures]) -> dict[str, Any]:
    """Measures over all sessions: ``total`` and ``values`` of those that have it, and ``parts`` by label."""
    names = [one.name for one in MEASURES]
    parts: dict[str, Counter[str]] = {name: Counter() for name in names}
    for one in measures:
        for name, its in one.parts.items():
            parts.setdefault(name, Counter()).update(its)
    return {
        "total": {name: sum(one.values[name] or 0 for one in measures) for name in names},
        "values": {name: [value for one in measures if (value := one.values[name]) is not None] for name in names},
        "parts": {name: dict(its) for name, its in parts.items()},
    }


def _scenarios(scenarios: Sequence[ScenarioText]) -> dict[str, Any]:
    permissions: dict[str, bool] = {}
    for scenario in scenarios:
        for name, allowed in scenario.permissions.items():
            permissions[name] = permissions.get(name, False) or allowed
    return {
        "scenarios": list({scenario.sha256 or scenario.title: scenario for scenario in scenarios}.values()),
        "phrases": max((len(scenario.phrases) for scenario in scenarios), default=0),
        "allowed": [name for name, allowed in permissions.items() if allowed],
        "forbidden": [name for name, allowed in permissions.items() if not allowed],
        "panels": distinct(panel for scenario in scenarios for panel in scenario.panels),
    }


def _steps(records: Iterable[StepRecord]) -> list[dict[str, Any]]:
    """Each protocol step over the sessions that had it, by scenario file and id."""
    steps: dict[tuple[str, str], list[StepRecord]] = {}
    for record in records:
        steps.setdefault((record.scenario, record.step_id), []).append(record)
    return [
        {
            "scenario": scenario,
            "title": each[-1].title,
            "planned_s": max(record.expected_s for record in each),
            "times_s": [record.time_s for record in each if record.visits],
            "sessions": len(each),
            "skipped": sum(record.skipped > 0 for record in each),
            "late": sum(record.late_s >= LATE_FROM_S for record in each),
        }
        for (scenario, _), each in steps.items()
    ]


def by_means(responses: Iterable[Response]) -> dict[str, list[float]]:
    """Gaps before responses by the means of the response."""
    gaps: dict[str, list[float]] = {}
    for response in responses:
        gaps.setdefault(response.means, []).append(response.gap_s)
    return gaps


def _checks(checked: Sequence[Preflight]) -> dict[str, Any]:
    """Pre-session checks of the sessions that recorded any."""
    return {
        "sessions": len(checked),
        "passed": sum(not one.still_open for one in checked),
        "ticked": Counter(
            check.title for one in checked for check in one.checks if check.manual and check.state == "passed"
        ),
        "not_passed": Counter(words for one in checked for words in open_words(one)),
    }


def _alarms(measures: Sequence[Measures]) -> dict[str, Any]:
    alarms = [alarm for one in measures for alarm in one.alarms]
    by_cause: dict[str, list[AlarmRecord]] = {}
    for alarm in alarms:
        by_cause.setdefault(alarm.cause, []).append(alarm)
    return {
        "count": len(alarms),
        "sessions": sum(bool(one.alarms) for one in measures),
        "dismissed": sum(bool(alarm.seen_to_by) for alarm in alarms),
        "active_at_end": sum(alarm.end_ns is None for alarm in alarms),
        "causes": [
            {"what": group[0].what, "count": len(group), "active_s": sum(one.stood_s for one in group)}
            for group in sorted(by_cause.values(), key=len, reverse=True)
        ],
    }


def _questions(exchanges: Sequence[LlmExchange]) -> dict[str, Any]:
    prompts: Counter[str] = Counter()
    for exchange in exchanges:
        prompts["\n\n".join(message.content for message in exchange.messages if message.role == "system")] += 1
    return {
        "questions": len(exchanges),
        "seeded": sum(exchange.seed is not None for exchange in exchanges),
        "settings": distinct(json.dumps(exchange.parameters, sort_keys=True) for exchange in exchanges),
        "prompts": {text: count for text, count in prompts.items() if text},
    }


def _clocks(clocks: Sequence[ClockSummary]) -> dict[str, Any]:
    """Robot clocks of the sessions in which they were measured."""
    return {
        "sessions": len(clocks),
        # Adding zero turns minus zero into zero.
        "offsets_s": [round(clock.utc_offset_s, 3) + 0.0 for clock in clocks],
        "drift_ms_per_min": max((abs(clock.drift_ms_per_min) for clock in clocks), default=0.0),
        "uncertainty_ms": max((clock.uncertainty_ms for clock in clocks), default=0.0),
    }


def _software(headers: Iterable[SessionHeader]) -> dict[str, list[str]]:
    versions: dict[str, list[str]] = {}
    for header in headers:
        for name, version in header.software.items():
            versions.setdefault(name, []).append(version)
    return {name: distinct(its) for name, its in sorted(versions.items())}


# Practice


class _Practice(Value):
    """Practice session of a wizard. ``score`` (0..100) of the guided exercise; None without it."""

    wizard: str
    started_utc_ns: int
    duration_s: float
    score: int | None = None


def _practice(sessions: Sequence[Session]) -> list[_Practice]:
    """Practice sessions in the parent folders of ``sessions``."""
    found: dict[Any, _Practice] = {}
    for parent in sorted({session.folder.absolute().parent for session in sessions}):
        try:
            folders = session_folders(parent)
        except OSError as error:
            _log.warning("practice sessions are not looked for in %s: %s", parent, error)
            continue
        for folder in folders:
            try:
                # By the session header alone, since there may be hundreds of sessions.
                if _purpose(read_header(folder).trial) != _PRACTICE:
                    continue
                session = open_session(folder, repair=False)
                scores = [event.score for _, event in session.values("event/practice_ended")]
            except SessionError as error:
                _log.info("not counted as practice: %s", error)
                continue
            # Copies count once.
            wizard = sessions[0].wizard_name(_wizard(session))
            score = scores[-1] if scores else None
            found.setdefault(session.identity, _Practice(wizard, _started_utc_ns(session), session.duration_s, score))
    return list(found.values())


def _training(known: Sequence[_Known], practice: Sequence[_Practice]) -> dict[str, dict[str, Any]]:
    """Each wizard's practice before the first session that counts."""
    trained = {}
    for name in distinct(_wizard(one.session) for one in known):
        sessions = [one.session for one in known if _wizard(one.session).casefold() == name.casefold()]
        first_ns = min(map(_started_utc_ns, sessions))
        own = [one for one in practice if one.wizard.casefold() == name.casefold() and one.started_utc_ns < first_ns]
        if own:
            trained[name] = {
                "sessions": len(own),
                "duration_s": sum(one.duration_s for one in own),
                "score": max((one.score for one in own if one.score is not None), default=None),
            }
    return trained


def _purpose(trial: dict[str, Any]) -> str:
    return str(trial.get("purpose") or "").strip().casefold()


def _wizard(session: Session) -> str:
    return session.trial.get("wizard", "").strip()


def _started_utc_ns(session: Session) -> int:
    return session.clock.anchor.utc_ns_at(session.started_ns)


def distinct(values: Iterable[str]) -> list[str]:
    """Values without duplicates and empty ones."""
    return list(dict.fromkeys(value for value in values if value))


def _merged(models: Iterable[ModelUse]) -> list[ModelUse]:
    """Uses of the same model in several sessions, added."""
    groups: dict[tuple[str, str, str, str], list[ModelUse]] = {}
    for model in models:
        groups.setdefault((model.provider, model.model, model.version, model.place), []).append(model)
    sums = ("asked", "answered", "cancelled", "failed", "said", "edited", "dismissed", "unused")
    lists = ("first_token_s", "answer_s", "settings")
    return [
        ModelUse(
            *key,
            *(sum(map(attrgetter(name), group)) for name in sums),
            *(tuple(value for one in group for value in getattr(one, name)) for name in lists),
        )
        for key, group in groups.items()
    ]


def write_methods_of_study(sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """Write one sheet for all ``sessions`` (at least one) into ``out``: ``methods.md`` and ``methods.html``, or the one
    that the researcher's template makes.

    Practice sessions among them or in the same folders count as the wizards' training; all other values exclude them.
    Raises OSError, SessionError, ExportError.
    """
    facts = methods_facts(sessions, lambda share: context.progress(0.95 * share))
    years = [datetime.fromisoformat(session.clock.utc(session.started_ns)).year for session in sessions]
    facts |= {"study": context.study, "citation": context.study.citation(max(years)) if context.study else ""}
    if context.template is not None:
        paths = [write_own_page(out, "methods", context.template, **facts)]
    else:
        layouts = (f"methods{suffix}" for suffix in (".md", ".html"))
        paths = [write_page(out / layout, "methods.j2", layout=f"{layout}.j2", **facts) for layout in layouts]
    if context.study is not None:
        paths.append(write_citation(out, context.study))
    context.progress(1.0)
    return paths
