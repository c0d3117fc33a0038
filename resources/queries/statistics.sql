-- The figures of each session, of each condition and of the whole study, in SQL of DuckDB.
-- Run in the folder of the statistics:  duckdb -init queries.sql

-- The sessions, with what heads them.
CREATE TABLE sessions AS
SELECT
    session,
    any_value(participant) AS participant,
    any_value(condition) AS condition,
    any_value(trial) AS trial,
    coalesce(max(value) FILTER (key = 'trial.wizard'), '') AS wizard,
    coalesce(max(value) FILTER (key = 'trial.purpose'), '') AS purpose,
    coalesce(max(value) FILTER (key = 'scenario.title'), '') AS scenario,
    CAST(coalesce(sum(TRY_CAST(value AS BIGINT)) FILTER (starts_with(key, 'lost.')), 0) AS BIGINT) AS missing_values,
    CAST(max(value) FILTER (key = 'started_ns') AS BIGINT) AS started_ns,
    CAST(max(value) FILTER (key = 'recorded_s') AS DOUBLE) AS lasts_s,
    CAST(max(value) FILTER (key = 'started_ns') AS BIGINT)
        + CAST(round(CAST(max(value) FILTER (key = 'recorded_s') AS DOUBLE) * 1e9) AS BIGINT) AS ended_ns
FROM session
GROUP BY session;

-- When the recording was paused.
CREATE TABLE pauses AS
WITH changes AS (
    SELECT session, stamp_ns, paused
    FROM event_recording_paused
    QUALIFY paused IS DISTINCT FROM coalesce(lag(paused) OVER (PARTITION BY session ORDER BY stamp_ns), false)
),
stretches AS (
    SELECT session, paused, stamp_ns AS start_ns, lead(stamp_ns) OVER (PARTITION BY session ORDER BY stamp_ns) AS next_ns
    FROM changes
)
SELECT session, start_ns, coalesce(next_ns, ended_ns) AS end_ns
FROM stretches JOIN sessions USING (session)
WHERE paused AND coalesce(next_ns, ended_ns) > start_ns;

-- A pause ends what lasts: what is still so after it is recorded again.
CREATE MACRO next_pause_ns(in_session, at_ns) AS (
    SELECT min(start_ns) FROM pauses WHERE session = in_session AND start_ns >= at_ns
);

-- Response times: the robot speaks right after a participant, soon enough, with no pause in between.
CREATE VIEW turns AS
SELECT
    session, speaker, end_ns, true AS with_fillers,
    lead(speaker) OVER following AS next_speaker,
    lead(start_ns) OVER following AS next_start_ns,
    lead(utterance_id) OVER following AS reply_id
FROM utterances
WHERE said AND speaker IN ('participant', 'robot')
WINDOW following AS (PARTITION BY session ORDER BY start_ns, speaker = 'robot')
UNION ALL
-- The same to the first answer that is no filler.
SELECT
    session, speaker, end_ns, false,
    lead(speaker) OVER following,
    lead(start_ns) OVER following,
    lead(utterance_id) OVER following
FROM utterances
WHERE said AND speaker IN ('participant', 'robot') AND origin != 'filler'
WINDOW following AS (PARTITION BY session ORDER BY start_ns, speaker = 'robot');

CREATE TABLE all_responses AS
SELECT session, with_fillers, next_start_ns AS at_ns, reply_id, (next_start_ns - end_ns) / 1e9 AS delay_s
FROM turns
WHERE speaker = 'participant' AND next_speaker = 'robot'
    AND next_start_ns - end_ns BETWEEN 0 AND getvariable('response_limit_s') * 1e9
    AND NOT EXISTS (
        FROM pauses
        WHERE pauses.session = turns.session AND start_ns < turns.next_start_ns AND pauses.end_ns > turns.end_ns
    );

CREATE VIEW response_times AS SELECT * EXCLUDE (with_fillers) FROM all_responses WHERE with_fillers;

CREATE VIEW content_responses AS SELECT * EXCLUDE (with_fillers) FROM all_responses WHERE NOT with_fillers;

