"""Events as sentences of the log; texts of preflight checks."""

from collections.abc import Mapping, Sequence

from caris_desktop.domain import events, intents
from caris_desktop.domain.actor import CONSOLE, OTHER_WIZARD, WIZARD, Actor, in_words
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import PreflightChecked, PreflightState
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import PreflightCheck
from caris_desktop.recording.session.loss_messages import read_reason
from caris_desktop.ui.text_formatting import (
    NameOf,
    local_moment,
    mark_sentence,
    missing,
    percent,
    shortened,
    with_detail,
    with_label,
    with_names,
)

Category = str  # one of CATEGORIES
SAID, MOVED, PEOPLE = QT_TR_NOOP("Said"), QT_TR_NOOP("Moved"), QT_TR_NOOP("People")
SESSION, PROBLEMS = QT_TR_NOOP("Session"), QT_TR_NOOP("Problems")
CATEGORIES = (SAID, MOVED, PEOPLE, SESSION, PROBLEMS)


def event_sentence(event: object, name_of: NameOf) -> tuple[Category, str] | None:
    """Category and sentence of an event; None for events that only the recording needs."""
    sentence = _event_sentence(event, name_of)
    by = _by_whom(event)
    return (
        sentence
        if sentence is None or not by
        else (sentence[0], tr("{what} · by {whom}").format(what=sentence[1], whom=by))
    )


def _assistant_sentence(setting: str, name: str) -> str:
    match setting:
        case "model":
            return tr("The assistant uses {model}").format(model=name)
        case "reset":
            return tr("The assistant’s settings were reset to those of the scenario")
        case "role":
            return tr("The assistant's role: {role}").format(role=name) if name else tr("The assistant's role: none")
        case "style":
            return (
                tr("The assistant's style: {style}").format(style=name) if name else tr("The assistant's style: none")
            )
        case "notes":
            return tr("The assistant's notes were changed")
    return tr("The assistant's instructions were changed")


def _by_whom(event: object) -> str:
    """The actor if it is not this wizard, unless the sentence already names the console's reason."""
    actor: Actor = getattr(event, "actor", "")
    if actor.startswith(OTHER_WIZARD):
        return tr("wizard {name}").format(name=actor.removeprefix(OTHER_WIZARD))
    not_sent = isinstance(event, events.AlarmChanged | events.DriveEnded | events.GuardChanged) or bool(
        getattr(event, "detail", "")
    )
    if actor in ("", WIZARD) or (actor == CONSOLE and not_sent):
        return ""
    whom = in_words(actor)
    return tr(whom)


