"""Numbers, times, states, events and values of robot controls formatted for the wizard."""

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime

from PySide6.QtWidgets import QWidget

from caris_desktop.domain import clock, events, person_marks
from caris_desktop.domain.control_definitions import ControlValue, RobotControl
from caris_desktop.domain.recorded_messages import retranslate
from caris_desktop.domain.sensing import CameraState, PersonBox
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveStream
from caris_desktop.live.status import DriveStatus, LinkStatus, MicrophoneStatus, ModelChoice
from caris_desktop.people.presence import PersonRow, is_unnamed_label, unnamed_number
from caris_desktop.robot.profile_model import RobotProfile

UNDER_WAY = ("requested", "active")
"""States of a navigation goal in progress."""

_PURPOSES = {"practice": QT_TR_NOOP("Practice")}


def local_time(started_utc: str) -> str:
    """Local time as 2026-11-21 14:02; anything else unchanged."""
    try:
        return f"{datetime.fromisoformat(started_utc).astimezone():%Y-%m-%d %H:%M}"
    except (ValueError, OverflowError):  # a year that this time zone lacks
        return started_utc


def local_moment(utc_ns: int) -> datetime:
    """Local date and time; of 1970 for a moment that no calendar holds, as in a damaged recording."""
    try:
        return datetime.fromtimestamp(utc_ns / 1e9)
    except (ValueError, OverflowError, OSError):
        return datetime.fromtimestamp(0)


def purpose_title(purpose: str) -> str:
    """Title of a session's purpose; an unknown purpose unchanged."""
    return tr(_PURPOSES[purpose]) if purpose in _PURPOSES else purpose


def clock_time(stamp_ns: int, anchor: clock.ClockAnchor) -> str:
    """Time of day of a session clock stamp, as 14:02:11."""
    return local_moment(anchor.utc_ns_at(stamp_ns)).strftime("%H:%M:%S")


def elapsed(seconds: float) -> str:
    """Duration as 12:43, or 1:02:03 from an hour on."""
    total_s = max(0, int(seconds))
    hours, rest = divmod(total_s, 3600)
    minutes, secs = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{secs:02}" if hours else f"{minutes:02}:{secs:02}"


def age(seconds: float) -> str:
    """Age as 41 ms, 0.1 s, 12 s, 3 min."""
    if seconds < 0.1:
        return f"{max(0, round(seconds * 1000))} ms"
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min"


def stream_age(stream: LiveStream) -> str:
    """Age of a stream's newest value, if known."""
    return age(stream.age_s() or 0.0) if stream.age_known else tr("age unknown")