-- Reaction times of the wizard: from the end of a participant's utterance, or a language model's answer, to the request.
CREATE VIEW moments AS
WITH happened AS (
    SELECT session, end_ns AS at_ns, 0 AS request, NULL AS utterance_id
    FROM utterances WHERE speaker = 'participant' AND said AND end_ns IS NOT NULL
    UNION ALL
    SELECT session, stamp_ns, 0, NULL FROM event_llm_exchange
    WHERE outcome = 'answered' AND coalesce(purpose, 'question') = 'question'
    UNION ALL
    SELECT session, requested_ns, 1, utterance_id FROM utterances
    WHERE speaker = 'robot' AND requested_ns IS NOT NULL AND actor NOT IN ('console', 'model', 'script')
)
SELECT
    session, at_ns, request,
    lead(at_ns) OVER following AS next_ns,
    lead(request) OVER following AS next_request,
    lead(utterance_id) OVER following AS reply_id
FROM happened
WINDOW following AS (PARTITION BY session ORDER BY at_ns, request);

CREATE TABLE reactions AS
SELECT session, next_ns AS at_ns, reply_id, (next_ns - at_ns) / 1e9 AS delay_s
FROM moments
WHERE request = 0 AND next_request = 1 AND next_ns - at_ns <= getvariable('response_limit_s') * 1e9
    AND NOT EXISTS (
        FROM pauses
        WHERE pauses.session = moments.session AND start_ns < moments.next_ns AND end_ns > moments.at_ns
    );

-- The way by odometry, without jumps; from the velocities where it reports no place. No step leads across a pause, or to
-- another robot.
CREATE VIEW odometry_steps AS
SELECT
    session,
    pose_in_odom_x_m AS x_m,
    pose_in_odom_y_m AS y_m,
    sqrt(pow(pose_in_odom_x_m - lag(pose_in_odom_x_m) OVER before, 2)
        + pow(pose_in_odom_y_m - lag(pose_in_odom_y_m) OVER before, 2)) AS step_m,
    CASE WHEN coalesce(break_ns, 0) <= lag(stamp_ns) OVER before THEN (stamp_ns - lag(stamp_ns) OVER before) / 1e9 END
        AS step_s,
    sqrt(pow(twist_forward_mps, 2) + pow(twist_left_mps, 2)) AS speed_mps,
    lag(sqrt(pow(twist_forward_mps, 2) + pow(twist_left_mps, 2))) OVER before AS speed_before_mps
FROM odometry
ASOF LEFT JOIN (
    SELECT session, start_ns AS stamp_ns, start_ns AS break_ns FROM pauses
    UNION ALL
    SELECT session, stamp_ns, stamp_ns FROM event_robot_chosen
) USING (session, stamp_ns)
WINDOW before AS (PARTITION BY session ORDER BY stamp_ns);

CREATE VIEW ways AS
SELECT
    session,
    CASE
        WHEN min(x_m) = max(x_m) AND min(y_m) = max(y_m)
            THEN coalesce(sum(speed_before_mps * least(step_s, getvariable('velocity_holds_s'))), 0)
        ELSE coalesce(sum(step_m) FILTER (step_m <= getvariable('plausible_speed_mps') * step_s), 0)
    END AS distance_m,
    max(speed_mps) AS max_speed_mps
FROM odometry_steps GROUP BY session;

-- Autonomous driving: each moment once, even if goals overlap.
CREATE VIEW goal_spans AS
SELECT
    session, stamp_ns AS start_ns, coalesce(end_ns, greatest(ended_ns, stamp_ns)) AS end_ns,
    CASE WHEN end_ns IS NULL THEN 'unfinished' ELSE state END AS outcome
FROM (SELECT session, stamp_ns, end_ns, state FROM goals) JOIN sessions USING (session);

