"""Each measure of a session in each output that shows it: the same value, to the rounding of the output.

The places are listed per output. A new measure fails until it has a place in every output, or stands among those that
the output does not show.
"""

import html
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import duckdb
import pytest

from caris_desktop.domain.events import GoalChanged, SuggestionChanged, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.recording.annotation.annotation_import import read_eaf
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.timeline_builder import build_overview
from caris_desktop.recording.measures.measure_definitions import MEASURES, TABLES
from caris_desktop.recording.measures.session_measures import measure, read_facts, sql
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import export_session
from caris_desktop.recording.studies.statistics import study_statistics
from caris_desktop.recording.tables.build import sql_types
from tests.recording.golden_exports import make
from tests.recording.methods_sheets import sheet_of
from tests.recording.studies.test_statistics import hard_to_count, interrupted_turns, wrong
from tests.recording.told_session import at, stepped, tell, tour

SESSIONS = ("busy", "creeping", "seldom", "suggestions", "titles", "rehearsal")
ALL = frozenset(one.name for one in MEASURES)
_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_NUMBERS = {word: number for number, word in enumerate(_WORDS)} | {"never": 0, "once": 1, "twice": 2, "a": 1}
_UNITS = {"h": 3600.0, "min": 60.0, "s": 1.0, "km": 1000.0, "m": 1.0, "%": 0.01}


class Shown(float):
    """A number as it is shown, with half of its last digit."""

    within: float

    @classmethod
    def of(cls, text: str) -> "Shown":
        """``three``, ``twice``, ``4.2 s``, ``3 min 12 s``, ``67%``, ``1.3 km``."""
        text = text.strip().lower().removesuffix(" times").removesuffix(" per 10 min")
        if text in _NUMBERS:
            return cls(_NUMBERS[text])
        parts = re.findall(r"(-?\d+(?:\.(\d+))?) ?(h|min|s|km|m|%)?(?![a-z])", text)
        assert parts, text
        _, decimals, unit = parts[-1]
        shown = cls(sum(float(each) * _UNITS.get(its, 1.0) for each, _, its in parts))
        rounded = decimals or unit or len(parts) > 1
        shown.within = 0.5 * 10.0 ** -len(decimals) * _UNITS.get(unit, 1.0) + 1e-6 if rounded else 0.0
        return shown

    within = 0.0


@dataclass(frozen=True)
class Made:
    """A session and its outputs, made when first asked for."""

    session: Session
    folder: Path

    def exported(self, fmt: str) -> Path:
        out = self.folder / fmt
        if not out.exists():
            export_session(self.session.folder, fmt, out)
        return out

    @cached_property
    def page(self) -> str:
        """Report: a line for each row of its tables, cells between bars."""
        text = (self.exported("html") / "report.html").read_text("utf-8")
        text = re.sub(r"(?s)<style>.*?</style>|<svg.*?</svg>|\n", "", text)
        text = re.sub(r"</t[dh]>", "|", re.sub(r"</(tr|h2|h3|p|li|div)>|<h2>|<span>", "\n", text))
        return re.sub(r"\n\s+", "\n", html.unescape(re.sub(r"<[^>]*>", "", text)))

    @cached_property
    def sheet(self) -> str:
        sheet = sheet_of([self.session])
        return "\n".join([*(f"{question} {answer}" for question, answer in sheet.answers.items()), sheet.paragraph])

    @cached_property
    def elan(self) -> AnnotationDocument:
        (path,) = self.exported("eaf").glob("*.eaf")
        return read_eaf(path)

    @cached_property
    def replay(self) -> AnnotationDocument:
        return build_overview(self.session).tiers


Place = Callable[[Made], float | None]


@pytest.fixture(scope="module")
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp(request.param)
    return Made(open_session(_told(request.param, folder / "sessions" / request.param)), folder)


def _told(name: str, folder: Path) -> Path:
    if name != "busy":
        return make(name, folder)
    values = [*tour(5, minutes=2.0, state_hz=4.0, building=False), *hard_to_count(), *wrong(0)]
    values += [*interrupted_turns(), *more()]
    values += stepped((0.0, "greet", "started"), (12.0, "ask", "next"), (15.0, "close", "skipped"))
    return tell(folder, values, lasts_s=130.0)


