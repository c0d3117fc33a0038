"""Definitions of the measures: names, units, meanings and thresholds; their SQL is in resources/queries."""

import re

from caris_desktop.domain.events import LATE_FROM_S, RESPONSE_LIMIT_S
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_conversation import AT_ONCE_S, HEARD_FROM_NS, PRESENT_SHARE
from caris_desktop.recording.session.session_robot import COMMAND_HOLDS_S
from caris_desktop.recording.tables.catalog import unit_of


class Measure(Value):
    """Measure of a session: a column of ``measures`` in the SQL, NULL if it was not recorded.

    ``formula`` in words, where the description does not say it; ``reference``: where the field defines it, or the
    package of the plug-in that computes it. ``empty``: meaning of NULL, if it can be. ``values``: all that are allowed.
    """

    name: str
    description: str
    formula: str = ""
    reference: str = ""
    empty: str = ""
    values: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        return unit_of(self.name)


class Threshold(Value):
    """Variable of the SQL, or of what the tables are made with."""

    name: str
    value: float
    description: str

    @property
    def unit(self) -> str:
        return unit_of(self.name)


def thresholds_in(*texts: str) -> tuple[Threshold, ...]:
    """Thresholds that these texts name."""
    words = {word for text in texts for word in re.findall(r"\w+", text)}
    return tuple(threshold for threshold in THRESHOLDS if threshold.name in words)


THRESHOLDS = (
    Threshold("response_limit_s", RESPONSE_LIMIT_S, "Speech of the robot later than this is no response."),
    Threshold("short_gap_s", AT_ONCE_S, "Gaps shorter than this are counted: longer ones are noticed."),
    Threshold("command_holds_s", COMMAND_HOLDS_S, "Longest time that a velocity command counts as driving."),
    Threshold("plausible_speed_mps", 5.0, "A faster step of the odometry is a jump of its origin."),
    Threshold("velocity_holds_s", 1.0, "Longest time that a velocity of the odometry is taken to last."),
    Threshold("late_from_s", LATE_FROM_S, "Least overrun of a late step."),
    Threshold("together_s", 2.0, "Least time together of people present at once: who is lost is briefly there twice."),
    Threshold("heard_from_s", HEARD_FROM_NS / 1e9, "Least length of audible speech that was cut short: a syllable."),
    Threshold("present_share_fraction", PRESENT_SHARE, "Share of an utterance in which its speaker was alone there."),
)
"""The thresholds of measures and tables. Those of drives, utterances and responses apply when the tables are made."""