def _event_sentence(event: object, name_of: NameOf) -> tuple[Category, str] | None:
    match event:
        case events.LinkChanged(link="media", state=state):
            return (PROBLEMS, tr("The camera and map connection was lost")) if state == "lost" else None
        case events.LinkChanged(state="connected"):
            return SESSION, tr("The robot is connected")
        case events.LinkChanged(state="connecting"):
            return SESSION, tr("Connecting to the robot")
        case events.LinkChanged(state="trouble", detail=detail):
            return PROBLEMS, with_detail(tr("The connection to the robot is unstable"), detail)
        case events.LinkChanged(state="lost", detail=detail):
            return PROBLEMS, with_detail(tr("The robot is unreachable"), detail)
        case events.LinkChanged(state="closed"):
            return SESSION, tr("The connection to the robot was closed")
        case events.DriveEnded(reason=reason):
            return MOVED, with_detail(tr("Driving ended"), reason)
        case events.StopRequested():
            return MOVED, tr("Stop")
        case events.EmergencyStopChanged(latched=latched, by=by):
            if by == "wizard":
                return MOVED, tr("Emergency stop activated") if latched else tr("Emergency stop released")
            return MOVED, tr("Emergency stop activated by the robot") if latched else tr(
                "Emergency stop released by the robot"
            )
        case events.GoalChanged(state=state, place=place, detail=detail):
            if state not in _GOALS:
                return None
            sentence = tr(_GOALS[state]).format(place=place or tr("the chosen point"))
            return (PROBLEMS if state == "failed" else MOVED), with_detail(sentence, detail)
        case events.MovementChanged(state=state, publishers=publishers) if state in _MOVEMENTS:
            return PROBLEMS, with_label(tr(_MOVEMENTS[state]), ", ".join(publishers))
        case events.GuardChanged() | events.InitialPoseSet() | events.MapRequestChanged() | events.MappingChanged():
            return _navigation_sentence(event)
        case events.PlacesChanged(name=name, pose_in_map=pose):
            sentence = tr("Place {place} removed") if pose is None else tr("Place {place} saved")
            return SESSION, sentence.format(place=name)
        case events.ControlUsed():
            return _control_sentence(event)
        case events.GamepadChanged(name=name, connected=connected):
            sentence = tr("{gamepad} was plugged in") if connected else tr("{gamepad} was unplugged")
            return SESSION, sentence.format(gamepad=name or tr("The gamepad"))
        case events.UtteranceChanged(speaker="robot", state="started", text=text):
            return SAID, tr("Robot: “{text}”").format(text=shortened(with_names(text, name_of), 120))
        case events.UtteranceChanged(speaker="robot", state="interrupted", text=text):
            return SAID, tr("Cut short: “{text}”").format(text=shortened(with_names(text, name_of), 60))
        case events.UtteranceChanged(speaker="robot", state="failed", text=text, detail=detail):
            sentence = tr("Not said: “{text}”").format(text=shortened(with_names(text, name_of), 60))
            return PROBLEMS, with_detail(sentence, detail)
        case events.UtteranceChanged(speaker="participant", state="finished", text=text, person_id=person_id):
            who = name_of(person_id) if person_id else tr("Participant")
            return SAID, tr("{who}: “{text}”").format(who=who, text=shortened(with_names(text, name_of), 120))
        case events.UtteranceCorrected(text=str(text)):
            return SAID, tr("Corrected: “{text}”").format(text=shortened(with_names(text, name_of), 120))
        case events.LlmExchange(purpose="replies" | "actions"):
            return None  # reported with each suggestion and proposal instead
        case events.AssistantChanged(setting=setting, name=name):
            return SESSION, _assistant_sentence(setting, name)
        case events.LlmExchange(outcome="answered", model=model):
            return SAID, tr("The assistant answered ({model})").format(model=model)
        case events.LlmExchange(outcome="cancelled"):
            return SAID, tr("The question to the assistant was cancelled")
        case events.LlmExchange(detail=detail):
            return PROBLEMS, with_detail(tr("The assistant gave no answer"), detail)
        case events.ProposalChanged(state="displayed" | "counting", intent=intent, arguments=arguments):
            return SAID, tr("Proposed: {act}").format(act=_proposed(intent, arguments))
        case events.ProposalChanged(state="refused", detail=detail):
            return PROBLEMS, with_detail(tr("A proposal was refused"), detail)
        case events.ProposalChanged(state=state, intent=intent, arguments=arguments):
            return SAID, tr(_PROPOSALS[state]).format(act=_proposed(intent, arguments))
        case events.LevelChanged(function=function, level=level):
            sentence = tr("{function}: {level}")
            return SESSION, sentence.format(function=tr(FUNCTIONS[function]), level=tr(LEVELS[level]))
        case events.PersonAppeared(person_id=person_id):
            return PEOPLE, tr("{person} came into view").format(person=name_of(person_id))
        case events.PersonLeft(person_id=person_id):
            return PEOPLE, tr("{person} left").format(person=name_of(person_id))
        case events.PersonRenamed(person_id=person_id):
            return PEOPLE, tr("Named {person}").format(person=name_of(person_id))
        case (
            events.PersonSuggested() | events.PersonIdentified() | events.PersonRejected() | events.PersonDescribed()
            | events.PeopleMerged() | events.PersonSplit() | events.ConsentNoted() | events.PeopleUndone()
            | events.PersonForgotten()
        ):  # fmt: skip
            return PEOPLE, _about_people(event, name_of)
        case events.PhotoTaken(file_name=file_name):
            return SESSION, tr("Photo taken ({file})").format(file=file_name.rsplit("/", 1)[-1])
        case events.PhotoTagged(file_name=file_name, tags=tags):
            sentence = tr("Photo tagged ({file}: {tags})")
            return SESSION, sentence.format(file=file_name.rsplit("/", 1)[-1], tags=", ".join(tags) or tr("no tags"))
        case events.PhotoDeleted(file_name=file_name, restored=restored):
            sentence = tr("Photo restored ({file})") if restored else tr("Photo deleted ({file})")
            return SESSION, sentence.format(file=file_name.rsplit("/", 1)[-1])
        case events.Marked():
            return SESSION, mark_sentence(event)
        case events.StepEntered() | events.ProtocolEnded() | events.StepTicked():
            return SESSION, _step_sentence(event)
        case events.RecordingPaused(paused=paused):
            return SESSION, tr("Recording paused") if paused else tr("Recording resumed")
        case events.PreflightChecked():
            return check_line(event)
        case events.RobotChosen(title=title):
            return SESSION, tr("Robot: {name}").format(name=title)
        case events.ScenarioOpened(title=title):
            return SESSION, tr("Scenario: {title}").format(title=title)
        case events.Gap(reason=events.OVERTAKEN | events.LOST_ON_THE_WAY):
            return None  # occurs every second on a busy machine
        case events.Gap(stream=stream, count=count, reason=reason):
            return PROBLEMS, with_detail(missing(stream, count), read_reason(reason))
        case events.Problem(severity=severity, what=what, meaning=meaning):
            return (SESSION if severity == "info" else PROBLEMS), f"{_sentence(what)} {meaning}".strip()
        case events.AlarmChanged(state="raised", told=False, what=what):
            return PROBLEMS, what
        case events.AlarmChanged(state="ended", what=what, actor=actor):
            over = tr("Ended: {problem}") if actor == CONSOLE else tr("Dismissed: {problem}")
            return PROBLEMS, over.format(problem=what)
        case events.SessionStarted(folder=folder):
            return SESSION, tr("Recording started ({folder})").format(folder=folder)
        case events.SessionEnded(folder=folder):
            return SESSION, tr("Recording ended ({folder})").format(folder=folder)
        case events.TrialResumed(folder=folder):
            return SESSION, tr("The trial resumed after {folder} ended unexpectedly").format(folder=folder)
        case events.PracticeStepEnded(number=number, done=done):
            text = tr("Practice: step {number} done") if done else tr("Practice: step {number} skipped")
            return SESSION, text.format(number=number)
        case events.PracticeEnded(done=done, steps=steps, score=score):
            text = tr("Practice ended: {done} of {steps} steps, {score} of 100 points")
            return SESSION, text.format(done=done, steps=steps, score=score)
        case events.ConfirmedAsBefore(what="people", person_id=person_id) if person_id:
            return SESSION, tr("Confirmed: {name} is identified correctly").format(name=name_of(person_id))
        case events.ConfirmedAsBefore(what=what):
            return SESSION, tr(CONFIRMED[what])
        case _:
            return None


