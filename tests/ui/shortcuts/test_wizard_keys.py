"""Keys of each wizard: saved with the profile, and reported if they cannot be used."""

import dataclasses
from collections.abc import Iterator

import pytest
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.scenario.phrases import Phrase
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.key_choices import Keys, as_text
from caris_desktop.ui.preferences import WizardProfiles
from caris_desktop.ui.shortcut_sheet import WizardKeys
from tests.ui import samples
from tests.ui.conftest import MemorySettings
from tests.ui.fake_console import FakeConsole

SCENARIO = dataclasses.replace(samples.TOUR, phrases=(*samples.TOUR.phrases, Phrase("Goodbye.", "Ctrl+6")))
KEPT_AT = "wizards/*/shortcuts"


class Bench:
    """Table and keys without a window."""

    def __init__(self, settings: MemorySettings) -> None:
        self.window = QWidget()
        self.actions = Actions(self.window, FakeConsole(SCENARIO), self)
        self.actions.rebuild(SCENARIO)
        self.wizards = WizardProfiles(settings)
        self.told: list[str] = []
        self.keys = WizardKeys(
            self.wizards, self.actions, lambda *words: self.told.append(" ".join(words)), self.window
        )

    def keys_of(self, action_id: str) -> Keys:
        spec = next(spec for spec in self.actions.all_specs if spec.id == action_id)
        return Keys(spec.keys, spec.driving_keys)

    def choose(self, action_id: str, *keys: str) -> None:
        self.keys.choose(next(spec for spec in self.actions.all_specs if spec.id == action_id), Keys(keys))


@pytest.fixture
def bench(qtbot: QtBot, settings: MemorySettings) -> Iterator[Bench]:
    bench = Bench(settings)
    qtbot.addWidget(bench.window)
    yield bench


def test_each_wizard_has_her_keys_and_they_are_there_the_next_time(
    qtbot: QtBot, bench: Bench, settings: MemorySettings
) -> None:
    bench.choose("mark", "Ctrl+8")
    bench.wizards.choose("Ana")
    bench.choose("photo", "Ctrl+5")
    bench.wizards.choose("Tom")
    assert (bench.keys_of("photo"), bench.keys_of("mark")) == (Keys(("Ctrl+P",), ("P",)), Keys(("Ctrl+8",)))
    bench.wizards.choose("Ana")
    assert (bench.keys_of("photo"), bench.keys_of("mark")) == (Keys(("Ctrl+5",)), Keys(("Ctrl+8",)))
    again = Bench(settings)
    qtbot.addWidget(again.window)
    assert again.keys_of("photo") == Keys(("Ctrl+5",))
    assert again.told == []


def test_a_row_that_loses_its_key_has_none_and_gets_it_back(bench: Bench) -> None:
    bench.choose("photo", "Ctrl+M")
    assert bench.keys_of("mark") == Keys((), ("M",))
    bench.choose("keyed_phrase_1", "Ctrl+P")
    bench.keys.reset(next(spec for spec in bench.actions.all_specs if spec.id == "mark"))
    assert bench.keys_of("mark") == Keys(("Ctrl+M",), ("M",))
    assert bench.keys_of("photo") == Keys()
    assert bench.keys_of("keyed_phrase_1") == Keys(("Ctrl+P",))
    bench.keys.reset_all()
    assert bench.keys_of("photo") == Keys(("Ctrl+P",), ("P",))
    assert bench.keys_of("keyed_phrase_1") == Keys(("Ctrl+6",))
    assert not bench.keys.any_changed
    assert bench.told == []


@pytest.mark.parametrize(
    ("kept", "told"),
    [
        ("nonsense", "could not be read"),
        (as_text({"photo": Keys(("Ctrl+M",))}), "“Photo”: Ctrl+M is already assigned to “Mark”."),
    ],
)
def test_unusable_saved_keys_fall_back_and_are_reported_once(
    bench: Bench, settings: MemorySettings, kept: str, told: str
) -> None:
    settings.setValue(KEPT_AT, kept)
    bench.keys.take_up()
    assert bench.keys_of("photo") == Keys(("Ctrl+P",), ("P",))
    assert [told in words for words in bench.told] == [True]
    bench.actions.rebuild(SCENARIO)
    assert len(bench.told) == 1
    if kept == "nonsense":
        assert settings.values["wizards/*/shortcuts unread"] == kept


def test_a_phrase_yields_to_a_key_chosen_with_another_scenario(bench: Bench, settings: MemorySettings) -> None:
    settings.setValue(KEPT_AT, as_text({"photo": Keys(("Ctrl+6",), ("P",))}))
    bench.keys.take_up()
    assert bench.keys_of("photo").keys == ("Ctrl+6",)
    assert [(phrase.text, other.id) for phrase, other in bench.actions.settled.clashes] == [("Goodbye.", "photo")]
    assert bench.told == [], "the sheet shows it"
