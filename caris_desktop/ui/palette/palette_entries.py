"""Items of the command palette, from the current state."""

from collections.abc import Callable
from datetime import datetime
from functools import partial

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import ControlValue, RobotControl
from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.intents import INTENTS
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import MapStatus
from caris_desktop.live.wizard_console import ReplayControls, WizardConsole
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.studies.study_query import SessionEntry
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui import text_formatting
from caris_desktop.ui.action_rows import (
    SAFETY_GROUP,
    SPEAKING_GROUP,
    answer_asked,
    go_to_nth_place,
    say,
    say_filler,
    say_keyed_phrase,
    say_phrase,
)
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.app_context import AppContext
from caris_desktop.ui.banners import QuestionBanner
from caris_desktop.ui.control_messages import question_for
from caris_desktop.ui.observer.observer_window import SEES_WORDS
from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.palette.setting_entries import TWICE, SettingEntries
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.people.pending_identity_question import is_asked
from caris_desktop.ui.people.shown_people import everyone
from caris_desktop.ui.step_intents import present_step, target_of
from caris_desktop.ui.text_formatting import UNDER_WAY

_COMMON_ROWS = frozenset(
    {"photo", "mark", "note", "silence", "name_person", "choose_place", "choose_scenario", "next_step", "shortcuts"}
)


_OTHER_WORDS = {
    "shortcuts": QT_TR_NOOP("help keys keyboard hotkeys"),
    "set_up": QT_TR_NOOP("help settings microphone begin welcome connect"),
    "alarms": QT_TR_NOOP("problems errors warnings trouble"),
    "note": QT_TR_NOOP("comment remark"),
    "preflight": QT_TR_NOOP("preflight checklist ready"),
}
"""Synonyms of rows of the action table."""