CONFIRMED: dict[intents.AsBefore, str] = {
    "map": QT_TR_NOOP("Confirmed: the robot is where the map shows it"),
    "people": QT_TR_NOOP("Confirmed: people are identified correctly"),
    "permissions": QT_TR_NOOP("Confirmed: permissions of the recording and the language model"),
    "consent": QT_TR_NOOP("Confirmed: the participant agrees to continue"),
}

FUNCTIONS: dict[events.AssistedFunction, str] = {
    "replies": QT_TR_NOOP("Suggested replies"),
    "fillers": QT_TR_NOOP("Filler when a reply is late"),
    "actions": QT_TR_NOOP("Proposed actions"),
}
LEVELS: dict[events.AssistanceLevel, str] = {
    "off": QT_TR_NOOP("Off"),
    "suggest": QT_TR_NOOP("Suggest (I confirm by key)"),
    "act": QT_TR_NOOP("Automatic (after a countdown)"),
}


def _proposed(intent: str, arguments: Mapping[str, float | str | bool]) -> str:
    """Proposed action as text, from the recorded intent and arguments."""
    match intent:
        case "GoToPlace":
            return tr("go to {place}").format(place=arguments.get("place", ""))
        case "LookAt":
            return tr("look around")
        case "Nod":
            return tr("nod")
        case "UseControl":
            return tr("use {control}").format(control=arguments.get("control", ""))
        case "TakePhoto":
            return tr("take a photo")
    return intent


