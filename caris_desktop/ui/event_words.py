"""What happened, as a sentence of the log."""

from collections.abc import Mapping

from caris_desktop.domain import events, intents
from caris_desktop.domain.actor import CONSOLE, OTHER_WIZARD, WIZARD, Actor, in_words
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.ui.preflight.preflight_words import log_line
from caris_desktop.ui.words import NameOf, mark_sentence, missing, percent, shortened, with_detail, with_names

Category = str  # one of CATEGORIES
CATEGORIES = ("Said", "Moved", "People", "Session", "Problems")


def event_sentence(event: object, name_of: NameOf) -> tuple[Category, str] | None:
    """Category and sentence for the log; None for what only the recording needs."""
    told = _event_sentence(event, name_of)
    by = _by_whom(event)
    return told if told is None or not by else (told[0], f"{told[1]} · by {by}")


def _assistant_sentence(setting: str, name: str) -> str:
    match setting:
        case "model":
            return f"The assistant asks {name}"
        case "reset":
            return "The assistant is asked as the scenario says"
        case "role" | "style":
            return f"The assistant's {setting}: {name or 'none'}"
    return f"The assistant's {'notes' if setting == 'notes' else 'instructions'} were changed"


def _by_whom(event: object) -> str:
    """Who did it, where that is not this wizard, and no sentence about the console says why already."""
    actor: Actor = getattr(event, "actor", "")
    if actor.startswith(OTHER_WIZARD):
        return f"wizard {actor.removeprefix(OTHER_WIZARD)}"
    told = isinstance(event, events.AlarmChanged | events.DriveEnded | events.GuardChanged) or bool(
        getattr(event, "detail", "")
    )
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
            return "Problems", with_detail("The connection to the robot is unsteady", detail)
        case events.LinkChanged(state="lost", detail=detail):
            return "Problems", with_detail("The robot is out of reach", detail)
        case events.LinkChanged(state="closed"):
            return "Session", "The connection to the robot was closed"
        case events.DriveEnded(reason=reason):
            return "Moved", with_detail("Driving ended", reason)
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
            return ("Problems" if state == "failed" else "Moved"), with_detail(words[state], detail)
        case events.GuardChanged() | events.InitialPoseSet() | events.MapRequestChanged() | events.MappingChanged():
            return _navigation_sentence(event)
        case events.PlacesChanged(name=name, pose_in_map=pose):
            return "Session", f"Place {name} {'removed' if pose is None else 'saved'}"
        case events.ControlUsed():
            return _control_sentence(event)
        case events.GamepadChanged(name=name, connected=connected):
            return "Session", f"{name or 'The gamepad'} was {'plugged in' if connected else 'unplugged'}"
        case events.UtteranceChanged(speaker="robot", state="started", text=text):
            return "Said", f"Robot: “{shortened(with_names(text, name_of), 120)}”"
        case events.UtteranceChanged(speaker="robot", state="interrupted", text=text):
            return "Said", f"Cut short: “{shortened(with_names(text, name_of), 60)}”"
        case events.UtteranceChanged(speaker="robot", state="failed", text=text, detail=detail):
            return "Problems", with_detail(f"Not said: “{shortened(with_names(text, name_of), 60)}”", detail)
        case events.UtteranceChanged(speaker="participant", state="finished", text=text, person_id=person_id):
            who = name_of(person_id) if person_id else "Participant"
            return "Said", f"{who}: “{shortened(with_names(text, name_of), 120)}”"
        case events.UtteranceCorrected(text=str(text)):
            return "Said", f"Corrected: “{shortened(with_names(text, name_of), 120)}”"
        case events.LlmExchange(purpose="replies" | "actions"):
            return None  # what it came to is told of each suggestion and proposal
        case events.AssistantChanged(setting=setting, name=name):
            return "Session", _assistant_sentence(setting, name)
        case events.LlmExchange(outcome="answered", model=model):
            return "Said", f"The assistant answered ({model})"
        case events.LlmExchange(outcome="cancelled"):
            return "Said", "Question to the assistant cancelled"
        case events.LlmExchange(detail=detail):
            return "Problems", with_detail("The assistant gave no answer", detail)
        case events.ProposalChanged(state="displayed" | "counting", intent=intent, arguments=arguments):
            return "Said", f"Proposed: {_proposed(intent, arguments)}"
        case events.ProposalChanged(state="refused", detail=detail):
            return "Problems", with_detail("A proposal was refused", detail)
        case events.ProposalChanged(state=state, intent=intent, arguments=arguments):
            return "Said", f"Proposal {'rejected' if state == 'vetoed' else state}: {_proposed(intent, arguments)}"
        case events.LevelChanged(function=function, level=level):
            return "Session", f"{FUNCTIONS[function]}: {LEVELS[level].lower()}"
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
        case events.StepEntered() | events.ProtocolEnded() | events.StepTicked():
            return "Session", _step_sentence(event)
        case events.RecordingPaused(paused=paused):
            return "Session", "Recording paused" if paused else "Recording goes on"
        case events.PreflightChecked():
            return log_line(event)
        case events.RobotChosen(title=title):
            return "Session", f"Robot: {title}"
        case events.ScenarioOpened(title=title):
            return "Session", f"Scenario: {title}"
        case events.Gap(reason=events.OVERTAKEN):
            return None  # every second on a crowded machine
        case events.Gap(stream=stream, count=count, reason=reason):
            return "Problems", with_detail(missing(stream, count), reason)
        case events.Problem(severity=severity, what=what, meaning=meaning):
            return ("Session" if severity == "info" else "Problems"), f"{_sentence(what)} {meaning}".strip()
        case events.AlarmChanged(state="raised", told=False, what=what):
            return "Problems", what
        case events.AlarmChanged(state="ended", what=what, actor=actor):
            over = tr("Over: {problem}") if actor == CONSOLE else tr("Seen to: {problem}")
            return "Problems", over.format(problem=what)
        case events.SessionStarted(folder=folder):
            return "Session", f"Recording started ({folder})"
        case events.SessionEnded(folder=folder):
            return "Session", f"Recording ended ({folder})"
        case events.TrialResumed(folder=folder):
            return "Session", tr("The trial goes on after the unexpected end of {folder}").format(folder=folder)
        case events.PracticeStepEnded(number=number, done=done):
            text = tr("Practice: step {number} done") if done else tr("Practice: step {number} skipped")
            return "Session", text.format(number=number)
        case events.PracticeEnded(done=done, steps=steps, score=score):
            text = tr("Practice ended: {done} of {steps} steps, {score} of 100 points")
            return "Session", text.format(done=done, steps=steps, score=score)
        case events.ConfirmedAsBefore(what=what, person_id=person_id):
            of_one = tr("Confirmed: {name} is who the list says").format(name=name_of(person_id)) if person_id else ""
            return "Session", of_one or tr(CONFIRMED[what])
        case _:
            return None