class PaletteEntries:
    """Collects the items of the palette. ``question``: confirmation of controls; ``show_connection``: opens the
    connection popup.
    """

    def __init__(self, parts: AppContext, question: QuestionBanner, show_connection: Callable[[], None]) -> None:
        self._parts = parts
        self._console = parts.console
        self._state = parts.console.state
        self._question = question
        self._show_connection = show_connection
        self._settings = SettingEntries(parts)
        self._people = PersonEntries(parts)

    def of_replay(self, replay: ReplayControls) -> list[PaletteItem]:
        """Items of a replay: no speech, and the stop only if robots are being driven."""
        left_out = {SPEAKING_GROUP} if replay.live_robots.value.robots else {SPEAKING_GROUP, SAFETY_GROUP}
        rows = [spec for spec in self._rows() if spec.group not in left_out]
        return [
            *map(self._of_row, rows),
            *self._of_panels(),
            *self._of_layout(),
            *self._settings.of_themes(),
            closing_entry(self._parts.close_window, replay=True),
        ]

    def now(self) -> list[PaletteItem]:
        """Items available now."""
        parts, permissions = self._parts, self._console.scenario.permissions
        return [
            *self._of_emergency_stop(),
            *map(self._of_row, self._rows()),
            *(self._of_phrases() if permissions.speech else ()),
            *(self._people.now() if permissions.naming_people else ()),
            *step_entries(self._console),
            *self._of_goal(),
            *(self.of_places() if permissions.driving else ()),
            *(self._of_controls() if permissions.robot_controls else ()),
            *(self._of_map() if permissions.driving else ()),
            *self._of_cameras(),
            *self._of_panels(),
            *self._of_layout(),
            *self._of_robots(),
            *(
                PaletteItem(
                    tr(SEES_WORDS[sees]),
                    tr("Window"),
                    "monitor",
                    "",
                    parts.observers.opener(sees),
                    also=tr("second screen"),
                    id=f"Window: {SEES_WORDS[sees]}",
                )
                for sees in SEES_WORDS
            ),
            PaletteItem(
                tr("Practise on the simulated robot"),
                tr("Do"),
                "student",
                "",
                parts.practise,
                also=tr("learn training tutorial help"),
                id="Do: Practise on the simulated robot",
            ),
            PaletteItem(
                tr("Connection in the last minute"),
                tr("Window"),
                "wifi-high",
                "",
                self._show_connection,
                id="Window: Connection in the last minute",
            ),
            *(
                [
                    PaletteItem(
                        tr("Gamepad"), tr("Window"), "game-controller", "", parts.gamepad.open, id="Window: Gamepad"
                    )
                ]
                if parts.gamepad.offered
                else []
            ),
            *self._of_sessions(),
            PaletteItem(
                tr("Edit this scenario…"),
                tr("Scenario"),
                "pencil-simple",
                "",
                parts.editor.open,
                also=tr("change phrases places permissions protocol form yaml"),
                id="Scenario: Edit this scenario…",
            ),
            *self.of_scenarios(),
            *self._of_scenario_files(),
            *self._settings.now(),
            closing_entry(self._parts.close_window, replay=False),
        ]

    def _rows(self) -> list[ActionSpec]:
        """Available rows of the action table, without places and layout commands, which have items of their own."""
        table = self._parts.actions
        elsewhere = {"find", *(command.action for command in self._parts.layout.commands())}
        return [
            spec
            for spec in table.specs
            if spec.runs
            and spec.intent not in (go_to_nth_place, answer_asked, say_phrase, say_keyed_phrase)
            and spec.id not in elsewhere
            and table.available(spec.id)
        ]

    def _of_row(self, spec: ActionSpec) -> PaletteItem:
        table = self._parts.actions
        intent = table.intent_of(spec)
        is_utterance = isinstance(intent, intents.Say)
        moves = intent is not None and (
            INTENTS[type(intent)].moves is not None or isinstance(intent, intents.UseControl)
        )
        other_words = _OTHER_WORDS.get(spec.id, "")
        return PaletteItem(
            spec.text,
            tr("Say") if is_utterance else tr("Do"),
            spec.icon,
            table.key_text(spec.id),
            lambda: table.run(spec.id),
            also=tr(other_words),
            acts=is_utterance or moves,
            named=spec.text if spec.intent is say_filler else spec.text.partition(": ")[2],
            id=f"row {spec.id}",
            common=spec.id in _COMMON_ROWS,
        )

    def _of_phrases(self) -> list[PaletteItem]:
        """Phrases of all groups, with the key that says them now."""
        table, chosen = self._parts.actions, self._state.phrase_group.value
        keyed = {spec.argument: spec.id for spec in table.all_specs if spec.intent is say_keyed_phrase}
        entries = []
        for index, group in enumerate(phrase_groups(self._console.scenario.phrases)):
            for number, phrase in enumerate(group.phrases, start=1):
                row = (keyed.get(phrase) if phrase.key else None) or (f"phrase_{number}" if index == chosen else "")
                key = table.key_text(row) if row else ""
                entries.append(
                    PaletteItem(
                        phrase.say,
                        tr("Say"),
                        "chat-text",
                        key,
                        partial(self._console.do, say(phrase)),
                        also=group.title,
                        acts=True,
                        named=f"{phrase.say} {group.title}",
                        id=f"Say: {phrase.say}",
                    )
                )
        return entries

    def _of_emergency_stop(self) -> list[PaletteItem]:
        if not self._state.drive.value.emergency_stop:
            return []
        return [
            PaletteItem(
                tr("Release emergency stop"),
                tr(TWICE),
                "lock-open",
                "",
                partial(self._console.do, intents.ReleaseEmergencyStop()),
                also=tr("unlock free reset clear drive again"),
                deliberate=True,
                first=True,
                again=tr("Press Enter again to release the emergency stop"),
                id="Release emergency stop",
            )
        ]

    def _of_goal(self) -> list[PaletteItem]:
        goal: GoalChanged | None = self._state.goal.value
        if goal is None or goal.state not in UNDER_WAY:
            return []
        return [
            PaletteItem(
                tr("Stop going to {place}").format(place=goal.place or tr("the chosen point")),
                tr("Do"),
                "x",
                "",
                partial(self._console.do, intents.CancelGoal()),
                also=tr("cancel goal way"),
                id=f"Do: Stop going to {goal.place or 'the chosen point'}",
            )
        ]

    def of_places(self) -> list[PaletteItem]:
        return [
            PaletteItem(
                tr("Go to {place}").format(place=place.name),
                tr("Place"),
                "flag",
                self._parts.actions.key_text(f"place_{number}"),
                partial(self._console.do, intents.GoToPlace(place.name)),
                also=tr("drive move navigate send take robot"),
                acts=True,
                named=place.name,
                by_name=True,
                id=f"Place: Go to {place.name}",
            )
            for number, place in enumerate(self._state.places.value, start=1)
        ]

    def _of_controls(self) -> list[PaletteItem]:
        """Robot controls that need no value but a choice."""
        entries = []
        held = self._state.drive.value.emergency_stop
        for control in self._state.controls.value:
            if held and control.is_held_by_stop:
                continue
            if control.kind == "button":
                uses: list[tuple[str, str, ControlValue]] = [(control.title, control.title, True)]
            elif control.kind == "toggle":
                uses = [
                    (f"{control.title} on", tr("{control} on").format(control=control.title), True),
                    (f"{control.title} off", tr("{control} off").format(control=control.title), False),
                ]
            elif control.kind == "choice":
                to_one = tr("{control}: {choice}")
                uses = [
                    (
                        f"{control.title}: {choice.title}",
                        to_one.format(control=control.title, choice=choice.title),
                        choice.value,
                    )
                    for choice in control.choices
                ]
            elif "robot" in self._parts.panels.possible():
                open_panel = self._parts.panels.opener("robot")
                text = tr("Robot: {control}").format(control=control.title)
                entries.append(
                    PaletteItem(text, tr("Control"), "sliders", "", open_panel, id=f"Control: Robot: {control.title}")
                )
                continue
            else:
                continue
            entries += [
                PaletteItem(
                    tr("Robot: {control}").format(control=use),
                    control.group or tr("Control"),
                    "sliders",
                    "",
                    self._control_user(control, value),
                    also=tr("control"),
                    acts=True,
                    named=f"{use} {control.group}",
                    id=f"{control.group or 'Control'}: Robot: {known_as}",
                )
                for known_as, use, value in uses
            ]
        return entries

    def _control_user(self, control: RobotControl, value: ControlValue) -> Callable[[], object]:
        use = partial(self._console.do, intents.UseControl(control.id, value))
        if not control.confirm:
            return use
        return lambda: self._question.ask(question_for(control, value), tr("Do it"), use)

    def _of_map(self) -> list[PaletteItem]:
        """Mapping commands that need no name."""
        status: MapStatus = self._state.mapping.value
        entries = []
        if status.can_save:
            name = f"map-{datetime.now():%Y-%m-%d-%H-%M}"
            entries.append(
                PaletteItem(
                    tr("Save the map as {name}").format(name=name),
                    tr("Map"),
                    "floppy-disk",
                    "",
                    partial(self._console.do, intents.SaveMap(name)),
                    acts=True,
                    named=tr("the map {name}").format(name=name),
                    id="save map",
                )
            )
        if status.can_switch and status.mapping is not True:
            entries.append(
                PaletteItem(
                    tr("Start mapping"),
                    tr("Map"),
                    "map-trifold",
                    "",
                    partial(self._console.do, intents.SetMapping(mapping=True)),
                    acts=True,
                    named=tr("map mapping"),
                    id="Map: Start mapping",
                )
            )
        if status.can_switch and status.mapping is not False:
            entries.append(
                PaletteItem(
                    tr("Stop mapping, keep the map"),
                    tr("Map"),
                    "map-trifold",
                    "",
                    partial(self._console.do, intents.SetMapping(mapping=False)),
                    acts=True,
                    named=tr("the map mapping"),
                    also=tr("localization localisation end"),
                    id="Map: Stop mapping, keep the map",
                )
            )
        return entries

    def _of_cameras(self) -> list[PaletteItem]:
        state = self._state
        return [
            PaletteItem(
                tr("Show the camera {name}").format(name=name),
                tr("Video"),
                "video-camera",
                "",
                partial(state.choose_camera, name),
                also=tr("picture"),
                id=f"Video: Show the camera {name}",
            )
            for name in state.cameras.value
            if name != state.camera.value
        ]

    def _of_panels(self) -> list[PaletteItem]:
        panels = self._parts.panels
        open_panels: list[PanelName] = [name for name in panels.possible() if panels.is_open(name)]
        opened = [
            PaletteItem(
                tr(PANELS[name].title),
                tr("Panel"),
                PANELS[name].icon,
                "",
                panels.opener(name),
                also="" if name in open_panels else tr("add open show"),
                id=f"Panel: {PANELS[name].title}",
            )
            for name in panels.possible()
        ]
        closed = [
            PaletteItem(
                tr("Close {panel}").format(panel=tr(PANELS[name].title)),
                tr("Panel"),
                "x",
                "",
                panels.closer(name),
                also=tr("hide remove"),
                id=f"Panel: Close {PANELS[name].title}",
            )
            for name in open_panels
        ]
        floats = [
            PaletteItem(
                tr("{panel}: to a separate window, or back").format(panel=tr(PANELS[name].title)),
                tr("Panel"),
                "arrow-square-out",
                "",
                panels.floater(name),
                also=tr("float undock second screen"),
                id=f"Panel: {PANELS[name].title}: into a window of its own, or back",
            )
            for name in open_panels
        ]
        resizes = [
            PaletteItem(
                (tr("{panel}: larger") if by_px > 0 else tr("{panel}: smaller")).format(panel=tr(PANELS[name].title)),
                tr("Panel"),
                "arrows-out-simple" if by_px > 0 else "arrows-in-simple",
                "",
                do,
                also=tr("size resize width height room split"),
                id=f"Panel: {PANELS[name].title}: {'larger' if by_px > 0 else 'smaller'}",
            )
            for name in open_panels
            for by_px, do in panels.resizers(name)
        ]
        return opened if self._parts.layout.locked else [*opened, *closed, *floats, *resizes]

    def _of_layout(self) -> list[PaletteItem]:
        layout = self._parts.layout
        return [
            PaletteItem(
                tr("Layout: {what}").format(what=command.text),
                tr("Window"),
                command.icon,
                self._parts.actions.key_text(command.action) if command.action else "",
                layout.soon(command.do),
                also=tr("panels arrangement put back save reset"),
                id=f"row {command.action}" if command.action else f"Window: Layout: {command.id}",
            )
            for command in layout.commands()
            if command.possible
        ] + [
            PaletteItem(
                tr(text),
                tr("Window"),
                "layout",
                "",
                do,
                also=tr("panels arrangement layout study screens size"),
                id=f"Window: {text}",
            )
            for text, do in (
                (QT_TR_NOOP("Unlock the layout"), lambda: layout.set_locked(False))
                if layout.locked
                else (QT_TR_NOOP("Lock for a study"), lambda: layout.set_locked(True)),
                (QT_TR_NOOP("Use one layout for all screens"), lambda: layout.set_adapts(False))
                if layout.adapts
                else (QT_TR_NOOP("Adapt to small and large screens"), lambda: layout.set_adapts(True)),
            )
        ]

    def _of_robots(self) -> list[PaletteItem]:
        robots = self._parts.robots
        entries = [
            PaletteItem(
                tr("Connect to {robot}").format(robot=choice.title),
                tr("Robot"),
                "robot",
                "",
                robots.chooser(choice),
                also=tr("use switch another"),
                acts=True,
                named=choice.title,
                id=f"Robot: Connect to {choice.title}",
            )
            for choice in robots.others()
        ]
        if robots.can_detect:
            entries.append(
                PaletteItem(
                    tr("Connect another robot…"),
                    tr("Robot"),
                    "plus",
                    "",
                    robots.open_dialog,
                    also=tr("new add"),
                    id="Robot: Connect another robot…",
                )
            )
        return entries

    def _of_sessions(self) -> list[PaletteItem]:
        status, windows = self._state.recording.value, self._parts.sessions
        entries = []
        if status.state in ("recording", "paused"):
            paused = status.state == "paused"
            entries.append(
                PaletteItem(
                    tr("Resume recording") if paused else tr("Pause recording"),
                    tr("Do"),
                    "record" if paused else "pause",
                    "",
                    partial(self._console.do, intents.PauseRecording(not paused)),
                    also=tr("resume continue break"),
                    id="Do: Go on recording" if paused else "Do: Pause recording",
                )
            )
            stop = partial(self._console.do, intents.StopRecording())
            also = tr("end finish")
            entries.append(
                PaletteItem(tr("Stop recording"), tr("Do"), "stop", "", stop, also=also, id="Do: Stop recording")
            )
        else:
            entries.append(
                PaletteItem(
                    tr("Start recording"),
                    tr("Do"),
                    "record",
                    "",
                    windows.open_start_dialog,
                    also=tr("begin trial new session"),
                    common=True,
                    id="Do: Start recording",
                )
            )
            if status.folder is not None:
                entries.append(
                    PaletteItem(
                        tr("Export the last session…"),
                        tr("Window"),
                        "export",
                        "",
                        windows.export_last_session,
                        id="Window: Export the last session…",
                    )
                )
        if windows.has_library:
            also = tr("replay search study export")
            entries.append(
                PaletteItem(
                    tr("All sessions…"),
                    tr("Window"),
                    "archive",
                    "",
                    windows.open_sessions,
                    also=also,
                    id="Window: All sessions…",
                )
            )
        return [*entries, *map(self._of_session, windows.recent)]

    def _of_session(self, session: SessionEntry) -> PaletteItem:
        from caris_desktop.ui.session_table import local_time  # imported late: the first window does not need it

        heading = (session.participant or session.folder.name, local_time(session.started_utc), session.scenario)
        return PaletteItem(
            tr("Replay {session}").format(session=" · ".join(part for part in heading if part)),
            tr("Session"),
            "play",
            "",
            lambda: self._parts.sessions.open_replay(session.folder),
            also=tr("recording open watch"),
            id=f"session {session.folder.name}",
        )

    def of_scenarios(self) -> list[PaletteItem]:
        parts = self._parts
        return [
            PaletteItem(
                tr("Open scenario {title}").format(title=choice.title),
                tr("Scenario"),
                "map-trifold",
                "",
                partial(parts.open_scenario, choice.path),
                id=f"Scenario: Open scenario {choice.title}",
            )
            for choice in parts.scenarios.now()
        ]

    def _of_scenario_files(self) -> list[PaletteItem]:
        parts = self._parts
        return [
            PaletteItem(
                tr("Import a scenario"),
                tr("Scenario"),
                "download-simple",
                "",
                parts.scenario_files.choose_import,
                also=tr("open received file"),
                id="Scenario: Import a scenario",
            ),
            PaletteItem(
                tr("Export this scenario as one file"),
                tr("Scenario"),
                "export",
                "",
                parts.scenario_files.choose_share,
                also=tr("share export send"),
                id="Scenario: Write this scenario as one file",
            ),
        ]