_GOALS = {
    "requested": QT_TR_NOOP("Going to {place}"),
    "reached": QT_TR_NOOP("Arrived at {place}"),
    "cancelled": QT_TR_NOOP("Going to {place} was cancelled"),
    "failed": QT_TR_NOOP("Could not reach {place}"),
}
_MOVEMENTS = {
    "uncommanded": QT_TR_NOOP("The robot is moving without a command from this console"),
    "commanded_elsewhere": QT_TR_NOOP("Another source is sending drive commands to the robot"),
    "not_following": QT_TR_NOOP("The robot is not following the drive commands"),
    "silent": QT_TR_NOOP("No odometry received"),
}
_PROPOSALS = {
    "confirmed": QT_TR_NOOP("Proposal confirmed: {act}"),
    "vetoed": QT_TR_NOOP("Proposal rejected: {act}"),
    "lapsed": QT_TR_NOOP("Proposal expired: {act}"),
}
_DETAILS = {
    "group": QT_TR_NOOP("The group of {person} was changed"),
    "tags": QT_TR_NOOP("The tags of {person} were changed"),
    "note": QT_TR_NOOP("The note about {person} was changed"),
}
CONSENTS: dict[events.ConsentKind, str] = {
    "face": QT_TR_NOOP("being recognised by face"),
    "photo": QT_TR_NOOP("photos"),
    "video": QT_TR_NOOP("video recording"),
    "sound": QT_TR_NOOP("sound recording"),
}
_UNDONE = {
    "named": QT_TR_NOOP("Undone: naming a person"),
    "group": QT_TR_NOOP("Undone: changing a group"),
    "tags": QT_TR_NOOP("Undone: changing tags"),
    "note": QT_TR_NOOP("Undone: changing a note"),
    "identified": QT_TR_NOOP("Undone: identifying a person"),
    "rejected": QT_TR_NOOP("Undone: rejecting an identity"),
    "merged": QT_TR_NOOP("Undone: merging two people"),
    "split": QT_TR_NOOP("Undone: splitting a person"),
    "consent": QT_TR_NOOP("Undone: changing a consent"),
}
DECISIONS_ABOUT_PEOPLE = (
    events.PersonRenamed, events.PersonIdentified, events.PersonRejected, events.PersonDescribed, events.PeopleMerged,
    events.PersonSplit, events.ConsentNoted,
)  # fmt: skip
"""Decisions that can be undone."""