CREATE VIEW navigated AS
WITH ahead AS (
    SELECT session, end_ns, greatest(start_ns, coalesce(max(end_ns) OVER (
        PARTITION BY session ORDER BY start_ns ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING
    ), start_ns)) AS begin_ns
    FROM goal_spans
)
SELECT session, sum(greatest(0, end_ns - begin_ns - (
    SELECT coalesce(sum(greatest(0, least(pauses.end_ns, ahead.end_ns) - greatest(start_ns, begin_ns))), 0)
    FROM pauses WHERE pauses.session = ahead.session
))) / 1e9 AS seconds
FROM ahead
GROUP BY session;

-- The link to the robot, from its first connection on.
CREATE VIEW link_states AS
SELECT
    session, state, stamp_ns AS start_ns,
    least(
        coalesce(lead(stamp_ns) OVER (PARTITION BY session ORDER BY stamp_ns), greatest(ended_ns, stamp_ns)),
        next_pause_ns(session, stamp_ns)
    ) AS end_ns
FROM event_link_changed JOIN sessions USING (session)
WHERE link = 'control' AND stamp_ns >= (
    SELECT min(stamp_ns) FROM event_link_changed first
    WHERE first.session = event_link_changed.session AND first.link = 'control' AND first.state = 'connected'
);

CREATE VIEW link_trouble AS FROM link_states WHERE state IN ('trouble', 'lost', 'connecting');

CREATE VIEW guard_states AS
SELECT
    session, state, stamp_ns,
    (least(
        coalesce(lead(stamp_ns) OVER (PARTITION BY session ORDER BY stamp_ns), greatest(ended_ns, stamp_ns)),
        next_pause_ns(session, stamp_ns)
    ) - stamp_ns) / 1e9 AS lasted_s
FROM event_guard_changed JOIN sessions USING (session);

-- The most people who were there together for a while: somebody whom the tracker loses stands there twice for a moment.
CREATE VIEW crowds AS
SELECT one.session, count(*) AS n
FROM visits one JOIN visits other ON other.session = one.session
    AND other.stamp_ns <= one.stamp_ns AND other.end_ns >= one.stamp_ns + getvariable('together_s') * 1e9
GROUP BY one.session, one.stamp_ns, one.person_id;