MEASURES = (
    Measure("recorded_s", "Recorded time, excluding pauses.", "Duration of the session minus paused_s."),
    Measure("paused_s", "Time during which the recording was paused."),
    Measure("pauses", "Number of times that the recording was paused."),
    Measure(
        "responses",
        "Number of robot answers to a participant; empty if no participant was transcribed.",
        "Number of utterances of the robot that directly follow one of a participant and start after its end.",
    ),
    Measure(
        "response_time_s",
        "Median time from the end of a participant's utterance to the robot's answer.",
        (
            "Median over the responses of: start of the robot's utterance minus end of the participant's "
            "utterance before it, if 0 or more and at most response_limit_s, with no pause of the recording "
            "between."
        ),
        "Shiwa et al. (2009), How quickly should a communication robot respond? Int J Soc Robot 1",
        "There was no response.",
    ),
    Measure(
        "content_response_time_s",
        "The same, to the first answer that is not a filler.",
        "As response_time_s, with the same response_limit_s, over the robot's utterances without fillers.",
        "Shiwa et al. (2009)",
        "There was no response.",
    ),
    Measure(
        "reaction_time_s",
        "Median time from the end of a participant's utterance, or a language model's answer, to the wizard's request.",
        (
            "Median of: speech request of the wizard, not of the console, minus the latest end of an audible "
            "utterance of a participant or arrival of an answer before it, at most response_limit_s."
        ),
        "Riek (2012), Wizard of Oz studies in HRI, J Hum-Robot Interact 1(1)",
        "The wizard requested no speech within the limit.",
    ),
    Measure(
        "gaps",
        "Number of answered turns of participants; empty if no participant was transcribed.",
        "Unlike responses, it includes overlaps and answers after which the participant had spoken on.",
    ),
    Measure(
        "gap_s",
        "Median time from the end of a participant's voice to the first sound; negative for overlaps.",
        "Median over the answered turns of: first sound of the robot minus end of the participant's turn.",
        "Heldner & Edlund (2010), Pauses, gaps and overlaps in conversations, J Phonetics 38(4)",
        "No participant was answered.",
    ),
    Measure(
        "gap_lower_quartile_s",
        "Lower quartile of these gaps: a quarter of them are shorter.",
        "First quartile, interpolated linearly.",
        "Heldner & Edlund (2010)",
        "No participant was answered.",
    ),
    Measure(
        "gap_upper_quartile_s",
        "Upper quartile of these gaps: a quarter of them are longer.",
        "Third quartile, interpolated linearly.",
        "Heldner & Edlund (2010)",
        "No participant was answered.",
    ),
    Measure(
        "gaps_under_1_s_fraction",
        "Fraction of these gaps that are shorter than a second, including overlaps.",
        "Gaps shorter than short_gap_s, divided by all gaps.",
        "Heldner & Edlund (2010)",
        "No participant was answered.",
    ),
    Measure(
        "overlaps",
        "Number of times the robot started before the participant had finished; empty if no participant was answered.",
        "Number of gaps below 0.",
        "Heldner & Edlund (2010)",
    ),
    Measure(
        "participant_talk_s",
        "Speaking time of participants; empty if no participant was transcribed.",
        "Sum of the durations of the audible utterances.",
    ),
    Measure("robot_talk_s", "Speaking time of the robot.", "Sum of the durations of the audible utterances."),
    Measure(
        "participant_utterances",
        "Number of participant utterances; empty if no participant was transcribed.",
    ),
    Measure("robot_utterances", "Number of audible utterances of the robot, from any source."),
    Measure("typed_utterances", "Robot utterances that the wizard typed."),
    Measure("phrase_utterances", "Robot utterances from the scenario's phrases."),
    Measure("filler_utterances", "Robot utterances from fillers."),
    Measure("assistant_utterances", "Robot utterances from the language model."),
    Measure("suggestion_utterances", "Robot utterances from suggested replies."),
    Measure("dictated_utterances", "Robot utterances that the wizard dictated."),
    Measure("own_voice_utterances", "Number of times the wizard spoke through the robot."),
    Measure("unsaid_utterances", "Robot utterances that were requested but never audible."),
    Measure("interrupted_utterances", "Robot utterances that were interrupted."),
    Measure("llm_exchanges", "Questions to a language model."),
    Measure(
        "llm_accepted_fraction",
        "Fraction of its answers that were said, edited or not.",
        "Answers that were audible, unchanged or edited, divided by all answers.",
        empty="No question was answered.",
    ),
    Measure("suggestions_shown", "Suggested replies that were shown to the wizard."),
    Measure("suggestions_said", "Suggested replies that were said unchanged."),
    Measure("suggestions_edited", "Suggested replies that were said after a change."),
    Measure("suggestions_dismissed", "Suggested replies that the wizard dismissed."),
    Measure("suggestions_superseded", "Suggested replies that others replaced."),
    Measure("suggestions_expired", "Suggested replies that were not used in time."),
    Measure(
        "suggestion_latency_ms",
        "Median time from the end of a participant's voice until a suggested reply was shown.",
        "Median of latency_ms over the shown replies.",
        empty="No reply was shown, or its latency was not recorded.",
    ),
    Measure(
        "suggestion_edit_distance",
        "Mean number of characters that the wizard changed in the replies that were edited and said.",
        "Mean of edit_distance over the replies with the fate edited.",
        empty="No reply was edited.",
    ),
    Measure("reply_exchanges", "Number of times that a language model was asked for suggested replies."),
    Measure(
        "reply_used_fraction",
        "Fraction of the exchanges with shown replies of which one was said, edited or not.",
        "Exchanges for replies with the use said or edited, divided by those of which a reply was shown.",
        empty="No reply was shown.",
    ),
    Measure(
        "distance_m",
        "Distance that the robot drove, from its odometry; empty if it reported none.",
        (
            "Sum of the steps between positions, without those faster than plausible_speed_mps, across a pause, or "
            "from one robot to another; without positions, sum of speed times time, each speed for at most "
            "velocity_holds_s."
        ),
    ),
    Measure(
        "driving_s",
        "Time during which the wizard drove.",
        (
            "Sum of the durations of the commands other than zero, each until the next command, the end of "
            "the recording or a pause, at most command_holds_s."
        ),
    ),
    Measure(
        "navigating_s",
        "Time during which the robot drove to a goal.",
        "Time from the request of a goal to its end, without pauses; overlapping goals count once.",
    ),
    Measure("max_speed_mps", "Highest speed, from the robot's odometry.", empty="There was no odometry."),
    Measure("stops", "Number of times the wizard pressed Stop."),
    Measure("emergency_stops", "Number of times the emergency stop was activated."),
    Measure("goals", "Number of navigation goals that were set."),
    Measure("goals_reached", "Navigation goals that were reached."),
    Measure("guard_interventions", "Number of times the obstacle guard slowed or stopped the robot."),
    Measure(
        "protocol_steps",
        "Number of steps in the protocol; empty if there was no protocol.",
    ),
    Measure("steps_visited", "Number of these steps that were started.", empty="There was no protocol."),
    Measure("steps_skipped", "Number of these steps that were skipped.", empty="There was no protocol."),
    Measure(
        "steps_late",
        "Number of these steps that took at least one second longer than expected.",
        "Number of steps with late_s of late_from_s or more.",
        empty="There was no protocol.",
    ),
    Measure(
        "steps_late_s", "Total time by which these steps took longer than expected.", empty="There was no protocol."
    ),
    Measure("marks", "Marks set by the wizard."),
    Measure(
        "wizard_errors",
        "Errors that the wizard marked.",
        "Number of marks of the kind wizard error that were not withdrawn.",
        "Riek (2012)",
    ),
    Measure(
        "wizard_errors_per_10_min",
        "The same per ten minutes.",
        "600 times wizard_errors, divided by recorded_s.",
        "Riek (2012)",
        "Nothing was recorded.",
    ),
    Measure(
        "link_trouble_s",
        "Time during which the robot could not be reached.",
        "Time in the states trouble, lost or connecting after the first connection, without pauses.",
    ),
    Measure("lost_values", "Values that were not recorded."),
    Measure(
        "missing_values",
        "Values that were recorded according to the counts in session.json but can no longer be read.",
    ),
    Measure("problems", "Problems reported to the wizard."),
    Measure(
        "alarms",
        "Alarms: problems that needed attention, including those that were active when the recording started.",
    ),
    Measure("alarms_s", "Total time that these alarms were active."),
    Measure(
        "alarms_seen_to",
        "Number of these alarms that were dismissed; the others ended automatically or remained active.",
    ),
    Measure(
        "people",
        "Highest number of people present at once for 2 s or longer, as counted on the screen.",
        "Largest number of visits that overlap for together_s or longer.",
    ),
    Measure(
        "identities",
        "Number of identities that detector and tracker distinguished; one person may get several.",
    ),
)

