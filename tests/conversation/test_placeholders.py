"""Placeholders in robot speech."""

import pytest

from caris_desktop.conversation.spoken_text import Words, fill_placeholders, gaps, missing

ADA = Words("Ada", "{p-12}")


def nobody(_person_id: str) -> str:
    return "nobody"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Hello, {name}! This is {place}. Right, {name}?", ("name", "place")),
        ("See you on {day of the week}.", ("day of the week",)),
        ("Hello, {p-12}.", ()),
        ("{Name} {} { name} {name", ()),
        ("Braces { in } text", ()),
    ],
)
def test_gaps_are_small_words_in_braces(text: str, found: tuple[str, ...]) -> None:
    assert gaps(text) == found


def test_a_name_is_spoken_and_its_mark_is_recorded() -> None:
    words = fill_placeholders("Hello, {name}! Hello, {name}.", {"name": ADA}, nobody)
    assert words == Words("Hello, Ada! Hello, Ada.", "Hello, {p-12}! Hello, {p-12}.")


def test_a_mark_is_spoken_as_the_name_of_now() -> None:
    assert fill_placeholders("Bye, {p-7}.", {}, lambda person_id: {"p-7": "Luis"}[person_id]) == Words(
        "Bye, Luis.", "Bye, {p-7}."
    )


def test_a_placeholder_without_text_is_missing_and_stays() -> None:
    assert missing("{name}, the {place} is on {day}.", {"name": ADA}) == ("place", "day")
    assert fill_placeholders("{name}: {day}", {"name": ADA}, nobody).spoken == "Ada: {day}"


def test_words_that_look_like_a_gap_are_not_filled_again() -> None:
    assert fill_placeholders("{day}", {"day": Words("{name}", "{name}"), "name": ADA}, nobody) == Words(
        "{name}", "{name}"
    )
