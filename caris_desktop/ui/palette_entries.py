"""What can be found and done with Find anything, now."""

from collections.abc import Callable
from datetime import datetime

from caris_desktop.domain import intents
from caris_desktop.domain.controls import ControlValue, RobotControl
from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.intents import INTENTS, Intent
from caris_desktop.live.status import DriveStatus, MapStatus
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.library import ScenarioChoice
from caris_desktop.scenario.model import PanelName
from caris_desktop.ui import words
from caris_desktop.ui.actions import ActionSpec, answer_suggestion, go_to_nth_place
from caris_desktop.ui.bands import QuestionBand
from caris_desktop.ui.control_words import question_for
from caris_desktop.ui.overlays import Entry
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.people.asked import is_asked
from caris_desktop.ui.people.shown_people import everyone
from caris_desktop.ui.theme import ThemeChoice
from caris_desktop.ui.window_parts import THEME_WORDS, WindowParts
from caris_desktop.ui.words import UNDER_WAY

_TWICE = "choose it, then Enter twice"


class PaletteEntries:
    """``question`` asks before a control that is to be confirmed, ``show_connection`` opens the connection's card."""

    def __init__(self, parts: WindowParts, question: QuestionBand, show_connection: Callable[[], None]) -> None:
        self._parts = parts
        self._console = parts.console
        self._state = parts.console.state
        self._question = question
        self._show_connection = show_connection

    def of_replay(self, replay: ReplayControls) -> list[Entry]:
        """A replay says nothing, and stops what another console drives."""
        left_out = {"Speaking"} if replay.live_robots.value.robots else {"Speaking", "Safety"}
        rows = [spec for spec in self._rows() if spec.group not in left_out]
        return [*map(self._of_row, rows), *self._of_panels(), *self._of_themes()]

    def now(self) -> list[Entry]:
        """Everything that can be done now."""
        parts, permissions = self._parts, self._console.scenario.permissions
        return [
            *self._of_emergency_stop(),
            *map(self._of_row, self._rows()),
            *(self._of_people() if permissions.naming_people else ()),
            *self._of_goal(),
            *(self._of_places() if permissions.driving else ()),
            *(self._of_controls() if permissions.robot_controls else ()),
            *(self._of_map() if permissions.driving else ()),
            *self._of_cameras(),
            *self._of_panels(),
            Entry("Save this panel layout", "Window", "floppy-disk", "", parts.layout.save),
            *self._of_robots(),
            *self._of_guard(),
            Entry("Connection in the last minute", "Window", "wifi-high", "", self._show_connection),
            *([Entry("Gamepad", "Window", "game-controller", "", parts.gamepad.open)] if parts.gamepad.offered else []),
            *self._of_sessions(),
            *self._of_scenarios(),
            *self._of_themes(),
        ]

    def _doer(self, intent: Intent) -> Callable[[], None]:
        def do() -> None:
            self._console.do(intent)

        return do

    def _rows(self) -> list[ActionSpec]:
        """The rows of the table that can be run now. The places come by themselves, all of them."""
        table = self._parts.actions
        return [
            spec
            for spec in table.specs
            if spec.runs
            and spec.intent not in (go_to_nth_place, answer_suggestion)
            and spec.id != "find"
            and table.available(spec.id)
        ]

    def _of_row(self, spec: ActionSpec) -> Entry:
        table = self._parts.actions
        intent = table.intent_of(spec)
        says = isinstance(intent, intents.Say)
        moves = intent is not None and INTENTS[type(intent)].moves
        return Entry(
            spec.text, "Say" if says else "Do", spec.icon, table.key_text(spec.id), lambda: table.run(spec.id),
            acts=says or moves,
        )  # fmt: skip

    def _of_emergency_stop(self) -> list[Entry]:
        if not self._state.drive.value.emergency_stop:
            return []
        return [
            Entry(
                "Release emergency stop", _TWICE, "lock-open", "", self._doer(intents.ReleaseEmergencyStop()),
                also="unlock free reset clear drive again", deliberate=True, first=True,
                again="Press Enter again to release the emergency stop",
            )
        ]  # fmt: skip

    def _of_goal(self) -> list[Entry]:
        goal: GoalChanged | None = self._state.goal.value
        if goal is None or goal.state not in UNDER_WAY:
            return []
        return [
            Entry(
                f"Stop going to {goal.place or 'the chosen point'}", "Do", "x", "", self._doer(intents.CancelGoal()),
                also="cancel goal way",
            )
        ]  # fmt: skip

    def _of_people(self) -> list[Entry]:
        """Everybody by name: to select, to rename, to read and write about; and the question that is asked now."""
        table, state = self._parts.actions, self._state
        persons = everyone(state.persons.value, state.everybody.value, state.present.now_ns())
        entries = []
        asked = next((person for person in persons if is_asked(person, state.asked_person.value)), None)
        if asked is not None and asked.suggestion is not None:
            who = f"{words.person_name(asked)} is {asked.suggestion.name}"
            for action_id, text, icon in (
                ("person_yes", f"Yes, {who}", "check"), ("person_no", f"No, {who.replace(' is ', ' is not ', 1)}", "x")
            ):  # fmt: skip
                entries.append(
                    Entry(
                        text, "Person", icon, table.key_text(action_id), self._runner(action_id), also="confirm reject",
                        acts=True,
                    )
                )  # fmt: skip
        for person in persons:
            name, also = words.person_name(person), " ".join((person.group, *person.tags))
            entries.append(Entry(name, "Select", "user", "", self._selector(person), also=f"person {also}", acts=True))
            entries.append(
                Entry(
                    f"All about {name}", "Person", "identification-card", "", self._shower(person, card=True), acts=True
                )
            )
            if person.here:
                entries.append(
                    Entry(f"Rename {name}", "Person", "pencil-simple", "", self._shower(person, rename=True), acts=True)
                )
        if state.everybody.value or state.persons.value:
            entries.append(
                Entry(
                    "Undo the last change to people", "Do", "arrow-u-up-left", "", self._doer(intents.UndoPeople()),
                    also="take back name merge",
                )
            )  # fmt: skip
        return entries

    def _runner(self, action_id: str) -> Callable[[], None]:
        return lambda: self._parts.actions.run(action_id)

    def _selector(self, person: PersonRow) -> Callable[[], None]:
        def select() -> None:
            self._console.do(intents.AttendPerson(person.person_id))
            panel = self._parts.panels.panels.get("people")
            if panel is not None:
                panel.show_person(person.person_id)

        return select

    def _shower(self, person: PersonRow, *, rename: bool = False, card: bool = False) -> Callable[[], None]:
        def show() -> None:
            panels = self._parts.panels
            panels.open("people")
            panel = panels.panels.get("people")
            if panel is not None:
                panel.show_person(person.person_id, rename=rename, card=card)

        return show

    def _of_places(self) -> list[Entry]:
        return [
            Entry(
                f"Go to {place.name}", "Place", "flag", self._parts.actions.key_text(f"place_{number}"),
                self._doer(intents.GoToPlace(place.name)), also="drive move navigate send take robot", acts=True,
            )
            for number, place in enumerate(self._state.places.value, start=1)
        ]  # fmt: skip

    def _of_controls(self) -> list[Entry]:
        """Every control of the robot that needs no more than a choice."""
        entries = []
        held = self._state.drive.value.emergency_stop
        for control in self._state.controls.value:
            if held and control.is_motion:
                continue
            if control.kind == "button":
                uses: list[tuple[str, ControlValue]] = [(control.title, True)]
            elif control.kind == "toggle":
                uses = [(f"{control.title} on", True), (f"{control.title} off", False)]
            elif control.kind == "choice":
                uses = [(f"{control.title}: {choice.title}", choice.value) for choice in control.choices]
            else:
                open_panel = self._parts.panels.opener("robot")
                entries.append(Entry(f"Robot: {control.title}", "Control", "sliders", "", open_panel))
                continue
            entries += [
                Entry(
                    f"Robot: {words}", control.group or "Control", "sliders", "", self._control_user(control, value),
                    also="control", acts=True,
                )
                for words, value in uses
            ]  # fmt: skip
        return entries

    def _control_user(self, control: RobotControl, value: ControlValue) -> Callable[[], None]:
        use = self._doer(intents.UseControl(control.id, value))
        if not control.confirm:
            return use
        return lambda: self._question.ask(question_for(control, value), "Do it", use)

    def _of_map(self) -> list[Entry]:
        """What the robot can do with its map, as far as it needs no name."""
        status: MapStatus = self._state.mapping.value
        entries = []
        if status.can_save:
            name = f"map-{datetime.now():%Y-%m-%d-%H-%M}"
            entries.append(
                Entry(f"Save the map as {name}", "Map", "floppy-disk", "", self._doer(intents.SaveMap(name)))
            )
        if status.can_switch and status.mapping is not True:
            entries.append(
                Entry("Start mapping", "Map", "map-trifold", "", self._doer(intents.SetMapping(mapping=True)))
            )
        if status.can_switch and status.mapping is not False:
            entries.append(
                Entry(
                    "Stop mapping, keep the map", "Map", "map-trifold", "",
                    self._doer(intents.SetMapping(mapping=False)), also="localization localisation end",
                )
            )  # fmt: skip
        return entries

    def _of_cameras(self) -> list[Entry]:
        state = self._state

        def chooser(name: str) -> Callable[[], None]:
            return lambda: state.choose_camera(name)

        return [
            Entry(f"Show the camera {name}", "Video", "video-camera", "", chooser(name), also="picture")
            for name in state.cameras.value
            if name != state.camera.value
        ]

    def _of_panels(self) -> list[Entry]:
        panels = self._parts.panels
        shown: list[PanelName] = [name for name in panels.possible() if panels.is_open(name)]
        opened = [
            Entry(
                PANELS[name].title, "Panel", PANELS[name].icon, "", panels.opener(name),
                also="" if name in shown else "add open show",
            )
            for name in panels.possible()
        ]  # fmt: skip
        closed = [
            Entry(f"Close {PANELS[name].title}", "Panel", "x", "", panels.closer(name), also="hide remove")
            for name in shown
        ]
        back = Entry("Put the panels back", "Window", "layout", "", self._parts.layout.put_back_soon)
        return [*opened, *closed, back]

    def _of_robots(self) -> list[Entry]:
        robots = self._parts.robots
        entries = [
            Entry(
                f"Connect to {choice.title}", "Robot", "robot", "", robots.chooser(choice), also="use switch another",
                acts=True,
            )
            for choice in robots.others()
        ]  # fmt: skip
        if robots.can_look:
            entries.append(Entry("Connect another robot…", "Robot", "plus", "", robots.open_dialog, also="new add"))
        return entries

    def _of_guard(self) -> list[Entry]:
        drive: DriveStatus = self._state.drive.value
        if drive.guard == "overridden":
            on = self._doer(intents.SetGuard(on=True))
            return [Entry("Switch the obstacle guard on", "Do", "shield-check", "", on)]
        if drive.guard == "absent" or not self._console.scenario.permissions.driving:
            return []
        return [
            Entry(
                "Switch the obstacle guard off", _TWICE, "shield-slash", "", self._doer(intents.SetGuard(on=False)),
                deliberate=True, again="Press Enter again to switch the guard off",
            )
        ]  # fmt: skip

    def _of_sessions(self) -> list[Entry]:
        status, windows = self._state.recording.value, self._parts.sessions
        entries = []
        if status.state in ("recording", "paused"):
            paused = status.state == "paused"
            entries.append(
                Entry(
                    "Go on recording" if paused else "Pause recording", "Do", "record" if paused else "pause", "",
                    self._doer(intents.PauseRecording(not paused)), also="resume continue break",
                )
            )  # fmt: skip
            entries.append(Entry("Stop recording", "Do", "stop", "", self._doer(intents.StopRecording())))
        else:
            entries.append(Entry("Start recording", "Do", "record", "", windows.open_start_dialog))
            if status.folder is not None:
                entries.append(Entry("Export the last session…", "Window", "export", "", windows.export_last_session))
        if windows.has_library:
            also = "replay search study export"
            entries.append(Entry("All sessions…", "Window", "archive", "", windows.open_sessions, also=also))
        return entries

    def _of_scenarios(self) -> list[Entry]:
        parts = self._parts

        def opener(choice: ScenarioChoice) -> Callable[[], None]:
            return lambda: parts.open_scenario(choice.path)

        return [
            Entry(f"Open scenario {choice.title}", "Scenario", "map-trifold", "", opener(choice))
            for choice in parts.scenarios()
        ]

    def _of_themes(self) -> list[Entry]:
        parts = self._parts

        def chooser(choice: ThemeChoice) -> Callable[[], None]:
            return lambda: parts.choose_theme(choice)

        return [
            Entry(f"Appearance: {words.lower()}", "Window", "moon", "", chooser(choice))
            for choice, words in THEME_WORDS.items()
        ]