def _about_people(event: object, name_of: NameOf) -> str:
    match event:
        case events.PersonSuggested(person_id=person_id, is_person_id=other, confidence=confidence):
            sentence = tr("{person} may be {other} ({likelihood})")
            return sentence.format(person=name_of(person_id), other=name_of(other), likelihood=percent(confidence))
        case events.PersonIdentified(is_person_id=other, by="console", confidence=confidence):
            return tr("{person} recognised ({likelihood})").format(
                person=name_of(other), likelihood=percent(confidence)
            )
        case events.PersonIdentified(is_person_id=other):
            return tr("{person} confirmed").format(person=name_of(other))
        case events.PersonRejected(is_person_id=other):
            return tr("Not {person}: a different person").format(person=name_of(other))
        case events.PersonDescribed(person_id=person_id, detail=detail):
            return tr(_DETAILS[detail]).format(person=name_of(person_id))
        case events.PeopleMerged(into_person_id=into):
            return tr("Merged into one person: {person}").format(person=name_of(into))
        case events.PersonSplit(person_id=person_id, from_person_id=other):
            sentence = tr("Split: {person} and {other} are two people")
            return sentence.format(person=name_of(person_id), other=name_of(other))
        case events.ConsentNoted(person_id=person_id, kind=kind, given=given):
            sentence = tr("{person} agrees to {kind}") if given else tr("{person} no longer agrees to {kind}")
            return sentence.format(person=name_of(person_id), kind=tr(CONSENTS[kind]))
        case events.PeopleUndone(decision=decision):
            return tr(_UNDONE[decision])
        case _:
            return tr("A person was erased")


def _step_sentence(event: events.StepEntered | events.ProtocolEnded | events.StepTicked) -> str:
    match event:
        case events.ProtocolEnded():
            return tr("The protocol ended")
        case events.StepTicked(item=item, on=on):
            return (tr("Ticked off: {item}") if on else tr("Unticked: {item}")).format(item=item)
        case events.StepEntered(number=number, title=title, branch=branch):
            if branch:
                return tr("Step {number}: {title} ({branch})").format(number=number, title=title, branch=branch)
            return tr("Step {number}: {title}").format(number=number, title=title)


def _navigation_sentence(
    event: events.GuardChanged | events.InitialPoseSet | events.MapRequestChanged | events.MappingChanged,
) -> tuple[Category, str] | None:
    match event:
        case events.GuardChanged(state="overridden"):
            return MOVED, tr("Obstacle guard turned off")
        case events.GuardChanged(state="blind", detail=detail):
            return PROBLEMS, with_detail(tr("The obstacle guard allows crawl speed only"), detail)
        case events.InitialPoseSet():
            return MOVED, tr("The robot’s position was set")
        case events.MapRequestChanged(operation="save" | "load" as operation, name=name, state=state, detail=detail):
            save = operation == "save"
            if state == "failed":
                sentence = tr("The map {map} was not saved") if save else tr("The map {map} was not loaded")
                return PROBLEMS, with_detail(sentence.format(map=name), detail)
            sentence = tr("The map {map} was saved") if save else tr("The map {map} was loaded")
            return (SESSION, sentence.format(map=name)) if state == "succeeded" else None
        case events.MapRequestChanged(state="failed", detail=detail):
            return PROBLEMS, with_detail(tr("The mapping mode was not changed"), detail)
        case events.MappingChanged(mapping=mapping) if mapping is not None:
            return SESSION, tr("The robot is building the map") if mapping else tr(
                "The robot only localises and does not change the map"
            )
        case _:
            return None


def _control_sentence(event: events.ControlUsed) -> tuple[Category, str] | None:
    """Sentence about a control; for a slider, which is dragged, only failures."""
    title = event.control.replace("_", " ")
    if event.state == "failed":
        return PROBLEMS, with_detail(tr("Robot: {control} failed").format(control=title), event.detail)
    if event.state != "succeeded" or (isinstance(event.value, float) and not isinstance(event.value, bool)):
        return None
    if event.value is True:
        return SESSION, tr("Robot: {control}").format(control=title)
    if event.value is False:
        return SESSION, tr("Robot: {control} off").format(control=title)
    return SESSION, tr("Robot: {control} “{value}”").format(control=title, value=shortened(str(event.value)))


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."