-- One row for each session.
CREATE TABLE measures AS
WITH
paused AS (SELECT session, count(*) AS n, sum(end_ns - start_ns) / 1e9 AS seconds FROM pauses GROUP BY session),
response AS (SELECT session, count(*) AS n, median(delay_s) AS middle_s FROM response_times GROUP BY session),
content AS (SELECT session, median(delay_s) AS middle_s FROM content_responses GROUP BY session),
reaction AS (SELECT session, median(delay_s) AS middle_s FROM reactions GROUP BY session),
gap AS (
    SELECT
        session,
        count(*) AS n,
        median(gap_s) AS middle_s,
        quantile_cont(gap_s, 0.25) AS lower_s,
        quantile_cont(gap_s, 0.75) AS upper_s,
        count(*) FILTER (gap_s < getvariable('short_gap_s')) / count(*) AS at_once,
        count(*) FILTER (gap_s < 0.0) AS overlaps
    FROM responses WHERE first GROUP BY session
),
talk AS (
    SELECT
        session,
        sum(end_ns - start_ns) FILTER (speaker = 'participant') / 1e9 AS participant_s,
        sum(end_ns - start_ns) FILTER (speaker = 'robot') / 1e9 AS robot_s,
        count(*) FILTER (speaker = 'participant') AS participant_n,
        count(*) FILTER (speaker = 'robot') AS robot_n,
        count(*) FILTER (speaker = 'robot' AND origin = 'typed') AS typed,
        count(*) FILTER (speaker = 'robot' AND origin = 'phrase') AS phrase,
        count(*) FILTER (speaker = 'robot' AND origin = 'filler') AS filler,
        count(*) FILTER (speaker = 'robot' AND origin = 'assistant') AS assistant,
        count(*) FILTER (speaker = 'robot' AND origin = 'suggestion') AS suggestion,
        count(*) FILTER (speaker = 'robot' AND origin = 'dictated') AS dictated,
        count(*) FILTER (speaker = 'robot' AND origin = 'own_voice') AS own_voice
    FROM utterances WHERE said GROUP BY session
),
llm AS (
    SELECT
        session, count(*) AS n,
        count(*) FILTER (use IN ('said', 'edited')) / nullif(count(*) FILTER (outcome = 'answered'), 0) AS accepted
    FROM answers WHERE purpose = 'question' GROUP BY session
),
reply AS (
    SELECT
        session, count(*) AS n,
        count(*) FILTER (use IN ('said', 'edited')) / nullif(count(*) FILTER (shown > 0), 0) AS used
    FROM answers WHERE purpose = 'replies' GROUP BY session
),
silent AS (
    SELECT
        session,
        count(*) FILTER (NOT said) AS unsaid,
        count(*) FILTER (said AND state = 'interrupted') AS interrupted
    FROM utterances WHERE speaker = 'robot' GROUP BY session
),
suggested AS (
    SELECT
        session, count(*) AS n,
        count(*) FILTER (fate = 'taken') AS said,
        count(*) FILTER (fate = 'edited') AS edited,
        count(*) FILTER (fate = 'dismissed') AS dismissed,
        count(*) FILTER (fate = 'superseded') AS superseded,
        count(*) FILTER (fate = 'expired') AS expired,
        median(latency_ms) AS latency_ms,
        avg(edit_distance) FILTER (fate = 'edited') AS edit_distance
    FROM suggestions GROUP BY session
),
driven AS (SELECT session, sum(duration_s) AS seconds FROM drives GROUP BY session),
stopped AS (SELECT session, count(*) AS n FROM event_stop_requested GROUP BY session),
emergency AS (
    SELECT session, count(*) AS n
    FROM (
        SELECT session FROM event_emergency_stop_changed
        QUALIFY latched AND NOT coalesce(lag(latched) OVER (PARTITION BY session ORDER BY stamp_ns), false)
    )
    GROUP BY session
),
goal AS (
    SELECT session, count(*) AS n, count(*) FILTER (outcome = 'reached') AS reached FROM goal_spans GROUP BY session
),
guard AS (
    SELECT session, count(*) AS n
    FROM (
        SELECT session FROM event_guard_changed
        QUALIFY state IN ('slowing', 'blocked')
            AND NOT coalesce(
                lag(state) OVER (PARTITION BY session ORDER BY stamp_ns) IN ('slowing', 'blocked'), false
            )
    )
    GROUP BY session
),
step AS (
    SELECT
        session,
        count(*) AS planned,
        count(*) FILTER (visits > 0) AS visited,
        count(*) FILTER (skipped > 0) AS skipped,
        count(*) FILTER (late_s >= getvariable('late_from_s')) AS late,
        sum(late_s) AS late_s
    FROM protocol GROUP BY session
),
marked AS (
    SELECT
        session,
        count(*) FILTER (kind = 'mark') AS marks,
        count(*) FILTER (kind = 'wizard_error') AS errors
    FROM marks GROUP BY session
),
link AS (
    SELECT session, sum(end_ns - start_ns) / 1e9 AS seconds FROM link_trouble GROUP BY session
),
lost AS (SELECT session, sum(count) AS n FROM event_gap GROUP BY session),
problem AS (SELECT session, count(*) AS n FROM event_problem GROUP BY session),
alarm AS (
    SELECT session, count(*) AS n, sum(stood_s) AS seconds, count(*) FILTER (seen_to_by != '') AS seen_to
    FROM alarms GROUP BY session
),
person AS (SELECT session, count(DISTINCT person_id) AS n FROM visits GROUP BY session),
crowd AS (SELECT session, max(n) AS n FROM crowds GROUP BY session)
SELECT
    session, participant, condition, trial, wizard, purpose, scenario,
    greatest(0, lasts_s - coalesce(paused.seconds, 0)) AS recorded_s,
    coalesce(paused.seconds, 0) AS paused_s,
    coalesce(paused.n, 0) AS pauses,
    -- Nothing, rather than none, where nobody was transcribed.
    CASE WHEN talk.participant_n > 0 THEN coalesce(response.n, 0) END AS responses,
    response.middle_s AS response_time_s,
    content.middle_s AS content_response_time_s,
    reaction.middle_s AS reaction_time_s,
    CASE WHEN talk.participant_n > 0 THEN coalesce(gap.n, 0) END AS gaps,
    gap.middle_s AS gap_s,
    gap.lower_s AS gap_lower_quartile_s,
    gap.upper_s AS gap_upper_quartile_s,
    gap.at_once AS gaps_under_1_s_fraction,
    gap.overlaps AS overlaps,
    CASE WHEN talk.participant_n > 0 THEN coalesce(talk.participant_s, 0) END AS participant_talk_s,
    coalesce(talk.robot_s, 0) AS robot_talk_s,
    nullif(talk.participant_n, 0) AS participant_utterances,
    coalesce(talk.robot_n, 0) AS robot_utterances,
    coalesce(talk.typed, 0) AS typed_utterances,
    coalesce(talk.phrase, 0) AS phrase_utterances,
    coalesce(talk.filler, 0) AS filler_utterances,
    coalesce(talk.assistant, 0) AS assistant_utterances,
    coalesce(talk.suggestion, 0) AS suggestion_utterances,
    coalesce(talk.dictated, 0) AS dictated_utterances,
    coalesce(talk.own_voice, 0) AS own_voice_utterances,
    coalesce(silent.unsaid, 0) AS unsaid_utterances,
    coalesce(silent.interrupted, 0) AS interrupted_utterances,
    coalesce(llm.n, 0) AS llm_exchanges,
    llm.accepted AS llm_accepted_fraction,
    coalesce(suggested.n, 0) AS suggestions_shown,
    coalesce(suggested.said, 0) AS suggestions_said,
    coalesce(suggested.edited, 0) AS suggestions_edited,
    coalesce(suggested.dismissed, 0) AS suggestions_dismissed,
    coalesce(suggested.superseded, 0) AS suggestions_superseded,
    coalesce(suggested.expired, 0) AS suggestions_expired,
    suggested.latency_ms AS suggestion_latency_ms,
    suggested.edit_distance AS suggestion_edit_distance,
    coalesce(reply.n, 0) AS reply_exchanges,
    reply.used AS reply_used_fraction,
    ways.distance_m AS distance_m,
    coalesce(driven.seconds, 0) AS driving_s,
    coalesce(navigated.seconds, 0) AS navigating_s,
    ways.max_speed_mps AS max_speed_mps,
    coalesce(stopped.n, 0) AS stops,
    coalesce(emergency.n, 0) AS emergency_stops,
    coalesce(goal.n, 0) AS goals,
    coalesce(goal.reached, 0) AS goals_reached,
    coalesce(guard.n, 0) AS guard_interventions,
    -- Nothing, rather than none, where there was no protocol.
    step.planned AS protocol_steps,
    step.visited AS steps_visited,
    step.skipped AS steps_skipped,
    step.late AS steps_late,
    step.late_s AS steps_late_s,
    coalesce(marked.marks, 0) AS marks,
    coalesce(marked.errors, 0) AS wizard_errors,
    coalesce(marked.errors, 0) * 600.0 / nullif(greatest(0, lasts_s - coalesce(paused.seconds, 0)), 0)
        AS wizard_errors_per_10_min,
    coalesce(link.seconds, 0) AS link_trouble_s,
    coalesce(lost.n, 0) AS lost_values,
    missing_values,
    coalesce(problem.n, 0) AS problems,
    coalesce(alarm.n, 0) AS alarms,
    coalesce(alarm.seconds, 0) AS alarms_s,
    coalesce(alarm.seen_to, 0) AS alarms_seen_to,
    -- Nobody stayed for so long, but somebody was there.
    coalesce(crowd.n, CASE WHEN person.n > 0 THEN 1 END, 0) AS people,
    coalesce(person.n, 0) AS identities