CONFIRMED: dict[intents.AsBefore, str] = {
    "map": QT_TR_NOOP("Confirmed: the robot is where the map shows it"),
    "people": QT_TR_NOOP("Confirmed: people are who the list says"),
    "consent": QT_TR_NOOP("Confirmed: the participant agrees to go on"),
}

FUNCTIONS: dict[events.AssistedFunction, str] = {
    "replies": "Suggested replies",
    "fillers": "Filler when a reply is late",
    "actions": "Proposed actions",
}
LEVELS: dict[events.AssistanceLevel, str] = {
    "off": "Off",
    "suggest": "Suggest: my key does it",
    "act": "By itself, after a countdown",
}


def _proposed(intent: str, arguments: Mapping[str, float | str | bool]) -> str:
    """What is to be done, as the record has it."""
    what = {
        "GoToPlace": "go to",
        "LookAt": "look around",
        "Nod": "nod",
        "UseControl": "use",
        "TakePhoto": "take a photo",
    }
    named = [str(arguments[name]) for name in ("place", "control") if name in arguments]
    return " ".join((what.get(intent, intent), *named))


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


def _step_sentence(event: events.StepEntered | events.ProtocolEnded | events.StepTicked) -> str:
    match event:
        case events.ProtocolEnded():
            return tr("The protocol ended")
        case events.StepTicked(item=item, on=on):
            return (tr("Ticked off: {item}") if on else tr("Not done after all: {item}")).format(item=item)
        case events.StepEntered(number=number, title=title, branch=branch):
            if branch:
                return tr("Step {number}: {title} ({branch})").format(number=number, title=title, branch=branch)
            return tr("Step {number}: {title}").format(number=number, title=title)


def _navigation_sentence(
    event: events.GuardChanged | events.InitialPoseSet | events.MapRequestChanged | events.MappingChanged,
) -> tuple[Category, str] | None:
    match event:
        case events.GuardChanged(state="overridden"):
            return "Moved", "Obstacle guard switched off"
        case events.GuardChanged(state="blind", detail=detail):
            return "Problems", with_detail("The obstacle guard lets the robot crawl only", detail)
        case events.InitialPoseSet():
            return "Moved", "The robot was told where it is"
        case events.MapRequestChanged(operation="save" | "load" as operation, name=name, state=state, detail=detail):
            done = "saved" if operation == "save" else "loaded"
            if state == "failed":
                return "Problems", with_detail(f"The map {name} was not {done}", detail)
            return ("Session", f"The map {name} was {done}") if state == "succeeded" else None
        case events.MapRequestChanged(state="failed", detail=detail):
            return "Problems", with_detail("Mapping was not switched", detail)
        case events.MappingChanged(mapping=mapping) if mapping is not None:
            return "Session", "The robot builds the map" if mapping else "The robot keeps the map as it is"
        case _:
            return None


def _control_sentence(event: events.ControlUsed) -> tuple[Category, str] | None:
    """What a control did; of a slider, which is dragged, only what went wrong."""
    title = event.control.replace("_", " ")
    if event.state == "failed":
        return "Problems", with_detail(f"Robot: {title} did not work", event.detail)
    if event.state != "succeeded" or (isinstance(event.value, float) and not isinstance(event.value, bool)):
        return None
    value = "" if event.value is True else " off" if event.value is False else f" “{shortened(str(event.value))}”"
    return "Session", f"Robot: {title}{value}"


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
