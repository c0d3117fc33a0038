"""English messages in a recording are translated into the language of the replay's user."""

import json
import re

import pytest

from caris_desktop.domain.recorded_messages import EARLIER_PATH, TEXTS_PATH, parse_recorded, retranslate
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, localized, tr

TEXTS: list[str] = json.loads(TEXTS_PATH.read_text("utf-8"))
EARLIER: dict[str, str] = json.loads(EARLIER_PATH.read_text("utf-8"))
VALUES = ("7A", "B8", "9C", "D6", "5E", "F4", "3G", "H2")


def names_in(text: str) -> list[str]:
    return list(dict.fromkeys(part.partition("}")[0] for part in text.split("{")[1:]))


def recorded(text: str) -> LocalizedText:
    """Message of a process, with a value for each placeholder."""
    values = dict(zip(names_in(text), VALUES, strict=False))
    return LocalizedText(text, {**({"%n": "5"} if "%n" in text else {}), **values})


def test_in_english_it_stays_what_it_is() -> None:
    assert type(retranslate("no fresh LIDAR for 1.5 s")) is str


@pytest.mark.usefixtures("trial_language")
def test_a_reason_is_translated_with_its_values() -> None:
    why = localized(QT_TR_NOOP("no fresh {stream} for {age} s"), stream=QT_TR_NOOP("LIDAR"), age="1.5")
    kept = str.__str__(json.loads(json.dumps(why)))
    assert tr(retranslate(kept)) == tr(why) != kept


@pytest.mark.usefixtures("trial_language")
@pytest.mark.parametrize(
    "words",
    [
        "",
        "Ana wrote this by hand",
        "7.5",
        "/cmd_vel",
        "Ana. " * 200 + "broke off.",
        ". ".join(map(str, range(100, 190))),
    ],
)
def test_a_text_that_is_not_the_programs_stays(words: str) -> None:
    assert type(retranslate(words)) is str


@pytest.mark.usefixtures("trial_language")
def test_every_text_is_found_again() -> None:
    lost = []
    for text in TEXTS:
        if names_in(text) or "%n" in text:
            why = recorded(text)
            again = retranslate(str.__str__(json.loads(json.dumps(why))))
            if _shape(again) != _shape(why):
                lost.append(text)
    assert lost == []


def _shape(why: str) -> str:
    """Text with anonymous placeholders: texts that differ only in placeholder names are equal."""
    return re.sub(r"\{\w+\}", "{}", why.template) if isinstance(why, LocalizedText) else ""


def test_an_earlier_wording_has_a_present_one_with_the_same_values() -> None:
    assert set(EARLIER.values()) <= set(TEXTS) and not set(EARLIER) & set(TEXTS)
    for before, now in EARLIER.items():
        assert set(names_in(before)) == set(names_in(now)) and ("%n" in before) == ("%n" in now), before


@pytest.mark.usefixtures("trial_language")
def test_sentences_of_older_sessions_are_translated_in_their_present_wording() -> None:
    lost = []
    for before, now in EARLIER.items():
        if names_in(before) or "%n" in before:
            read = parse_recorded(str.__str__(recorded(before)), (now,))
            if _shape(read) != _shape(recorded(now)):
                lost.append(before)
    assert lost == []