FROM sessions
LEFT JOIN paused USING (session)
LEFT JOIN response USING (session)
LEFT JOIN content USING (session)
LEFT JOIN reaction USING (session)
LEFT JOIN gap USING (session)
LEFT JOIN talk USING (session)
LEFT JOIN silent USING (session)
LEFT JOIN llm USING (session)
LEFT JOIN suggested USING (session)
LEFT JOIN reply USING (session)
LEFT JOIN ways USING (session)
LEFT JOIN driven USING (session)
LEFT JOIN navigated USING (session)
LEFT JOIN stopped USING (session)
LEFT JOIN emergency USING (session)
LEFT JOIN goal USING (session)
LEFT JOIN guard USING (session)
LEFT JOIN step USING (session)
LEFT JOIN marked USING (session)
LEFT JOIN link USING (session)
LEFT JOIN lost USING (session)
LEFT JOIN problem USING (session)
LEFT JOIN alarm USING (session)
LEFT JOIN person USING (session)
LEFT JOIN crowd USING (session)
ORDER BY session;

-- What measures consist of, by a label, in order of first occurrence.
CREATE VIEW parts AS
SELECT session, measure, label, value
FROM (
    SELECT session, 'driving_s' AS measure, source AS label, sum(duration_s) AS value, min(stamp_ns) AS first_ns
    FROM drives GROUP BY session, source
    UNION ALL
    SELECT session, 'drives_ended', reason, count(*), min(stamp_ns) FROM event_drive_ended GROUP BY session, reason
    UNION ALL
    SELECT session, 'goals', outcome, count(*), min(start_ns) FROM goal_spans GROUP BY session, outcome
    UNION ALL
    SELECT session, 'guard_s', state, sum(lasted_s), min(stamp_ns) FROM guard_states GROUP BY session, state
    UNION ALL
    SELECT session, unnest(['talk_s', 'utterances', 'words']), speaker,
        unnest([
            sum(end_ns - start_ns) / 1e9, count(*), sum(len(regexp_extract_all(text, '[^\s\pZ]+')))
        ]),
        min(CASE speaker WHEN 'participant' THEN 1 WHEN 'robot' THEN 2 ELSE 3 END)
    FROM utterances WHERE said AND speaker != '' GROUP BY session, speaker
    UNION ALL
    SELECT session, 'robot_utterances', origin, count(*), min(start_ns)
    FROM utterances WHERE said AND speaker = 'robot' GROUP BY session, origin
    UNION ALL
    SELECT session, CASE kind WHEN 'mark' THEN 'marks' ELSE 'wizard_errors' END, label, count(*), min(stamp_ns)
    FROM marks WHERE kind IN ('mark', 'wizard_error') GROUP BY session, kind, label
    UNION ALL
    SELECT session, 'lost_values', stream, sum(count), min(stamp_ns) FROM event_gap GROUP BY session, stream
)
ORDER BY session, measure, first_ns;