def since(seconds: float) -> str:
    """Duration of presence: just now, 20 s, 3 min."""
    if seconds < 5:
        return tr("just now")
    if seconds < 60:
        return tr("for {time} s").format(time=int(seconds) // 5 * 5)
    return tr("for {time} min").format(time=int(seconds // 60))


def ago(seconds: float) -> str:
    """Time since an event: just now, 20 s ago, 3 min ago, 2 h ago, 3 days ago."""
    if seconds < 5:
        return tr("just now")
    if seconds < 60:
        return tr("{time} s ago").format(time=int(seconds) // 5 * 5)
    if seconds < 5_400:
        return tr("{time} min ago").format(time=int(seconds // 60))
    hours = seconds / 3_600
    if hours < 36:
        return tr("{time} h ago").format(time=round(hours))
    return tr("%n days ago", "", round(hours / 24))


def size(count_bytes: float) -> str:
    """Size as 24 MB, 1.2 GB."""
    for unit in ("B", "kB", "MB"):
        if count_bytes < 999.5:
            return f"{count_bytes:.0f} {unit}"
        count_bytes /= 1000
    return f"{count_bytes:.1f} GB" if count_bytes < 100 else f"{count_bytes:.0f} GB"


_ANOTHER_TIME_MS = 1e9


def session_clock_ms(anchor: clock.ClockAnchor) -> float:
    """Offset of this computer's time of day from the session clock, in ms: the expected offset of a
    synchronised robot.
    """
    return (anchor.utc_ns - anchor.monotonic_ns) / 1e6


def clock_offset(offset_ms: float, uncertainty_ms: float | None, anchor: clock.ClockAnchor) -> str:
    """Robot clock relative to this computer's, as 3.1 ± 0.4 ms ahead.

    ``offset_ms`` is robot clock minus session clock.
    """
    ahead_ms = offset_ms - session_clock_ms(anchor)
    spread = "" if uncertainty_ms is None else f" ± {_milliseconds(uncertainty_ms)}"
    if abs(ahead_ms) > _ANOTHER_TIME_MS:
        # A simulation clock starts at zero; its offset from today is meaningless.
        if uncertainty_ms is None:
            return tr("on a separate time base")
        return tr("on a separate time base, known to {uncertainty} ms").format(uncertainty=spread.strip())
    offset = tr("{offset} ms ahead") if ahead_ms >= 0 else tr("{offset} ms behind")
    return offset.format(offset=f"{_milliseconds(abs(ahead_ms))}{spread}")


def _milliseconds(milliseconds: float) -> str:
    return f"{milliseconds:.1f}" if milliseconds < 10 else f"{milliseconds:,.0f}"


def link_facts(link: LinkStatus, traffic: Mapping[str, events.TrafficMeasured], anchor: clock.ClockAnchor) -> str:
    """Address, clock and load of the link in one line; the detail if it is in trouble."""
    parts = [link.address, tr(link.detail)]
    if link.state in ("connected", "trouble"):
        if link.round_trip_ms is not None:
            parts.append(tr("{time} ms round trip").format(time=f"{link.round_trip_ms:.0f}"))
        if link.clock_offset_ms is not None:
            offset = clock_offset(link.clock_offset_ms, link.clock_uncertainty_ms, anchor)
            parts.append(tr("robot clock {offset}").format(offset=offset))
        load = sum(topic.bytes_per_s for measured in traffic.values() for topic in measured.topics)
        if traffic:
            parts.append(f"{size(load)}/s")
        refused = sum(measured.refused for measured in traffic.values())
        if refused:
            parts.append(tr("%n messages refused", "", refused))
    return " · ".join(part for part in parts if part)


def long_duration(seconds: float) -> str:
    """Rounded duration: 53 h, 5 h 20 min, 26 min, less than a minute."""
    minutes = int(seconds // 60)
    if minutes < 1:
        return tr("less than a minute")
    hours, rest = divmod(minutes, 60)
    if not hours:
        return f"{rest} min"
    if hours >= 10 or not rest:
        return f"{hours} h"
    return f"{hours} h {rest} min"


def duration(seconds: float) -> str:
    """Duration of an interval: 0:07, 12:43, 1:02:03."""
    text = elapsed(seconds)
    return text[1:] if text.startswith("0") else text


def missing(stream: str, count: int) -> str:
    """Missing data of a stream, as "3 frames were not recorded"."""
    match stream:
        case "frame":
            one, many = tr("1 frame was not recorded"), tr("%n frames were not recorded", "", count)
        case "scan":
            one, many = tr("1 scan was not recorded"), tr("%n scans were not recorded", "", count)
        case "audio" | "audio_chunk":
            one, many = tr("1 audio chunk was not recorded"), tr("%n audio chunks were not recorded", "", count)
        case "transcription":
            one = tr("1 audio chunk for the transcript was not recorded")
            many = tr("%n audio chunks for the transcript were not recorded", "", count)
        case _:
            one = tr("1 value of {stream} was not recorded").format(stream=stream)
            many = tr("%n values of {stream} were not recorded", "", count).format(stream=stream)
    return one if count == 1 else many


def all_missing(dropped: Mapping[str, int]) -> str:
    """Missing data of all streams, as "3 frames not recorded", or as values for several streams; empty if none."""
    total = sum(dropped.values())
    if not total:
        return ""
    match "" if len(dropped) > 1 else next(iter(dropped)):
        case "frame":
            one, many = tr("1 frame not recorded"), tr("%n frames not recorded", "", total)
        case "scan":
            one, many = tr("1 scan not recorded"), tr("%n scans not recorded", "", total)
        case "audio" | "audio_chunk":
            one, many = tr("1 audio chunk not recorded"), tr("%n audio chunks not recorded", "", total)
        case "transcription":
            one = tr("1 audio chunk for the transcript not recorded")
            many = tr("%n audio chunks for the transcript not recorded", "", total)
        case _:
            one, many = tr("1 value not recorded"), tr("%n values not recorded", "", total)
    return one if total == 1 else many


def expectation(bytes_per_hour: float | None, free_bytes: int | None) -> str:
    """Expected recording size, as "About 1.2 GB per hour; 64 GB free: room for 53 h"."""
    if not bytes_per_hour:
        return "" if free_bytes is None else tr("{size} free").format(size=size(free_bytes))
    rate = size(bytes_per_hour)
    if free_bytes is None:
        return tr("About {rate} per hour").format(rate=rate)
    room = long_duration(free_bytes / bytes_per_hour * 3600)
    return tr("About {rate} per hour; {size} free: room for {room}").format(rate=rate, size=size(free_bytes), room=room)


def with_label(sentence: str, label: str) -> str:
    """The sentence with the label of a scenario or wizard."""
    return f"{sentence}: {label}" if label else sentence


def with_detail(sentence: str, detail: str) -> str:
    """The sentence with a recorded reason, which is English in the record."""
    again = retranslate(detail)
    return f"{sentence}: {tr(again)}" if detail else sentence


def mark_sentence(mark: events.Marked) -> str:
    """Text of a mark in its current state."""
    if mark.kind == "note":
        if mark.state == "withdrawn":
            return tr("Note removed")
        return with_label(tr("Note"), f"“{shortened(mark.note, 120)}”")
    text = tr("Wizard error marked") if mark.kind == "wizard_error" else tr("Marked")
    label = mark.label
    match mark.state:
        case "withdrawn":
            return tr("Mark removed: {label}").format(label=label) if label else tr("Mark removed")
        case "open":
            return tr("{label} started").format(label=label) if label else tr("Interval started")
    if mark.end_ns is not None and mark.start_ns is not None:
        label = label or tr("interval")
        label = f"{label}, {age((mark.end_ns - mark.start_ns) / 1e9)}"
    note = f" “{shortened(mark.note, 80)}”" if mark.note else ""
    return with_label(text, label) + note


ESC_CLOSES = QT_TR_NOOP("Esc closes this and stops the robot")
"""Tooltip of a button with the key Esc, which never only closes."""


def in_menu(text: str) -> str:
    """``text`` escaped for a menu, where Qt treats "&" as a mnemonic and a tab as the start of the shortcut."""
    return text.replace("&", "&&").replace("\t", " ")


def shortened(text: str, length: int = 48) -> str:
    text = " ".join(text.split())
    return text if len(text) <= length else text[: length - 1].rstrip() + "…"


def moving(forward_mps: float, turn_radps: float, left_mps: float = 0.0) -> str:
    """Velocity as text; empty for a robot at rest."""
    parts = []
    if abs(forward_mps) >= 0.005:
        ahead = tr("{speed} m/s forward") if forward_mps > 0 else tr("{speed} m/s backward")
        parts.append(ahead.format(speed=f"{abs(forward_mps):.2f}"))
    if abs(left_mps) >= 0.005:
        sideways = tr("{speed} m/s to the left") if left_mps > 0 else tr("{speed} m/s to the right")
        parts.append(sideways.format(speed=f"{abs(left_mps):.2f}"))
    if abs(turn_radps) >= 0.01:
        turning = tr("turning left {speed}°/s") if turn_radps > 0 else tr("turning right {speed}°/s")
        parts.append(turning.format(speed=f"{abs(math.degrees(turn_radps)):.0f}"))
    return ", ".join(parts)


def drive_line(drive: DriveStatus) -> str:
    if not drive.allowed or (drive.emergency_stop and drive.movement != "uncommanded"):
        return tr("Driving is off")
    commanded = moving(drive.target_forward_mps, drive.target_turn_radps, drive.target_left_mps)
    match drive.movement:
        case "uncommanded":
            return tr("Moving without a console command")
        case "not_following" if commanded:
            return tr("{motion} commanded, but the robot is not following").format(motion=commanded)
        case "standing" if not commanded:
            return tr("Standing still")
        case _:
            return commanded or tr("Nothing commanded")


def goal_speed(robot: RobotProfile | None, drive: DriveStatus, *, begins: bool = False) -> tuple[str, bool]:
    """Speed limit on the way to a goal, and whether the speed setting determines it; empty without navigation.
    ``begins`` capitalises the text.
    """
    server = robot.navigation if robot is not None else None
    if server is None:
        return "", True
    if drive.goal_limit_mps is not None:
        return tr("{speed} m/s at most").format(speed=f"{drive.goal_limit_mps:.2f}"), True
    if server.max_mps is None:
        return tr("At the robot’s navigation speed") if begins else tr("at the robot’s navigation speed"), False
    up_to = (
        tr("At the robot’s navigation speed, up to {speed} m/s")
        if begins
        else tr("at the robot’s navigation speed, up to {speed} m/s")
    )
    return up_to.format(speed=f"{server.max_mps:.2f}"), False


def robot_now(drive: DriveStatus, goal: events.GoalChanged | None, robot: RobotProfile | None) -> str:
    """Current activity of the robot in one line, or the reason why it may not move."""
    if not drive.allowed:
        return tr(drive.reason)
    going = goal_now(goal)
    if not going:
        return drive_line(drive)
    speed, _by_speed_setting = goal_speed(robot, drive)
    return " · ".join(part for part in (going, speed) if part)


def goal_now(goal: events.GoalChanged | None) -> str:
    """Where the robot goes by itself; empty if it does not."""
    if goal is None or goal.state not in UNDER_WAY:
        return ""
    if goal.state == "requested":  # no answer from the robot yet
        going = tr("Asked to go to {place}") if goal.place else tr("Asked to go to the chosen point")
    else:
        going = tr("Going to {place}") if goal.place else tr("Going to the chosen point")
    going = going.format(place=goal.place)
    if goal.distance_left_m is not None:
        going = tr("{going}, {distance} m left").format(going=going, distance=f"{goal.distance_left_m:.1f}")
    return going


def head_angles(pan_rad: float, tilt_rad: float) -> str:
    """Head angles in two short lines."""
    pan, tilt = round(math.degrees(pan_rad)), round(math.degrees(tilt_rad))
    across = tr("ahead") if pan == 0 else tr("{angle}° left") if pan > 0 else tr("{angle}° right")
    up = tr("level") if tilt == 0 else tr("{angle}° down") if tilt > 0 else tr("{angle}° up")
    return f"{across.format(angle=abs(pan))}\n{up.format(angle=abs(tilt))}"


def guard_line(drive: DriveStatus) -> str:
    """Current action of the obstacle guard; empty if none."""
    # In the direction of motion, which may be backward or sideways.
    away = "" if drive.guard_distance_m is None else f"{max(0.0, drive.guard_distance_m):.1f}"
    match drive.guard:
        case "slowing":
            line = tr("Obstacle {distance} m away · slowing") if away else tr("Obstacle · slowing")
            return line.format(distance=away)
        case "blocked":
            line = tr("Blocked · obstacle {distance} m away") if away else tr("Blocked · obstacle")
            return line.format(distance=away)
        case "blind" if drive.guard_detail:
            return tr("The guard allows crawling only: {why}").format(why=tr(drive.guard_detail))
        case "blind":
            return tr("The guard allows crawl speed only: it sees nothing")
        case _:
            return ""


_MONTHS = (
    QT_TR_NOOP("Jan"), QT_TR_NOOP("Feb"), QT_TR_NOOP("Mar"), QT_TR_NOOP("Apr"), QT_TR_NOOP("May"), QT_TR_NOOP("Jun"),
    QT_TR_NOOP("Jul"), QT_TR_NOOP("Aug"), QT_TR_NOOP("Sep"), QT_TR_NOOP("Oct"), QT_TR_NOOP("Nov"), QT_TR_NOOP("Dec"),
)  # fmt: skip


def day_of(moment: datetime, *, with_year: bool) -> str:
    """Date as 21 Nov, or 21 Nov 2026."""
    text = tr("{day} {month} {year}") if with_year else tr("{day} {month}")
    return text.format(day=moment.day, month=tr(_MONTHS[moment.month - 1]), year=moment.year)


def camera_title(name: str) -> str:
    """A camera's name as a title: "Front camera" for front; empty for none."""
    words = _camera_words(name)
    words = words[:1].upper() + words[1:]
    return tr("{name} camera", "a title").format(name=words) if _has_no_kind(words) else words


def camera_in_text(name: str) -> str:
    """A camera's name within a sentence, after "the": "front camera" for front."""
    words = _camera_words(name)
    return tr("{name} camera", "in a sentence, after “the”").format(name=words) if _has_no_kind(words) else words


def camera_name(name: str) -> str:
    """Distinctive part of a camera's name: "Front" for front_camera."""
    words = _camera_words(name).removesuffix(" camera")
    return words[:1].upper() + words[1:]


def _camera_words(name: str) -> str:
    return name.replace("_", " ").strip()


def _has_no_kind(words: str) -> bool:
    return bool(words) and "camera" not in words.casefold()


def person_state(box: PersonBox) -> str:
    """State of a detected person in a word or two; nothing for the usual or unknown."""
    words = (
        tr("sitting") if box.posture == "sitting" else "",
        tr("hand raised") if box.hand_raised else "",
        tr("faces robot") if box.facing else "",
    )
    return " · ".join(word for word in words if word)


def no_picture(age_s: float | None, state: CameraState | None) -> str:
    """Placeholder text for a lost camera's image; ``state``: the camera's reported state."""
    if state is not None and state.state == "ended":
        return tr(state.detail) or tr("The camera stream has ended. A recording continues without it.")
    if age_s is None:
        lost = tr("No picture yet. The console is trying again.")
    else:
        lost = tr("No picture for {time}. The console is trying again.").format(time=age(age_s))
    reason = tr(state.detail) if state is not None and state.state in ("lost", "connecting") else ""
    return " ".join(filter(None, (lost, reason)))


def has_given_name(person: PersonRow) -> bool:
    """Whether the wizard named this person; others are labelled Person 1, Person 2, ..."""
    return bool(person.name) and not is_unnamed_label(person.name)


def person_name(person: PersonRow) -> str:
    return name_in_words(person.name) or tr("Person {number}").format(number=person.track)


def name_in_words(name: str) -> str:
    """The name, or a translated label for an unnamed person."""
    number = unnamed_number(name)
    return name if number is None else tr("Person {number}").format(number=number)


def percent(confidence: float) -> str:
    """Confidence as 82 %, at most 99 %: identification is never certain."""
    return f"{min(99, int(100 * confidence + 0.5))} %"


def maybe(person: PersonRow) -> str:
    """Suggested identity, as "Maybe Anna (82 %)"; empty if none."""
    if person.suggestion is None:
        return ""
    name, how_sure = name_in_words(person.suggestion.name), percent(person.suggestion.confidence)
    return tr("Maybe {name} ({percent})").format(name=name, percent=how_sure)


def on_box(person: PersonRow, yes_key: str = "") -> str:
    """Label of a person's box: the name, or "Anna? 82 % · Y" for a pending question."""
    if person.suggestion is None:
        return person_name(person)
    who = f"{name_in_words(person.suggestion.name)}? {percent(person.suggestion.confidence)}"
    return " · ".join(filter(None, (who, yes_key)))


NameOf = Callable[[str], str]
"""Maps a person id to a name."""


def with_names(text: str, name_of: NameOf) -> str:
    """Transcript text with names in place of recorded ids."""
    return person_marks.with_names(text, name_of)


def microphone_facts(microphone: MicrophoneStatus) -> str:
    """Source, name and problems of an open microphone."""
    wizard, name = microphone.role == "wizard", microphone.name
    if microphone.state == "failed":
        no = (
            tr("No microphone is picking you up: {why}")
            if wizard
            else tr("No microphone is picking up the participant: {why}")
        )
        return no.format(why=tr(microphone.detail))
    if microphone.source == ROBOT_MICROPHONE:
        return (
            tr("The robot's microphone is picking you up")
            if wizard
            else tr("The robot's microphone is picking up the participant")
        )
    if not name:
        return (
            tr("The system’s default microphone is picking you up")
            if wizard
            else tr("The system’s default microphone is picking up the participant")
        )
    return (
        tr("{microphone} is picking you up") if wizard else tr("{microphone} is picking up the participant")
    ).format(microphone=name)


def microphone(name: str) -> str:
    """Microphone name; the system default if empty."""
    return name or tr("System’s default microphone")


def models_offered(models: Iterable[ModelChoice]) -> list[tuple[str, str]]:
    """Title and name of each language model; where it runs, if its title does not end with that."""
    return [
        (each.title if each.title.endswith(each.where) else f"{each.title} · {each.where}", each.model)
        for each in models
    ]


def value_words(control: RobotControl, value: ControlValue) -> str:
    """The value as shown to the wizard: on, 62 %, Welcome."""
    for choice in control.choices:
        if choice.value == value and isinstance(choice.value, bool) == isinstance(value, bool):
            return choice.title
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return value or "empty"
    number = f"{value:.{_decimals(control, value)}f}"
    return f"{number} {control.unit}" if control.unit else number


def question_for(control: RobotControl, value: ControlValue) -> str:
    if control.kind == "button":
        return f"{control.title}?"
    if control.kind == "toggle":
        return f"{control.title} {'on' if value else 'off'}?"
    return f"{control.title}: {value_words(control, value)}?"


def _decimals(control: RobotControl, value: float) -> int:
    if control.step > 0:
        return len(f"{control.step:.3f}".rstrip("0").partition(".")[2])
    if control.kind != "slider" and float(value).is_integer():
        return 0
    size = control.highest - control.lowest if control.kind == "slider" else abs(value)
    return 0 if size >= 100 else 1 if size >= 10 else 2


_LINE_CHARACTERS = 70


def wrapped_tip(*texts: str) -> str:
    """Wrap ``texts``, each on a new line; empty ones are skipped. Qt wraps HTML tooltips only, these are plain text."""
    lines = "\n".join(filter(None, texts)).splitlines()
    return "\n".join(textwrap.fill(line, _LINE_CHARACTERS) for line in lines)


def set_wrapped_tip(widget: QWidget, *texts: str) -> None:
    """Set the tooltip; the accessible description has no line breaks."""
    widget.setToolTip(wrapped_tip(*texts))
    widget.setAccessibleDescription(" ".join(filter(None, texts)))
