"""Measures of a session with known values."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.events import (
    AnswerUsed,
    CommandSent,
    DriveEnded,
    EmergencyStopChanged,
    Gap,
    GoalChanged,
    GuardChanged,
    LinkChanged,
    LinkQuality,
    Marked,
    PersonAppeared,
    PersonLeft,
    Problem,
    RecordingPaused,
    RobotChosen,
    StopRequested,
    SuggestionChanged,
    SuggestionState,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.recording.annotation.session_tiers import session_tiers
from caris_desktop.recording.exporters.templates import SummaryStats
from caris_desktop.recording.measures.measure_definitions import MEASURES
from caris_desktop.recording.measures.session_measures import Measures, measure, read_facts
from caris_desktop.recording.session.session_data import SessionData
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.studies.data_quality import data_quality_problems
from tests.recording.methods_sheets import sheet_of
from tests.recording.told_session import at, drive, exchange, heard, said, silenced, tell


def measured(tmp_path: Path, values: list[Any], *, lasts_s: float = 100.0) -> Measures:
    return measure(read_facts(open_session(tell(tmp_path / "s", values, lasts_s=lasts_s))))


def test_a_response_is_what_the_robot_says_right_after_a_participant(tmp_path: Path) -> None:
    measures = measured(
        tmp_path,
        [
            *said(1, 0.5, 1.0, 2.0, "Hello."),  # not an answer
            *heard(1, 3.0, 5.0, "Hi, who are you?"),
            *said(2, 5.4, 5.75, 6.5, "Let me think...", origin="filler"),
            *said(3, 7.0, 7.5, 9.0, "I am a robot."),  # not the first
            *heard(2, 20.0, 21.0, "First"),
            *heard(3, 22.0, 23.0, "Second"),  # this one is answered
            *said(4, 23.2, 24.5, 25.0, "Yes."),
            *heard(4, 30.0, 33.0, "A long story"),
            *said(5, 31.0, 32.0, 34.0, "Interrupting."),  # before the end of the participant's turn
            *heard(5, 40.0, 41.0, "Hello?"),
            *said(6, 71.5, 72.0, 73.0, "Much later."),  # 31 s
            *heard(6, 80.0, 81.0, "And now?"),
            RecordingPaused(at(82.0), True),
            RecordingPaused(at(84.0), False),
            *said(7, 84.5, 85.0, 86.0, "After a pause."),
        ],
    )
    assert [round(reply.delay_s, 6) for reply in measures.responses] == [0.75, 1.5]
    assert [reply.utterance_id for reply in measures.responses] == ["u-2", "u-4"]
    assert [round(reply.delay_s, 6) for reply in measures.content_responses] == [2.5, 1.5]
    assert (measures["pauses"], measures["paused_s"], measures["recorded_s"]) == (1, 2.0, 98.0)


def test_a_wizard_reacts_to_what_came_last(tmp_path: Path) -> None:
    measures = measured(
        tmp_path,
        [
            *heard(1, 1.0, 3.0, "What is this?"),
            exchange(1, 3.5, 5.0, "An arm."),
            exchange(2, 5.1, 5.2, "", outcome="failed"),
            *said(1, 6.25, 6.5, 8.0, "An arm.", origin="assistant"),  # 1.25 s after the answer
            *said(2, 9.0, 9.1, 9.5, "And a hand."),  # not an answer
            *heard(2, 20.0, 21.0, "Aha"),
            *said(3, 21.5, 25.0, 26.0, "Yes."),
        ],
    )
    assert [round(reply.delay_s, 6) for reply in measures.reactions] == [1.25, 0.5]


def test_an_echo_and_an_automatic_filler_are_no_reactions(tmp_path: Path) -> None:
    by_itself = [replace(event, actor="console") for event in said(1, 3.5, 3.6, 4.0, "Hm...", origin="filler")]
    echo = UtteranceChanged(at(9.0), "echo", "participant", "", "heard", "started")
    measures = measured(
        tmp_path,
        [
            *heard(1, 1.0, 3.0, "What is this?"),
            *by_itself,
            *said(2, 5.0, 5.1, 6.0, "An arm."),
            echo,
            replace(echo, stamp_ns=at(10.0), state="failed"),
            *said(3, 10.4, 10.5, 11.0, "And a hand."),
        ],
    )
    assert [reply.delay_s for reply in measures.reactions] == [2.0]


def test_suggested_replies_are_counted_by_fate(tmp_path: Path) -> None:
    def reply(number: int, second: float, state: SuggestionState, **fields: Any) -> SuggestionChanged:
        return SuggestionChanged(at(second), f"s-{number}", state, "h-1", 1, number, "Hello.", "m", **fields)

    shown = [reply(number, 1.0, "displayed") for number in (1, 2, 3, 4)]
    ended = [reply(1, 2.0, "taken"), reply(2, 2.0, "superseded"), reply(3, 3.0, "edited", edit_distance=2)]
    session = open_session(tell(tmp_path / "s", [*shown, *ended], lasts_s=10.0))
    measures = measure(read_facts(session))
    names = ("shown", "said", "edited", "dismissed", "superseded", "expired")
    assert [measures[f"suggestions_{name}"] for name in names] == [4, 1, 1, 0, 1, 1]
    told = sheet_of([session]).paragraph
    assert "shown four suggested replies of a language model and used one unchanged and one after editing" in told


def test_talk_is_reported_by_speaker_and_by_origin(tmp_path: Path) -> None:
    waiting = UtteranceChanged(at(50.0), "never", "robot", "Never said", "typed", "requested")
    measures = measured(
        tmp_path,
        [
            *heard(1, 1.0, 3.0, "one two three"),
            *heard(2, 10.0, 10.5, "four"),
            *said(1, 4.0, 4.5, 6.0, "five six", origin="phrase"),
            *said(2, 7.0, 7.5, 8.0, "seven", origin="phrase"),
            UtteranceChanged(at(20.0), "cut", "robot", "eight nine ten", "suggestion", "started"),
            UtteranceChanged(at(20.5), "cut", "robot", "eight nine ten", "suggestion", "interrupted"),
            waiting,
        ],
    )
    assert measures.of("utterances") == {"participant": 2, "robot": 3}
    assert measures.of("words") == {"participant": 4, "robot": 6}
    assert measures.of("talk_s") == pytest.approx({"participant": 2.5, "robot": 2.5})
    assert measures.of("robot_utterances") == {"phrase": 2, "suggestion": 1}
    assert (measures["unsaid_utterances"], measures["interrupted_utterances"]) == (1, 1)


def test_each_model_is_listed_with_the_fate_of_its_answers(tmp_path: Path) -> None:
    other = {"model": "big", "model_version": "2026-01", "provider": "openai"}
    measures = measured(
        tmp_path,
        [
            exchange(1, 1.0, 2.0, "a"),
            exchange(2, 3.0, 5.0, "b"),
            exchange(3, 6.0, 7.0, "c"),
            exchange(4, 8.0, 9.0, "d"),
            exchange(5, 10.0, 11.0, "", outcome="cancelled"),
            exchange(6, 12.0, 12.5, "", outcome="failed", **other),
            AnswerUsed(at(2.5), "x-1", "edited", "a!"),
            AnswerUsed(at(2.6), "x-1", "said", "a"),
            AnswerUsed(at(5.5), "x-2", "edited", "b!"),
            AnswerUsed(at(7.5), "x-3", "dismissed", ""),
        ],
    )
    small, big = measures.models
    assert (small.asked, small.answered, small.cancelled, small.failed) == (5, 4, 1, 0)
    assert (small.said, small.edited, small.dismissed, small.unused) == (1, 1, 1, 1)
    assert small.accepted_fraction == 0.5
    assert small.first_token_s == pytest.approx((0.2,) * 4)
    assert small.answer_s == pytest.approx((1.0, 2.0, 1.0, 1.0))
    assert (big.provider, big.model, big.version, big.failed, big.accepted_fraction) == (
        "openai",
        "big",
        "2026-01",
        1,
        None,
    )


def test_suggestions_and_proposals_are_no_questions_of_the_wizard(tmp_path: Path) -> None:
    questions = [
        exchange(1, 1.0, 2.0, "a"),
        *said(1, 4.0, 4.1, 6.0, "a"),
        AnswerUsed(at(4.0), "x-1", "said", "a", "u-1"),
    ]
    plain = measured(tmp_path / "plain", questions)
    replies = exchange(2, 2.5, 3.0, "{}", purpose="replies", turn_id="u-9", revision=2)
    actions = exchange(3, 3.0, 3.5, "{}", purpose="actions", turn_id="u-9", revision=2)
    with_suggestions = measured(tmp_path / "more", [*questions[:1], replies, actions, *questions[1:]])
    assert with_suggestions.models == plain.models
    assert with_suggestions.reactions == plain.reactions
    assert [reply.delay_s for reply in plain.reactions] == [pytest.approx(2.0)]


def odometry(session_s: float, x_m: float, forward_mps: float) -> Odometry:
    return Odometry(at(session_s), None, Pose2D(x_m, 0.0, 0.0), Twist2D(forward_mps=forward_mps))


def test_an_unspoken_suggestion_was_not_used(tmp_path: Path) -> None:
    answer = "About three kilograms."
    values = [
        # By its id; other edited text does not count for it.
        exchange(1, 1.0, 2.0, answer),
        *silenced(1, 3.0, answer),
        AnswerUsed(at(3.0), "x-1", "said", answer, "u-1"),
        *said(2, 4.0, 4.1, 6.0, answer),
        # An older recording, without ids.
        exchange(3, 11.0, 12.0, "Yes."),
        AnswerUsed(at(13.0), "x-3", "said", "Yes."),
        *silenced(3, 13.0, "Yes."),
        # Interrupted at first, then spoken.
        exchange(4, 21.0, 22.0, "No."),
        *silenced(4, 23.0, "No."),
        AnswerUsed(at(23.0), "x-4", "said", "No.", "u-4"),
        *said(5, 25.0, 25.1, 26.0, "No!", origin="assistant"),
        AnswerUsed(at(25.0), "x-4", "edited", "No!", "u-5"),
        # Interrupted, but partly spoken.
        exchange(6, 31.0, 32.0, "This is a long story."),
        *silenced(6, 33.0, "This is a long story.", after_s=0.8),
        AnswerUsed(at(33.0), "x-6", "said", "This is a long story.", "u-6"),
        # The speech backend failed.
        exchange(7, 41.0, 42.0, "Hello."),
        UtteranceChanged(at(43.0), "u-7", "robot", "Hello.", "assistant", "requested"),
        AnswerUsed(at(43.0), "x-7", "said", "Hello.", "u-7"),
        UtteranceChanged(at(43.1), "u-7", "robot", "Hello.", "assistant", "failed", detail="no voice"),
    ]
    session = open_session(tell(tmp_path / "s", values, lasts_s=60.0))
    measures = measure(read_facts(session))
    (model,) = measures.models
    assert (model.answered, model.said, model.edited, model.dismissed, model.unused) == (5, 1, 1, 0, 3)
    assert model.accepted_fraction == pytest.approx(0.4)
    assert measures.of("robot_utterances") == {"typed": 1, "assistant": 2}
    assert (measures["unsaid_utterances"], measures["interrupted_utterances"]) == (4, 1)
    assert measures["robot_utterances"] == 3


def test_identities_are_not_people(tmp_path: Path) -> None:
    values = [
        # One person whom the tracker loses twice; a lost person counts as present for a moment.
        PersonAppeared(at(1.0), "p-1", 1, 1),
        PersonAppeared(at(20.0), "p-2", 2, 2),
        PersonLeft(at(21.4), "p-1", 1),
        PersonAppeared(at(40.0), "p-3", 3, 3),
        PersonLeft(at(41.4), "p-2", 2),
        # Leaving during a pause is not reported when the recording resumes.
        RecordingPaused(at(60.0), True),
        PersonAppeared(at(69.9), "p-4", 9, 4),
        RecordingPaused(at(70.0), False),
    ]
    facts = read_facts(open_session(tell(tmp_path / "s", values, lasts_s=100)))
    measures = measure(facts)
    assert (measures["people"], measures["identities"]) == (1, 4)
    assert [(visit.person_id, (visit.end_ns - visit.start_ns) / 1e9) for visit in facts.visits] == [
        ("p-1", pytest.approx(20.4)),
        ("p-2", pytest.approx(21.4)),
        ("p-3", pytest.approx(20.0)),
        ("p-4", pytest.approx(30.1)),
    ]


def test_driving(tmp_path: Path) -> None:
    goal = Pose2D(1.0, 2.0, 0.0)
    values = [
        *drive(1.0, 3.0, 0.4),
        *drive(10.0, 11.0, 0.0, turn_radps=0.5, source="gamepad"),
        odometry(0.0, 0.0, 0.0),
        odometry(1.0, 0.0, 0.1),
        odometry(2.0, 0.4, 0.45),
        odometry(3.0, 0.8, -0.6),
        odometry(3.1, 50.0, 0.0),  # its origin was reset
        odometry(4.0, 50.5, 0.0),
        RobotPose(at(1.0), None, Pose2D(7.0, 7.0, 0.0)),
        StopRequested(at(5.0)),
        DriveEnded(at(6.0), "The link to the robot was lost"),
        EmergencyStopChanged(at(0.0), False, "robot"),
        EmergencyStopChanged(at(12.0), True, "wizard"),
        EmergencyStopChanged(at(12.1), True, "robot"),
        EmergencyStopChanged(at(13.0), False, "wizard"),
        EmergencyStopChanged(at(14.0), True, "wizard"),
        GoalChanged(at(20.0), "g1", "requested", goal),
        GoalChanged(at(20.5), "g1", "active", goal),
        GoalChanged(at(30.0), "g1", "reached", goal),
        GoalChanged(at(40.0), "g2", "failed", goal),
        GoalChanged(at(95.0), "g3", "requested", goal),
        GuardChanged(at(0.0), "clear"),
        GuardChanged(at(50.0), "slowing", 0.5),
        GuardChanged(at(51.0), "blocked", 0.1),
        GuardChanged(at(54.0), "clear"),
        GuardChanged(at(60.0), "slowing", 0.5),
        GuardChanged(at(61.0), "overridden"),
    ]
    facts = read_facts(open_session(tell(tmp_path / "s", values, lasts_s=100)))
    measures = measure(facts)
    assert measures["distance_m"] == pytest.approx(1.3)
    assert measures["max_speed_mps"] == 0.6
    assert measures.of("driving_s") == pytest.approx({"keyboard": 2.0, "gamepad": 1.0})
    assert measures["driving_s"] == pytest.approx(3.0)
    assert [measures[name] for name in ("stops", "emergency_stops", "guard_interventions")] == [1, 2, 2]
    assert measures.of("drives_ended") == {"The link to the robot was lost": 1}
    assert measures.of("goals") == {"reached": 1, "failed": 1, "unfinished": 1}
    assert measures["navigating_s"] == pytest.approx(15.0)
    assert measures.of("guard_s") == pytest.approx({"clear": 56.0, "slowing": 2.0, "blocked": 3.0, "overridden": 39.0})
    assert [(drive.source, drive.duration_s) for drive in facts.drives] == [("keyboard", 2.0), ("gamepad", 1.0)]
    assert [stretch.label for stretch in measures.navigation] == ["reached", "unfinished"]


def test_the_way_from_one_robot_to_another_is_driven_by_neither(tmp_path: Path) -> None:
    values = [
        RobotChosen(at(-1.0), "first", "First", "ws://a:1"),
        odometry(1.0, 0.0, 0.0),
        odometry(2.0, 1.0, 0.0),
        RobotChosen(at(10.0), "second", "Second", "ws://b:1"),
        odometry(15.0, 21.0, 0.0),
        odometry(16.0, 21.5, 0.0),
    ]
    assert measured(tmp_path, values)["distance_m"] == pytest.approx(1.5)


def test_a_pause_is_no_part_of_any_measure(tmp_path: Path) -> None:
    goal = Pose2D(1.0, 2.0, 0.0)
    values = [
        odometry(1.0, 0.0, 0.0),
        odometry(2.0, 1.0, 0.0),
        odometry(19.0, 1.0, 0.0),
        # Carried back to its start for the next participant, in a pause.
        odometry(81.0, 9.0, 0.0),
        odometry(82.0, 9.5, 0.0),
        LinkChanged(at(0.0), "control", "connected", "ws"),
        LinkChanged(at(15.0), "control", "lost", "ws"),
        GuardChanged(at(0.0), "clear"),
        GuardChanged(at(18.0), "overridden"),
        GoalChanged(at(10.0), "g1", "requested", goal),
        RecordingPaused(at(20.0), True),
        GoalChanged(at(80.0), "g1", "reached", goal),
        LinkChanged(at(80.0), "control", "connected", "ws"),
        GuardChanged(at(80.0), "clear"),
        RecordingPaused(at(80.0), False),
    ]
    session = open_session(tell(tmp_path / "s", values, lasts_s=100.0))
    measures = measure(read_facts(session))
    assert (measures["recorded_s"], measures["paused_s"]) == (40.0, 60.0)
    assert measures["distance_m"] == pytest.approx(1.5)
    assert measures["navigating_s"] == pytest.approx(10.0)
    assert measures["link_trouble_s"] == pytest.approx(5.0)
    assert measures.of("guard_s") == pytest.approx({"clear": 38.0, "overridden": 2.0})
    document = session_tiers(session)
    shown = {
        tier.name: [(one.start_ms, one.end_ms) for one in document.of_tier(tier.tier_id)] for tier in document.tiers
    }
    assert (shown["Link trouble"], shown["Obstacle guard"]) == ([(15_000, 20_000)], [(18_000, 20_000)])


def test_goals_that_overlap_count_once(tmp_path: Path) -> None:
    goal = Pose2D(1.0, 2.0, 0.0)
    spans = [("g1", 0.0, 4.0), ("g2", 1.0, 2.0), ("g3", 3.0, 6.0)]
    values = [GoalChanged(at(1 + start), name, "active", goal) for name, start, _ in spans]
    values += [GoalChanged(at(1 + end), name, "reached", goal) for name, _, end in spans]
    assert measured(tmp_path, values)["navigating_s"] == 6.0


def test_marks_link_clock_and_losses(tmp_path: Path) -> None:
    values = [
        Marked(at(1), "Laughs", mark_id="a"),
        Marked(at(2), "Laughs", mark_id="b"),
        Marked(at(3), "slip", "wizard_error", "c"),
        Marked(at(4), "late", "wizard_error", "c"),  # renamed
        Marked(at(5), "", "note", "d", note="Remember"),
        LinkChanged(at(-2), "control", "connecting", "ws"),
        LinkChanged(at(-1), "control", "connected", "ws"),
        LinkChanged(at(0), "media", "lost", "ws"),
        LinkChanged(at(10), "control", "trouble", "ws"),
        LinkChanged(at(11), "control", "lost", "ws"),
        LinkChanged(at(12), "control", "connecting", "ws"),
        LinkChanged(at(14), "control", "connected", "ws"),
        LinkChanged(at(90), "control", "closed", "ws"),
        LinkQuality(at(1), 4.0),
        LinkQuality(at(2), 6.0, 2000.0, 1.5),
        LinkQuality(at(3), 8.0, 2003.0, 0.5),
        Gap(at(20), "frame", 5, "slow"),
        Gap(at(21), "frame", 2, "slow"),
        Gap(at(22), "scan", 1, "slow"),
        Problem(at(23), "warning", "W", "", ""),
        Problem(at(24), "info", "I", "", ""),
        PersonAppeared(at(30), "p-1", 1),
        PersonLeft(at(40), "p-1", 1),
        PersonAppeared(at(50), "p-1", 2),
        PersonAppeared(at(60), "p-2", 3),
        PersonLeft(at(61), "p-9", 9),
    ]
    facts = read_facts(open_session(tell(tmp_path / "s", values, lasts_s=100)))
    measures = measure(facts)
    assert (measures.of("marks"), measures.of("wizard_errors")) == ({"Laughs": 2}, {"late": 1})
    assert measures["wizard_errors_per_10_min"] == pytest.approx(6.0)
    assert measures["link_trouble_s"] == pytest.approx(4.0)
    assert [stretch.label for stretch in measures.link_trouble] == ["trouble", "lost", "connecting"]
    assert not any("robot's clock" in sentence for sentence in data_quality_problems(facts, measures))
    assert measures.of("lost_values") == {"frame": 7, "scan": 1}
    assert measures["problems"] == 2
    assert (measures["people"], measures["identities"]) == (2, 3)
    assert [(visit.person_id, (visit.end_ns - visit.start_ns) / 1e9) for visit in facts.visits] == [
        ("p-9", pytest.approx(61.0)),
        ("p-1", pytest.approx(10.0)),
        ("p-1", pytest.approx(50.0)),
        ("p-2", pytest.approx(40.0)),
    ]


def test_an_empty_session_has_measures_too(tmp_path: Path) -> None:
    facts = read_facts(open_session(tell(tmp_path / "s", [], lasts_s=0.0)))
    measures = measure(facts)
    values = {figure.name: measures.values[figure.name] for figure in MEASURES}
    assert any("robot's clock" in sentence for sentence in data_quality_problems(facts, measures))
    unknown = {name for name, value in values.items() if value is None}
    assert unknown == {
        "response_time_s", "content_response_time_s", "reaction_time_s", "llm_accepted_fraction", "distance_m",
        "max_speed_mps", "wizard_errors_per_10_min", "responses", "participant_talk_s", "participant_utterances",
        "gaps", "gap_s", "gap_lower_quartile_s", "gap_upper_quartile_s", "gaps_under_1_s_fraction", "overlaps",
        "protocol_steps", "steps_visited", "steps_skipped", "steps_late", "steps_late_s",
        "suggestion_latency_ms", "suggestion_edit_distance", "reply_used_fraction",
    }  # fmt: skip
    assert {value for value in values.values() if value is not None} == {0}
    assert len(values) == len(MEASURES)


def test_spread_of_one_value_has_no_deviation() -> None:
    assert SummaryStats.of([]) is None
    assert SummaryStats.of([2.0]) == SummaryStats(1, 2.0, None, 2.0, 2.0, 2.0)
    assert SummaryStats.of([1.0, 3.0]) == SummaryStats(2, 2.0, pytest.approx(2**0.5), 2.0, 1.0, 3.0)


def _one_number(facts: SessionData) -> tuple[float, float, float, float]:
    """Driving time by the measures, the report, and its two tiers."""
    tiers = session_tiers(facts.session)
    names = {tier.tier_id: tier.name for tier in tiers.tiers}

    def of(name: str) -> float:
        return sum(
            (one.end_ms - one.start_ms) / 1000
            for one in tiers.annotations
            if names[one.tier_id] == name and one.value != "standing"
        )

    reported = sum(drive.duration_s for drive in facts.drives)
    return measure(facts)["driving_s"], reported, of("Driving source"), of("Motion")


@pytest.mark.parametrize(
    ("speed_mps", "turn_radps", "every_s"), [(0.3, 0.0, 0.1), (0.015, 0.03, 0.1), (0.3, 0.6, 0.44)]
)
def test_driving_time_is_one_number_everywhere_however_slow_or_seldom(
    tmp_path: Path, speed_mps: float, turn_radps: float, every_s: float
) -> None:
    moments = [2.0 + number * every_s for number in range(20)]
    events: list[Any] = [
        CommandSent(at(moment), number, Twist2D(speed_mps, 0.0, turn_radps), "keyboard")
        for number, moment in enumerate(moments)
    ]
    events += [CommandSent(at(moments[-1] + 0.2), 99, Twist2D(), "stop")]
    events += [CommandSent(at(29.9), 100, Twist2D(speed_mps, 0.0, turn_radps), "keyboard")]
    tell(tmp_path / "s", events, lasts_s=30)
    expected_s = 19 * min(every_s, 0.5) + 0.2 + 0.1  # the last one lasts until the end
    assert _one_number(read_facts(open_session(tmp_path / "s"))) == pytest.approx((expected_s,) * 4, abs=0.05)


def test_without_odometry_the_distance_is_not_known_and_without_places_it_is_the_integrated_speed(
    tmp_path: Path,
) -> None:
    # Poses of a localisation with corrections of some centimetres.
    poses = [RobotPose(at(moment / 10), None, Pose2D(0.1 * (moment % 2), 0.0, 0.0)) for moment in range(200)]
    tell(tmp_path / "s", poses, lasts_s=30)
    facts = read_facts(open_session(tmp_path / "s"))
    assert measure(facts).values["distance_m"] is None
    assert any("the distance is unknown" in sentence for sentence in data_quality_problems(facts, measure(facts)))
    driven = [Odometry(at(1 + n / 10), None, Pose2D(0.0, 0.0, 0.0), Twist2D(0.2, 0.0, 0.0)) for n in range(51)]
    tell(tmp_path / "t", driven, lasts_s=30)
    assert measure(read_facts(open_session(tmp_path / "t")))["distance_m"] == pytest.approx(1.0, abs=0.01)