def more() -> list[Any]:
    """A goal that is reached, an utterance that is interrupted, and a suggestion that is dismissed."""
    goal = GoalChanged(at(100.0), "g-more", "requested", Pose2D(1.0, 1.0, 0.0))
    begun = UtteranceChanged(at(105.0), "u-more", "robot", "And over there is", "typed", "started")
    shown = SuggestionChanged(at(110.0), "s-more", "displayed", "h-more", 1, 1, "Yes.", "smollm2-135m")
    return [
        goal, replace(goal, stamp_ns=at(103.5), state="reached"),
        begun, replace(begun, stamp_ns=at(107.0), state="interrupted"),
        shown, replace(shown, stamp_ns=at(112.0), state="dismissed", actor="wizard"),
    ]  # fmt: skip


# Tables: the queries give every measure from them.


def _of_tables(source: Callable[[str, Mapping[str, str]], str]) -> dict[str, float | None]:
    with duckdb.connect(":memory:") as database:
        for name, columns in TABLES.items():
            types = sql_types(name, columns)
            there = source(name, types)
            empty = ", ".join(f'NULL::{kind} AS "{column}"' for column, kind in types.items())
            database.execute(f"CREATE VIEW {name} AS {there or f'SELECT {empty} LIMIT 0'}")
        database.execute(sql())
        cursor = database.execute("SELECT * FROM measures")
        row = cursor.fetchone()
        assert row is not None
        return dict(zip((column[0] for column in cursor.description), row, strict=True))


def _of_parquet(made: Made) -> dict[str, float | None]:
    out = made.exported("parquet")
    return _of_tables(
        lambda name, _: f"FROM read_parquet('{out / name}.parquet')" if (out / f"{name}.parquet").exists() else ""
    )


def _of_csv(made: Made) -> dict[str, float | None]:
    out = made.exported("csv")

    def source(name: str, types: Mapping[str, str]) -> str:
        if not (out / f"{name}.csv").exists():
            return ""
        # Of texts, CSV does not tell empty from missing.
        texts = {column: f"coalesce(\"{column}\", '')" for column, kind in types.items() if kind == "VARCHAR"}
        columns = ", ".join(f'CAST({texts.get(one, one)} AS {kind}) AS "{one}"' for one, kind in types.items())
        return f"SELECT {columns} FROM read_csv('{out / name}.csv', header = true, all_varchar = true)"  # noqa: S608

    return _of_tables(source)


def _of_statistics(made: Made) -> dict[str, float | None]:
    (row,) = study_statistics(made.session.folder.parent.parent, made.folder / "statistics").measures
    return row


# Texts: a pattern with the number in it.


def _in_page(pattern: str) -> Place:
    return lambda made: _number(pattern, made.page)


def _in_sheet(pattern: str) -> Place:
    return lambda made: _number(pattern, made.sheet)


def _number(pattern: str, text: str) -> Shown | None:
    found = re.search(pattern, text, re.MULTILINE)
    return Shown.of(found[1]) if found else None


def _sum(pattern: str) -> Callable[[str], float]:
    return lambda text: sum(Shown.of(each) for each in re.findall(pattern, text, re.MULTILINE))


def _row(label: str, column: int = 1) -> Place:
    return _in_page(rf"^{label}\|" + r"[^|\n]*\|" * (column - 1) + r"([^|\n]+)\|")


def _tile(label: str) -> Place:
    return _in_page(rf"^(\S[^\n|]*?)\s*\n{label}\n")