TABLES: dict[str, tuple[str, ...]] = {
    "session": ("key", "value"),
    "utterances": (
        "actor",
        "utterance_id", "speaker", "origin", "said", "state", "requested_ns", "start_ns", "end_ns", "text", "stamp_ns",
    ),
    "responses": ("means", "first", "gap_s"),
    "suggestions": ("fate", "latency_ms", "edit_distance"),
    "annotations": ("coder", "tier", "value", "duration_s"),
    "marks": ("stamp_ns", "label", "kind", "duration_s"),
    "odometry": ("stamp_ns", "pose_in_odom_x_m", "pose_in_odom_y_m", "twist_forward_mps", "twist_left_mps"),
    "event_recording_paused": ("stamp_ns", "paused"),
    "event_robot_chosen": ("stamp_ns",),
    "event_llm_exchange": (
        "stamp_ns", "exchange_id", "outcome", "purpose", "provider", "model", "model_version", "server", "seed",
        "parameters",
    ),
    "answers": (
        "stamp_ns", "exchange_id", "provider", "model", "model_version", "outcome", "use", "asked_ns", "first_token_ns",
        "purpose", "shown", "latency_ms", "edit_distance",
    ),
    "drives": ("stamp_ns", "source", "duration_s"),
    "event_drive_ended": ("stamp_ns", "reason"),
    "event_link_changed": ("stamp_ns", "link", "state"),
    "event_stop_requested": ("stamp_ns",),
    "event_emergency_stop_changed": ("stamp_ns", "latched"),
    "goals": ("stamp_ns", "goal_id", "state", "end_ns"),
    "alarms": ("alarm_id", "cause", "what", "stood_s", "times", "seen_to_by"),
    "protocol": (
        "scenario_file", "step_id", "title", "step_number", "visits", "expected_s", "time_s", "late_s", "skipped",
    ),
    "event_guard_changed": ("stamp_ns", "state"),
    "event_gap": ("stamp_ns", "stream", "count"),
    "event_problem": ("stamp_ns",),
    "visits": ("stamp_ns", "end_ns", "person_id"),
}  # fmt: skip
"""Tables and columns that the SQL reads."""
