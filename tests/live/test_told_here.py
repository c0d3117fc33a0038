"""English messages of child processes are translated into the wizard's language if a translation exists."""

from collections.abc import Iterator

import pytest

from caris_desktop.domain.events import Problem
from caris_desktop.domain.translation import use_translator
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import ProcessManager, localize_problem
from caris_desktop.live.state import LiveState

GERMAN = {"The disk is full.": "Die Platte ist voll.", "Stop the recording.": "Die Aufnahme beenden."}


@pytest.fixture
def german() -> Iterator[None]:
    use_translator(lambda text, _meant, _number: GERMAN.get(text, text))
    yield
    use_translator(None)


@pytest.mark.usefixtures("german")
def test_known_sentences_are_translated_others_stay() -> None:
    told = localize_problem(
        Problem(1, "error", "The disk is full.", "s-17 is kept.", "Stop the recording.", "quiet", "disk")
    )
    assert (told.what, told.meaning, told.advice) == ("Die Platte ist voll.", "s-17 is kept.", "Die Aufnahme beenden.")
    assert (told.stamp_ns, told.severity, told.until, told.cause) == (1, "error", "quiet", "disk")


@pytest.mark.usefixtures("german")
def test_a_problem_of_a_child_comes_onto_the_bus_translated() -> None:
    bus = Bus(LiveState())
    values: list[object] = []
    bus.tap(lambda value, _raw: values.append(value))
    children = ProcessManager(bus)
    children.pass_on(lambda _value: None, Problem(1, "error", "The disk is full.", "", ""), b"")
    children.close()
    assert [value.what for value in values if isinstance(value, Problem)] == ["Die Platte ist voll."]