REPORT: dict[str, Place] = {
    "paused_s": _in_page(r"was paused [^,]*, for ([^,]*) in total"),
    "pauses": _in_page(r"was paused ([^,]*), for"),
    "responses": _row("Robot answers participant"),
    "response_time_s": _row("Robot answers participant", 2),
    "content_response_time_s": _row("… with more than a filler", 2),
    "reaction_time_s": _row("Wizard reacts", 2),
    "gaps": _row("Gap before the first sound"),
    "gap_s": _row("Gap before the first sound", 2),
    "gap_lower_quartile_s": _in_page(r"quartiles (\S+) and"),
    "gap_upper_quartile_s": _in_page(r"quartiles \S+ and (\S+ s)"),
    "gaps_under_1_s_fraction": _in_page(r"(\d+ %) under 1 s"),
    "overlaps": _in_page(r"(\d+) of \d+ overlapping"),
    "participant_talk_s": _row("Participant"),
    "robot_talk_s": _row("Robot"),
    "participant_utterances": _row("Participant", 2),
    "robot_utterances": _row("Robot", 2),
    "typed_utterances": _row("Typed by the wizard"),
    "phrase_utterances": _row("Phrases of the scenario"),
    "filler_utterances": _row("Fillers"),
    "assistant_utterances": _row("Language model"),
    "suggestion_utterances": _row("Suggested replies"),
    "dictated_utterances": _row("Dictated by the wizard"),
    "own_voice_utterances": _row("The wizard's own voice"),
    "unsaid_utterances": _row("Requested but never said"),
    "interrupted_utterances": _row("Interrupted"),
    "llm_exchanges": lambda made: _sum(r"\)\|(\d+)\|\d+\|\d+\|\d+\|\d+\|")(made.page),
    "llm_accepted_fraction": _in_page(r"\|(\d+%)\|"),
    "distance_m": _row("Distance"),
    "driving_s": lambda made: _driven(made.page),
    "navigating_s": _row("Driving autonomously"),
    "max_speed_mps": _row("Highest speed"),
    "stops": _row("Stop pressed"),
    "emergency_stops": _row("Emergency stops"),
    "goals": lambda made: _sum(r"^Goals \w+\|(\d+)\|")(made.page),
    "goals_reached": _row("Goals reached"),
    "guard_interventions": _row("Obstacle guard interventions"),
    "protocol_steps": _in_page(r"^Protocol, planned and actual\d+ of (\d+) step"),
    "steps_visited": _in_page(r"^Protocol, planned and actual(\d+) of"),
    "steps_skipped": _in_page(r"^Protocol, planned and actual.* (\d+) skipped"),
    "steps_late": _in_page(r"^Protocol, planned and actual.* (\d+) late"),
    "marks": _in_page(r"^Marks and errors(\w+) mark"),
    "wizard_errors": _tile("wizard errors?"),
    "wizard_errors_per_10_min": lambda made: _sum(r"^wizard error .*\(([\d.]+) per 10 min\)")(made.page),
    "link_trouble_s": _row("Connection interrupted"),
    "lost_values": lambda made: _sum(r"^(\d+) [\w ]+ are missing: ")(made.page),
    "missing_values": _in_page(r"(\d+) of the \d+ recorded values are missing"),
    "alarms": _in_page(r"^Alarms(\d+) alarm"),
    "alarms_s": _in_page(r"^Alarms\d+ alarms?, ([^\n]*)"),
    "alarms_seen_to": lambda made: len(re.findall(r"\|dismissed by ", made.page)) if "Alarms" in made.page else None,
    "people": _tile("(?:person|people) at once"),
}
"""Of the problems, the report leaves out notices."""


def _driven(page: str) -> Shown | None:
    found = re.search(r"^Driving([^\n]*)$", page, re.MULTILINE)
    return Shown.of(found[1]) if found and found[1].strip() else None


def _share(words: str) -> Place:
    """Share of the robot's utterances, as their number."""

    def place(made: Made) -> float | None:
        share, total = _number(rf"(\d+%) {words}", made.sheet), _number(r"The robot made (\w+) utterance", made.sheet)
        return None if share is None or total is None else float(round(share * total))

    return place