def closing_entry(close: Callable[[], object], *, replay: bool) -> PaletteItem:
    """Palette item that quits the program.

    Quit item; the console's needs a second Enter, because closing a panel has nearly the same words.
    """
    return PaletteItem(
        tr("Close this window") if replay else tr("Close the console"),
        tr("Window") if replay else tr(TWICE),
        "x",
        "",
        close,
        also=tr("quit exit end leave program"),
        deliberate=not replay,
        again=tr("Press Enter again to close the console"),
        id="Window: Close this window" if replay else "Close the console",
    )


def step_entries(console: WizardConsole) -> list[PaletteItem]:
    """Palette items for the protocol: steps, and branches of the current step."""

    scenario = console.scenario
    step = present_step(scenario, console.state)
    branches = [
        PaletteItem(
            tr("{what}: continue to {step}").format(what=branch.title, step=target_of(scenario, branch).title),
            tr("Branch"), "git-branch", "", partial(console.do, intents.TakeBranch(branch.title)),
            also=tr("branch protocol"), acts=True,
            named=f"{branch.title} {target_of(scenario, branch).title}",
            id=f"Branch: {branch.title}: on to {target_of(scenario, branch).title}",
        )
        for branch in (() if step is None else step.branches)
    ]  # fmt: skip
    steps = [
        PaletteItem(
            tr("Step {number}: {title}").format(number=number, title=one.title), tr("Step"), "list-numbers", "",
            partial(console.do, intents.GoToStep(one.step_id)), also=tr("protocol jump begin"), acts=True,
            named=f"{number} {one.title}",
            id=f"Step: Step {number}: {one.title}",
        )
        for number, one in enumerate(scenario.protocol.steps, start=1)
    ]  # fmt: skip
    return [*branches, *steps]


