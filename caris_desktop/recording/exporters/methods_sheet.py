"""Questions of the methods sheet, each with its answer from the recording or a hint on what to fill in.

The questions are those of the reporting guidelines of Riek, "Wizard of Oz Studies in HRI: A Systematic Review and New
Reporting Guidelines", Journal of Human-Robot Interaction 1(1), 2012, and what journals require on language models:
model, version, parameters, prompts, purpose, and who decided on the answers. Nothing is invented: what the recording
lacks is marked for the researcher.
"""

import json
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from caris_desktop.domain.actor import WIZARD, in_words
from caris_desktop.domain.events import (
    LATE_FROM_S,
    AlarmChanged,
    LlmExchange,
    PreflightChecked,
    ProtocolEnded,
    ProtocolOpened,
    RobotChosen,
    ScenarioOpened,
    StepEntered,
)
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.exporters.drawings import duration_text
from caris_desktop.recording.exporters.html import distance_text, model_name
from caris_desktop.recording.exporters.methods_facts import (
    PRACTICE,
    PracticeSession,
    StudyFacts,
    practice_available,
    purpose_of,
    read_known,
    wizard_of,
)
from caris_desktop.recording.exporters.methods_words import (
    CAN,
    MEANS_WORDS,
    SEEN,
    SOURCE_WORDS,
    days_words,
    distinct,
    gaps_words,
    listing,
    listing_counts,
    number_of,
    number_word,
    settings_words,
    share_words,
    spread_words,
    statistics_words,
    times_word,
    was_or_were,
)
from caris_desktop.recording.measures.distributions import SummaryStats, per_10_min, quantile
from caris_desktop.recording.measures.session_measures import THIS_COMPUTER, ModelUse
from caris_desktop.recording.session.scenario_text import ScenarioText
from caris_desktop.recording.session.session_alarms import AlarmRecord
from caris_desktop.recording.session.session_checks import open_words
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.studies.data_quality import stream_words
from caris_desktop.recording.studies.study_index import copies_among

# A larger offset means a robot clock that was never set, or simulation time.
_OWN_TIME_S = 30 * 86400.0


@dataclass(frozen=True, slots=True)
class SheetItem:
    """One question. ``answer`` is empty if the recording has none; ``by_hand`` says what to add.

    ``sources`` names the parts of the recording behind the answer.
    """

    question: str
    answer: str = ""
    sources: tuple[str, ...] = ()
    by_hand: str = ""


@dataclass(frozen=True, slots=True)
class SheetSection:
    """Questions on one subject."""

    title: str
    items: tuple[SheetItem, ...]


@dataclass(frozen=True, slots=True)
class Appendix:
    """Full text, such as a system prompt; may be long and multi-line."""

    title: str
    about: str
    text: str


@dataclass(frozen=True, slots=True)
class MethodsSheet:
    """Whole sheet. ``paragraph`` is for a paper; parts in square brackets are still to be filled in."""

    title: str
    about: str
    sections: tuple[SheetSection, ...]
    paragraph: str
    appendices: tuple[Appendix, ...]

    @property
    def open_items(self) -> int:
        return sum(bool(item.by_hand) for section in self.sections for item in section.items)


def methods_sheet(sessions: Sequence[Session], progress: Callable[[float], None] = lambda _: None) -> MethodsSheet:
    """Fill the sheet. ``progress`` may raise to cancel. Raises SessionError."""
    copies = copies_among({str(session.folder): (session.identity, session.losses) for session in sessions})
    sessions = [session for session in sessions if str(session.folder) not in copies]
    counting = [session for session in sessions if purpose_of(session.trial) != PRACTICE] or list(sessions)
    known = []
    for number, session in enumerate(counting):

        def report(fraction: float, *, before: int = number) -> None:
            progress(0.95 * (before + fraction) / len(counting))

        known.append(read_known(session, report))
    return _Answers(StudyFacts(known, practice_available(sessions), len(copies))).sheet()