SHEET: dict[str, Place] = {
    "recorded_s": _in_sheet(r"\(([^()]*) recorded\)"),
    "paused_s": _in_sheet(r"Recording was paused [^,]*, for (.*?) in total"),
    "pauses": _in_sheet(r"Recording was paused ([^,]*), for"),
    "responses": _in_sheet(r"robot's next words: .*?\(n = (\d+)"),
    "response_time_s": _in_sheet(r"robot's next words was ([\d.]+ s)"),
    "content_response_time_s": lambda made: _number(
        r"Without fillers: (?:median )?([\d.]+ s)" if "Without fillers" in made.sheet else
        r"robot's next words was ([\d.]+ s)", made.sheet),
    "reaction_time_s": _in_sheet(r"to the wizard's request: (?:median )?([\d.]+ s)"),
    "gaps": _in_sheet(r"of (\d+) overlapping"),
    "gap_s": _in_sheet(r"sound of an answer: median (\S+ s)"),
    "gap_lower_quartile_s": _in_sheet(r"quartiles (\S+) and"),
    "gap_upper_quartile_s": _in_sheet(r"quartiles \S+ and (\S+ s)"),
    "gaps_under_1_s_fraction": _in_sheet(r"(\d+ %) under 1 s"),
    "overlaps": _in_sheet(r"(\d+) of \d+ overlapping"),
    "robot_utterances": _in_sheet(r"It spoke (\w+(?: times)?):"),
    "typed_utterances": _share("typed by the wizard"),
    "phrase_utterances": _share("prepared phrases"),
    "filler_utterances": _share("fillers"),
    "assistant_utterances": _share("answers of the language model that the wizard approved"),
    "suggestion_utterances": _share("suggested replies that the wizard chose"),
    "dictated_utterances": _share("dictated by the wizard"),
    "own_voice_utterances": _share("in the wizard's own voice"),
    "llm_exchanges": lambda made: _sum(r"was asked (\w+(?: times)?) to propose")(made.sheet),
    "llm_accepted_fraction": _in_sheet(r"accepted \d+ \((\d+%):"),
    "suggestions_shown": _in_sheet(r"The wizard was shown (\w+) suggested"),
    "suggestions_said": _in_sheet(r"used (\w+) unchanged[ ;.]"),
    "suggestions_edited": _in_sheet(r"(\w+) after editing"),
    "suggestions_dismissed": _in_sheet(r"[;,] (\w+) w\w+ dismissed"),
    "suggestions_superseded": _in_sheet(r"(\w+) w\w+ superseded"),
    "suggestions_expired": _in_sheet(r"(\w+) expired"),
    "distance_m": _in_sheet(r"It drove ([\d.]+ k?m) in total"),
    "driving_s": _in_sheet(r"was driven manually for (\d[\d.]*(?: (?:s|min|h)\b(?: \d\d (?:s|min)\b)?))"),
    "navigating_s": _in_sheet(r"that the wizard set \(.*?; ([^()]*)\)"),
    "max_speed_mps": _in_sheet(r"highest speed was ([\d.]+ m)/s"),
    "stops": _in_sheet(r"Stop was pressed (.*?),"),
    "emergency_stops": _in_sheet(r"the emergency stop (\w+(?: times)?)\."),
    "goals": _in_sheet(r"was sent to (\w+) navigation goal"),
    "goals_reached": _in_sheet(r"that the wizard set \(.*?reached: (\d+)"),
    "guard_interventions": _in_sheet(r"slowed or stopped it (\w+(?: times)?)\."),
    "protocol_steps": _in_sheet(r"how closely\? (\w+) steps?:"),
    "steps_visited": lambda made: _steps(made, r"median [^,)]* actual"),
    "steps_skipped": lambda made: _steps(made, "skipped in 1 of 1"),
    "steps_late": lambda made: _steps(made, "late in 1 of 1"),
    "wizard_errors": _in_sheet(r"The wizard marked (\w+) errors? of their own"),
    "wizard_errors_per_10_min": _in_sheet(r"; ([\d.]+) per 10 minutes"),
    "link_trouble_s": _in_sheet(r"could not be reached for (.*?) in total"),
    "lost_values": _in_sheet(r"Data loss: (\w+) values? w\w+ not recorded"),
    "missing_values": _in_sheet(r"(\d+) of the \d+ recorded values are missing"),
    "alarms": _in_sheet(r"sessions\? (\w+) alarms? in the session"),
    "alarms_s": lambda made: _sum(r": \w+ alarms?, ([^,]*?) in total")(made.sheet),
    "alarms_seen_to": _in_sheet(r"in the session; (\d+) dismissed"),
    "people": _in_sheet(r"At most (\w+) (?:person|people) at once"),
    "identities": _in_sheet(r"(\w+) identit\w+ from its detector"),
}  # fmt: skip


def _steps(made: Made, words: str) -> float | None:
    return len(re.findall(words, made.sheet)) if "how closely?" in made.sheet else None


# Tiers: sums in milliseconds, and numbers of annotations.


def _tier_places(document: Callable[[Made], AnnotationDocument]) -> dict[str, Place]:
    def values(made: Made, name: str) -> list[tuple[float, str]]:
        tiers = document(made)
        ids = [tier.tier_id for tier in tiers.tiers if re.sub(r" \(\d+\)$", "", tier.name) == name]
        return [((one.end_ms - one.start_ms) / 1000.0, one.value) for tier_id in ids for one in tiers.of_tier(tier_id)]

    def seconds(name: str, matching: str = "") -> Place:
        def place(made: Made) -> float:
            found = [each for each in values(made, name) if re.search(matching, each[1])]
            shown = Shown(sum(lasts_s for lasts_s, _ in found))
            shown.within = 0.001 * len(found) + 1e-6
            return shown

        return place

    def number(name: str, matching: str = "") -> Place:
        return lambda made: len([value for _, value in values(made, name) if re.search(matching, value)])

    return {
        "paused_s": seconds("Pauses"),
        "pauses": number("Pauses"),
        "participant_talk_s": seconds("Participant speech"),
        "robot_talk_s": seconds("Robot speech"),
        "participant_utterances": number("Participant speech"),
        "robot_utterances": number("Robot speech"),
        **{
            f"{origin}_utterances": number("Robot speech origin", f"^{origin}$")
            for origin in ("typed", "phrase", "filler", "assistant", "suggestion", "dictated", "own_voice")
        },
        "driving_s": seconds("Driving source"),
        "goals": number("Navigation goals"),
        "goals_reached": number("Navigation goals", "reached"),
        "emergency_stops": number("Emergency stop"),
        "stops": number("Stop requested"),
        "steps_skipped": number("Protocol", "skipped"),
        "marks": number("Wizard marks"),
        "wizard_errors": number("Wizard errors"),
        "link_trouble_s": seconds("Link trouble", "^control: "),
    }


