"""Window parts that provide entries for menus and the command palette."""

from collections.abc import Callable
from pathlib import Path

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.background_reading import Remembered
from caris_desktop.ui.gamepad_window import GamepadWindow
from caris_desktop.ui.layout_store import LayoutStore
from caris_desktop.ui.observer.observer_window import ObserverWindows
from caris_desktop.ui.panel_manager import PanelManager
from caris_desktop.ui.robot_choice import RobotChooser
from caris_desktop.ui.scenario_editor_window import ScenarioEditorWindow
from caris_desktop.ui.scenario_files import ScenarioFiles
from caris_desktop.ui.session_windows import SessionWindows
from caris_desktop.ui.theme import Theme, ThemeChoice
from caris_desktop.ui.window_appearance import Appearance
from caris_desktop.ui.wizard_profiles import WizardProfiles

THEME_WORDS: dict[ThemeChoice, str] = {
    "system": QT_TR_NOOP("Same as system"),
    "dark": QT_TR_NOOP("Dark"),
    "light": QT_TR_NOOP("Light"),
}


class AppContext(Value):
    console: WizardConsole
    theme: Theme
    actions: Actions
    panels: PanelManager
    layout: LayoutStore
    sessions: SessionWindows
    robots: RobotChooser
    gamepad: GamepadWindow
    editor: ScenarioEditorWindow
    wizards: WizardProfiles
    scenarios: Remembered  # of ScenarioChoice
    open_scenario: Callable[[Path], None]
    appearance: Appearance
    practise: Callable[[], None]
    scenario_files: ScenarioFiles
    observers: ObserverWindows
    close_window: Callable[[], None]