CHECK_STATES: dict[PreflightState, str] = {
    "not checked": QT_TR_NOOP("Not checked"),
    "pending": QT_TR_NOOP("Pending"),
    "minor": QT_TR_NOOP("Minor"),
    "major": QT_TR_NOOP("Major"),
    "passed": QT_TR_NOOP("Passed"),
}
_BEGAN_WITH: dict[PreflightState, str] = {
    "not checked": QT_TR_NOOP("Started with: {check} (not checked)"),
    "pending": QT_TR_NOOP("Started with: {check} (pending)"),
    "minor": QT_TR_NOOP("Started with: {check} (minor)"),
    "major": QT_TR_NOOP("Started with: {check} (major)"),
}
_BEGAN_IN_SPITE_OF: dict[PreflightState, str] = {
    "not checked": QT_TR_NOOP("Started despite: {check} (not checked)"),
    "pending": QT_TR_NOOP("Started despite: {check} (pending)"),
    "minor": QT_TR_NOOP("Started despite: {check} (minor)"),
    "major": QT_TR_NOOP("Started despite: {check} (major)"),
}
CHECK_ROLES: dict[PreflightState, str] = {
    "not checked": "dim", "pending": "dim", "minor": "amber", "major": "red", "passed": "green",
}  # fmt: skip
CHECK_ICONS: dict[PreflightState, str] = {
    "not checked": "circle-dashed", "pending": "hourglass", "minor": "warning", "major": "warning-octagon",
    "passed": "check-circle",
}  # fmt: skip
_WORST_FIRST: tuple[PreflightState, ...] = ("major", "minor", "not checked", "pending", "passed")


def worst_check(checks: Sequence[PreflightCheck]) -> PreflightState:
    """Worst state of all checks."""
    return min((check.state for check in checks), key=_WORST_FIRST.index, default="passed")


def checks_summary(checks: Sequence[PreflightCheck], *, past: bool = False) -> str:
    """Summary as "3 of 12 to check", or for a ``past`` recording "3 of 12 checks were open"."""
    still_open = sum(check.state != "passed" for check in checks)
    if not still_open:
        return tr("All %n checks passed", "", len(checks))
    text = (
        tr("{open} of %n checks were open", "", len(checks)) if past else tr("{open} of %n to check", "", len(checks))
    )
    return text.format(open=still_open)


def open_checks(checks: Sequence[PreflightCheck]) -> str:
    """Question before a recording that starts with open checks."""
    titles = [tr(check.title) for check in checks if check.asks_first]
    named = ", ".join(f"“{title}”" for title in titles[:3])
    if len(titles) > 3:
        named = tr("{some} and %n more", "", len(titles) - 3).format(some=named)
    return tr("Not ready: {checks}. Start anyway? The recording will note this.").format(checks=named)


def check_state(check: PreflightCheck, anchor: ClockAnchor) -> str:
    """State of a check; for a manual one, by whom and when it was ticked."""
    if not check.manual or check.checked_ns is None:
        return _as_sentence(tr(check.detail))
    moment = local_moment(anchor.utc_ns_at(check.checked_ns)).strftime("%H:%M")
    if check.actor == WIZARD:
        return tr("Ticked by you at {moment}.").format(moment=moment)
    return tr("Ticked by {who} at {moment}.").format(who=in_words(check.actor), moment=moment)


def _as_sentence(detail: str) -> str:
    """Capitalise a status reason, which elsewhere follows a colon."""
    return f"{detail[:1].upper()}{detail[1:].removesuffix('.')}." if detail else ""


def check_line(event: PreflightChecked) -> tuple[str, str] | None:
    """Log line of a check; None if it had passed when a recording began."""
    if not event.at_start:
        text = tr("Checked: {check}") if event.state == "passed" else tr("No longer checked: {check}")
    elif event.state == "passed":
        return None
    else:
        text = tr((_BEGAN_IN_SPITE_OF if event.accepted else _BEGAN_WITH)[event.state])
    return QT_TR_NOOP("Session"), text.format(check=tr(event.title))