OF_REPLIES = {"suggestion_latency_ms", "suggestion_edit_distance", "reply_exchanges", "reply_used_fraction"}
TIERS_DO_NOT_SHOW = {
    "recorded_s", "responses", "response_time_s", "content_response_time_s", "reaction_time_s", "gaps", "gap_s",
    "gap_lower_quartile_s", "gap_upper_quartile_s", "gaps_under_1_s_fraction", "overlaps", "unsaid_utterances",
    "interrupted_utterances", "llm_exchanges", "llm_accepted_fraction", "suggestions_shown", "suggestions_said",
    "suggestions_edited", "suggestions_dismissed", "suggestions_superseded", "suggestions_expired", "distance_m",
    "navigating_s", "max_speed_mps", "guard_interventions", "protocol_steps", "steps_visited", "steps_late",
    "steps_late_s", "wizard_errors_per_10_min", "lost_values", "missing_values", "problems", "alarms", "alarms_s",
    "alarms_seen_to", "people", "identities", *OF_REPLIES,
}  # fmt: skip
"""Some are derived from intervals of tiers, but are no sum of one."""
PLACES: dict[str, dict[str, Place]] = {
    "report": REPORT,
    "methods sheet": SHEET,
    "ELAN": _tier_places(lambda made: made.elan),
    "replay": _tier_places(lambda made: made.replay),
}
NOT_SHOWN: dict[str, set[str]] = {
    "report": {
        "recorded_s", "identities", "problems", "steps_late_s", "suggestions_shown", "suggestions_said",
        "suggestions_edited", "suggestions_dismissed", "suggestions_superseded", "suggestions_expired",
        *OF_REPLIES,
    },
    "methods sheet": {
        *OF_REPLIES,
        "participant_talk_s", "robot_talk_s", "participant_utterances", "unsaid_utterances", "interrupted_utterances",
        "steps_late_s", "marks", "problems",
    },
    "ELAN": TIERS_DO_NOT_SHOW,
    "replay": TIERS_DO_NOT_SHOW,
}  # fmt: skip


@pytest.mark.parametrize("output", PLACES)
def test_every_measure_has_its_place(output: str) -> None:
    assert set(PLACES[output]) | NOT_SHOWN[output] == ALL
    assert not set(PLACES[output]) & NOT_SHOWN[output]


@pytest.mark.long("busy", "seldom", "creeping", "titles")
@pytest.mark.parametrize("made", SESSIONS, indirect=True)
@pytest.mark.logs(r".*")
def test_every_measure_is_the_same_in_every_output(made: Made) -> None:
    expected = measure(read_facts(made.session)).values
    for of, values in (("CSV", _of_csv(made)), ("Parquet", _of_parquet(made)), ("statistics", _of_statistics(made))):
        for name in ALL:
            assert values[name] == pytest.approx(expected[name]), (of, name)
    wrong = []
    for output, places in PLACES.items():
        for name, place in places.items():
            shown, value = place(made), expected[name]
            within = getattr(shown, "within", 1e-6)
            if (shown is None) != (value is None) and (shown or value):
                wrong.append((output, name, shown, value))
            elif shown is not None and value is not None and not math.isclose(shown, value, abs_tol=within, rel_tol=0):
                wrong.append((output, name, float(shown), value))
    assert not wrong


def test_the_sessions_have_a_value_of_almost_every_measure(tmp_path: Path) -> None:
    """Equal zeros prove little."""
    sessions = [open_session(_told(name, tmp_path / name)) for name in SESSIONS]
    having = {name for session in sessions for name, value in measure(read_facts(session)).values.items() if value}
    assert ALL - having == {"dictated_utterances", "own_voice_utterances", "missing_values"}
