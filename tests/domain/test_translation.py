"""Texts are found by lupdate, and translated by the translator."""

import subprocess
import sys
from pathlib import Path

from caris_desktop.domain.translation import QT_TR_NOOP, tr, use_translator


def test_a_text_is_what_the_translator_makes_of_it() -> None:
    known = {"Go to {place}": "Nach {place} fahren"}
    use_translator(lambda text, _meant, _number: known.get(text, text))
    try:
        assert tr("Go to {place}").format(place="Lab") == "Nach Lab fahren"
        assert tr("Something else") == "Something else"
    finally:
        use_translator(None)
    assert tr("Go to {place}") == "Go to {place}"


def test_without_one_a_number_stands_in_its_text() -> None:
    assert tr("%n people here", "", 3) == "3 people here"


def test_lupdate_finds_texts_in_functions_in_classes_and_in_tables(tmp_path: Path) -> None:
    source = tmp_path / "source.py"
    source.write_text(
        'TABLE = {"a": QT_TR_NOOP("In a table")}\n\n\nclass Panel:\n    def say(self):\n'
        '        return tr("In a class"), tr("%n people", "", 2)\n\n\ndef free():\n    return tr("Free")\n'
    )
    found = tmp_path / "found.ts"
    lupdate = Path(sys.executable).with_name("pyside6-lupdate")
    subprocess.run([lupdate, source, "-ts", found], check=True, capture_output=True)
    written = found.read_text("utf-8")
    for text in ("In a table", "In a class", "%n people", "Free"):
        assert f"<source>{text}</source>" in written
    assert QT_TR_NOOP("as it is") == "as it is"
