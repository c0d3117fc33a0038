"""Items of the command palette, from the current state; quick choices by a digit."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QLocale

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import ControlValue, RobotControl
from caris_desktop.domain.events import AssistanceLevel
from caris_desktop.domain.intents import INTENTS
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr, tr_filled
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.studies.study_query import SessionEntry
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.scenario.scenario_model import levels_up_to
from caris_desktop.ui import event_messages, text_formatting
from caris_desktop.ui.action_rows import (
    PEOPLE_GROUP,
    PLACES_GROUP,
    SAFETY_GROUP,
    SCENARIO_GROUP,
    SPEAKING_GROUP,
    ActionSpec,
    answer_asked,
    go_to_nth_place,
    present_step,
    say,
    say_filler,
    say_keyed_phrase,
    say_phrase,
    target_of,
)
from caris_desktop.ui.banners import QuestionBanner
from caris_desktop.ui.dock_host import RESIZE_PX
from caris_desktop.ui.menus import sound_choices
from caris_desktop.ui.observer_window import SEES_WORDS
from caris_desktop.ui.palette.command_palette import CommandPalette, PaletteItem
from caris_desktop.ui.panel_table import PANELS
from caris_desktop.ui.people.shown_people import everyone, is_asked
from caris_desktop.ui.speak.speak_field import voice_choices
from caris_desktop.ui.text_formatting import UNDER_WAY, local_time, question_for
from caris_desktop.ui.theme import SCALES, ThemeChoice
from caris_desktop.ui.window_appearance import languages, percent_of, scale_words
from caris_desktop.ui.window_menus import THEME_WORDS, AppContext

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.live.replay_console import ReplayConsole

_DO, _SAY, _WINDOW, _PANEL = QT_TR_NOOP("Do"), QT_TR_NOOP("Say"), QT_TR_NOOP("Window"), QT_TR_NOOP("Panel")
_SCENARIO, _ROBOT, _CONTROL = QT_TR_NOOP("Scenario"), QT_TR_NOOP("Robot"), QT_TR_NOOP("Control")
_PERSON, _MAP, _WIZARD = QT_TR_NOOP("Person"), QT_TR_NOOP("Map"), QT_TR_NOOP("Wizard")
_TWICE = QT_TR_NOOP("select it, then Enter twice")

# Parts of the ids in the usage history: they stay as they are, however the texts are worded.
_LEVEL_IDS: dict[AssistanceLevel, str] = {
    "off": "off",
    "suggest": "suggest: my key does it",
    "act": "by itself, after a countdown",
}
_THEME_IDS: dict[ThemeChoice, str] = {"system": "like the system", "dark": "dark", "light": "light"}

_Items = Iterator[PaletteItem]


def item(
    kind: str,
    text: str,
    icon: str,
    do: Callable[[], object],
    also: str = "",
    *,
    id: str = "",  # noqa: A002
    **more: Any,
) -> PaletteItem:
    """Item of marked texts, with the kind and the English text as its id if no other is given."""
    return PaletteItem(
        tr_filled(text), tr_filled(kind), icon, do, also=tr_filled(also), id=id or f"{kind}: {text}", **more
    )


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

    def of_replay(self, replay: "ReplayConsole") -> list[PaletteItem]:
        """Items of a replay: no speech, and the stop only if robots are being driven."""
        left_out = {SPEAKING_GROUP} if replay.live_robots.value.robots else {SPEAKING_GROUP, SAFETY_GROUP}
        rows = [spec for spec in self._rows() if spec.group not in left_out]
        return [
            *map(self._of_row, rows), *self._of_panels(), *self._of_layout(), *self._of_themes(),
            closing_entry(self._parts.close_window, replay=True),
        ]  # fmt: skip

    def now(self) -> list[PaletteItem]:
        """Items available now."""
        permissions = self._console.scenario.permissions
        return [
            *self._of_emergency_stop(),
            *map(self._of_row, self._rows()),
            *(self._of_phrases() if permissions.speech else ()),
            *(person_entries(self._parts) if permissions.naming_people else ()),
            *step_entries(self._console),
            *self._of_goal(),
            *(self.of_places() if permissions.driving else ()),
            *(self._of_controls() if permissions.robot_controls else ()),
            *(self._of_map() if permissions.driving else ()),
            *self._of_cameras(),
            *self._of_panels(),
            *self._of_layout(),
            *self._of_robots(),
            *self._of_windows(),
            *self._of_sessions(),
            *self._of_scenarios(),
            *(self._of_voices() if permissions.speech else ()),
            *(self._of_levels() if permissions.assistant else ()),
            *self._of_guard(),
            *self._of_sound(),
            *self._of_themes(),
            *self._of_appearance(),
            *self._of_wizards(),
            closing_entry(self._parts.close_window, replay=False),
        ]

    def _ask(self, intent: intents.Intent) -> Callable[[], object]:
        return partial(self._console.do, intent)

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
        return item(
            _SAY if is_utterance else _DO, spec.text, spec.icon, lambda: table.press(spec.id),
            spec.also, key=table.key_text(spec.id), acts=is_utterance or moves,
            named=spec.text if spec.intent is say_filler else spec.text.partition(": ")[2],
            common=spec.common, id=f"row {spec.id}",
        )  # fmt: skip

    def _of_phrases(self) -> _Items:
        """Phrases of all groups, with the key that says them now."""
        table, chosen = self._parts.actions, self._state.phrase_group.value
        keyed = {spec.argument: spec.id for spec in table.all_specs if spec.intent is say_keyed_phrase}
        for index, group in enumerate(phrase_groups(self._console.scenario.phrases)):
            for number, phrase in enumerate(group.phrases, start=1):
                row = (keyed.get(phrase) if phrase.key else None) or (f"phrase_{number}" if index == chosen else "")
                yield item(
                    _SAY, phrase.say, "chat-text", self._ask(say(phrase)), group.title, acts=True,
                    key=table.key_text(row) if row else "", named=f"{phrase.say} {group.title}",
                )  # fmt: skip

    def _of_emergency_stop(self) -> _Items:
        if self._state.drive.value.emergency_stop:
            yield item(
                _TWICE, QT_TR_NOOP("Release emergency stop"), "lock-open", self._ask(intents.ReleaseEmergencyStop()),
                QT_TR_NOOP("unlock free reset clear drive again"), deliberate=True, first=True,
                again=tr("Press Enter again to release the emergency stop"), id="Release emergency stop",
            )  # fmt: skip

    def _of_goal(self) -> _Items:
        goal = self._state.goal.value
        if goal is not None and goal.state in UNDER_WAY:
            text = localized(QT_TR_NOOP("Stop going to {place}"), place=goal.place or QT_TR_NOOP("the chosen point"))
            yield item(_DO, text, "x", self._ask(intents.CancelGoal()), QT_TR_NOOP("cancel goal way"))

    def of_places(self) -> list[PaletteItem]:
        return [
            item(
                QT_TR_NOOP("Place"), localized(QT_TR_NOOP("Go to {place}"), place=place.name), "flag",
                self._ask(intents.GoToPlace(place.name)), QT_TR_NOOP("drive move navigate send take robot"),
                key=self._parts.actions.key_text(f"place_{number}"), acts=True, named=place.name, by_name=True,
            )
            for number, place in enumerate(self._state.places.value, start=1)
        ]  # fmt: skip

    def _of_controls(self) -> _Items:
        """Robot controls that need no value but a choice."""
        held = self._state.drive.value.emergency_stop
        for control in self._state.controls.value:
            if held and control.is_held_by_stop:
                continue
            title, uses = control.title, list[tuple[str, ControlValue]]()
            if control.kind == "button":
                uses = [(title, True)]
            elif control.kind == "toggle":
                on, off = QT_TR_NOOP("{control} on"), QT_TR_NOOP("{control} off")
                uses = [(localized(on, control=title), True), (localized(off, control=title), False)]
            elif control.kind == "choice":
                to_one = QT_TR_NOOP("{control}: {choice}")
                uses = [(localized(to_one, control=title, choice=each.title), each.value) for each in control.choices]
            elif "robot" in self._parts.panels.possible():
                text = localized(QT_TR_NOOP("Robot: {control}"), control=title)
                yield item(_CONTROL, text, "sliders", partial(self._parts.panels.open_and_focus, "robot"))
            for use, value in uses:
                yield item(
                    control.group or _CONTROL, localized(QT_TR_NOOP("Robot: {control}"), control=use), "sliders",
                    self._control_user(control, value), QT_TR_NOOP("control"), acts=True,
                    named=f"{tr_filled(use)} {control.group}",
                )  # fmt: skip

    def _control_user(self, control: RobotControl, value: ControlValue) -> Callable[[], object]:
        use = self._ask(intents.UseControl(control.id, value))
        if not control.confirm:
            return use
        return lambda: self._question.ask(question_for(control, value), tr("Do it"), use)

    def _of_map(self) -> _Items:
        """Mapping commands that need no name."""
        status = self._state.mapping.value
        if status.can_save:
            name = f"map-{datetime.now():%Y-%m-%d-%H-%M}"
            yield item(
                _MAP, localized(QT_TR_NOOP("Save the map as {name}"), name=name), "floppy-disk",
                self._ask(intents.SaveMap(name)), acts=True, named=tr("the map {name}").format(name=name),
                id="save map",
            )  # fmt: skip
        if status.can_switch and status.mapping is not True:
            start = self._ask(intents.SetMapping(mapping=True))
            yield item(_MAP, QT_TR_NOOP("Start mapping"), "map-trifold", start, acts=True, named=tr("map mapping"))
        if status.can_switch and status.mapping is not False:
            yield item(
                _MAP, QT_TR_NOOP("Stop mapping, keep the map"), "map-trifold",
                self._ask(intents.SetMapping(mapping=False)), QT_TR_NOOP("localization localisation end"), acts=True,
                named=tr("the map mapping"),
            )  # fmt: skip

    def _of_cameras(self) -> _Items:
        state = self._state
        for name in state.cameras.value:
            if name != state.camera.value:
                text = localized(QT_TR_NOOP("Show the camera {name}"), name=name)
                choose = partial(state.choose_camera, name)
                yield item(QT_TR_NOOP("Video"), text, "video-camera", choose, QT_TR_NOOP("picture"))

    def _of_panels(self) -> _Items:
        panels, docks, locked = self._parts.panels, self._parts.panels.docks, self._parts.layout.locked
        possible = panels.possible()
        open_panels = [name for name in possible if panels.is_open(name)]
        for name in possible:
            also = "" if name in open_panels else tr("add open show")
            yield item(
                _PANEL, PANELS[name].title, PANELS[name].icon, partial(panels.open_and_focus, name),
                f"{tr_filled(PANELS[name].also)} {also}",
            )  # fmt: skip
        if locked:
            return
        for name in open_panels:
            title = PANELS[name].title
            yield item(
                _PANEL, localized(QT_TR_NOOP("Close {panel}"), panel=title), "x", partial(panels.close, name),
                QT_TR_NOOP("hide remove"), ends=True, named=tr(title),
            )  # fmt: skip
        for name in open_panels:
            title = PANELS[name].title
            yield item(
                _PANEL, localized(QT_TR_NOOP("{panel}: to a separate window, or back"), panel=title),
                "arrow-square-out", partial(docks.toggle_floating, name), QT_TR_NOOP("float undock second screen"),
                id=f"Panel: {title}: into a window of its own, or back",
            )  # fmt: skip
        for name in open_panels:
            for by_px in (RESIZE_PX, -RESIZE_PX):
                if docks.resized(name, by_px) is None:
                    continue
                change = QT_TR_NOOP("{panel}: larger") if by_px > 0 else QT_TR_NOOP("{panel}: smaller")
                yield item(
                    _PANEL, localized(change, panel=PANELS[name].title),
                    "arrows-out-simple" if by_px > 0 else "arrows-in-simple",
                    partial(docks.resize_panel, name, by_px), QT_TR_NOOP("size resize width height room split"),
                )  # fmt: skip

    def _of_layout(self) -> _Items:
        layout, also = self._parts.layout, QT_TR_NOOP("panels arrangement put back save reset")
        for command in layout.commands():
            if command.possible:
                yield item(
                    _WINDOW, tr("Layout: {what}").format(what=command.text), command.icon, layout.soon(command.do),
                    also, key=self._parts.actions.key_text(command.action) if command.action else "",
                    id=f"row {command.action}" if command.action else f"Window: Layout: {command.id}",
                )  # fmt: skip
        lock = QT_TR_NOOP("Unlock the layout") if layout.locked else QT_TR_NOOP("Lock for a study")
        adapt = (
            QT_TR_NOOP("Use one layout for all screens")
            if layout.adapts
            else QT_TR_NOOP("Adapt to small and large screens")
        )
        also = QT_TR_NOOP("panels arrangement layout study screens size")
        yield item(_WINDOW, lock, "layout", partial(layout.set_locked, not layout.locked), also)
        yield item(_WINDOW, adapt, "layout", partial(layout.set_adapts, not layout.adapts), also)

    def _of_robots(self) -> _Items:
        robots = self._parts.robots
        for choice in robots.others():
            yield item(
                _ROBOT, localized(QT_TR_NOOP("Connect to {robot}"), robot=choice.title), "robot",
                partial(robots.choose, choice), QT_TR_NOOP("use switch another"), acts=True, named=choice.title,
            )  # fmt: skip
        if robots.can_detect:
            yield item(_ROBOT, QT_TR_NOOP("Connect another robot…"), "plus", robots.open_dialog, QT_TR_NOOP("new add"))

    def _of_windows(self) -> _Items:
        parts, connection = self._parts, QT_TR_NOOP("Connection in the last minute")
        for sees, text in SEES_WORDS.items():
            yield item(_WINDOW, text, "monitor", partial(parts.observers.open, sees), QT_TR_NOOP("second screen"))
        practise, also = QT_TR_NOOP("Practise on the simulated robot"), QT_TR_NOOP("learn training tutorial help")
        yield item(_DO, practise, "student", parts.practise, also)
        yield item(_WINDOW, connection, "wifi-high", self._show_connection)
        if parts.gamepad.offered:
            also = QT_TR_NOOP("joystick controller")
            yield item(_WINDOW, QT_TR_NOOP("Gamepad"), "game-controller", parts.gamepad.open, also)

    def _of_sessions(self) -> _Items:
        status, windows = self._state.recording.value, self._parts.sessions
        if status.state in ("recording", "paused"):
            paused = status.state == "paused"
            yield item(
                _DO, QT_TR_NOOP("Resume recording") if paused else QT_TR_NOOP("Pause recording"),
                "record" if paused else "pause", self._ask(intents.PauseRecording(not paused)),
                QT_TR_NOOP("resume continue break"), id="Do: Go on recording" if paused else "",
                ends=True, named=tr("recording"),
            )  # fmt: skip
            stop = self._ask(intents.StopRecording())
            text, also = QT_TR_NOOP("Stop recording"), QT_TR_NOOP("end finish")
            yield item(_DO, text, "stop", stop, also, ends=True, named=tr("recording"))
        else:
            also = QT_TR_NOOP("begin trial new session")
            yield item(_DO, QT_TR_NOOP("Start recording"), "record", windows.open_start_dialog, also, common=True)
            if status.folder is not None:
                yield item(_WINDOW, QT_TR_NOOP("Export the last session…"), "export", windows.export_last_session)
        if windows.has_library:
            also = QT_TR_NOOP("replay search study export")
            yield item(_WINDOW, QT_TR_NOOP("All sessions…"), "archive", windows.open_sessions, also)
        yield from map(self._of_session, windows.recent)

    def _of_session(self, session: SessionEntry) -> PaletteItem:
        heading = (session.participant or session.folder.name, local_time(session.started_utc), session.scenario)
        return item(
            QT_TR_NOOP("Session"), localized(QT_TR_NOOP("Replay {session}"), session=" · ".join(filter(None, heading))),
            "play", lambda: self._parts.sessions.open_replay(session.folder),
            QT_TR_NOOP("recording open watch"), id=f"session {session.folder.name}",
        )  # fmt: skip

    def of_scenarios(self) -> list[PaletteItem]:
        parts, text = self._parts, QT_TR_NOOP("Open scenario {title}")
        return [
            item(
                _SCENARIO, localized(text, title=choice.title), "map-trifold", partial(parts.open_scenario, choice.path)
            )
            for choice in parts.scenarios.now()
        ]

    def _of_scenarios(self) -> _Items:
        files, also = self._parts.scenario_files, QT_TR_NOOP("change phrases places permissions protocol form yaml")
        yield item(_SCENARIO, QT_TR_NOOP("Edit this scenario…"), "pencil-simple", self._parts.editor.open, also)
        yield from self.of_scenarios()
        text, also = QT_TR_NOOP("Import a scenario"), QT_TR_NOOP("open received file")
        yield item(_SCENARIO, text, "download-simple", files.choose_import, also)
        yield item(
            _SCENARIO, QT_TR_NOOP("Export this scenario as one file"), "export", files.choose_share,
            QT_TR_NOOP("share export send"), id="Scenario: Write this scenario as one file",
        )  # fmt: skip

    # Settings: current values are left out.

    def _of_voices(self) -> _Items:
        kind, also = QT_TR_NOOP("Voice"), QT_TR_NOOP("speak voice")
        for group in voice_choices(self._state.voice.value):
            for choice in group:
                if not choice.chosen:
                    do = self._ask(choice.intent)
                    yield item(kind, choice.text, "sliders-horizontal", do, also, acts=True, id=f"Voice: {choice.id}")

    def _of_levels(self) -> _Items:
        """Autonomy levels of the language model, where they can be changed."""
        scenario, levels = self._console.scenario, self._state.levels.value
        for function, title in event_messages.FUNCTIONS.items():
            for level in levels_up_to(scenario.highest_level(function)) if function in scenario.assisted else ():
                if level != getattr(levels, function):
                    text = QT_TR_NOOP("{function}: {level}")
                    yield item(
                        _DO, localized(text, function=title, level=event_messages.LEVELS[level]), "sliders-horizontal",
                        self._ask(intents.SetLevel(function, level)),
                        QT_TR_NOOP("assistant level suggestions proposals"), id=f"Do: {title}: {_LEVEL_IDS[level]}",
                    )  # fmt: skip

    def _of_guard(self) -> _Items:
        guard = self._state.drive.value.guard
        if guard == "overridden":
            yield item(
                _DO, QT_TR_NOOP("Turn on the obstacle guard"), "shield-check", self._ask(intents.SetGuard(on=True)),
                id="Do: Switch the obstacle guard on",
            )  # fmt: skip
        elif guard != "absent" and self._console.scenario.permissions.driving:
            yield item(
                _TWICE, QT_TR_NOOP("Turn off the obstacle guard"), "shield-slash",
                self._ask(intents.SetGuard(on=False)), deliberate=True,
                again=tr("Press Enter again to turn off the guard"), id="Switch the obstacle guard off",
            )  # fmt: skip

    def _of_wizards(self) -> _Items:
        wizards = self._parts.wizards
        for name in (*wizards.names, ""):
            if name != wizards.current:
                yield item(
                    _WIZARD, localized(QT_TR_NOOP("Wizard: {name}"), name=name or QT_TR_NOOP("not specified")),
                    "user-gear", partial(wizards.choose, name), QT_TR_NOOP("who is at the console profile keys"),
                    id=f"Wizard: Wizard: {name or 'nobody in particular'}",
                )  # fmt: skip

    def _of_sound(self) -> _Items:
        for choice in sound_choices(self._console):
            if not choice.chosen:
                yield item(
                    QT_TR_NOOP("Sound"), tr("{setting}: {choice}").format(setting=choice.title, choice=choice.text),
                    "microphone", self._ask(choice.intent), QT_TR_NOOP("device input volume"), id=f"Sound: {choice.id}",
                )  # fmt: skip

    def _of_themes(self) -> _Items:
        also = QT_TR_NOOP("theme colours colors mode night day")
        for choice, words in THEME_WORDS.items():
            yield item(
                _WINDOW, localized(QT_TR_NOOP("Appearance: {theme}"), theme=words), "moon",
                partial(self._parts.appearance.choose_theme, choice), also,
                id=f"Window: Appearance: {_THEME_IDS[choice]}",
            )  # fmt: skip

    def _of_appearance(self) -> _Items:
        appearance = self._parts.appearance
        for scale in SCALES:
            if scale != appearance.scale:
                size = f"{percent_of(scale)} % from the next start" if scale else "as the system has it"
                yield item(
                    _WINDOW, scale_words(scale), "text-aa", partial(appearance.choose_scale, scale),
                    QT_TR_NOOP("larger bigger smaller text font zoom scale"), id=f"Window: Size: {size}",
                )  # fmt: skip
        for name in languages():
            if name != appearance.language:
                native = QLocale(name).nativeLanguageName()
                yield item(
                    _WINDOW, localized(QT_TR_NOOP("Language: {name} after a restart"), name=native), "translate",
                    partial(appearance.choose_language, name), QT_TR_NOOP("translation"),
                    id=f"Window: Language: {native} from the next start",
                )  # fmt: skip


def closing_entry(close: Callable[[], object], *, replay: bool) -> PaletteItem:
    """Palette item that quits the program.

    The console's needs a second Enter, because closing a panel has nearly the same words.
    """
    also = QT_TR_NOOP("quit exit end leave program")
    if replay:
        return item(_WINDOW, QT_TR_NOOP("Close this window"), "x", close, also)
    return item(
        _TWICE, QT_TR_NOOP("Close the console"), "x", close, also, deliberate=True,
        again=tr("Press Enter again to close the console"), id="Close the console",
    )  # fmt: skip


def step_entries(console: WizardConsole) -> list[PaletteItem]:
    """Palette items for the protocol: steps, and branches of the current step."""
    scenario = console.scenario
    step = present_step(scenario, console.state)
    branches = [(branch, target_of(scenario, branch).title) for branch in (() if step is None else step.branches)]
    return [
        *(
            item(
                QT_TR_NOOP("Branch"),
                localized(QT_TR_NOOP("{what}: continue to {step}"), what=branch.title, step=target), "git-branch",
                partial(console.do, intents.TakeBranch(branch.title)), QT_TR_NOOP("branch protocol"), acts=True,
                named=f"{branch.title} {target}", id=f"Branch: {branch.title}: on to {target}",
            )
            for branch, target in branches
        ),
        *(
            item(
                QT_TR_NOOP("Step"), localized(QT_TR_NOOP("Step {number}: {title}"), number=number, title=one.title),
                "list-numbers", partial(console.do, intents.GoToStep(one.step_id)), QT_TR_NOOP("protocol jump begin"),
                acts=True, named=f"{number} {one.title}",
            )
            for number, one in enumerate(scenario.protocol.steps, start=1)
        ),
    ]  # fmt: skip


def person_entries(parts: AppContext) -> _Items:
    """Items to select, rename, view and annotate each person; and the pending question."""
    state = parts.console.state
    persons = everyone(state.persons.value, state.everybody.value, state.present.now_ns())
    yield from _answers(parts, persons)
    for person in persons:
        # The usage history must not contain names.
        name, person_key = text_formatting.person_name(person), f"person {person.person_id}"
        also = " ".join((tr("person"), person.group, *person.tags))
        yield item(
            QT_TR_NOOP("Select"), name, "user", partial(_select, parts, person.person_id), also, acts=True,
            id=f"{person_key} select",
        )  # fmt: skip
        if "people" not in parts.panels.possible():
            continue
        yield item(
            _PERSON, localized(QT_TR_NOOP("Details of {person}"), person=name), "identification-card",
            partial(_show, parts, person.person_id, card=True), acts=True, id=f"{person_key} card",
        )  # fmt: skip
        if person.here:
            yield item(
                _PERSON, localized(QT_TR_NOOP("Rename {person}"), person=name), "pencil-simple",
                partial(_show, parts, person.person_id, rename=True), acts=True, id=f"{person_key} rename",
            )  # fmt: skip
    if state.everybody.value or state.persons.value:
        undo = partial(parts.console.do, intents.UndoPeople())
        text, also = QT_TR_NOOP("Undo the last change to people"), QT_TR_NOOP("take back name merge")
        yield item(_DO, text, "arrow-u-up-left", undo, also)


def _answers(parts: AppContext, persons: Sequence[PersonRow]) -> _Items:
    table = parts.actions
    asked = parts.console.state.asked_person.value
    suggested = next((person for person in persons if is_asked(person, asked)), None)
    if suggested is None or suggested.suggestion is None:
        return
    person, other = text_formatting.person_name(suggested), text_formatting.name_in_words(suggested.suggestion.name)
    for action_id, text, icon in (
        ("answer_yes", QT_TR_NOOP("Yes, {person} is {other}"), "check"),
        ("answer_no", QT_TR_NOOP("No, {person} is not {other}"), "x"),
    ):
        yield item(
            _PERSON, localized(text, person=person, other=other), icon, partial(table.run, action_id),
            QT_TR_NOOP("confirm reject"), key=table.key_text(action_id), acts=True, id=f"row {action_id}",
        )  # fmt: skip


def _select(parts: AppContext, person_id: str) -> None:
    parts.console.do(intents.AttendPerson(person_id))
    if panel := parts.panels.panels.get("people"):
        panel.show_person(person_id)


def _show(parts: AppContext, person_id: str, *, rename: bool = False, card: bool = False) -> None:
    parts.panels.open("people")
    if panel := parts.panels.panels.get("people"):
        panel.show_person(person_id, rename=rename, card=card)


class QuickChoices:
    """Commands of the action table to choose places, scenarios and wizards, and to name a person."""

    def __init__(self, parts: AppContext, entries: PaletteEntries, palette: CommandPalette) -> None:
        self._parts = parts
        self._entries = entries
        self._palette = palette
        self._awaits_scenarios = False
        parts.scenarios.changed.connect(self._on_scenarios_read)
        for group in (PLACES_GROUP, SCENARIO_GROUP, PEOPLE_GROUP):
            parts.actions.answer_for(group, self)

    def choose_place(self) -> None:
        self._palette.choose_from(
            tr("Where should the robot go? Press a digit, or type."), self._with_digits(self._entries.of_places())
        )

    def choose_scenario(self) -> None:
        entries = self._entries.of_scenarios()
        self._awaits_scenarios = not entries
        self._palette.choose_from(tr("Which scenario? Press a digit, or type."), self._with_digits(entries))

    def _on_scenarios_read(self) -> None:
        if self._awaits_scenarios and self._palette.isVisible():
            self.choose_scenario()
        self._awaits_scenarios = False

    def choose_wizard(self) -> None:
        """Choose a known wizard or enter a new name."""
        wizards = self._parts.wizards

        def chosen(name: str, text: str) -> PaletteItem:
            return PaletteItem(text, tr("Wizard"), "user-gear", lambda: wizards.choose(name), id=f"Wizard: {name}")

        known = [chosen(name, name) for name in wizards.names if name != wizards.current]
        self._palette.ask(
            tr("Your name or initials"), known, lambda typed: chosen(typed, tr("New wizard: {name}").format(name=typed))
        )

    def name_person(self) -> str:
        """Edit the name of the person in front of the robot; Enter saves it."""
        state = self._parts.console.state
        person = nearest_person(state.persons.value, selected=state.selected_person.value)
        if person is None:
            return tr("Nobody is in view, so nobody can be named.")
        _show(self._parts, person.person_id, rename=True)
        return ""

    def _with_digits(self, entries: Sequence[PaletteItem]) -> Sequence[PaletteItem]:
        letter = self._parts.actions.letter
        return [
            replace(entry, key=letter(str(number)) if number <= CommandPalette.DIGITS else "")
            for number, entry in enumerate(entries, start=1)
        ]


def nearest_person(persons: Iterable[PersonRow], *, selected: str = "") -> PersonRow | None:
    """Nearest person in front of the robot.

    The selected person if present; else the nearest unnamed person, else the nearest.

    Without distances: the one most straight ahead, then the one present longest.
    """
    here = [person for person in persons if person.here]
    chosen = next((person for person in here if person.person_id == selected), None)
    return chosen or min(here, key=_how_far, default=None)


def _how_far(person: PersonRow) -> tuple[bool, float, float, int]:
    aside = math.inf if person.bearing_rad is None else abs(math.remainder(person.bearing_rad, math.tau))
    distance_m = math.inf if person.distance_m is None else person.distance_m
    return text_formatting.has_given_name(person), distance_m, aside, person.since_ns
