"""Numbers, times and events in words that a wizard reads."""

import math
from collections.abc import Callable, Mapping
from datetime import datetime

from caris_desktop.domain import clock, events
from caris_desktop.domain.actor import CONSOLE, OTHER_WIZARD, WIZARD, Actor, in_words
from caris_desktop.domain.sensing import CameraState, PersonBox
from caris_desktop.live.status import DriveStatus, LinkStatus
from caris_desktop.people.presence import PersonRow, is_unnamed_label
from caris_desktop.robot.profile import RobotProfile

Category = str  # one of CATEGORIES
UNDER_WAY = ("requested", "active")
"""States of a goal that the robot drives to."""

CATEGORIES = ("Said", "Moved", "People", "Session", "Problems")


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


def mark_sentence(mark: events.Marked) -> str:
    """What a mark says, in the state it has now."""
    if mark.kind == "note":
        return (
            "Note taken back" if mark.state == "withdrawn" else _with_detail("Note", f"“{shortened(mark.note, 120)}”")
        )
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
    return _with_detail(what, label) + note


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
        return drive.reason
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


def event_sentence(event: object, name_of: NameOf) -> tuple[Category, str] | None:
    """Category and sentence for the log; None for what only the recording needs."""
    told = _event_sentence(event, name_of)
    by = _by_whom(event)
    return told if told is None or not by else (told[0], f"{told[1]} · by {by}")


def _by_whom(event: object) -> str:
    """Who did it, where that is not this wizard, and no sentence about the console says why already."""
    actor: Actor = getattr(event, "actor", "")
    if actor.startswith(OTHER_WIZARD):
        return f"wizard {actor.removeprefix(OTHER_WIZARD)}"
    told = isinstance(event, events.DriveEnded | events.GuardChanged) or bool(getattr(event, "detail", ""))
    return "" if actor in ("", WIZARD) or (actor == CONSOLE and told) else in_words(actor)


def _event_sentence(event: object, name_of: NameOf) -> tuple[Category, str] | None:
    match event:
        case events.LinkChanged(link="media", state=state):
            return ("Problems", "Camera and map are out of reach") if state == "lost" else None
        case events.LinkChanged(state="connected"):
            return "Session", "The robot is connected"
        case events.LinkChanged(state="connecting"):
            return "Session", "Looking for the robot"
        case events.LinkChanged(state="trouble", detail=detail):
            return "Problems", _with_detail("The connection to the robot is unsteady", detail)
        case events.LinkChanged(state="lost", detail=detail):
            return "Problems", _with_detail("The robot is out of reach", detail)
        case events.LinkChanged(state="closed"):
            return "Session", "The connection to the robot was closed"
        case events.DriveEnded(reason=reason):
            return "Moved", _with_detail("Driving ended", reason)
        case events.StopRequested():
            return "Moved", "Stop"
        case events.EmergencyStopChanged(latched=latched, by=by):
            whose = "" if by == "wizard" else " by the robot"
            return "Moved", f"Emergency stop {'on' if latched else 'released'}{whose}"
        case events.GoalChanged(state=state, place=place, detail=detail):
            where = place or "the chosen point"
            words = {
                "requested": f"Going to {where}", "reached": f"Arrived at {where}",
                "cancelled": f"No longer going to {where}", "failed": f"Could not get to {where}",
            }  # fmt: skip
            if state not in words:
                return None
            return ("Problems" if state == "failed" else "Moved"), _with_detail(words[state], detail)
        case events.GuardChanged() | events.InitialPoseSet() | events.MapRequestChanged() | events.MappingChanged():
            return _navigation_sentence(event)
        case events.PlacesChanged(name=name, pose_in_map=pose):
            return "Session", f"Place {name} {'removed' if pose is None else 'saved'}"
        case events.ControlUsed():
            return _control_sentence(event)
        case events.GamepadChanged(name=name, connected=connected):
            return "Session", f"{name or 'The gamepad'} was {'plugged in' if connected else 'unplugged'}"
        case events.UtteranceChanged(speaker="robot", state="started", text=text):
            return "Said", f"Robot: “{shortened(text, 120)}”"
        case events.UtteranceChanged(speaker="robot", state="interrupted", text=text):
            return "Said", f"Cut short: “{shortened(text, 60)}”"
        case events.UtteranceChanged(speaker="robot", state="failed", text=text, detail=detail):
            return "Problems", _with_detail(f"Not said: “{shortened(text, 60)}”", detail)
        case events.UtteranceChanged(speaker="participant", state="finished", text=text):
            return "Said", f"Participant: “{shortened(text, 120)}”"
        case events.LlmExchange(outcome="answered", model=model):
            return "Said", f"The assistant answered ({model})"
        case events.LlmExchange(outcome="cancelled"):
            return "Said", "Question to the assistant cancelled"
        case events.LlmExchange(detail=detail):
            return "Problems", _with_detail("The assistant gave no answer", detail)
        case events.PersonAppeared(person_id=person_id):
            return "People", f"{name_of(person_id)} came into view"
        case events.PersonLeft(person_id=person_id):
            return "People", f"{name_of(person_id)} left"
        case events.PersonRenamed(person_id=person_id):
            return "People", f"Named {name_of(person_id)}"
        case (
            events.PersonSuggested() | events.PersonIdentified() | events.PersonRejected() | events.PersonDescribed()
            | events.PeopleMerged() | events.PersonSplit() | events.ConsentNoted() | events.PeopleUndone()
            | events.PersonForgotten()
        ):  # fmt: skip
            return "People", _about_people(event, name_of)
        case events.PhotoTaken(file_name=file_name):
            return "Session", f"Photo taken ({file_name.rsplit('/', 1)[-1]})"
        case events.PhotoTagged(file_name=file_name, tags=tags):
            return "Session", f"Photo tagged ({file_name.rsplit('/', 1)[-1]}: {', '.join(tags) or 'no tags'})"
        case events.PhotoDeleted(file_name=file_name, restored=restored):
            return "Session", f"Photo {'brought back' if restored else 'deleted'} ({file_name.rsplit('/', 1)[-1]})"
        case events.Marked():
            return "Session", mark_sentence(event)
        case events.RecordingPaused(paused=paused):
            return "Session", "Recording paused" if paused else "Recording goes on"
        case events.RobotChosen(title=title):
            return "Session", f"Robot: {title}"
        case events.ScenarioOpened(title=title):
            return "Session", f"Scenario: {title}"
        case events.Gap(reason=events.OVERTAKEN):
            return None  # every second on a crowded machine
        case events.Gap(stream=stream, count=count, reason=reason):
            return "Problems", _with_detail(missing(stream, count), reason)
        case events.Problem(severity=severity, what=what, meaning=meaning):
            return ("Session" if severity == "info" else "Problems"), f"{_sentence(what)} {meaning}".strip()
        case events.SessionStarted(folder=folder):
            return "Session", f"Recording started ({folder})"
        case events.SessionEnded(folder=folder):
            return "Session", f"Recording ended ({folder})"
        case _:
            return None


