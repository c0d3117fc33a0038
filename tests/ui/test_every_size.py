"""No cut-off or overlapping text in the window for every scenario, screen, scale, theme and language.

The suite covers every pair of values at least once; ``--long`` all combinations.
"""

import itertools
from collections.abc import Iterator, Sequence

import pytest
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel

from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.window_appearance import ENGLISH, TRIAL, Language
from tests.support.window_check import text_flaws
from tests.ui import samples
from tests.ui.conftest import freshen
from tests.ui.fake_console import FakeConsole

SCREENS = ((1366, 768), (1920, 1080), (2560, 1440))
SCALES = (1.0, 1.5, 2.0)
THEMES = ("dark", "light")
LANGUAGES = (ENGLISH, TRIAL)
SCENARIOS = tuple(sorted(path.stem for path in layouts_dir().glob("*.yaml")))
Case = tuple[str, tuple[int, int], float, str, str]
_COMES_ROUND_MS = 400


def everything() -> list[Case]:
    return list(itertools.product(SCENARIOS, SCREENS, SCALES, THEMES, LANGUAGES))


def pairwise(cases: Sequence[Case]) -> list[Case]:
    """A subset of ``cases`` that covers every pair of values in them."""
    left = {pair for case in cases for pair in _pairs(case)}
    chosen: list[Case] = []
    while left:
        best = max(cases, key=lambda case: len(left & _pairs(case)))
        chosen.append(best)
        left -= _pairs(best)
    return sorted(chosen)  # expensive changes last


def _pairs(case: Case) -> set[tuple[tuple[int, object], tuple[int, object]]]:
    return set(itertools.combinations(enumerate(case), 2))


class Shown:
    """One window per language, as texts are not translated again; scenario, size and theme change in it."""

    def __init__(self, theme: Theme, language: str) -> None:
        self.console = FakeConsole(load_scenario(layouts_dir() / f"{SCENARIOS[0]}.yaml"))
        samples.fill_console(self.console)
        self.speaks = Language()
        self.speaks.use(language)
        self.window = MainWindow(self.console, theme=theme)
        self.window._top_bar.show_details(TrialDetails("Lab visit", "P07", "B", "2", "Kim"))
        self.window.show()
        self.console.state.close()

    def flaws_in(self, case: Case) -> list[str]:
        scenario, (width_px, height_px), scale, theme, _language = case
        if self.console.scenario.path is None or self.console.scenario.path.stem != scenario:
            self.console.scenario = load_scenario(layouts_dir() / f"{scenario}.yaml")
            self.console.protocol.use_scenario(self.console.scenario)
            self.console.state.scenario.reset_value(self.console.scenario)
            self.window.board.complete()
        self.window.theme.set_choice("dark" if theme == "dark" else "light")
        freshen(self.console)
        # Logical units: scaling changes only the resolution.
        self.window.resize(round(width_px / scale), round(height_px / scale))
        for _ in range(10):
            QApplication.processEvents()
        found = text_flaws(self.window)
        if found:  # parts that are not updated yet do not count
            QTest.qWait(_COMES_ROUND_MS)
            found = text_flaws(self.window)
        return found


@pytest.fixture(params=LANGUAGES)
def shown(request: pytest.FixtureRequest, theme: Theme) -> Iterator[Shown]:
    shown = Shown(theme, request.param)
    yield shown
    shown.speaks.use(ENGLISH)
    shown.window.close()
    shown.window.deleteLater()


def _found(shown: Shown, cases: Sequence[Case]) -> list[str]:
    return [f"{case[:4]}: {flaw}" for case in cases for flaw in shown.flaws_in(case)]


@pytest.mark.long("trial")
def test_all_pairs_can_be_read(shown: Shown, request: pytest.FixtureRequest) -> None:
    language = request.node.callspec.params["shown"]
    assert _found(shown, [case for case in pairwise(everything()) if case[4] == language]) == []


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_everything_can_be_read(shown: Shown, scenario: str, request: pytest.FixtureRequest) -> None:
    language = request.node.callspec.params["shown"]
    cases = [case for case in everything() if case[0] == scenario and case[4] == language]
    assert _found(shown, sorted(cases, key=lambda case: case[3])) == []


def test_the_check_sees_what_is_cut_off_and_what_lies_on_one_another(window: MainWindow) -> None:
    """Negative control: the same window with a squeezed label and an overlapping one."""
    squeezed, over = QLabel("Squeezed out of sight", window), QLabel("Lies over the title", window)
    squeezed.setObjectName("squeezed")
    squeezed.setGeometry(600, 90, 40, 20)
    over.adjustSize()
    over.move(20, 18)
    choice = DropDown(window.theme, "squeezed_choice", "Choice")
    choice.addItem("Chosen out of sight")
    choice.setParent(window)
    choice.setGeometry(600, 130, 70, 28)
    for widget in (squeezed, over, choice):
        widget.show()
    found = text_flaws(window)
    for widget in (squeezed, over, choice):
        widget.hide()
        widget.deleteLater()
    assert any("'squeezed'" in flaw or "squeezed lacks" in flaw for flaw in found), found
    assert any("squeezed_choice" in flaw for flaw in found), found
    assert any("Lies over the title" in flaw and "overlap" in flaw for flaw in found), found


def test_pairs_are_all_there() -> None:
    cases = everything()
    chosen = pairwise(cases)
    wanted = {pair for case in cases for pair in _pairs(case)}
    assert {pair for case in chosen for pair in _pairs(case)} == wanted
    assert len(chosen) < len(cases) / 2