class PersonEntries:
    """Palette items for people, and for the pending question about one."""

    def __init__(self, parts: AppContext) -> None:
        self._parts = parts
        self._console = parts.console
        self._state = parts.console.state

    def now(self) -> list[PaletteItem]:
        """Items to select, rename, view and annotate each person; and the pending question."""
        table, state = self._parts.actions, self._state
        persons = everyone(state.persons.value, state.everybody.value, state.present.now_ns())
        entries = []
        suggested = next((person for person in persons if is_asked(person, state.asked_person.value)), None)
        if suggested is not None and suggested.suggestion is not None:
            named = {
                "person": text_formatting.person_name(suggested),
                "other": text_formatting.name_in_words(suggested.suggestion.name),
            }
            for action_id, text, icon in (
                ("answer_yes", tr("Yes, {person} is {other}").format(**named), "check"),
                ("answer_no", tr("No, {person} is not {other}").format(**named), "x"),
            ):
                entries.append(
                    PaletteItem(
                        text,
                        tr("Person"),
                        icon,
                        table.key_text(action_id),
                        partial(table.run, action_id),
                        also=tr("confirm reject"),
                        acts=True,
                        id=f"row {action_id}",
                    )
                )
        for person in persons:
            name, also = text_formatting.person_name(person), " ".join((tr("person"), person.group, *person.tags))
            # The usage history must not contain names.
            known_as = person.person_id
            entries.append(
                PaletteItem(
                    name,
                    tr("Select"),
                    "user",
                    "",
                    partial(self._select, person),
                    also=also,
                    acts=True,
                    id=f"person {known_as} select",
                )
            )
            if "people" not in self._parts.panels.possible():
                continue
            entries.append(
                PaletteItem(
                    tr("Details of {person}").format(person=name),
                    tr("Person"),
                    "identification-card",
                    "",
                    partial(self._show, person, card=True),
                    acts=True,
                    id=f"person {known_as} card",
                )
            )
            if person.here:
                entries.append(
                    PaletteItem(
                        tr("Rename {person}").format(person=name),
                        tr("Person"),
                        "pencil-simple",
                        "",
                        partial(self._show, person, rename=True),
                        acts=True,
                        id=f"person {known_as} rename",
                    )
                )
        if state.everybody.value or state.persons.value:
            entries.append(
                PaletteItem(
                    tr("Undo the last change to people"),
                    tr("Do"),
                    "arrow-u-up-left",
                    "",
                    partial(self._console.do, intents.UndoPeople()),
                    also=tr("take back name merge"),
                    id="Do: Undo the last change to people",
                )
            )
        return entries

    def _select(self, person: PersonRow) -> None:
        self._console.do(intents.AttendPerson(person.person_id))
        panel = self._parts.panels.panels.get("people")
        if panel is not None:
            panel.show_person(person.person_id)

    def _show(self, person: PersonRow, *, rename: bool = False, card: bool = False) -> None:
        panels = self._parts.panels
        panels.open("people")
        panel = panels.panels.get("people")
        if panel is not None:
            panel.show_person(person.person_id, rename=rename, card=card)
