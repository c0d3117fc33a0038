"""What a paper has to report of a Wizard-of-Oz study, filled from the record as far as it tells.

The questions are those of the reporting guidelines of Riek, "Wizard of Oz Studies in HRI: A Systematic Review and New
Reporting Guidelines", Journal of Human-Robot Interaction 1(1), 2012, and what journals ask to be disclosed of language
models: which one, which version, with which parameters and prompts, for what, and who decided about its answers.
Nothing is invented: what the record does not tell is left for the researcher, and marked so.
"""

import json
import logging
import re
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from caris_desktop.domain.events import (
    ControlUsed,
    HeadMoved,
    LlmExchange,
    RobotChosen,
    ScenarioOpened,
)
from caris_desktop.domain.streams import BY_TYPE, spec_of_topic
from caris_desktop.recording import mcap_blocks
from caris_desktop.recording.completeness import counted, stream_words
from caris_desktop.recording.export import ExportContext
from caris_desktop.recording.exporters.drawings import duration_text
from caris_desktop.recording.exporters.html import distance_text, model_name
from caris_desktop.recording.exporters.templates import write_page
from caris_desktop.recording.measures import Measures, ModelUse, Spread, measure, per_10_min, read_facts
from caris_desktop.recording.robot_clock import ClockSummary, robot_clock
from caris_desktop.recording.scenario_text import ScenarioText, read_scenario
from caris_desktop.recording.session_header import SessionError
from caris_desktop.recording.session_reader import Session, open_session
from caris_desktop.recording.study_index import session_folders

_log = logging.getLogger(__name__)
PRACTICE = "practice"
# A robot's clock that is further off was never set, or is that of a simulation.
_OWN_TIME_S = 30 * 86400.0

_NUMBERS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
)  # fmt: skip
_SEEN = (
    ("frame", "the video of the robot's camera"),
    ("people", "boxes around the people that a detector found in it"),
    ("map", "a map"),
    ("pose", "the robot's place on it"),
    ("scan", "the LIDAR scan"),
    ("people_in_map", "where people stood on the map"),
    ("head", "how the robot's head was turned"),
    ("battery", "the robot's battery"),
)
_CAN = (
    ("driving", "drive the robot"),
    ("assistant", "ask a language model"),
    ("photos", "take photos"),
    ("naming_people", "name people"),
    ("robot_controls", "use further controls of the robot"),
)
_ORIGIN_WORDS = {
    "typed": "typed by the wizard",
    "phrase": "prepared phrases",
    "suggestion": "suggested replies that the wizard chose",
    "assistant": "answers of the language model that the wizard approved",
    "filler": "fillers",
    "heard": "of other origin",
}
_SOURCE_WORDS = {
    "keyboard": "the keyboard",
    "gamepad": "a gamepad",
    "onscreen": "buttons on the screen",
    "rehearsal": "a rehearsed script",
}


# What is known of one session


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """What the sheet needs of one session; its values themselves are let go."""

    session: Session
    measures: Measures
    scenarios: tuple[ScenarioText, ...]
    robots: tuple[str, ...]
    exchanges: tuple[LlmExchange, ...]
    streams: frozenset[str]
    clock: ClockSummary | None
    heard: bool
    spoken: bool
    voices: frozenset[str]
    head_moves: int
    controls: int


def _read(session: Session, progress: Callable[[float], None]) -> _Known:
    facts = read_facts(session, lambda fraction: progress(0.8 * fraction))
    opened, chosen = facts.of(ScenarioOpened), facts.of(RobotChosen)
    head = session.header
    robots = [event.title or event.name for event in chosen]
    if not robots and isinstance(head.get("robot"), dict) and head["robot"].get("profile"):
        robots = [str(head["robot"]["profile"])]
    scenarios = [read_scenario(event) for event in opened]
    if not scenarios and isinstance(head.get("scenario"), dict) and head["scenario"].get("title"):
        of = head["scenario"]
        scenarios = [ScenarioText(str(of["title"]), str(of.get("file", "")), str(of.get("sha256", "")))]
    rare = [value for _, value in session.values("event/head_moved", "event/control_used")]
    anchor = session.clock.anchor
    return _Known(
        session=session,
        measures=measure(facts),
        scenarios=tuple(scenarios),
        robots=tuple(dict.fromkeys(robots)),
        exchanges=facts.of(LlmExchange),
        streams=_streams(session),
        clock=robot_clock(session).summary(
            utc_ns_at=anchor.utc_ns_at(session.started_ns), session_ns_at=session.started_ns
        ),
        heard=any(item.speaker == "participant" for item in facts.utterances),
        spoken=any(item.speaker == "robot" and item.said for item in facts.utterances),
        voices=frozenset(item.voice for item in facts.utterances if item.speaker == "robot" and item.voice),
        head_moves=sum(isinstance(value, HeadMoved) for value in rare),
        controls=sum(isinstance(value, ControlUsed) and value.state == "requested" for value in rare),
    )


def _streams(session: Session) -> frozenset[str]:
    try:
        channels = mcap_blocks.read_index(session.folder / "events.mcap").channels.values()
    except OSError as error:
        raise SessionError(f"{session.folder} cannot be read: {error.strerror or error}.") from error
    specs = (spec_of_topic(channel.topic) for channel in channels)
    return frozenset(spec.name for spec in specs if spec is not None)