-- Which language models were asked by the wizard, what became of their answers, and with which parameters.
CREATE VIEW model_uses AS
SELECT
    session, provider, model, model_version,
    CASE
        WHEN provider = 'embedded' OR regexp_matches(server, '^(localhost|127\.[0-9.]+|\[::1\])(:[0-9]+)?$')
            THEN 'this computer'
        ELSE server
    END AS place,
    count(*) AS asked,
    count(*) FILTER (outcome = 'answered') AS answered,
    count(*) FILTER (outcome = 'cancelled') AS cancelled,
    count(*) FILTER (outcome = 'failed') AS failed,
    count(*) FILTER (use = 'said') AS said,
    count(*) FILTER (use = 'edited') AS edited,
    count(*) FILTER (use = 'dismissed') AS dismissed,
    count(*) FILTER (use = 'unused') AS unused,
    coalesce(list((first_token_ns - asked_ns) / 1e9 ORDER BY stamp_ns)
        FILTER (outcome = 'answered' AND first_token_ns IS NOT NULL), []) AS first_token_s,
    coalesce(list((stamp_ns - asked_ns) / 1e9 ORDER BY stamp_ns) FILTER (outcome = 'answered'), []) AS answer_s,
    list(parameters ORDER BY stamp_ns) AS settings