_DETAILS = {"group": "The group of", "tags": "The tags of", "note": "The note about"}
CONSENTS: dict[events.ConsentKind, str] = {
    "face": "being recognised by face",
    "photo": "photos",
    "video": "video recording",
    "sound": "sound recording",
}
_UNDONE = {
    "named": "a name", "group": "a group", "tags": "tags", "note": "a note", "identified": "who somebody is",
    "rejected": "who somebody is not", "merged": "two people being one", "split": "one person being two",
    "consent": "a consent",
}  # fmt: skip
DECISIONS_ABOUT_PEOPLE = (
    events.PersonRenamed, events.PersonIdentified, events.PersonRejected, events.PersonDescribed, events.PeopleMerged,
    events.PersonSplit, events.ConsentNoted,
)  # fmt: skip
"""What can be taken back."""


def _about_people(event: object, name_of: NameOf) -> str:
    match event:
        case events.PersonSuggested(person_id=person_id, is_person_id=other, confidence=confidence):
            return f"{name_of(person_id)} may be {name_of(other)} ({percent(confidence)})"
        case events.PersonIdentified(is_person_id=other, by="console", confidence=confidence):
            return f"{name_of(other)} recognised ({percent(confidence)})"
        case events.PersonIdentified(is_person_id=other):
            return f"{name_of(other)} confirmed"
        case events.PersonRejected(is_person_id=other):
            return f"Not {name_of(other)}: somebody else"
        case events.PersonDescribed(person_id=person_id, detail=detail):
            return f"{_DETAILS[detail]} {name_of(person_id)} changed"
        case events.PeopleMerged(into_person_id=into):
            return f"Two people were one: {name_of(into)}"
        case events.PersonSplit(person_id=person_id, from_person_id=other):
            return f"{name_of(person_id)} was not {name_of(other)}: two people now"
        case events.ConsentNoted(person_id=person_id, kind=kind, given=given):
            return f"{name_of(person_id)} {'agrees' if given else 'no longer agrees'} to {CONSENTS[kind]}"
        case events.PeopleUndone(decision=decision):
            return f"Taken back: {_UNDONE[decision]}"
        case _:
            return "Somebody was forgotten"


def _navigation_sentence(
    event: events.GuardChanged | events.InitialPoseSet | events.MapRequestChanged | events.MappingChanged,
) -> tuple[Category, str] | None:
    match event:
        case events.GuardChanged(state="overridden"):
            return "Moved", "Obstacle guard switched off"
        case events.GuardChanged(state="blind", detail=detail):
            return "Problems", _with_detail("The obstacle guard lets the robot crawl only", detail)
        case events.InitialPoseSet():
            return "Moved", "The robot was told where it is"
        case events.MapRequestChanged(operation="save" | "load" as operation, name=name, state=state, detail=detail):
            done = "saved" if operation == "save" else "loaded"
            if state == "failed":
                return "Problems", _with_detail(f"The map {name} was not {done}", detail)
            return ("Session", f"The map {name} was {done}") if state == "succeeded" else None
        case events.MapRequestChanged(state="failed", detail=detail):
            return "Problems", _with_detail("Mapping was not switched", detail)
        case events.MappingChanged(mapping=mapping) if mapping is not None:
            return "Session", "The robot builds the map" if mapping else "The robot keeps the map as it is"
        case _:
            return None


def _control_sentence(event: events.ControlUsed) -> tuple[Category, str] | None:
    """What a control did; of a slider, which is dragged, only what went wrong."""
    title = event.control.replace("_", " ")
    if event.state == "failed":
        return "Problems", _with_detail(f"Robot: {title} did not work", event.detail)
    if event.state != "succeeded" or (isinstance(event.value, float) and not isinstance(event.value, bool)):
        return None
    value = "" if event.value is True else " off" if event.value is False else f" “{shortened(str(event.value))}”"
    return "Session", f"Robot: {title}{value}"


def _with_detail(sentence: str, detail: str) -> str:
    return f"{sentence}: {detail}" if detail else sentence


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