@dataclass(frozen=True, slots=True)
class _Practice:
    """A practice session of a wizard."""

    wizard: str
    started_utc_ns: int
    duration_s: float


def _practice_beside(sessions: Sequence[Session]) -> list[_Practice]:
    """The practice sessions in the folders that ``sessions`` lie in."""
    found = []
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
            found.append(_Practice(_wizard(session), utc_ns, session.duration_s))
    return found


def _head_purpose(folder: Path) -> str:
    """Raises SessionError. A look at the head alone: there may be hundreds of sessions."""
    from caris_desktop.recording.session_header import read_header

    trial = read_header(folder).get("trial")
    return _purpose_of(trial if isinstance(trial, dict) else {})


def _purpose_of(trial: dict[str, Any]) -> str:
    return str(trial.get("purpose") or "").strip().casefold()


def _wizard(session: Session) -> str:
    return session.trial.get("wizard", "").strip()


# The sheet


@dataclass(frozen=True, slots=True)
class SheetItem:
    """One question. ``answer`` is empty where the record does not tell; ``by_hand`` says what to add.

    ``sources`` names the parts of the record that the answer is from.
    """

    question: str
    answer: str = ""
    sources: tuple[str, ...] = ()
    by_hand: str = ""


@dataclass(frozen=True, slots=True)
class SheetSection:
    """Questions of one kind."""

    title: str
    items: tuple[SheetItem, ...]


@dataclass(frozen=True, slots=True)
class Appendix:
    """A text in full, such as a system prompt; ``text`` may be long and have lines."""

    title: str
    about: str
    text: str


@dataclass(frozen=True, slots=True)
class MethodsSheet:
    """The whole sheet. ``paragraph`` is for a paper; what stands in square brackets in it is still to be filled in."""

    title: str
    about: str
    sections: tuple[SheetSection, ...]
    paragraph: str
    appendices: tuple[Appendix, ...]

    @property
    def open_items(self) -> int:
        return sum(bool(item.by_hand) for section in self.sections for item in section.items)


