"""Phrases of a scenario file: plain, with actions, and in groups."""

from pathlib import Path

import pytest

from caris_desktop.scenario.phrases import Phrase, PhraseGroup, PhraseKeys, phrase_groups
from caris_desktop.scenario.scenario_file import ScenarioError, parse_scenario, scenario_data

HEAD = "version: 1\ntitle: T\nlayout: {panel: speak}\n"
FILE = (
    HEAD
    + """phrases:
  - Hello, {name}!
  - {say: Goodbye., key: Ctrl+G, gesture: wave, face: happy}
  - group: Questions
    phrases: ["How are you?", {say: "Any pain?", key: Ctrl+Shift+G}]
"""
)


def read(text: str) -> tuple[object, ...]:
    return parse_scenario(text, path=Path("x.yaml")).phrases


def test_each_notation_is_read_and_written_as_it_was() -> None:
    wave = Phrase("Goodbye.", "Ctrl+G", "wave", "happy")
    pain = Phrase("Any pain?", "Ctrl+Shift+G")
    scenario = parse_scenario(FILE, path=Path("x.yaml"))
    assert scenario.phrases == ("Hello, {name}!", wave, PhraseGroup("Questions", ("How are you?", pain)))
    assert scenario_data(scenario)["phrases"][2]["phrases"] == [
        "How are you?",
        {"say": "Any pain?", "key": "Ctrl+Shift+G"},
    ]
    assert phrase_groups(scenario.phrases) == (
        PhraseKeys("", (Phrase("Hello, {name}!"), wave)),
        PhraseKeys("Questions", (Phrase("How are you?"), pain)),
    )


def test_without_loose_phrases_there_are_only_the_groups() -> None:
    assert [group.title for group in phrase_groups((PhraseGroup("A", ("x",)), PhraseGroup("B", ("y",))))] == ["A", "B"]
    assert phrase_groups(()) == ()


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("Ctrl+G,", "Ctrl+C,", "line 6: 'phrases[2].key' is 'Ctrl+C'. Allowed: Ctrl or Ctrl+Shift with a letter"),
        ("Ctrl+G,", "F4,", "line 6: 'phrases[2].key' is 'F4'. Allowed: "),
        ("Ctrl+Shift+G", "Ctrl+G", "line 8: the key Ctrl+G is already assigned to 'Goodbye.'."),
        ("  - Hello, {name}!\n", "  - Hello.\n" * 8, "line 13: more than 8 phrases without a group"),
        (
            "  - Hello, {name}!\n",
            "  - {group: questions, phrases: [A]}\n",
            "line 7: duplicate group 'Questions'",
        ),
        ("group: Questions", "grup: Questions", "line 7: unknown key 'grup' in 'phrases[3]'. Allowed: group, phrases."),
        ("Hello, {name}!", "5", "line 5: 'phrases[1]' must be text, found 5."),
        ("How are you?", "", "line 8: 'phrases[3].phrases[1]' is empty."),
    ],
)
def test_a_mistake_is_reported_where_it_is(before: str, after: str, told: str) -> None:
    assert before in FILE
    with pytest.raises(ScenarioError) as error:
        read(FILE.replace(before, after))
    assert told in str(error.value)


def test_several_fillers_stand_next_to_the_first() -> None:
    scenario = parse_scenario(HEAD + "filler: Hm.\nfillers: [Well., Let me see.]\n", path=Path("x.yaml"))
    assert scenario.every_filler == ("Hm.", "Well.", "Let me see.")
    with pytest.raises(ScenarioError, match="'fillers' is allowed only with 'filler'"):
        read(HEAD + "fillers: [Well.]\n")
