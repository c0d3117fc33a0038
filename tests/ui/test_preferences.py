"""Preferences of a wizard: restored at the next start; invalid ones are ignored silently."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.live.status import AssistantSetup, LevelsStatus, ModelChoice, PracticeStatus
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.phrases import PhraseGroup
from caris_desktop.scenario.scenario_model import MapSettings, NamedText, PanelSettings
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.session_panel import SessionPanel
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import MemorySettings, open_window, with_panels
from tests.ui.fake_console import FakeConsole

Start = Callable[[], tuple[MainWindow, FakeConsole]]
TOUR = replace(
    with_panels(samples.TOUR, "video", "map", "speak", "session"),  # those that save preferences
    phrases=(PhraseGroup("Greeting", ("Hello",)), PhraseGroup("Tour", ("Follow me",))),
)
ROLES = (NamedText("Guide", "You guide."), NamedText("Nurse", "You care."))
SETUP = AssistantSetup(
    "embedded", roles=ROLES, styles=(NamedText("Brief", "Be brief."),),
    models=(ModelChoice("embedded", "Here", ""), ModelChoice("ollama:small", "Small", "")),
)  # fmt: skip


@pytest.fixture
def start(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> Start:
    """Each call is another run of the program by the same user."""

    def run() -> tuple[MainWindow, FakeConsole]:
        console = FakeConsole(TOUR, {samples.MENTAL.path: samples.MENTAL, TOUR.path: TOUR})
        window = open_window(qtbot, console, settings, theme)
        state = console.state
        state.levels.set(LevelsStatus("act", "act", "suggest"))
        state.assistant_setup.set(SETUP)
        state.voice.set(replace(state.voice.value, choices=(("alba", "en"),)))
        state.cameras.set(("front", "desk"))
        window.preferences.begin()
        return window, console

    return run


def panel(window: MainWindow, kind: type[Any]) -> Any:
    found = window.findChild(kind)
    assert found is not None
    return found


def chosen(window: MainWindow, console: FakeConsole) -> dict[str, object]:
    state = console.state
    voice, setup = state.voice.value, state.assistant_setup.value
    return {
        "speed": state.drive.value.speed_fraction,
        "voice": (voice.output, voice.name, voice.rate, voice.volume),
        "assistant": (setup.model, setup.role, setup.style),
        "levels": state.levels.value,
        "phrases": state.phrase_group.value,
        "camera": state.camera.value,
        "map": panel(window, MapPanel).choices(),
        "log": panel(window, SessionPanel).choices(),
        "robot": window.preferences.robot_of_last_time,
    }


def choose_all(window: MainWindow, console: FakeConsole) -> None:
    console.do(intents.SetSpeed(0.3))
    console.do(intents.SetVoice("computer", "alba", "", 1.2, 0.5))
    console.do(intents.ChooseModel("ollama:small"))
    console.do(intents.ChoosePrompt("role", "Nurse"))
    console.do(intents.ChoosePrompt("style", "Brief"))
    console.do(intents.SetLevel("replies", "suggest"))
    console.state.choose_phrases(1)
    console.state.choose_camera("desk")
    console.state.robot.set(load_profile("pepper"))
    view = panel(window, MapPanel).view
    view.set_follow(not view.follow)
    view.set_rotate(True)
    panel(window, SessionPanel).show_category("Problems")


def test_choices_are_restored(qtbot: QtBot, start: Start, settings: MemorySettings) -> None:
    window, console = start()
    before = chosen(window, console)
    choose_all(window, console)
    wanted = chosen(window, console)
    assert {name for name, value in wanted.items() if value != before[name]} == set(wanted), "each was changed"
    qtbot.waitUntil(lambda: any("camera" in key for key in settings.values))
    window.close()
    again, console = start()
    assert chosen(again, console) == wanted


def test_the_robot_that_a_person_practises_on_was_not_chosen(start: Start) -> None:
    window, console = start()
    console.state.robot.set(load_profile("pepper"))
    console.state.practice.set(PracticeStatus("preparing"))
    console.state.robot.set(load_profile("simulated"))
    assert window.preferences.robot_of_last_time == "pepper"
    console.state.practice.set(PracticeStatus("ended"))
    console.state.robot.set(load_profile("nao"))
    assert window.preferences.robot_of_last_time == "nao"
    console.state.practice.set(PracticeStatus())


def test_each_scenario_has_its_own_and_another_one_s_own_settings_are_no_choice(
    qtbot: QtBot, start: Start, settings: MemorySettings
) -> None:
    _window, console = start()
    console.do(intents.SetVoice("computer", "alba", "", 1.2, 0.5))
    qtbot.waitUntil(lambda: any(key.endswith("/voice") for key in settings.values))
    kept = dict(settings.values)
    console.state.voice.set(replace(console.state.voice.value, rate=1.0))  # as set in the next one
    assert samples.MENTAL.path is not None and TOUR.path is not None
    console.do(intents.OpenScenario(samples.MENTAL.path))
    qtbot.waitUntil(lambda: not console_is_busy(_window))
    assert console.state.voice.value.rate == 1.0
    assert {key: value for key, value in settings.values.items() if key.endswith("/voice")} == {
        key: value for key, value in kept.items() if key.endswith("/voice")
    }
    console.do(intents.OpenScenario(TOUR.path))
    qtbot.waitUntil(lambda: console.state.voice.value.rate == 1.2)


def console_is_busy(window: MainWindow) -> bool:
    return window.preferences._anew.isActive()


@pytest.mark.long
def test_the_file_says_how_a_panel_is_at_first_and_the_wizard_from_then_on(qtbot: QtBot, start: Start) -> None:
    window, console = start()
    following = replace(TOUR, panels=PanelSettings(map=MapSettings(follow=True)))
    whole = replace(TOUR, path=samples.MENTAL.path)
    for scenario in (following, whole, following):
        console.scenario = scenario
        console.state.scenario.reset_value(scenario)
        qtbot.waitUntil(lambda: window.board.whole)
        assert panel(window, MapPanel).view.follow is (scenario is following), "nobody chose otherwise"
    panel(window, MapPanel).view.set_follow(False)
    for scenario in (whole, following):
        console.scenario = scenario
        console.state.scenario.reset_value(scenario)
        qtbot.waitUntil(lambda: window.board.whole)
    assert not panel(window, MapPanel).view.follow


@pytest.mark.long
def test_levels_are_never_raised_by_it(qtbot: QtBot, start: Start, settings: MemorySettings) -> None:
    _window, console = start()
    console.do(intents.SetLevel("actions", "off"))
    console.do(intents.SetLevel("replies", "suggest"))
    qtbot.waitUntil(lambda: any(key.endswith("/levels") for key in settings.values))
    again, console = start()
    assert console.state.levels.value == LevelsStatus("suggest", "act", "off")
    console.state.levels.set(LevelsStatus("off", "off", "suggest"))
    again.preferences._use_stored()
    assert console.state.levels.value == LevelsStatus("off", "off", "off")


@pytest.mark.long
def test_a_camera_and_a_model_are_waited_for(qtbot: QtBot, start: Start, settings: MemorySettings) -> None:
    window, console = start()
    choose_all(window, console)
    qtbot.waitUntil(lambda: any("camera" in key for key in settings.values))
    window, console = start()
    console.state.cameras.set(("front",))
    console.state.assistant_setup.set(replace(SETUP, models=()))
    window.preferences._use_stored()
    assert console.state.assistant_setup.value.model == "embedded"
    console.state.assistant_setup.set(replace(console.state.assistant_setup.value, models=SETUP.models))
    assert console.state.assistant_setup.value.model == "ollama:small"
    console.state.choose_camera("front")
    console.state.cameras.set(("front", "desk"))
    assert console.state.camera.value == "front", "whoever chose meanwhile is not overruled"


@pytest.mark.parametrize(
    "unfit", ["", "{", "[]", "{}", "null", "true", "-3", "7", '"gone"', "[1, 2]", '["computer", "gone", "", 1.0, 1.0]']
)
@pytest.mark.long("-3", "true", "null", '"gone"', "[[]]", "{}")
def test_missing_and_unfit_choices_are_left_out_silently(start: Start, settings: MemorySettings, unfit: str) -> None:
    window, console = start()
    names = ["speed", "voice", "model", "role", "style", "levels", "phrases", "camera", "robot"]
    before = {**chosen(window, console), "robot": ""}
    for name in names:
        settings.setValue(f"wizards/*/{window.preferences._place(name)}", unfit)
    for name in ("map", "session"):
        settings.setValue(f"wizards/*/choices/panels/{name}", unfit)
    window, console = start()
    now = {**chosen(window, console), "robot": ""}
    assert now == before
    assert console.calls == [], "nothing is even asked for, so nothing is refused"


def test_of_another_type_are_no_panel_s_choices(start: Start, settings: MemorySettings) -> None:
    settings.setValue("wizards/*/choices/panels/map", json.dumps({"follow": "yes", "rotate": 3}))
    settings.setValue("wizards/*/choices/panels/session", json.dumps({"category": ["Problems"]}))
    window, _console = start()
    assert panel(window, SessionPanel).choices() == {"category": ""}
    assert panel(window, MapPanel).choices()["rotate"] is False


def edited(scenario: samples.Scenario) -> samples.Scenario:
    """Edited scenario of the study: another model, fewer roles, another voice, lower levels."""
    return replace(
        scenario,
        voice="computer" if scenario.voice != "computer" else "robot",
        assistant=replace(scenario.assistant, model="ollama:large", roles=(NamedText("Host", "You host."),)),
        assistance=replace(scenario.assistance, replies="suggest"),
    )


def test_choices_of_the_file_count_and_others_stay(
    qtbot: QtBot, start: Start, settings: MemorySettings, theme: Theme
) -> None:
    window, console = start()
    choose_all(window, console)
    wanted = chosen(window, console)
    qtbot.waitUntil(lambda: any("camera" in key for key in settings.values))
    window.close()
    console = FakeConsole(edited(TOUR))
    window = open_window(qtbot, console, settings, theme)
    console.state.levels.set(LevelsStatus("suggest", "act", "suggest"))
    console.state.assistant_setup.set(SETUP)
    console.state.voice.set(replace(console.state.voice.value, choices=(("alba", "en"),)))
    console.state.cameras.set(("front", "desk"))
    before = chosen(window, console)
    window.preferences.begin()
    now = chosen(window, console)
    assert now["voice"] == before["voice"]
    assert now["levels"] == before["levels"]
    model, role, style = now["assistant"]  # type: ignore[misc]
    assert (model, role, style) == ("embedded", SETUP.role, "Brief")
    assert {name: now[name] for name in ("speed", "phrases", "camera", "map", "log", "robot")} == {
        name: wanted[name] for name in ("speed", "phrases", "camera", "map", "log", "robot")
    }


def test_a_panel_is_as_its_file_has_it_once_that_says_something_else(
    qtbot: QtBot, start: Start, settings: MemorySettings, theme: Theme
) -> None:
    window, _console = start()
    view = panel(window, MapPanel).view
    view.set_rotate(True)
    panel(window, SessionPanel).show_category("Problems")
    qtbot.waitUntil(lambda: any(key.endswith("panels/session") for key in settings.values))
    window.close()
    settings_of_map = replace(TOUR.panels.map, follow=not TOUR.panels.map.follow)
    again = open_window(
        qtbot, FakeConsole(replace(TOUR, panels=replace(TOUR.panels, map=settings_of_map))), settings, theme
    )
    again.preferences.begin()
    assert panel(again, MapPanel).choices() == {
        "follow": settings_of_map.follow, "rotate": settings_of_map.up == "robot", "trail": settings_of_map.trail,
    }  # fmt: skip
    assert panel(again, SessionPanel).choices() == {"category": "Problems"}
