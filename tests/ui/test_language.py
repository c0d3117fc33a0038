"""The window uses the translation, and English for untranslated texts."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain.translation import tr
from caris_desktop.ui import window_appearance
from caris_desktop.ui.window_appearance import ENGLISH, TRIAL, Language, in_trial_language

_TS = """<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE TS>
<TS version="2.1" language="de"><context><name></name>
<message><source>Stop</source><translation>Halt</translation></message>
<message><source>Stop</source><comment>of a bus</comment><translation>Haltestelle</translation></message>
<message numerus="yes"><source>%n people</source>
<translation><numerusform>%n Mensch</numerusform><numerusform>%n Menschen</numerusform></translation></message>
</context></TS>
"""


@pytest.fixture
def spoken(qapp: QApplication) -> Iterator[Language]:
    spoken = Language()
    yield spoken
    spoken.use(ENGLISH)


def test_a_translation_next_to_the_program_is_spoken(
    spoken: Language, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "german.ts").write_text(_TS, "utf-8")
    lrelease = Path(sys.executable).with_name("pyside6-lrelease")
    made = [lrelease, tmp_path / "german.ts", "-qm", tmp_path / "caris_desktop_de.qm"]
    subprocess.run(made, check=True, capture_output=True)
    monkeypatch.setattr(window_appearance, "translations_dir", lambda: tmp_path)
    assert window_appearance.languages() == ("en", "de")
    spoken.use("de")
    assert (tr("Stop"), tr("Stop", "of a bus"), tr("Unknown")) == ("Halt", "Haltestelle", "Unknown")
    assert (tr("%n people", "", 1), tr("%n people", "", 4)) == ("1 Mensch", "4 Menschen")
    spoken.use(ENGLISH)
    assert (tr("Stop"), tr("%n people", "", 4)) == ("Stop", "4 people")


@pytest.mark.logs(r"there is no translation into 'xx'")
def test_missing_translations_are_english(spoken: Language) -> None:
    spoken.use("xx")
    assert tr("Stop") == "Stop"


@pytest.mark.parametrize(
    "text", ["Save", "Start recording", "Say “{text}” to {name}", "%n steps", "Open the log.\nNow."]
)
def test_the_trial_language_is_longer_by_its_share_and_keeps_what_is_filled_in(text: str) -> None:
    longer = in_trial_language(text)
    assert 1.25 * len(text) <= len(longer) <= 1.4 * len(text) + 4
    for kept in ("{text}", "{name}", "%n", "\n"):
        assert (kept in text) == (kept in longer)


def test_everything_that_is_translated_can_be_reported_by_its_brackets(spoken: Language) -> None:
    spoken.use(TRIAL)
    assert tr("Go to {place}").format(place="Lab").startswith("[Ĝ".replace("Ĝ", "Ğ")) and "Lab" in tr("{p}").format(
        p="Lab"
    )
    assert tr("%n steps", "", 3).startswith("[3 ")


def test_translated_text_stays(spoken: Language) -> None:
    spoken.use(TRIAL)
    assert tr(tr("Stop")) == tr("Stop")