FROM answers JOIN (SELECT session, exchange_id, server, parameters FROM event_llm_exchange)
    USING (session, exchange_id)
WHERE purpose = 'question'
GROUP BY ALL
ORDER BY min(stamp_ns);

-- Each figure as a row of its own. Practice sessions are in measures, not in here.
CREATE VIEW each_value AS
WITH counting AS (
    SELECT session, condition, CAST(COLUMNS(* EXCLUDE (session, participant, condition, trial, wizard, purpose, scenario)) AS DOUBLE)
    FROM measures WHERE lower(purpose) != 'practice'
)
UNPIVOT counting ON COLUMNS(* EXCLUDE (session, condition)) INTO NAME measure VALUE value;

CREATE VIEW each_response AS
SELECT session, condition, 'each_response_time_s' AS measure, delay_s AS value
FROM response_times JOIN sessions USING (session) WHERE lower(purpose) != 'practice'
UNION ALL
SELECT session, condition, 'each_reaction_time_s', delay_s
FROM reactions JOIN sessions USING (session) WHERE lower(purpose) != 'practice'
UNION ALL
SELECT session, condition, 'each_gap_s', gap_s
FROM (SELECT session, first, gap_s FROM responses) JOIN sessions USING (session)
WHERE first AND lower(purpose) != 'practice';

-- Of the whole study (condition is NULL) and of each condition.
CREATE VIEW summary AS
SELECT
    CASE WHEN grouping(condition) = 1 THEN 'study' ELSE 'condition' END AS of,
    condition,
    measure,
    count(value) AS n,
    -- In one order, so that the same values have the same sum to the last digit.
    avg(value ORDER BY value) AS mean,
    stddev_samp(value ORDER BY value) AS sd,
    median(value) AS median,
    min(value) AS min,
    max(value) AS max
FROM (FROM each_value UNION ALL FROM each_response)
GROUP BY GROUPING SETS ((measure), (measure, condition))
ORDER BY of DESC, condition, measure;

-- How the gaps are distributed, by what the robot said it with: of the whole study (condition is NULL) and of each
-- condition. A filler and the answer after it count each.
CREATE VIEW gaps_by_means AS
SELECT
    CASE WHEN grouping(condition) = 1 THEN 'study' ELSE 'condition' END AS of,
    condition,
    means,
    count(*) AS n,
    median(gap_s) AS median_s,
    quantile_cont(gap_s, 0.25) AS lower_quartile_s,
    quantile_cont(gap_s, 0.75) AS upper_quartile_s,
    count(*) FILTER (gap_s < getvariable('short_gap_s')) / count(*) AS under_1_s_fraction,
    count(*) FILTER (gap_s < 0.0) AS overlaps
FROM (SELECT session, means, gap_s FROM responses) JOIN sessions USING (session) WHERE lower(purpose) != 'practice'
GROUP BY GROUPING SETS ((means), (means, condition))
ORDER BY of DESC, condition, means;

-- Each step of the protocol, planned against actual: of the whole study (condition is NULL) and of each condition.
-- Times are those of the sessions in which it was begun.
CREATE VIEW steps AS
SELECT
    CASE WHEN grouping(condition) = 1 THEN 'study' ELSE 'condition' END AS of,
    condition,
    scenario,
    scenario_file,
    step_id,
    min(title) AS title,
    min(step_number) AS step_number,
    count(*) AS sessions,
    count(*) FILTER (visits > 0) AS visited_in,
    count(*) FILTER (skipped > 0) AS skipped_in,
    count(*) FILTER (late_s >= getvariable('late_from_s')) AS late_in,
    CAST(sum(visits) AS BIGINT) AS visits,
    max(expected_s) AS expected_s,
    median(time_s) FILTER (visits > 0) AS median_s,
    avg(time_s ORDER BY time_s) FILTER (visits > 0) AS mean_s,
    stddev_samp(time_s ORDER BY time_s) FILTER (visits > 0) AS sd_s,
    min(time_s) FILTER (visits > 0) AS min_s,
    max(time_s) FILTER (visits > 0) AS max_s