def write_methods(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """The sheet of one session, as ``methods.md`` and ``methods.html``. Raises OSError, SessionError."""
    return write_methods_of_study([session], out, context)


def write_methods_of_study(sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """One sheet of all ``sessions`` together (at least one) in the folder ``out``: ``methods.md`` and ``methods.html``.

    Practice sessions among them, and those that lie beside them, count as the wizards' training; the other figures
    are those of the rest. Raises OSError, SessionError.
    """
    sheet = methods_sheet(sessions, context.progress)
    markdown = out / "methods.md"
    markdown.write_bytes(as_markdown(sheet).encode("utf-8", "replace"))
    page = write_page(out / "methods.html", "methods.html.j2", sheet=sheet)
    context.progress(1.0)
    return [markdown, page]


def methods_sheet(sessions: Sequence[Session], progress: Callable[[float], None] = lambda _: None) -> MethodsSheet:
    """Fill the sheet. ``progress`` may raise to cancel. Raises SessionError."""
    counting = [session for session in sessions if _purpose_of(session.trial) != PRACTICE] or list(sessions)
    known = []
    for number, session in enumerate(counting):

        def tell(fraction: float, *, before: int = number) -> None:
            progress(0.95 * (before + fraction) / len(counting))

        known.append(_read(session, tell))
    return _Study(known, _practice_beside(sessions)).sheet()


class _Study:
    """The sessions that count, and how each question is answered from them."""

    def __init__(self, known: list[_Known], practice: list[_Practice]) -> None:
        self._known = sorted(known, key=lambda one: one.session.clock.anchor.utc_ns_at(one.session.started_ns))
        self._practice = practice
        self._models = _merged([model for one in known for model in one.measures.models])

    def sheet(self) -> MethodsSheet:
        sections = (self._robot(), self._participants(), self._wizards(), self._study(), self._language_model(),
                    self._record())  # fmt: skip
        one = len(self._known) == 1
        of = self._known[0].session.folder.name if one else f"{len(self._known)} sessions"
        return MethodsSheet(
            title=f"Methods sheet of {of}",
            about=(
                "Filled from the record of CARIS Desktop after the reporting guidelines for Wizard-of-Oz studies by"
                " Riek (2012) and current practice in disclosing language models. Each answer names the parts of the"
                " record that it is from. What the record cannot tell is marked to be filled in by hand."
            ),
            sections=tuple(section for section in sections if section.items),
            paragraph=" ".join(sentence for sentence in self._sentences() if sentence),
            appendices=tuple(self._prompts()),
        )

    # Sections

    def _robot(self) -> SheetSection:
        robots = _distinct(name for one in self._known for name in one.robots)
        goals = self._counted(lambda m: m.driving.goals)
        navigated_s = sum(one.measures.driving.navigating_s for one in self._known)
        own = []
        if goals:
            own.append(
                f"It drove by itself to {_number(sum(goals.values()), 'goal')} that the wizard set"
                f" ({_listed_counts(goals)}; {duration_text(navigated_s)})."
            )
        guarded = sum(one.measures.driving.guard_interventions for one in self._known)
        if any("event/guard_changed" in one.streams for one in self._known):
            often = f"slowed or stopped it {_times(guarded)}" if guarded else "never slowed or stopped it"
            own.append(f"A guard against obstacles {often}.")
        own.append("What it said was decided by the wizard." if any(one.spoken for one in self._known) else "")
        return SheetSection(
            "Robot",
            (
                SheetItem(
                    "How many robots, and of which kind?",
                    _listed(robots),
                    ("session.json", *_events(RobotChosen)) if robots else (),
                    "Make, model and appearance (humanoid, mechanical, ...)." if robots else "The robot.",
                ),
                SheetItem(
                    "What did the robot do by itself, and what did the wizard decide?",
                    " ".join(part for part in own if part),
                    ("event/goal_changed", "event/guard_changed", "event/utterance_changed"),
                    "How it was presented to participants: as autonomous or not.",
                ),
                SheetItem(
                    "How did it move?",
                    self._movement(),
                    ("event/command_sent", "odometry", "pose", "event/stop_requested"),
                ),
                SheetItem("How did it speak?", self._speech(), ("event/utterance_changed",)),
            ),
        )

    def _participants(self) -> SheetSection:
        people = _distinct(one.session.trial.get("participant", "") for one in self._known)
        without = sum(not one.session.trial.get("participant") for one in self._known)
        answer = ""
        if people:
            answer = f"{_number(len(people), 'participant').capitalize()} in {_number(len(self._known), 'session')}."
            if without:
                verb = "names" if without == 1 else "name"
                answer += f" {_number(without, 'session').capitalize()} {verb} no participant."
        conditions = Counter(one.session.trial.get("condition", "") for one in self._known)
        conditions.pop("", None)
        seen = [one.measures.people for one in self._known]
        return SheetSection(
            "Participants",
            (
                SheetItem(
                    "How many participants?",
                    answer,
                    ("session.json",) if answer else (),
                    "" if answer else "How many took part.",
                ),
                SheetItem(
                    "Which conditions, with how many sessions each?",
                    _listed_counts(conditions),
                    ("session.json",) if conditions else (),
                    "" if conditions else "The conditions, if any.",
                ),
                SheetItem(
                    "How many people were in front of the robot?",
                    self._people_seen(seen),
                    ("event/person_appeared",) if any(seen) else (),
                ),
                SheetItem("Who were they?", by_hand="Age, gender, background, experience with robots, recruitment."),
                SheetItem(
                    "What were they told?",
                    by_hand="Instructions, consent, what they believed of the robot's autonomy, debriefing.",
                ),
                SheetItem(
                    "Was the simulation convincing?",
                    by_hand="Whether participants suspected a wizard, and how that was found out.",
                ),
            ),
        )

    @staticmethod
    def _people_seen(seen: list[int]) -> str:
        if not any(seen):
            return ""
        if len(seen) == 1:
            return f"{_number(seen[0], 'person', 'people').capitalize()} by the console's person detector."
        return (
            f"{min(seen)} to {max(seen)} in a session (median {statistics.median(seen):g}), by the console's person"
            " detector."
        )

    def _wizards(self) -> SheetSection:
        wizards = self._wizard_names()
        errors = self._counted(lambda m: m.errors)
        return SheetSection(
            "Wizard",
            (
                SheetItem(
                    "How many wizards?",
                    self._wizards_text(wizards),
                    ("session.json",) if wizards else (),
                    "Who they were (researcher, confederate, naive), and what they knew of the hypotheses.",
                ),
                SheetItem(
                    "How were they trained?",
                    self._training_text(wizards),
                    ("session.json of practice sessions",),
                    "Training outside of the program; the criterion for being ready.",
                ),
                SheetItem(
                    "What could the wizard perceive?",
                    self._perceived(),
                    ("events.mcap", *_events(ScenarioOpened)),
                    "What the wizard saw and heard without the program (same room, one-way mirror, ...).",
                ),
                SheetItem(
                    "What could the wizard do, and what was used?",
                    self._produced(),
                    (
                        *_events(ScenarioOpened),
                        "event/utterance_changed",
                        "event/command_sent",
                        "event/goal_changed",
                        "event/head_moved",
                        "event/control_used",
                    ),
                    "The rules that the wizard followed (protocol, when to use which phrase).",
                ),
                SheetItem(
                    "How fast did the wizard and the robot respond?",
                    self._responses_text(),
                    ("event/utterance_changed", *_events(LlmExchange)),
                    "" if self._responses() else "Response times: what participants said is not in the record.",
                ),
                SheetItem(
                    "Which errors did the wizard make?",
                    self._errors_text(errors),
                    ("event/marked",),
                    "How errors were noticed: only those that the wizard marked are in the record.",
                ),
            ),
        )

    def _study(self) -> SheetSection:
        scenarios: dict[str, ScenarioText] = {}
        for one in self._known:
            for scenario in one.scenarios:
                scenarios[scenario.sha256 or scenario.title] = scenario
        described = [
            f"{scenario.title}{f': {scenario.description}' if scenario.description else ''}"
            f"{f' (file {scenario.file_name}, SHA-256 {scenario.sha256[:12]}…)' if scenario.file_name else ''}"
            for scenario in scenarios.values()
        ]
        recorded_s = [one.measures.recorded_s for one in self._known]
        spread = Spread.of(recorded_s)
        length = f"{duration_text(sum(recorded_s))} in {_number(len(recorded_s), 'session')}"
        if spread is not None and spread.n > 1:
            span = f"{duration_text(spread.smallest)} to {duration_text(spread.largest)}"
            same = duration_text(spread.smallest) == duration_text(spread.largest)
            mean = duration_text(spread.mean)
            length += f"; {mean} each" if same else f"; {mean} on average ({span})"
        left_out = len(self._practice)
        if left_out and len(self._known) > 1:
            length += f"; {_number(left_out, 'practice session')} {_was(left_out)} left out"
        return SheetSection(
            "Study",
            (
                SheetItem(
                    "How many scenarios, and which?",
                    " ".join(f"{text.rstrip('.')}." for text in described),
                    ("session.json", *_events(ScenarioOpened)) if described else (),
                ),
                SheetItem("When, and how long?", f"{self._dates()}: {length}.", ("session.json",)),
                SheetItem("Where did it take place?", by_hand="Place, room, number of locations, who else was there."),
                SheetItem(
                    "Was the robot's behaviour developed in several rounds?",
                    by_hand="Pilots and what was changed after them.",
                ),
                SheetItem("With which software?", self._software(), ("session.json",)),
                SheetItem(
                    "Which limitations follow from the wizard?",
                    by_hand="What of the wizard's part could later be done by the robot itself, and how well.",
                ),
            ),
        )

    def _language_model(self) -> SheetSection:
        if not self._models:
            return SheetSection(
                "Language model",
                (
                    SheetItem(
                        "Was a language model used?", "No: no question to one is in the record.", _events(LlmExchange)
                    ),
                ),
            )
        exchanges = [exchange for one in self._known for exchange in one.exchanges]
        settings = _distinct(json.dumps(exchange.parameters, sort_keys=True) for exchange in exchanges)
        sources = _events(LlmExchange)
        days = _span(one.session for one in self._known if one.exchanges)
        return SheetSection(
            "Language model",
            (
                SheetItem(
                    "Which model, which version?",
                    " ".join(
                        f"{model_name(model.provider, model.model, model.version)}: asked {_times(model.asked)}"
                        f"{'' if model.version else '; its version is not in the record'}."
                        for model in self._models
                    ),
                    sources,
                    "Where the model ran, and to whom the questions were sent."
                    if any(model.provider != "embedded" for model in self._models)
                    else "",
                ),
                SheetItem("When?", f"{days}.", ("session.json",)),
                SheetItem("With which parameters?", f"{'; '.join(map(_settings, settings))}.", sources),
                SheetItem(
                    "With which prompts?",
                    f"{_number(len(self._system_prompts()), 'system prompt').capitalize()}, in full in the appendix."
                    " Every prompt is in the record as it was sent."
                    if self._system_prompts()
                    else "Without a system prompt. Every prompt is in the record as it was sent.",
                    sources,
                ),
                SheetItem(
                    "What was it used for, and who decided?",
                    "It proposed what the robot could say. Nothing of it was said unless the wizard chose to.",
                    (*sources, "event/answer_used"),
                ),
                SheetItem(
                    "How many of its answers were used?",
                    " ".join(self._acceptance(model) for model in self._models),
                    (*sources, "event/answer_used"),
                ),
                SheetItem("How long did it take?", self._latency(), sources),
            ),
        )

    def _record(self) -> SheetSection:
        lost = self._counted(lambda m: m.lost)
        cut = sum(not one.session.closed_properly for one in self._known)
        pauses = sum(one.measures.pauses for one in self._known)
        paused_s = sum(one.measures.paused_s for one in self._known)
        losses = [
            f"{count} {stream_words(stream)} were not recorded." if count != 1 else
            f"1 of the {stream_words(stream)} was not recorded."
            for stream, count in lost.items()
        ] or ["No loss is in the record."]  # fmt: skip
        if cut:
            losses.append(f"{_number(cut, 'recording').capitalize()} {_was(cut)} cut off before the end.")
        if pauses:
            losses.append(f"Recording was paused {_times(pauses)}, for {duration_text(paused_s)} in all.")
        trouble_s = sum(one.measures.link_trouble_s for one in self._known)
        if trouble_s:
            losses.append(f"The robot could not be reached for {duration_text(trouble_s)} in all.")
        return SheetSection(
            "Record",
            (
                SheetItem("Which clocks, and how exact?", self._clocks(), ("event/link_quality", "session.json")),
                SheetItem(
                    "What was lost?", " ".join(losses), ("event/gap", "event/recording_paused", "event/link_changed")
                ),
            ),
        )

    # Answers

    def _movement(self) -> str:
        sources: dict[str, float] = {}
        for one in self._known:
            for source, seconds in one.measures.driving.seconds_by_source.items():
                sources[source] = sources.get(source, 0.0) + seconds
        ways = [one.measures.driving.distance_m for one in self._known if one.measures.driving.distance_m is not None]
        speeds = [one.measures.driving.max_speed_mps for one in self._known]
        known_speeds = [speed for speed in speeds if speed is not None]
        parts = []
        if sources:
            shown = [f"{_SOURCE_WORDS.get(source, source)} ({duration_text(s)})" for source, s in sources.items()]
            parts.append(f"The wizard drove with {_listed(shown)}.")
        else:
            parts.append("The wizard did not drive it by hand.")
        if ways:
            parts.append(f"It went {distance_text(sum(ways))} in all.")
        if known_speeds:
            parts.append(f"Its highest speed was {max(known_speeds):.2f} m/s.")
        stops = sum(one.measures.driving.stops for one in self._known)
        emergencies = sum(one.measures.driving.emergency_stops for one in self._known)
        if stops or emergencies:
            parts.append(f"Stop was pressed {_times(stops)}, the emergency stop {_times(emergencies)}.")
        else:
            parts.append("Neither stop nor the emergency stop was pressed.")
        return " ".join(parts)

    def _speech(self) -> str:
        origins = self._counted(lambda m: m.origins)
        whole = sum(origins.values())
        if not whole:
            return "It said nothing."
        voices = {voice for one in self._known for voice in one.voices}
        voice = {frozenset({"robot"}): " The voice was the robot's own.",
                 frozenset({"computer"}): " The voice was synthesised by the wizard's computer."}.get(
                     frozenset(voices), "")  # fmt: skip
        return f"It spoke {_times(whole)}: {_shares(origins)}.{voice}"

    def _wizard_names(self) -> list[str]:
        return _distinct(_wizard(one.session) for one in self._known)

    def _wizards_text(self, wizards: list[str]) -> str:
        if not wizards:
            return ""
        sessions = Counter(_wizard(one.session) for one in self._known)
        shares = _listed([f"{name or 'unnamed'} ({_number(count, 'session')})" for name, count in sessions.items()])
        return f"{_number(len(wizards), 'wizard').capitalize()}: {shares}."

    def _training(self, wizards: list[str]) -> dict[str, list[float]]:
        """The durations of each wizard's practice before the first session that counts."""
        first_ns: dict[str, int] = {}
        for one in reversed(self._known):
            session = one.session
            first_ns[_wizard(session).casefold()] = session.clock.anchor.utc_ns_at(session.started_ns)
        lasted: dict[str, list[float]] = {}
        for name in wizards:
            own = [
                item.duration_s
                for item in self._practice
                if item.wizard.casefold() == name.casefold() and item.started_utc_ns < first_ns[name.casefold()]
            ]
            if own:
                lasted[name] = own
        return lasted

    def _training_text(self, wizards: list[str]) -> str:
        lasted = self._training(wizards)
        if not lasted:
            return "No practice session before the first session is in the record."
        parts = [
            f"{name}: {duration_text(sum(durations))} in {_number(len(durations), 'practice session')}"
            for name, durations in lasted.items()
        ]
        without = [name for name in wizards if name not in lasted]
        rest = f" Of {_listed(without)} no practice session is in the record." if without else ""
        return f"With the program, before the first session: {'; '.join(parts)}.{rest}"

    def _perceived(self) -> str:
        shown = [words for stream, words in _SEEN if any(stream in one.streams for one in self._known)]
        texts = [f"On the console: {_listed(shown)}."] if shown else []
        texts.append(
            "What participants said was transcribed for the wizard."
            if any(one.heard for one in self._known)
            else "What participants said was not transcribed."
        )
        panels = _distinct(panel for one in self._known for scenario in one.scenarios for panel in scenario.panels)
        if panels:
            texts.append(f"Panels of the scenario: {', '.join(panels)}.")
        return " ".join(texts)

    def _produced(self) -> str:
        permissions: dict[str, bool] = {}
        phrases = 0
        for one in self._known:
            for scenario in one.scenarios:
                phrases = max(phrases, len(scenario.phrases))
                for name, allowed in scenario.permissions.items():
                    permissions[name] = permissions.get(name, False) or allowed
        able = [words for name, words in _CAN if permissions.get(name)]
        unable = [words for name, words in _CAN if permissions.get(name) is False]
        texts = []
        if phrases:
            texts.append(f"{_number(phrases, 'prepared phrase').capitalize()} on keys.")
        if able:
            texts.append(f"The scenario let the wizard type what the robot says, {_listed(able)}.")
        if unable:
            texts.append(f"It did not let the wizard {_listed(unable, 'or')}.")
        moves = sum(one.head_moves for one in self._known)
        controls = sum(one.controls for one in self._known)
        goals = sum(sum(one.measures.driving.goals.values()) for one in self._known)
        photos = sum(one.measures.photos for one in self._known)
        used = [
            text
            for count, text in (
                (goals, f"{goals} navigation goals" if goals != 1 else "1 navigation goal"),
                (moves, f"{moves} turns of the head" if moves != 1 else "1 turn of the head"),
                (controls, f"{controls} uses of further controls" if controls != 1 else "1 use of a further control"),
                (photos, f"{photos} photos" if photos != 1 else "1 photo"),
            )
            if count
        ]
        if used:
            texts.append(f"Used beside speech and driving: {_listed(used)}.")
        return " ".join(texts)

    def _responses(self) -> list[float]:
        return [seconds for one in self._known for seconds in one.measures.response_times_s]

    def _responses_text(self) -> str:
        parts = []
        response = Spread.of(self._responses())
        if response is not None:
            parts.append(f"From the end of a participant's utterance to the robot's next words: {_spread(response)}.")
            content = Spread.of([reply.delay_s for one in self._known for reply in one.measures.content_responses])
            if content is not None and content != response:
                parts.append(f"Without fillers: {_spread(content)}.")
        reaction = Spread.of([reply.delay_s for one in self._known for reply in one.measures.reactions])
        if reaction is not None:
            parts.append(
                "From the end of a participant's utterance, or the language model's answer, to the wizard's request:"
                f" {_spread(reaction)}."
            )
        return " ".join(parts)

    def _errors_text(self, errors: dict[str, int]) -> str:
        count = sum(errors.values())
        if not count:
            return "The wizard marked no errors."
        rate = per_10_min(count, sum(one.measures.recorded_s for one in self._known))
        kinds = _listed_counts({label or "not told which": number for label, number in errors.items()})
        shown = f", {rate:.1f} per 10 minutes" if rate is not None else ""
        return f"The wizard marked {_number(count, 'error')} ({kinds}){shown}."

    def _dates(self) -> str:
        return _span(one.session for one in self._known)

    def _software(self) -> str:
        versions = _distinct(str(one.session.header.get("program_version", "")) for one in self._known)
        text = f"CARIS Desktop {_listed(versions)}." if versions else "CARIS Desktop."
        named: dict[str, list[str]] = {}
        for one in self._known:
            software = one.session.header.get("software")
            for name, version in software.items() if isinstance(software, dict) else ():
                if str(version) not in named.setdefault(str(name), []):
                    named[str(name)].append(str(version))
        listed = ", ".join(f"{name} {' / '.join(versions)}" for name, versions in sorted(named.items()))
        return f"{text} {listed}." if listed else text

    def _acceptance(self, model: ModelUse) -> str:
        name = f"{model_name(model.provider, model.model, model.version)}: " if len(self._models) > 1 else ""
        text = f"{name}{_number(model.answered, 'answer')} to {_number(model.asked, 'question')}"
        text = text[0].upper() + text[1:]
        if model.accepted_fraction is not None:
            text += (
                f"; accepted {model.said + model.edited} ({model.accepted_fraction:.0%}: {model.said} as"
                f" {'it was' if model.said == 1 else 'they were'}, {model.edited} edited), {model.dismissed} dismissed,"
                f" {model.unused} not used"
            )
        failed = ((model.cancelled, "cancelled"), (model.failed, "failed"))
        rest = _listed([f"{count} {word}" for count, word in failed if count])
        return f"{text}{f'; {rest}' if rest else ''}."

    def _latency(self) -> str:
        texts = []
        for model in self._models:
            first, whole = Spread.of(model.first_token_s), Spread.of(model.answer_s)
            name = f"{model_name(model.provider, model.model, model.version)}: " if len(self._models) > 1 else ""
            if first is not None:
                texts.append(f"{name}To the first word: {_spread(first)}.")
            if whole is not None:
                texts.append(f"{name}To the whole answer: {_spread(whole)}.")
        return " ".join(texts)

    def _clocks(self) -> str:
        known = [one.clock for one in self._known if one.clock is not None]
        text = "All times are those of one monotonic clock of the wizard's computer, mapped to UTC at the start."
        if not known:
            return f"{text} The offset of the robot's clock was not measured."
        drifts = [abs(clock.drift_ms_per_min) for clock in known]
        # Adding zero makes a zero of what would be shown as minus zero.
        offsets = [round(clock.utc_offset_s, 3) + 0.0 for clock in known]
        if max(map(abs, offsets)) > _OWN_TIME_S:
            ahead = "it counted from a moment of its own"
        elif len(offsets) == 1:
            ahead = f"it was {offsets[0]:+.3f} s from the computer's UTC"
        else:
            ahead = f"it was {min(offsets):+.3f} to {max(offsets):+.3f} s from the computer's UTC"
        unknown = len(self._known) - len(known)
        rest = f" In {_number(unknown, 'session')} it was not measured." if unknown else ""
        return (
            f"{text} The robot's clock was compared with it once a second: {ahead}, and drifted by at most"
            f" {max(drifts):.1f} ms per minute; its stamps are known to ±{max(c.uncertainty_ms for c in known):.1f} ms."
            f"{rest}"
        )

    def _system_prompts(self) -> dict[str, int]:
        prompts: Counter[str] = Counter()
        for one in self._known:
            for exchange in one.exchanges:
                text = "\n\n".join(message.content for message in exchange.messages if message.role == "system")
                if text:
                    prompts[text] += 1
        return dict(prompts)

    def _prompts(self) -> list[Appendix]:
        prompts = self._system_prompts()
        return [
            Appendix(
                "System prompt" if len(prompts) == 1 else f"System prompt {number}",
                f"Sent with {_number(count, 'question')}.",
                text,
            )
            for number, (text, count) in enumerate(prompts.items(), start=1)
        ]

    def _counted(self, of: Callable[[Measures], dict[str, int]]) -> dict[str, int]:
        whole: Counter[str] = Counter()
        for one in self._known:
            whole.update(of(one.measures))
        return dict(whole.most_common())

    # The paragraph

    def _sentences(self) -> Iterable[str]:
        sessions = _number(len(self._known), "session")
        people = _distinct(one.session.trial.get("participant", "") for one in self._known)
        wizards = self._wizard_names()
        robots = _distinct(name for one in self._known for name in one.robots)
        recorded_s = sum(one.measures.recorded_s for one in self._known)
        versions = _distinct(str(one.session.header.get("program_version", "")) for one in self._known)
        by_whom = _number(len(wizards), "wizard") if wizards else "[number of] wizards"
        with_people = f" with {_number(len(people), 'participant')}" if people else ""
        yield (
            f"The robot ({_listed(robots) or '[robot]'}) was controlled by {by_whom} with"
            f" CARIS Desktop{f' (version {_listed(versions)})' if versions else ''} in {sessions}{with_people}"
            f" ({duration_text(recorded_s)} recorded)."
        )
        yield "[Participants: age, gender, recruitment.]"
        lasted = self._training(wizards)
        if lasted:
            minutes = [sum(durations) for durations in lasted.values()]
            if len(wizards) == 1:
                who = "The wizard"
            elif len(lasted) == len(wizards):
                who = "The wizards"
            else:
                who = f"{_word(len(lasted)).capitalize()} of the {_word(len(wizards))} wizards"
            shortest, longest = duration_text(min(minutes)), duration_text(max(minutes))
            span = shortest if len(minutes) == 1 else f"{shortest} each"
            if shortest != longest:
                span = f"{shortest} to {longest} each"
            yield f"{who} had practised with the program for {span} before the first session."
        else:
            yield "[Training of the wizard.]" if len(wizards) <= 1 else "[Training of the wizards.]"
        shown = [words for stream, words in _SEEN[:5] if any(stream in one.streams for one in self._known)]
        if shown:
            yield f"The console showed {_listed(shown)}."
        origins = self._counted(lambda m: m.origins)
        whole = sum(origins.values())
        if whole:
            yield f"The robot made {_number(whole, 'utterance')} ({_shares(origins)})."
        response = Spread.of(self._responses())
        if response is not None:
            yield (
                "The median time from the end of a participant's utterance to the robot's next words was"
                f" {response.median:.2f} s ({_statistics(response)})."
            )
        yield self._movement_sentence()
        for model in self._models:
            yield self._model_sentence(model)
        errors = self._counted(lambda m: m.errors)
        count = sum(errors.values())
        marker = "The wizard" if len(wizards) <= 1 else "The wizards"
        rate = per_10_min(count, recorded_s)
        if count:
            kinds = _listed_counts({label or "not told which": number for label, number in errors.items()})
            yield (
                f"{marker} marked {_number(count, 'error')} of their own ({kinds}; {rate or 0.0:.1f} per 10 minutes)."
            )
        else:
            yield f"{marker} marked no errors of their own."
        lost = sum(sum(one.measures.lost.values()) for one in self._known)
        cut = sum(not one.session.closed_properly for one in self._known)
        if lost or cut:
            parts = [
                f"{lost} values were not recorded" if lost > 1 else "one value was not recorded" if lost else "",
                f"{_number(cut, 'recording')} {_was(cut)} cut off before the end" if cut else "",
            ]
            text = _listed([part for part in parts if part])
            yield f"Of the record, {text}."

    def _movement_sentence(self) -> str:
        driven_s = sum(one.measures.driving.driving_s for one in self._known)
        goals = self._counted(lambda m: m.driving.goals)
        count, reached = sum(goals.values()), goals.get("reached", 0)
        ways = [one.measures.driving.distance_m for one in self._known if one.measures.driving.distance_m is not None]
        distance = f" ({distance_text(sum(ways))} in all)" if ways else ""
        by_hand = f"was driven by hand for {duration_text(driven_s)}" if driven_s else ""
        by_itself = ""
        if count:
            if count == 1:
                outcome = "which it reached" if reached else "which it did not reach"
            elif reached == count:
                outcome = "both of which it reached" if count == 2 else "all of which it reached"
            else:
                outcome = f"of which it reached {_word(reached) if reached else 'none'}"
            by_itself = f"was sent to {_number(count, 'navigation goal')}, {outcome}"
        if not by_hand and not by_itself:
            return "The robot was not driven." if not ways or sum(ways) < 0.5 else ""
        return f"The robot {' and '.join(part for part in (by_hand, by_itself) if part)}{distance}."

    def _model_sentence(self, model: ModelUse) -> str:
        name = model_name(model.provider, model.model, model.version)
        settings = _distinct(
            json.dumps(exchange.parameters, sort_keys=True)
            for one in self._known
            for exchange in one.exchanges
            if (exchange.provider, exchange.model, exchange.model_version)
            == (model.provider, model.model, model.version)
        )
        shown = f"; {'; '.join(map(_settings, settings))}" if settings and settings != ["{}"] else ""
        inside = name[:-1] + f"{shown})" if name.endswith(")") else f"{name}{f' ({shown[2:]})' if shown else ''}"
        text = f"The language model {inside} was asked {_times(model.asked)} to propose what the robot could say"
        if not model.answered:
            return f"{text} and gave no answer."
        accepted = model.said + model.edited
        answers = "its answer" if model.answered == 1 else f"its {_number(model.answered, 'answer')}"
        if model.answered == 1:
            used = "used as it was" if model.said else "edited and used" if model.edited else "not used"
            return f"{text}; {answers} was {used} by the wizard."
        edited = ""
        if model.edited:
            edited = ", edited" if accepted == 1 else f", {_word(model.edited)} of them edited"
            if 1 < accepted == model.edited:
                edited = ", both edited" if accepted == 2 else ", all edited"
        took = "none" if accepted == 0 else _word(accepted)
        return f"{text}; of {answers}, the wizard used {took} ({accepted / model.answered:.0%}{edited})."


# Words


def _number(count: int, one: str, many: str = "") -> str:
    """``no sessions``, ``one session``, ``twelve sessions``, ``13 sessions``."""
    return f"{_word(count)} {one if count == 1 else many or one + 's'}"


def _word(count: int) -> str:
    """``one``, ``twelve``, ``13``."""
    return _NUMBERS[count] if count < len(_NUMBERS) else str(count)


def _times(count: int) -> str:
    return {0: "never", 1: "once", 2: "twice"}.get(count, f"{_word(count)} times")


def _was(count: int) -> str:
    return "was" if count == 1 else "were"


def _listed(parts: Sequence[str], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return f" {last} ".join(part for part in (", ".join(parts[:-1]), *parts[-1:]) if part)


def _listed_counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name}: {count}" for name, count in counts.items())


def _shares(origins: dict[str, int]) -> str:
    whole = sum(origins.values())
    return _listed([f"{count / whole:.0%} {_ORIGIN_WORDS.get(name, name)}" for name, count in origins.items()])


def _distinct(values: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(value for value in values if value))


def _events(*kinds: type[Any]) -> tuple[str, ...]:
    return tuple(BY_TYPE[kind].name for kind in kinds)


def _statistics(spread: Spread) -> str:
    sd = "" if spread.sd is None else f", SD {spread.sd:.2f} s"
    return f"n = {spread.n}" if spread.n == 1 else f"n = {spread.n}, mean {spread.mean:.2f} s{sd}"


def _spread(spread: Spread) -> str:
    if spread.n == 1:
        return f"{spread.median:.2f} s (n = 1)"
    return f"median {spread.median:.2f} s ({_statistics(spread)}, {spread.smallest:.2f} to {spread.largest:.2f} s)"


def _settings(text: str) -> str:
    """Parameters as they were sent, in words: ``temperature 0.3, max_tokens 48``."""
    return ", ".join(f"{name} {value}" for name, value in json.loads(text).items()) or "the model's defaults"


def _span(sessions: Iterable[Session]) -> str:
    """``21 November 2026``, or the first and the last day."""
    days = sorted(session.clock.anchor.utc_ns_at(session.started_ns) // 1_000_000_000 for session in sessions)
    if not days:
        return ""
    first, last = (datetime.fromtimestamp(moment, UTC) for moment in (days[0], days[-1]))
    if first.date() == last.date():
        return f"{first.day} {first:%B %Y}"
    return f"{first.day} {first:%B %Y} to {last.day} {last:%B %Y}"


def _merged(models: Iterable[ModelUse]) -> list[ModelUse]:
    groups: dict[tuple[str, str, str], list[ModelUse]] = {}
    for model in models:
        groups.setdefault((model.provider, model.model, model.version), []).append(model)
    return [
        ModelUse(
            provider=provider,
            model=name,
            version=version,
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
        )
        for (provider, name, version), group in groups.items()
    ]


# Markdown


def as_markdown(sheet: MethodsSheet) -> str:
    """The sheet as Markdown; whatever comes from the record stands there as it is, not as markup."""
    lines = [f"# {_plain(sheet.title)}", "", sheet.about, "", f"Still to be filled in by hand: {_open(sheet)}.", ""]
    for section in sheet.sections:
        lines += [f"## {section.title}", ""]
        for item in section.items:
            lines.append(f"**{item.question}**")
            if item.answer:
                lines += ["", _plain(item.answer)]
            if item.answer and item.sources:
                lines += ["", f"*From {', '.join(f'`{source}`' for source in item.sources)}*"]
            if item.by_hand:
                lines += ["", f"- [ ] **To fill in by hand:** {item.by_hand}"]
            lines.append("")
    lines += [
        "## Paragraph for a paper", "", "What stands in square brackets is still to be filled in.", "",
        _plain(sheet.paragraph), "",
    ]  # fmt: skip
    for appendix in sheet.appendices:
        fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", appendix.text)), default=0))
        lines += [f"## Appendix: {appendix.title}", "", appendix.about, "", fence, appendix.text, fence, ""]
    return "\n".join(lines)


def _open(sheet: MethodsSheet) -> str:
    return counted(sheet.open_items, "item")


def _plain(text: str) -> str:
    return re.sub(r"([\\`*_\[\]<>#|~])", r"\\\1", " ".join(text.split()))