class _Answers:
    """Answers each question from the sessions."""

    def __init__(self, study: StudyFacts) -> None:
        self._of = study

    def sheet(self) -> MethodsSheet:
        sections = (self._robot(), self._participants(), self._wizards(), self._study(), self._language_model(),
                    self._record())  # fmt: skip
        one = len(self._of.known) == 1
        of = self._of.known[0].session.folder.name if one else f"{len(self._of.known)} sessions"
        return MethodsSheet(
            title=f"Methods sheet of {of}",
            about=(
                "Filled in from the CARIS Desktop recording, following the reporting guidelines for "
                "Wizard-of-Oz studies by Riek (2012) and current practice in disclosing language models. "
                "Each answer names its sources in the recording. Information that is not in the recording is "
                "marked to be filled in by hand."
            ),
            sections=tuple(section for section in sections if section.items),
            paragraph=methods_paragraph(self._of),
            appendices=tuple(self._prompts()),
        )

    # Sections

    def _robot(self) -> SheetSection:
        robots = distinct(name for one in self._of.known for name in one.robots)
        goals = self._of.counted("goals")
        navigated_s = self._of.total("navigating_s")
        own = []
        if goals:
            own.append(
                f"It drove autonomously to {number_of(sum(goals.values()), 'goal')} that the wizard set"
                f" ({listing_counts(goals)}; {duration_text(navigated_s)})."
            )
        guarded = int(self._of.total("guard_interventions"))
        if any("event/guard_changed" in one.streams for one in self._of.known):
            often = f"slowed or stopped it {times_word(guarded)}" if guarded else "never slowed or stopped it"
            own.append(f"An obstacle guard {often}.")
        own.append(self._who_decided_words())
        return SheetSection(
            "Robot",
            (
                SheetItem(
                    "How many robots were used, and of which kind?",
                    listing(robots),
                    ("session.json", *events_named(RobotChosen)) if robots else (),
                    "Make, model and appearance (humanoid, mechanical, ...)." if robots else "The robot.",
                ),
                SheetItem(
                    "What did the robot do autonomously, and what did the wizard decide?",
                    " ".join(part for part in own if part),
                    ("event/goal_changed", "event/guard_changed", "event/utterance_changed"),
                    "Whether the robot was presented to participants as autonomous.",
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
        people = distinct(one.session.trial.get("participant", "") for one in self._of.known)
        without = sum(not one.session.trial.get("participant") for one in self._of.known)
        answer = ""
        if people:
            answer = (
                f"{number_of(len(people), 'participant').capitalize()} in {number_of(len(self._of.known), 'session')}."
            )
            if without:
                verb = "has" if without == 1 else "have"
                answer += f" {number_of(without, 'session').capitalize()} {verb} no named participant."
        conditions = Counter(one.session.trial.get("condition", "") for one in self._of.known)
        conditions.pop("", None)
        return SheetSection(
            "Participants",
            (
                SheetItem(
                    "How many participants?",
                    answer,
                    ("session.json",) if answer else (),
                    "" if answer else "Number of participants.",
                ),
                SheetItem(
                    "Which conditions were there, and with how many sessions each?",
                    listing_counts(conditions),
                    ("session.json",) if conditions else (),
                    "" if conditions else "The conditions, if any.",
                ),
                SheetItem(
                    "How many people were in front of the robot?",
                    self._people_seen(),
                    ("event/person_appeared",) if self._of.total("people") else (),
                ),
                SheetItem("Who were they?", by_hand="Age, gender, background, experience with robots, recruitment."),
                SheetItem(
                    "What were they told?",
                    by_hand="Instructions, consent, beliefs about the robot's autonomy, debriefing.",
                ),
                SheetItem(
                    "Was the simulation convincing?",
                    by_hand="Whether participants suspected a wizard, and how this was determined.",
                ),
            ),
        )

    def _people_seen(self) -> str:
        people = [int(one.measures["people"]) for one in self._of.known]
        if not any(people):
            return ""
        identities = int(self._of.total("identities"))
        remark = (
            "as counted by the console: "
            f"{number_of(identities, 'identity', 'identities')} from its detector and tracker, which may give one "
            "person several."
        )
        if len(people) == 1:
            return f"At most {number_of(people[0], 'person', 'people')} at once, {remark}"
        median = f"{statistics.median(people):g}"
        return f"At most {min(people)} to {max(people)} at once in a session (median {median}), {remark}"

    def _wizards(self) -> SheetSection:
        wizards = self._of.wizards()
        errors = self._of.counted("wizard_errors")
        return SheetSection(
            "Wizard",
            (
                SheetItem(
                    "How many wizards?",
                    self._wizards_text(wizards),
                    ("session.json",) if wizards else (),
                    "Who they were (researcher, confederate, naive), and what they knew about the hypotheses.",
                ),
                SheetItem(
                    "How were they trained?",
                    self._training_text(wizards),
                    ("session.json of practice sessions",),
                    "Training outside the program; the readiness criterion.",
                ),
                SheetItem(
                    "What could the wizard perceive?",
                    self._perceived(),
                    ("events.mcap", *events_named(ScenarioOpened)),
                    "What the wizard saw and heard outside the program (same room, one-way mirror, ...).",
                ),
                SheetItem(
                    "What could the wizard do, and what was used?",
                    self._produced(),
                    (
                        *events_named(ScenarioOpened),
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
                    ("event/utterance_changed", *events_named(LlmExchange)),
                    "" if self._of.responses() else "Response times: participants' speech is not in the recording.",
                ),
                SheetItem(
                    "Which errors did the wizard make?",
                    self._errors_text(errors),
                    ("event/marked",),
                    "How errors were noticed: the recording contains only errors that the wizard marked.",
                ),
            ),
        )

    def _study(self) -> SheetSection:
        scenarios: dict[str, ScenarioText] = {}
        for one in self._of.known:
            for scenario in one.scenarios:
                scenarios[scenario.sha256 or scenario.title] = scenario
        described = [
            f"{scenario.title}{f': {scenario.description}' if scenario.description else ''}"
            f"{f' (file {scenario.file_name}, SHA-256 {scenario.sha256[:12]}…)' if scenario.file_name else ''}"
            for scenario in scenarios.values()
        ]
        recorded_s = self._of.each("recorded_s")
        spread = SummaryStats.of(recorded_s)
        length = f"{duration_text(sum(recorded_s))} in {number_of(len(recorded_s), 'session')}"
        if spread is not None and spread.n > 1:
            span = f"{duration_text(spread.smallest)} to {duration_text(spread.largest)}"
            same = duration_text(spread.smallest) == duration_text(spread.largest)
            mean = duration_text(spread.mean)
            length += f"; {mean} each" if same else f"; {mean} on average ({span})"
        left_out = len(self._of.practice)
        if left_out and len(self._of.known) > 1:
            length += f"; {number_of(left_out, 'practice session')} {was_or_were(left_out)} left out"
        return SheetSection(
            "Study",
            (
                SheetItem(
                    "How many scenarios, and which?",
                    " ".join(f"{text.rstrip('.')}." for text in described),
                    ("session.json", *events_named(ScenarioOpened)) if described else (),
                ),
                *self._protocol_item(),
                SheetItem("When, and how long?", f"{self._dates()}: {length}.", ("session.json",)),
                *self._checked(),
                *self._went_wrong(),
                SheetItem(
                    "Where did it take place?", by_hand="Place, room, number of locations, other people present."
                ),
                SheetItem(
                    "Was the robot's behaviour developed in several iterations?",
                    by_hand="Pilot studies, and what was changed after them.",
                ),
                SheetItem("Which software was used?", self._software(), ("session.json",)),
                SheetItem(
                    "Which limitations result from the use of a wizard?",
                    by_hand="Which of the wizard's tasks the robot could later do autonomously, and how well.",
                ),
            ),
        )

    def _checked(self) -> list[SheetItem]:
        """Pre-session checks; omitted if no session recorded any."""
        checked = [one for one in self._of.known if one.preflight.checks]
        if not checked:
            return []
        ready = sum(not one.preflight.still_open for one in checked)
        by_hand = Counter(
            check.title for one in checked for check in one.preflight.checks if check.manual and check.state == "passed"
        )
        still_open = Counter(words for one in checked for words in open_words(one.preflight))
        which = "the session" if len(checked) == 1 else f"{ready} of {len(checked)} sessions"
        share = "all" if ready or len(checked) > 1 else "not all"
        parts = [f"In {which}, {share} of the program's checks passed."]
        if by_hand:
            parts.append(f"Ticked by the wizard: {listing_counts(by_hand)}.")
        if still_open:
            parts.append(f"Not passed: {listing_counts(still_open)}.")
        return [SheetItem("What was checked before each session?", " ".join(parts), events_named(PreflightChecked))]

    def _went_wrong(self) -> list[SheetItem]:
        """Alarms that occurred; omitted if no session recorded alarms."""
        sources = events_named(AlarmChanged)
        if not any(stream == sources[0] for one in self._of.known for stream in one.streams):
            return []
        alarms = [alarm for one in self._of.known for alarm in one.measures.alarms]
        by_cause: dict[str, list[AlarmRecord]] = {}
        for alarm in alarms:
            by_cause.setdefault(alarm.cause, []).append(alarm)
        sentences = [
            f"{group[0].what.rstrip('.')}: {number_of(len(group), 'alarm')},"
            f" {duration_text(sum(one.stood_s for one in group))} in total."
            for group in sorted(by_cause.values(), key=len, reverse=True)
        ]
        concerned = sum(bool(one.measures.alarms) for one in self._of.known)
        dismissed = sum(bool(alarm.seen_to_by) for alarm in alarms)
        stood_on = sum(alarm.end_ns is None for alarm in alarms)
        total = len(self._of.known)
        answer = (
            f"{number_of(len(alarms), 'alarm').capitalize()} in"
            f" {'the session' if total == 1 else f'{concerned} of {total} sessions'}; {dismissed} dismissed,"
            f" {len(alarms) - dismissed - stood_on} ended automatically, {stood_on} active when a session ended."
        )
        return [SheetItem("What went wrong during the sessions?", " ".join((answer, *sentences)), sources)]

    def _language_model(self) -> SheetSection:
        if not self._of.models:
            return SheetSection(
                "Language model",
                (
                    SheetItem(
                        "Was a language model used?",
                        _suggestions_sentence(self._of)
                        if self._of.total("suggestions_shown")
                        else "No: the recording contains no questions to a language model.",
                        events_named(LlmExchange),
                    ),
                ),
            )
        exchanges = [exchange for one in self._of.known for exchange in one.exchanges]
        settings = distinct(json.dumps(exchange.parameters, sort_keys=True) for exchange in exchanges)
        sources = events_named(LlmExchange)
        count = len(self._of.system_prompts())
        prompts = (
            f"{number_of(count, 'system prompt').capitalize()}, in full in the appendix."
            if count
            else "No system prompt was used."
        )
        days = days_words(one.session for one in self._of.known if one.exchanges)
        return SheetSection(
            "Language model",
            (
                SheetItem(
                    "Which model and which version?",
                    " ".join(
                        f"{model_name(model)}: asked {times_word(model.asked)}"
                        f"{'' if model.version else '; its version is not in the recording'}."
                        for model in self._of.models
                    ),
                    sources,
                    "Who runs the server, and what happens to the questions there."
                    if any(model.place != THIS_COMPUTER for model in self._of.models)
                    else "",
                ),
                SheetItem("When?", f"{days}.", ("session.json",)),
                SheetItem(
                    "Which parameters were used?",
                    f"{'; '.join(map(settings_words, settings))}. {_seeds(exchanges)}",
                    sources,
                ),
                SheetItem(
                    "Which prompts were used?",
                    f"{prompts} The recording contains every prompt as it was sent.",
                    sources,
                ),
                SheetItem(
                    "What was it used for, and who decided?",
                    ("It proposed what the robot could say. The robot said a proposal only if the wizard chose it."),
                    (*sources, "event/answer_used"),
                ),
                SheetItem(
                    "How many of its answers were used?",
                    " ".join(self._acceptance(model) for model in self._of.models),
                    (*sources, "event/answer_used"),
                ),
                *(
                    [
                        SheetItem(
                            "What became of its suggested replies?",
                            _suggestions_sentence(self._of),
                            ("event/suggestion_changed",),
                        )
                    ]
                    if self._of.total("suggestions_shown")
                    else []
                ),
                SheetItem("How long did it take?", self._latency(), sources),
            ),
        )

    def _record(self) -> SheetSection:
        lost = self._of.counted("lost_values")
        cut = sum(not one.session.closed_properly for one in self._of.known)
        pauses = int(self._of.total("pauses"))
        paused_s = self._of.total("paused_s")
        losses = [
            f"{count} {stream_words(stream)} were not recorded." if count != 1 else
            f"1 of the {stream_words(stream)} was not recorded."
            for stream, count in lost.items()
        ]  # fmt: skip
        several = len(self._of.known) > 1
        for one in self._of.known:
            name = f"{one.session.folder.name}: " if several else ""
            losses += [f"{name}{loss}" for loss in one.session.losses]
        losses = losses or ["No missing data was recorded."]
        if self._of.copies:
            losses.append(f"{number_of(self._of.copies, 'copy', 'copies').capitalize()} of sessions not counted.")
        if cut:
            losses.append(f"{number_of(cut, 'recording').capitalize()} {was_or_were(cut)} cut off before the end.")
        if pauses:
            losses.append(f"Recording was paused {times_word(pauses)}, for {duration_text(paused_s)} in total.")
        trouble_s = self._of.total("link_trouble_s")
        if trouble_s:
            losses.append(f"The robot could not be reached for {duration_text(trouble_s)} in total.")
        return SheetSection(
            "Recording",
            (
                SheetItem(
                    "Which clocks were used, and how accurate were they?",
                    self._clocks(),
                    ("event/link_quality", "session.json"),
                ),
                SheetItem(
                    "Which data is missing?",
                    " ".join(losses),
                    ("event/gap", "event/recording_paused", "event/link_changed", "session.json"),
                ),
            ),
        )

    # Answers

    def _movement(self) -> str:
        sources: dict[str, float] = {}
        for one in self._of.known:
            for source, seconds in one.measures.of("driving_s").items():
                sources[source] = sources.get(source, 0.0) + seconds
        ways, known_speeds = self._of.each("distance_m"), self._of.each("max_speed_mps")
        parts = []
        if sources:
            source_texts = [f"{SOURCE_WORDS.get(source, source)} ({duration_text(s)})" for source, s in sources.items()]
            parts.append(f"The wizard drove with {listing(source_texts)}.")
        else:
            parts.append("The wizard did not drive it manually.")
        if ways:
            some = (
                ""
                if len(ways) == len(self._of.known)
                else f", in the {len(ways)} of {len(self._of.known)} sessions with odometry"
            )
            parts.append(f"It drove {distance_text(sum(ways))} in total{some}.")
        else:
            parts.append("The distance is unknown: the robot reported no odometry.")
        if known_speeds:
            parts.append(f"Its highest speed was {max(known_speeds):.2f} m/s.")
        stops = int(self._of.total("stops"))
        emergencies = int(self._of.total("emergency_stops"))
        if stops or emergencies:
            parts.append(f"Stop was pressed {times_word(stops)}, the emergency stop {times_word(emergencies)}.")
        else:
            parts.append("Neither Stop nor the emergency stop was pressed.")
        return " ".join(parts)

    def _speech(self) -> str:
        origins = self._of.counted("robot_utterances")
        total = sum(origins.values())
        if not total:
            return "The robot did not speak."
        voices = {voice for one in self._of.known for voice in one.voices}
        voice = {frozenset({"robot"}): " The voice was the robot's own.",
                 frozenset({"computer"}): " The voice was synthesised by the wizard's computer.",
                 frozenset({"both"}): " The robot's own voice and the wizard's computer spoke at the same time."}.get(
                     frozenset(voices), "")  # fmt: skip
        return f"It spoke {times_word(total)}: {share_words(origins)}.{voice}"

    def _who_decided_words(self) -> str:
        counts: Counter[str] = Counter()
        for one in self._of.known:
            counts.update(one.utterances_by_actor)
        others = dict(counts.most_common())
        others.pop(in_words(WIZARD), None)
        but = f", except for utterances by others ({listing_counts(others)})" if others else ""
        return f"The wizard decided what it said{but}." if counts else ""

    def _wizards_text(self, wizards: list[str]) -> str:
        if not wizards:
            return ""
        sessions = Counter(wizard_of(one.session) for one in self._of.known)
        shares = listing([f"{name or 'unnamed'} ({number_of(count, 'session')})" for name, count in sessions.items()])
        return f"{number_of(len(wizards), 'wizard').capitalize()}: {shares}."

    def _training_text(self, wizards: list[str]) -> str:
        practised = self._of.training()
        if not practised:
            return "No practice session was recorded before the first session."
        parts = [
            f"{name}: {duration_text(sum(one.duration_s for one in runs))} in"
            f" {number_of(len(runs), 'practice session')}{_best_score(runs)}"
            for name, runs in practised.items()
        ]
        without = [name for name in wizards if name not in practised]
        rest = f" No practice session was recorded for {listing(without)}." if without else ""
        return f"With the program, before the first session: {'; '.join(parts)}.{rest}"

    def _perceived(self) -> str:
        stream_texts = [words for stream, words in SEEN if any(stream in one.streams for one in self._of.known)]
        texts = [f"On the console: {listing(stream_texts)}."] if stream_texts else []
        texts.append(
            "Participants' speech was transcribed for the wizard."
            if any(one.participant_spoke for one in self._of.known)
            else "Participants' speech was not transcribed."
        )
        panels = distinct(panel for one in self._of.known for scenario in one.scenarios for panel in scenario.panels)
        if panels:
            texts.append(f"Panels in the scenario: {', '.join(panels)}.")
        return " ".join(texts)

    def _produced(self) -> str:
        permissions: dict[str, bool] = {}
        phrases = 0
        for one in self._of.known:
            for scenario in one.scenarios:
                phrases = max(phrases, len(scenario.phrases))
                for name, allowed in scenario.permissions.items():
                    permissions[name] = permissions.get(name, False) or allowed
        able = [words for name, words in CAN if permissions.get(name)]
        unable = [words for name, words in CAN if permissions.get(name) is False]
        texts = []
        if phrases:
            texts.append(f"{number_of(phrases, 'prepared phrase').capitalize()} on keys.")
        if able:
            texts.append(f"The scenario allowed the wizard to type what the robot says, {listing(able)}.")
        if unable:
            texts.append(f"It did not allow the wizard to {listing(unable, 'or')}.")
        moves = sum(one.head_moves for one in self._of.known)
        controls = sum(one.controls for one in self._of.known)
        goals = int(self._of.total("goals"))
        photos = sum(one.photos for one in self._of.known)
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
            texts.append(f"Used in addition to speech and driving: {listing(used)}.")
        return " ".join(texts)

    def _responses_text(self) -> str:
        parts = []
        response = SummaryStats.of(self._of.responses())
        if response is not None:
            parts.append(
                f"From the end of a participant's utterance to the robot's next words: {spread_words(response)}."
            )
            content = SummaryStats.of(
                [reply.delay_s for one in self._of.known for reply in one.measures.content_responses]
            )
            if content is not None and content != response:
                parts.append(f"Without fillers: {spread_words(content)}.")
        gaps = self._of.gaps()
        parts += filter(None, [gaps_words([gap.gap_s for gap in gaps if gap.first])])
        by_means = {means: [gap.gap_s for gap in gaps if gap.means == means] for means in MEANS_WORDS}
        medians = [
            f"{MEANS_WORDS[means]} {quantile(gaps_s, 0.5):.2f} s (n = {len(gaps_s)})"
            for means, gaps_s in by_means.items()
            if gaps_s
        ]
        if medians:
            parts.append(f"Median by means of speech: {listing(medians)}.")
        reaction = SummaryStats.of([reply.delay_s for one in self._of.known for reply in one.measures.reactions])
        if reaction is not None:
            parts.append(
                "From the end of a participant's utterance, or the language model's answer, to the wizard's request:"
                f" {spread_words(reaction)}."
            )
        return " ".join(parts)

    def _protocol_item(self) -> list[SheetItem]:
        """Planned against actual steps; omitted without a protocol."""
        steps = self._of.steps()
        if not steps:
            return []
        step_texts = []
        several = len({scenario for scenario, _ in steps}) > 1
        for (scenario, _), records in steps.items():
            begun = [record for record in records if record.visits]
            planned = max(record.expected_s for record in records)
            spread = SummaryStats.of([record.time_s for record in begun])
            facts = [f"{duration_text(planned)} planned" if planned else ""]
            facts.append("never started" if spread is None else f"median {duration_text(spread.median)} actual")
            often = {
                "started in {} of {}": len(begun) if len(begun) < len(records) and begun else 0,
                "skipped in {} of {}": sum(record.skipped > 0 for record in records),
                "late in {} of {}": sum(record.late_s >= LATE_FROM_S for record in records),
            }
            facts += [words.format(count, len(records)) for words, count in often.items() if count]
            title = f"{records[-1].title}{f' of {scenario}' if several else ''}"
            step_texts.append(f"{title} ({', '.join(filter(None, facts))})")
        return [
            SheetItem(
                "Which protocol did the wizard follow, and how closely?",
                f"{number_of(len(steps), 'step').capitalize()}: {'; '.join(step_texts)}.",
                events_named(ProtocolOpened, StepEntered, ProtocolEnded),
                "Why steps were skipped or took longer, if relevant.",
            )
        ]

    def _errors_text(self, errors: dict[str, int]) -> str:
        count = sum(errors.values())
        if not count:
            return "The wizard marked no errors."
        rate = per_10_min(count, self._of.recorded_s())
        kinds = listing_counts({label or "not specified": number for label, number in errors.items()})
        rate_text = f", {rate:.1f} per 10 minutes" if rate is not None else ""
        return f"The wizard marked {number_of(count, 'error')} ({kinds}){rate_text}."

    def _dates(self) -> str:
        return days_words(one.session for one in self._of.known)

    def _software(self) -> str:
        versions = distinct(one.session.header.program_version for one in self._of.known)
        text = f"CARIS Desktop {listing(versions)}." if versions else "CARIS Desktop."
        named: dict[str, list[str]] = {}
        for one in self._of.known:
            for name, version in one.session.header.software.items():
                if version not in named.setdefault(name, []):
                    named[name].append(version)
        listed = ", ".join(f"{name} {' / '.join(versions)}" for name, versions in sorted(named.items()))
        return f"{text} {listed}." if listed else text

    def _acceptance(self, model: ModelUse) -> str:
        name = f"{model_name(model)}: " if len(self._of.models) > 1 else ""
        text = f"{name}{number_of(model.answered, 'answer')} to {number_of(model.asked, 'question')}"
        text = text[0].upper() + text[1:]
        if model.accepted_fraction is not None:
            text += (
                f"; accepted {model.said + model.edited} ({model.accepted_fraction:.0%}: {model.said} as"
                f" {'it was' if model.said == 1 else 'they were'}, {model.edited} edited), {model.dismissed} dismissed,"
                f" {model.unused} not used"
            )
        failed = ((model.cancelled, "cancelled"), (model.failed, "failed"))
        rest = listing([f"{count} {word}" for count, word in failed if count])
        return f"{text}{f'; {rest}' if rest else ''}."

    def _latency(self) -> str:
        texts = []
        for model in self._of.models:
            first, complete = SummaryStats.of(model.first_token_s), SummaryStats.of(model.answer_s)
            name = f"{model_name(model)}: " if len(self._of.models) > 1 else ""
            if first is not None:
                texts.append(f"{name}Time to the first word: {spread_words(first)}.")
            if complete is not None:
                texts.append(f"{name}Time to the complete answer: {spread_words(complete)}.")
        return " ".join(texts)

    def _clocks(self) -> str:
        known = [one.clock for one in self._of.known if one.clock is not None]
        text = "All times are from one monotonic clock of the wizard's computer, mapped to UTC at the start."
        if not known:
            return f"{text} The offset of the robot's clock was not measured."
        drifts = [abs(clock.drift_ms_per_min) for clock in known]
        # Adding zero turns minus zero into zero.
        offsets = [round(clock.utc_offset_s, 3) + 0.0 for clock in known]
        if max(map(abs, offsets)) > _OWN_TIME_S:
            ahead = "it had its own epoch"
        elif len(offsets) == 1:
            ahead = f"it was {offsets[0]:+.3f} s from the computer's UTC"
        else:
            ahead = f"it was {min(offsets):+.3f} to {max(offsets):+.3f} s from the computer's UTC"
        unknown = len(self._of.known) - len(known)
        rest = f" In {number_of(unknown, 'session')} it was not measured." if unknown else ""
        return (
            f"{text} The robot's clock was compared with it once per second: {ahead}, and drifted by at most"
            f" {max(drifts):.1f} ms per minute; its timestamps are accurate to"
            f" ±{max(c.uncertainty_ms for c in known):.1f} ms."
            f"{rest}"
        )

    def _prompts(self) -> list[Appendix]:
        prompts = self._of.system_prompts()
        return [
            Appendix(
                "System prompt" if len(prompts) == 1 else f"System prompt {number}",
                f"Sent with {number_of(count, 'question')}.",
                text,
            )
            for number, (text, count) in enumerate(prompts.items(), start=1)
        ]


def _best_score(runs: Sequence[PracticeSession]) -> str:
    scores = [run.score for run in runs if run.score is not None]
    return f", {max(scores)} of 100 points in the guided exercise" if scores else ""


def _seeds(exchanges: Sequence[LlmExchange]) -> str:
    seeded = sum(exchange.seed is not None for exchange in exchanges)
    if not seeded:
        return "No seed was sent."
    which = "Each question" if seeded == len(exchanges) else f"{seeded} of the {len(exchanges)} questions"
    return f"{which} had a separate seed, which is in the recording."


def events_named(*kinds: type[Any]) -> tuple[str, ...]:
    return tuple(BY_TYPE[kind].name for kind in kinds)


def methods_paragraph(study: StudyFacts) -> str:
    """Methods paragraph of a paper; parts in square brackets are for the researcher to fill in.

    Complete sentences that the recording supports; others are left out.
    """
    return " ".join(sentence for sentence in _sentences(study) if sentence)


def _sentences(study: StudyFacts) -> Iterable[str]:
    sessions = number_of(len(study.known), "session")
    people = distinct(one.session.trial.get("participant", "") for one in study.known)
    wizards = study.wizards()
    robots = distinct(name for one in study.known for name in one.robots)
    recorded_s = study.recorded_s()
    versions = distinct(one.session.header.program_version for one in study.known)
    by_whom = number_of(len(wizards), "wizard") if wizards else "[number of] wizards"
    with_people = f" with {number_of(len(people), 'participant')}" if people else ""
    yield (
        f"The robot ({listing(robots) or '[robot]'}) was controlled by {by_whom} with"
        f" CARIS Desktop{f' (version {listing(versions)})' if versions else ''} in {sessions}{with_people}"
        f" ({duration_text(recorded_s)} recorded)."
    )
    yield "[Participants: age, gender, recruitment.]"
    lasted = study.training()
    if lasted:
        minutes = [sum(one.duration_s for one in runs) for runs in lasted.values()]
        if len(wizards) == 1:
            who = "The wizard"
        elif len(lasted) == len(wizards):
            who = "The wizards"
        else:
            who = f"{number_word(len(lasted)).capitalize()} of the {number_word(len(wizards))} wizards"
        shortest, longest = duration_text(min(minutes)), duration_text(max(minutes))
        span = shortest if len(minutes) == 1 else f"{shortest} each"
        if shortest != longest:
            span = f"{shortest} to {longest} each"
        yield f"{who} had practised with the program for {span} before the first session."
    else:
        yield "[Training of the wizard.]" if len(wizards) <= 1 else "[Training of the wizards.]"
    stream_texts = [words for stream, words in SEEN[:5] if any(stream in one.streams for one in study.known)]
    if stream_texts:
        yield f"The console showed {listing(stream_texts)}."
    origins = study.counted("robot_utterances")
    total = sum(origins.values())
    if total:
        yield f"The robot made {number_of(total, 'utterance')} ({share_words(origins)})."
    response = SummaryStats.of(study.responses())
    if response is not None:
        yield (
            "The median time from the end of a participant's utterance to the robot's next words was"
            f" {response.median:.2f} s ({statistics_words(response)})."
        )
    yield _movement_sentence(study)
    for model in study.models:
        yield _model_sentence(model)
    if study.total("suggestions_shown"):
        yield _suggestions_sentence(study)
    errors = study.counted("wizard_errors")
    count = sum(errors.values())
    marker = "The wizard" if len(wizards) <= 1 else "The wizards"
    rate = per_10_min(count, recorded_s)
    if count:
        kinds = listing_counts({label or "not specified": number for label, number in errors.items()})
        yield (f"{marker} marked {number_of(count, 'error')} of their own ({kinds}; {rate or 0.0:.1f} per 10 minutes).")
    else:
        yield f"{marker} marked no errors of their own."
    lost = int(study.total("lost_values"))
    cut = sum(not one.session.closed_properly for one in study.known)
    damaged = sum(bool(one.session.losses) and one.session.closed_properly for one in study.known)
    if lost or cut or damaged:
        parts = [
            f"{lost} values were not recorded" if lost > 1 else "one value was not recorded" if lost else "",
            f"{number_of(cut, 'recording')} {was_or_were(cut)} cut off before the end" if cut else "",
            f"{number_of(damaged, 'recording')} lost data afterwards" if damaged else "",
        ]
        text = listing([part for part in parts if part])
        yield f"Data loss: {text}."


def _movement_sentence(study: StudyFacts) -> str:
    driven_s = study.total("driving_s")
    goals = study.counted("goals")
    count, reached = sum(goals.values()), goals.get("reached", 0)
    ways = study.each("distance_m")
    of_some = (
        "" if len(ways) == len(study.known) else f", in the {len(ways)} of {len(study.known)} sessions with odometry"
    )
    distance = f" ({distance_text(sum(ways))} in total{of_some})" if ways else ""
    by_hand = f"was driven manually for {duration_text(driven_s)}" if driven_s else ""
    by_itself = ""
    if count:
        if count == 1:
            outcome = "which it reached" if reached else "which it did not reach"
        elif reached == count:
            outcome = "both of which it reached" if count == 2 else "all of which it reached"
        else:
            outcome = f"of which it reached {number_word(reached) if reached else 'none'}"
        by_itself = f"was sent to {number_of(count, 'navigation goal')}, {outcome}"
    if not by_hand and not by_itself:
        return "The robot was not driven." if not ways or sum(ways) < 0.5 else ""
    return f"The robot {' and '.join(part for part in (by_hand, by_itself) if part)}{distance}."


def _suggestions_sentence(study: StudyFacts) -> str:
    """``A language model suggested 7 replies; the wizard used five unchanged; two expired.``"""
    shown, said, edited = (int(study.total(f"suggestions_{name}")) for name in ("shown", "said", "edited"))
    used = listing(
        [f"{number_word(count)} {how}" for count, how in ((said, "unchanged"), (edited, "after editing")) if count]
    )
    fates = ("dismissed", "superseded", "expired")
    rest = [
        f"{number_word(count)} {was_or_were(count)} {fate}" if fate != "expired" else f"{number_word(count)} expired"
        for fate in fates
        if (count := int(study.total(f"suggestions_{fate}")))
    ]
    unused = f"; {listing(rest)}" if rest else ""
    return (
        f"The wizard was shown {number_of(shown, 'suggested reply', 'suggested replies')} of a language model and used"
        f" {used or 'none'}{unused}."
    )


def _model_sentence(model: ModelUse) -> str:
    name = model_name(model)
    settings = distinct(model.settings)
    settings_text = f"; {'; '.join(map(settings_words, settings))}" if settings and settings != ["{}"] else ""
    inside = (
        name[:-1] + f"{settings_text})"
        if name.endswith(")")
        else f"{name}{f' ({settings_text[2:]})' if settings_text else ''}"
    )
    text = f"The language model {inside} was asked {times_word(model.asked)} to propose what the robot could say"
    if not model.answered:
        return f"{text} and gave no answer."
    accepted = model.said + model.edited
    answers = "its answer" if model.answered == 1 else f"its {number_of(model.answered, 'answer')}"
    if model.answered == 1:
        used = "used unchanged" if model.said else "edited and used" if model.edited else "not used"
        return f"{text}; {answers} was {used} by the wizard."
    edited = ""
    if model.edited:
        edited = ", edited" if accepted == 1 else f", {number_word(model.edited)} of them edited"
        if 1 < accepted == model.edited:
            edited = ", both edited" if accepted == 2 else ", all edited"
    took = "none" if accepted == 0 else number_word(accepted)
    return f"{text}; of {answers}, the wizard used {took} ({accepted / model.answered:.0%}{edited})."
