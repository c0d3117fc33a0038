"""Methods paragraph of a paper; parts in square brackets are for the researcher to fill in."""

import json
from collections.abc import Iterable

from caris_desktop.recording.exporters.drawings import duration_text
from caris_desktop.recording.exporters.html import distance_text, model_name
from caris_desktop.recording.exporters.methods_facts import StudyFacts
from caris_desktop.recording.exporters.methods_words import (
    SEEN,
    distinct,
    listing,
    listing_counts,
    number_of,
    number_word,
    settings_words,
    share_words,
    statistics_words,
    times_word,
    was_or_were,
)
from caris_desktop.recording.studies.measures import ModelUse, SummaryStats, model_asked, per_10_min


def paragraph(study: StudyFacts) -> str:
    """Complete sentences that the recording supports; others are left out."""
    return " ".join(sentence for sentence in _sentences(study) if sentence)


def _sentences(study: StudyFacts) -> Iterable[str]:
    sessions = number_of(len(study.known), "session")
    people = distinct(one.session.trial.get("participant", "") for one in study.known)
    wizards = study.wizards()
    robots = distinct(name for one in study.known for name in one.robots)
    recorded_s = study.recorded_s()
    versions = distinct(str(one.session.header.get("program_version", "")) for one in study.known)
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
    shown = [words for stream, words in SEEN[:5] if any(stream in one.streams for one in study.known)]
    if shown:
        yield f"The console showed {listing(shown)}."
    origins = study.counted(lambda m: m.origins)
    whole = sum(origins.values())
    if whole:
        yield f"The robot made {number_of(whole, 'utterance')} ({share_words(origins)})."
    response = SummaryStats.of(study.responses())
    if response is not None:
        yield (
            "The median time from the end of a participant's utterance to the robot's next words was"
            f" {response.median:.2f} s ({statistics_words(response)})."
        )
    yield _movement_sentence(study)
    for model in study.models:
        yield _model_sentence(study, model)
    errors = study.counted(lambda m: m.errors)
    count = sum(errors.values())
    marker = "The wizard" if len(wizards) <= 1 else "The wizards"
    rate = per_10_min(count, recorded_s)
    if count:
        kinds = listing_counts({label or "not specified": number for label, number in errors.items()})
        yield (f"{marker} marked {number_of(count, 'error')} of their own ({kinds}; {rate or 0.0:.1f} per 10 minutes).")
    else:
        yield f"{marker} marked no errors of their own."
    lost = sum(sum(one.measures.lost.values()) for one in study.known)
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
    driven_s = sum(one.measures.driving.driving_s for one in study.known)
    goals = study.counted(lambda m: m.driving.goals)
    count, reached = sum(goals.values()), goals.get("reached", 0)
    ways = [one.measures.driving.distance_m for one in study.known if one.measures.driving.distance_m is not None]
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


def _model_sentence(study: StudyFacts, model: ModelUse) -> str:
    name = model_name(model)
    settings = distinct(
        json.dumps(exchange.parameters, sort_keys=True)
        for one in study.known
        for exchange in one.exchanges
        if model_asked(exchange) == (model.provider, model.model, model.version, model.place)
    )
    shown = f"; {'; '.join(map(settings_words, settings))}" if settings and settings != ["{}"] else ""
    inside = name[:-1] + f"{shown})" if name.endswith(")") else f"{name}{f' ({shown[2:]})' if shown else ''}"
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
