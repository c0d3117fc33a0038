"""Numbers, times and events in words that a wizard reads."""

import math
from collections.abc import Callable, Mapping
from datetime import datetime

from caris_desktop.domain import clock, events, person_marks
from caris_desktop.domain.sensing import CameraState, PersonBox
from caris_desktop.domain.sound import ROBOT_MICROPHONE
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import DriveStatus, LinkStatus, MicrophoneStatus
from caris_desktop.people.presence import PersonRow, is_unnamed_label
from caris_desktop.robot.profile import RobotProfile

UNDER_WAY = ("requested", "active")
"""States of a goal that the robot drives to."""


def clock_time(stamp_ns: int, anchor: clock.ClockAnchor) -> str:
    """Time of day, as 14:02:11, of a session clock stamp."""
    return datetime.fromtimestamp(anchor.utc_ns_at(stamp_ns) / 1e9).strftime("%H:%M:%S")


def elapsed(seconds: float) -> str:
    """12:43, or 1:02:03 from an hour on."""
    whole = max(0, int(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, secs = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{secs:02}" if hours else f"{minutes:02}:{secs:02}"


def age(seconds: float) -> str:
    """41 ms, 0.1 s, 12 s, 3 min."""
    if seconds < 0.1:
        return f"{max(0, round(seconds * 1000))} ms"
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min"


def since(seconds: float) -> str:
    """How long somebody has been here: just now, 20 s, 3 min."""
    if seconds < 5:
        return "just now"
    if seconds < 60:
        return f"for {int(seconds) // 5 * 5} s"
    return f"for {int(seconds // 60)} min"


def ago(seconds: float) -> str:
    """How long ago something was: just now, 20 s ago, 3 min ago, 2 h ago, 3 days ago."""
    if seconds < 5:
        return "just now"
    if seconds < 60:
        return f"{int(seconds) // 5 * 5} s ago"
    if seconds < 5_400:
        return f"{int(seconds // 60)} min ago"
    hours = seconds / 3_600
    return f"{round(hours)} h ago" if hours < 36 else f"{round(hours / 24)} days ago"


def size(count_bytes: float) -> str:
    """24 MB, 1.2 GB."""
    for unit in ("B", "kB", "MB"):
        if count_bytes < 999.5:
            return f"{count_bytes:.0f} {unit}"
        count_bytes /= 1000
    return f"{count_bytes:.1f} GB" if count_bytes < 100 else f"{count_bytes:.0f} GB"


_ANOTHER_TIME_MS = 1e9


def session_clock_ms(anchor: clock.ClockAnchor) -> float:
    """What this computer's time of day is ahead of the session clock: the offset of a robot with the right time."""
    return (anchor.utc_ns - anchor.monotonic_ns) / 1e6


def clock_offset(offset_ms: float, uncertainty_ms: float | None, anchor: clock.ClockAnchor) -> str:
    """How the robot's clock goes beside this computer's: 3.1 ± 0.4 ms ahead.

    ``offset_ms`` is robot clock minus session clock.
    """
    ahead_ms = offset_ms - session_clock_ms(anchor)
    spread = "" if uncertainty_ms is None else f" ± {_milliseconds(uncertainty_ms)}"
    if abs(ahead_ms) > _ANOTHER_TIME_MS:
        # A simulation begins at zero; how far that is from today says nothing.
        known = "" if uncertainty_ms is None else f", known to{spread} ms"
        return f"set to a time of its own{known}"
    return f"{_milliseconds(abs(ahead_ms))}{spread} ms {'ahead' if ahead_ms >= 0 else 'behind'}"


def _milliseconds(milliseconds: float) -> str:
    return f"{milliseconds:.1f}" if milliseconds < 10 else f"{milliseconds:,.0f}"


def link_facts(link: LinkStatus, traffic: Mapping[str, events.TrafficMeasured], anchor: clock.ClockAnchor) -> str:
    """Address, clock and load of the link in one line; its detail where it is in trouble."""
    parts = [link.address, link.detail]
    if link.state in ("connected", "trouble"):
        if link.round_trip_ms is not None:
            parts.append(f"{link.round_trip_ms:.0f} ms to the robot and back")
        if link.clock_offset_ms is not None:
            offset = clock_offset(link.clock_offset_ms, link.clock_uncertainty_ms, anchor)
            parts.append(f"robot clock {offset}")
        load = sum(topic.bytes_per_s for measured in traffic.values() for topic in measured.topics)
        if traffic:
            parts.append(f"{size(load)}/s")
        refused = sum(measured.refused for measured in traffic.values())
        if refused:
            parts.append(f"{refused} messages refused")
    return " · ".join(part for part in parts if part)


def long_duration(seconds: float) -> str:
    """How long something lasts that is told roughly: 53 h, 5 h 20 min, 26 min, less than a minute."""
    minutes = int(seconds // 60)
    if minutes < 1:
        return "less than a minute"
    hours, rest = divmod(minutes, 60)
    if not hours:
        return f"{rest} min"
    if hours >= 10 or not rest:
        return f"{hours} h"
    return f"{hours} h {rest} min"


def stretch(seconds: float) -> str:
    """How long a stretch goes on: 0:07, 12:43, 1:02:03."""
    text = elapsed(seconds)
    return text[1:] if text.startswith("0") else text


_MISSING = {"frame": ("frame", "frames"), "audio": ("piece of sound", "pieces of sound"), "scan": ("scan", "scans")}
_MISSING["audio_chunk"] = _MISSING["audio"]
_MISSING["transcription"] = ("piece of sound for the transcript", "pieces of sound for the transcript")


def missing(stream: str, count: int) -> str:
    """3 frames were not recorded."""
    one, many = _MISSING.get(stream, (f"value of {stream}", f"values of {stream}"))
    return f"{count} {one} was not recorded" if count == 1 else f"{count} {many} were not recorded"


def counted(count: int, one: str) -> str:
    """1 session, 2 sessions."""
    return f"{count} {one}{'s' * (count != 1)}"


def all_missing(dropped: Mapping[str, int]) -> str:
    """3 frames not recorded; of several streams together 12 values; empty where nothing is missing."""
    total = sum(dropped.values())
    if not total:
        return ""
    one, many = ("value", "values") if len(dropped) > 1 else _MISSING.get(next(iter(dropped)), ("value", "values"))
    return f"{total} {one if total == 1 else many} not recorded"


def expectation(bytes_per_hour: float | None, free_bytes: int | None) -> str:
    """About 1.2 GB per hour; 64 GB free: room for 53 h."""
    free = "" if free_bytes is None else f"{size(free_bytes)} free"
    if not bytes_per_hour:
        return free
    rate = f"About {size(bytes_per_hour)} per hour"
    if free_bytes is None:
        return rate
    return f"{rate}; {free}: room for {long_duration(free_bytes / bytes_per_hour * 3600)}"


def with_label(sentence: str, label: str) -> str:
    """With what a scenario or a wizard calls it."""
    return f"{sentence}: {label}" if label else sentence


def with_detail(sentence: str, detail: str) -> str:
    """With a reason out of the record, which is English there."""
    return f"{sentence}: {tr(detail)}" if detail else sentence


def mark_sentence(mark: events.Marked) -> str:
    """What a mark says, in the state it has now."""
    if mark.kind == "note":
        return "Note taken back" if mark.state == "withdrawn" else with_label("Note", f"“{shortened(mark.note, 120)}”")
    what = "Wizard error marked" if mark.kind == "wizard_error" else "Marked"
    label = mark.label
    match mark.state:
        case "withdrawn":
            return f"Taken back: {label}" if label else "Mark taken back"
        case "open":
            return f"{label or 'A stretch'} began"
    if mark.end_ns is not None and mark.start_ns is not None:
        label = f"{label or 'a stretch'}, {age((mark.end_ns - mark.start_ns) / 1e9)}"
    note = f" “{shortened(mark.note, 80)}”" if mark.note else ""
    return with_label(what, label) + note


def shortened(text: str, length: int = 48) -> str:
    text = " ".join(text.split())
    return text if len(text) <= length else text[: length - 1].rstrip() + "…"


def motion(forward_mps: float, turn_radps: float, left_mps: float = 0.0) -> str:
    """What a velocity looks like to somebody who watches the robot."""
    parts = []
    if abs(forward_mps) >= 0.005:
        parts.append(f"{abs(forward_mps):.2f} m/s {'forward' if forward_mps > 0 else 'backward'}")
    if abs(left_mps) >= 0.005:
        parts.append(f"{abs(left_mps):.2f} m/s to the {'left' if left_mps > 0 else 'right'}")
    if abs(turn_radps) >= 0.01:
        parts.append(f"turning {'left' if turn_radps > 0 else 'right'} {abs(math.degrees(turn_radps)):.0f}°/s")
    return ", ".join(parts) if parts else "Standing still"


def drive_line(drive: DriveStatus) -> str:
    if drive.emergency_stop:
        return "Emergency stop is on"
    if not drive.allowed:
        return "Driving is off"
    return motion(drive.target_forward_mps, drive.target_turn_radps, drive.target_left_mps)


def goal_speed(robot: RobotProfile | None, drive: DriveStatus) -> tuple[str, bool]:
    """How fast the robot drives to a goal, and whether that is as Drive says; empty where it drives to none."""
    server = robot.navigation if robot is not None else None
    if server is None:
        return "", True
    if drive.goal_limit_mps is not None:
        return f"{drive.goal_limit_mps:.2f} m/s at most", True
    own = "" if server.max_mps is None else f", up to {server.max_mps:.2f} m/s"
    return f"at its navigation’s own speed{own}", False


def robot_now(drive: DriveStatus, goal: events.GoalChanged | None, robot: RobotProfile | None) -> str:
    """What the robot does now, in one line; why it does nothing where it may not."""
    if not drive.allowed:
        return tr(drive.reason)
    by_itself = goal is not None and goal.state in UNDER_WAY
    if goal is None or not by_itself:
        return drive_line(drive)
    left = "" if goal.distance_left_m is None else f", {goal.distance_left_m:.1f} m left"
    speed, _as_drive_says = goal_speed(robot, drive)
    return " · ".join(part for part in (f"Going to {goal.place or 'the chosen point'}{left}", speed) if part)


def head_angles(pan_rad: float, tilt_rad: float) -> str:
    """Where the head looks, in two short lines."""
    pan, tilt = round(math.degrees(pan_rad)), round(math.degrees(tilt_rad))
    across = "ahead" if pan == 0 else f"{abs(pan)}° {'left' if pan > 0 else 'right'}"
    up = "level" if tilt == 0 else f"{abs(tilt)}° {'down' if tilt > 0 else 'up'}"
    return f"{across}\n{up}"


def guard_line(drive: DriveStatus) -> str:
    """What the obstacle guard does now; empty while it does nothing."""
    # In the direction of the motion, which may be back or sideways.
    away = "" if drive.guard_distance_m is None else f" {max(0.0, drive.guard_distance_m):.1f} m away"
    match drive.guard:
        case "slowing":
            return f"Obstacle{away} · slowing"
        case "blocked":
            return f"Blocked · obstacle{away}"
        case "blind":
            return f"The guard lets it crawl only: {drive.guard_detail or 'it sees nothing'}"
        case _:
            return ""


def camera_title(name: str) -> str:
    """A camera's name as a title: "Front camera" for front. Empty for none."""
    words = name.replace("_", " ").strip()
    if words and "camera" not in words.lower():
        words += " camera"
    return words[:1].upper() + words[1:]


def camera_in_text(name: str) -> str:
    """A camera's name within a sentence, after "the": "front camera" for front."""
    return camera_title(name)[:1].lower() + camera_title(name)[1:]


def person_state(box: PersonBox) -> str:
    """What somebody does who is seen, in a word or two: nothing for what is usual, or is not known."""
    told = (
        "sitting" if box.posture == "sitting" else "",
        "hand raised" if box.hand_raised else "",
        "looks here" if box.facing else "",
    )
    return " · ".join(word for word in told if word)


def no_picture(age_s: float | None, told: CameraState | None) -> str:
    """What stands in the place of a lost camera's picture; ``told`` is what is known of the camera itself."""
    if told is not None and told.state == "ended":
        return told.detail or "It has ended. A recording goes on without it."
    since = "No picture yet" if age_s is None else f"No picture for {age(age_s)}"
    why = f" {told.detail}" if told is not None and told.state in ("lost", "connecting") and told.detail else ""
    return f"{since}, it is being tried again.{why}"


def has_given_name(person: PersonRow) -> bool:
    """Whether the wizard named this person; the console calls the others Person 1, Person 2, ..."""
    return bool(person.name) and not is_unnamed_label(person.name)


def person_name(person: PersonRow) -> str:
    return person.name or f"Person {person.track}"


def percent(confidence: float) -> str:
    """82 %. Never 100 %: nobody is that sure of who somebody is."""
    return f"{min(99, int(100 * confidence + 0.5))} %"


def maybe(person: PersonRow) -> str:
    """Who it could be: Maybe Anna (82 %). Empty where nobody is suggested."""
    if person.suggestion is None:
        return ""
    return f"Maybe {person.suggestion.name} ({percent(person.suggestion.confidence)})"


def on_box(person: PersonRow, yes_key: str = "") -> str:
    """What stands on somebody's box: the name, or Anna? 82 % · Y where that is asked."""
    if person.suggestion is None:
        return person_name(person)
    who = f"{person.suggestion.name}? {percent(person.suggestion.confidence)}"
    return " · ".join(filter(None, (who, yes_key)))


NameOf = Callable[[str], str]
"""Gives the words for a person id."""


def with_names(text: str, name_of: NameOf) -> str:
    """What was said, as it is shown: with names where the record has ids."""
    return person_marks.with_names(text, name_of)


def microphone_facts(microphone: MicrophoneStatus) -> str:
    """Whom an open microphone hears, which one it is, and what is wrong with it."""
    whom = "You are heard" if microphone.role == "wizard" else "The participant is heard"
    if microphone.state == "failed":
        return f"{whom} by no microphone: {microphone.detail}"
    if microphone.source == ROBOT_MICROPHONE:
        return f"{whom} by the robot's microphone"
    return f"{whom} by {microphone.name or 'the system’s default microphone'}"


def microphone(name: str) -> str:
    """One of this computer's, by its name; empty: the system's own choice."""
    return name or "System’s default microphone"
