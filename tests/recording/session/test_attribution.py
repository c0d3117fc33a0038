"""Attribution of participants' utterances: to the only person present, by the console, or by a wizard."""

from dataclasses import replace

import pytest

from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected
from caris_desktop.recording.session.session_conversation import SpokenUtterance, UtteranceEvent, spoken_utterances
from caris_desktop.recording.session.session_visits import Visit

ANA, BEN = Visit("p-ana", 1, 0, 10_000), Visit("p-ben", 2, 0, 10_000)
SAID = (
    UtteranceChanged(1_000, "h-1", "participant", "", "heard", "started"),
    UtteranceChanged(2_000, "h-1", "participant", "Hello.", "heard", "finished"),
)


def said(*visits: Visit, events: tuple[UtteranceEvent, ...] = SAID) -> SpokenUtterance:
    (utterance,) = spoken_utterances(events, ended_ns=20_000, visits=visits)
    return utterance


def corrected(**changes: object) -> UtteranceCorrected:
    return UtteranceCorrected(3_000, "h-1", **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("visits", "who", "confidence"),
    [
        ((ANA,), "p-ana", 0.78),
        ((replace(ANA, start_ns=1_100),), "p-ana", 0.702),
        ((replace(ANA, end_ns=1_500), replace(ANA, start_ns=1_600)), "p-ana", 0.702),
        ((replace(ANA, start_ns=1_500),), "", None),
        ((ANA, BEN), "", None),
        ((ANA, replace(BEN, start_ns=1_999)), "", None),
        ((ANA, replace(BEN, start_ns=2_000)), "p-ana", 0.78),
        ((), "", None),
    ],
)
def test_a_person_alone_is_the_speaker(visits: tuple[Visit, ...], who: str, confidence: float | None) -> None:
    utterance = said(*visits)
    assert (utterance.person_id, utterance.person_confidence) == (who, confidence)
    assert utterance.person_by == ("record" if who else "")


def test_decisions_of_console_and_wizard_stay() -> None:
    by_console = corrected(person_id="p-ben", actor=CONSOLE, person_confidence=0.83)
    utterance = said(ANA, events=(*SAID, by_console))
    assert (utterance.person_id, utterance.person_by, utterance.person_confidence) == ("p-ben", CONSOLE, 0.83)
    by_wizard = corrected(person_id="p-cyd", actor="wizard:Ann")
    # The later one of the console does not override the wizard's.
    utterance = said(ANA, events=(*SAID, by_wizard, by_console))
    assert (utterance.person_id, utterance.person_by, utterance.person_confidence) == ("p-cyd", "wizard:Ann", None)


def test_a_wizard_who_is_not_sure_is_not_overruled() -> None:
    utterance = said(ANA, events=(*SAID, corrected(person_id="", actor="wizard")))
    assert (utterance.person_id, utterance.person_by) == ("", "wizard")


def test_words_of_the_robot_or_the_wizard_are_nobodys_of_the_people() -> None:
    robots = tuple(replace(event, speaker="robot", origin="typed") for event in SAID)
    assert said(ANA, events=robots).person_id == ""
    assert said(ANA, events=(*SAID, corrected(speaker="wizard", person_id="", actor=CONSOLE))).person_id == ""
    failed = (SAID[0], replace(SAID[1], state="failed", text=""))
    assert said(ANA, events=failed).person_id == ""