FROM (SELECT * EXCLUDE (participant, condition, trial) FROM protocol) JOIN sessions USING (session)
WHERE lower(purpose) != 'practice'
GROUP BY GROUPING SETS ((scenario, scenario_file, step_id), (scenario, scenario_file, step_id, condition))
ORDER BY of DESC, condition, scenario, scenario_file, step_number, step_id;

-- What was wrong, by its cause: of the whole study (condition is NULL) and of each condition.
CREATE VIEW alarm_causes AS
SELECT
    CASE WHEN grouping(condition) = 1 THEN 'study' ELSE 'condition' END AS of,
    condition,
    cause,
    min(what) AS what,
    count(DISTINCT session) AS sessions,
    count(*) AS alarms,
    CAST(sum(times) AS BIGINT) AS times,
    sum(stood_s ORDER BY stood_s) AS stood_s,
    max(stood_s) AS longest_s,
    count(*) FILTER (seen_to_by != '') AS seen_to
FROM (SELECT * EXCLUDE (participant, condition, trial) FROM alarms) JOIN sessions USING (session)
WHERE lower(purpose) != 'practice'
GROUP BY GROUPING SETS ((cause), (cause, condition))
ORDER BY of DESC, condition, alarms DESC, cause;

-- The sessions that count: practice is in measures only.
CREATE VIEW counted AS SELECT session FROM sessions WHERE lower(purpose) != 'practice';

-- How often which label was marked, in which session.
CREATE VIEW labels AS
SELECT session, any_value(condition) AS condition, kind, label, count(*) AS n, sum(duration_s) AS lasted_s
FROM marks SEMI JOIN counted USING (session)
GROUP BY session, kind, label
ORDER BY session, kind, label;

-- How often, and how long, each coder used which code in which session.
CREATE VIEW codes AS
SELECT session, any_value(condition) AS condition, coder, tier, value, count(*) AS n, sum(duration_s) AS lasted_s
FROM annotations SEMI JOIN counted USING (session)
GROUP BY session, coder, tier, value
ORDER BY session, coder, tier, value;

-- Which language models were asked in which session, and where they ran.
CREATE VIEW models AS
SELECT
    session, any_value(condition) AS condition, provider, model, model_version,
    CASE
        WHEN provider = 'embedded' OR regexp_matches(server, '^(localhost|127\.[0-9.]+|\[::1\])(:[0-9]+)?$')
            THEN 'this computer'
        WHEN coalesce(server, '') = '' THEN 'not told'
        ELSE server
    END AS server,
    count(*) AS asked, count(*) FILTER (outcome = 'answered') AS answered, count(seed) AS with_seed
FROM event_llm_exchange SEMI JOIN counted USING (session)
GROUP BY ALL
ORDER BY session, provider, model, model_version, server;

-- What became of the texts of each language model, by function: questions of the wizard, or suggested replies.
CREATE VIEW model_functions AS
SELECT
    session, any_value(condition) AS condition, provider, model, model_version, purpose,
    count(*) AS asked,
    count(*) FILTER (use = 'said') AS said,
    count(*) FILTER (use = 'edited') AS edited,
    count(*) FILTER (use = 'dismissed') AS dismissed,
    count(*) FILTER (use = 'superseded') AS superseded,
    count(*) FILTER (use = 'expired') AS expired,
    count(*) FILTER (use = 'unused') AS unused,
    median(latency_ms) AS latency_ms,
    avg(edit_distance ORDER BY edit_distance) FILTER (use = 'edited') AS edit_distance,
    median((first_token_ns - asked_ns) / 1e9) AS first_token_s
FROM answers SEMI JOIN counted USING (session)
GROUP BY session, provider, model, model_version, purpose
ORDER BY session, provider, model, model_version, purpose;
