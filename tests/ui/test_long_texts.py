"""Emergency stop and recording controls stay visible with long texts of a study, scenario or robot."""

import dataclasses
import itertools

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PySide6.QtCore import QPoint, QRect
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.status import PerceptionStatus, RecordingStatus
from caris_desktop.scenario.scenario_model import Place, RecordingSettings
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.top_bar import TopBar
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui import samples
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

SENTENCE = "The participant who came back for the second part of the study, with her sister "
LONG = st.one_of(
    st.text(max_size=400),
    st.integers(1, 400).map(lambda count: "W" * count),
    st.integers(1, 6).map(lambda count: SENTENCE * count),
    st.just("<b>bold</b><br><table width=4000><tr><td>x</td></tr></table>"),
    st.just("first\nsecond\n" * 40),
)
WIDTHS = st.sampled_from([1366, 1366, 1280, 1024])


@pytest.fixture
def console() -> FakeConsole:
    long = SENTENCE * 4
    scenario = dataclasses.replace(
        samples.TOUR, phrases=(long, "W" * 300), filler=long, recording=RecordingSettings((long, "W" * 300)),
        places=tuple(Place(f"{number} {long}", Pose2D(number, 1.0, 0.0)) for number in range(4)),
    )  # fmt: skip
    return FakeConsole(scenario)


def whole(window: MainWindow, widget: QWidget) -> None:
    """Assert that the widget is in the window in its full width."""
    place = QRect(widget.mapTo(window, QPoint()), widget.size())
    assert window.rect().contains(place), f"{widget.objectName()} at {place} is outside"
    assert widget.width() >= widget.sizeHint().width(), f"{widget.objectName()} is cut short"


def apart(parent: QWidget, window: MainWindow) -> None:
    """Assert that parts of a bar neither overlap nor leave the window."""
    parts = [part for part in parent.findChildren(QWidget) if part.parent() is parent and part.isVisible()]
    parts.sort(key=lambda part: part.x())
    for left, right in itertools.pairwise(parts):
        assert left.geometry().right() < right.x(), f"{left.objectName()} lies over {right.objectName()}"
    assert parts[-1].geometry().right() < window.width()


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    participant=LONG, condition=LONG, trial=LONG, title=LONG, robot=LONG, model=LONG, label=LONG, width=WIDTHS,
    state=st.sampled_from(["recording", "paused", "starting", "stopping", "failed"]), latched=st.booleans(),
)  # fmt: skip
@pytest.mark.long
def test_the_red_button_and_the_recording_are_never_hidden(
    window: MainWindow, console: FakeConsole, *, participant: str, condition: str, trial: str, title: str, robot: str,
    model: str, label: str, width: int, state: str, latched: bool,
) -> None:  # fmt: skip
    assistant = dataclasses.replace(console.scenario.assistant, model=model or "embedded")
    console.scenario = dataclasses.replace(console.scenario, title=title, assistant=assistant)
    lost = {f"{robot}{number}": 1 for number in range(3)}
    free_bytes = 41_300_000_000
    console.state.recording.set(
        RecordingStatus(state, None, 1, 184_000_000, free_bytes, detail=label, dropped=lost)  # type: ignore[arg-type]
    )
    console.state.link.set(dataclasses.replace(console.state.link.value, robot=robot))
    console.state.perception.set(PerceptionStatus("failed", model, detail=label))
    if latched:
        console.emergency_stop()
    else:
        console.clear_emergency_stop()
    bar = window.findChild(TopBar)
    assert bar is not None
    bar.show_details(TrialDetails("Study", participant, condition, trial, "Kim", purpose=label))
    bar.show_scenario()
    if console.state.marks.value.open:
        console.end_mark(console.state.marks.value.open[-1].mark_id)
    if state == "recording":
        console.begin_mark(label)
    window.status_bar.refresh()
    window.resize(width, 768)
    bar._clock.stop()  # its updates once a second are laid out only in the next event loop pass
    stop = find(window, "emergency_stop")
    for number in range(20):  # each pass lays out the changes of the previous one
        QApplication.processEvents()
        if number and stop.width() >= stop.sizeHint().width():
            break
    assert (window.width(), window.height()) == (width, 768)
    whole(window, find(window, "emergency_stop"))
    whole(window, find(window, "record_button"))
    apart(bar, window)
    if state == "failed":  # else its button alone says it
        whole(window, window.status_bar.items["recording"])
    apart(window.status_bar, window)
    if latched:
        whole(window, find(window, "emergency_release"))


def test_elided_text_is_in_the_tip(window: MainWindow, console: FakeConsole) -> None:
    bar = window.findChild(TopBar)
    assert bar is not None
    bar.show_details(TrialDetails("Study", f"P07 {SENTENCE}", "<b>B</b>", "2", "Kim"))
    console.scenario = dataclasses.replace(console.scenario, title=SENTENCE)
    console.state.link.set(dataclasses.replace(console.state.link.value, robot=f"<i>{SENTENCE}"))
    bar.show_scenario()
    window.status_bar.refresh()
    QApplication.processEvents()
    trial = find(window, "trial_label")
    assert trial.width() >= 100, "what there is room for is shown"
    assert SENTENCE.strip() in " ".join(trial.toolTip().split())
    assert "<b>B</b>" in trial.toolTip(), "a tip is no place for mark-up of others"
    assert trial.accessibleName().startswith(f"P07 {SENTENCE}".strip()[:60])
    assert SENTENCE.strip() in " ".join(find(window, "scenario_button").toolTip().split())
    assert SENTENCE.strip() in window.status_bar.items["link"].toolTip()


def test_short_words_are_shown_whole(window: MainWindow, console: FakeConsole) -> None:
    bar = window.findChild(TopBar)
    assert bar is not None
    console.scenario = samples.TOUR
    bar.show_details(TrialDetails("Study", "P07", "B", "2", "Kim"))
    bar.show_scenario()
    QApplication.processEvents()
    trial = find(window, "trial_label")
    assert trial.property("text") == "P07 · condition B · trial 2"
    for part in (trial, *bar.findChildren(ActionButton)):
        if part.isVisible():
            whole(window, part)
