"""Phrase buttons: groups, phrases of the selected group, and gestures."""

from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.gestures import MOST_GESTURES
from caris_desktop.scenario.phrases import phrase_groups
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import Actions, cap_text, keyed_phrases
from caris_desktop.ui.action_rows import PHRASE_COUNT, perform_nth_gesture
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.key_cap import KeyCap

_UNTITLED = QT_TR_NOOP("General")
_GESTURES = tuple(f"gesture_{number}" for number in range(1, MOST_GESTURES + 1))
_CHIPS = (*(f"phrase_{number}" for number in range(1, PHRASE_COUNT + 1)), "filler", *_GESTURES)
"""Rows of the action table with a button here, in order."""


class PhraseRows(QWidget):
    """Phrase buttons with height for width."""

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self._theme = theme
        self._console = console
        self._actions = actions
        self._titles: list[ActionButton] = []
        tabs = self._tabs = QWidget()
        self._tabs_row = layouts.hbox(tabs, margins_px=0, spacing_px=4)
        self._next_key = KeyCap(theme)
        self._tabs_row.addWidget(self._next_key)
        self._tabs_row.addStretch(1)
        self._flow = FlowRow(gap_px=6)
        self._chips: dict[str, ActionButton] = {}
        self._next = ActionButton(theme, key_first=True, look="ghost", height_px=32, may_shrink=True)
        self._next.setObjectName("next_phrases")
        self._next.bind(actions, "next_phrases")
        self._flow.add(self._next)
        self._keyless = QLabel(wordWrap=True)
        column = layouts.vbox(self, margins_px=0, spacing_px=6)
        column.addWidget(tabs)
        column.addWidget(self._flow)
        column.addWidget(self._keyless)
        actions.rows_changed.connect(self._refresh)
        theme.restyle_on_change(self._style)
        self.show_scenario()

    def show_scenario(self) -> None:
        """Show groups, phrases and gestures of the scenario, reusing buttons."""
        groups = phrase_groups(self._console.scenario.phrases)
        while len(self._titles) > len(groups):
            title = self._titles.pop()
            title.hide()
            title.deleteLater()
        for number in range(len(self._titles), len(groups)):
            self._titles.append(self._new_title(number))
        for title, group in zip(self._titles, groups, strict=True):
            title.set_label(group.title or tr(_UNTITLED))
        self._next_key.set_text(self._actions.key_text("next_phrases"))
        there = {spec.id for spec in self._actions.all_specs}
        wanted = [action_id for action_id in _CHIPS if action_id in there]
        for action_id in self._chips.keys() - set(wanted):
            chip = self._chips.pop(action_id)
            self._flow.remove(chip)
            chip.deleteLater()
        for action_id in wanted:
            if action_id not in self._chips:
                self._chips[action_id] = self._new_chip(action_id)
        self._flow.arrange([*(self._chips[action_id] for action_id in wanted), self._next])
        self._report_keyless()
        self._refresh()

    def _new_title(self, number: int) -> ActionButton:
        title = ActionButton(self._theme, look="ghost", height_px=28)
        title.setCheckable(True)
        title.setObjectName(f"phrase_group_{number + 1}")
        title.clicked.connect(lambda: self._choose(number))
        self._tabs_row.insertWidget(number, title)
        title.show()
        return title

    def _new_chip(self, action_id: str) -> ActionButton:
        icon = "hand-waving" if action_id in _GESTURES else ""
        chip = ActionButton(self._theme, icon=icon, key_first=True, height_px=32, may_shrink=True)
        chip.setObjectName(action_id)
        chip.bind(self._actions, action_id)
        self._flow.add(chip)
        return chip

    def set_size(self, *, chip_px: int, text_px: int, gap_px: int, low: bool) -> None:
        """Set button sizes; ``low``: instead of a line of groups, a button switches to the next group."""
        several = len(self._titles) > 1
        self._tabs.setVisible(several and not low)
        self._next.setVisible(several and low)
        self._flow.set_gap(gap_px)
        for chip in (*self._chips.values(), self._next):
            chip.set_size(height_px=chip_px, text_px=text_px)

    def height_for(self, width_px: int) -> int:
        """Total height at this width."""
        others = sum(30 + 6 for there in (self._tabs.isVisibleTo(self), bool(self._keyless.text())) if there)
        return self._flow.heightForWidth(width_px) + others

    def _choose(self, number: int) -> None:
        self._console.state.choose_phrases(number)
        self._refresh()

    def _refresh(self) -> None:
        chosen = self._console.state.phrase_group.value
        for number, title in enumerate(self._titles):
            title.setChecked(number == chosen)
        if self._titles:
            self._next.set_label(f"{self._titles[(chosen + 1) % len(self._titles)].text()} …")
        for action_id, chip in self._chips.items():
            spec = self._actions.spec(action_id)
            label = "" if spec is None else spec.text
            if spec is not None and spec.intent is perform_nth_gesture:
                # The keys may still belong to the former scenario, which had more gestures.
                titles = [gesture.title for gesture in self._console.scenario.gestures]
                spec, label = (spec, titles[spec.argument - 1]) if spec.argument <= len(titles) else (None, "")
            chip.setVisible(spec is not None)
            if spec is not None:
                chip.set_label(label)
                chip.setAccessibleName(spec.text)
                chip.setToolTip(spec.text)
                chip.set_key(self._actions.key_text(action_id))
        self._flow.updateGeometry()

    def _report_keyless(self) -> None:
        """List phrases and gestures whose key is taken by another command."""
        lost = {spec.argument for spec, _other in self._actions.settled.clashes}
        keyless = [phrase for phrase in keyed_phrases(self._console.scenario) if phrase in lost]
        scenario = self._console.scenario
        gestures = [
            scenario.gestures[spec.argument - 1]
            for spec, _other in self._actions.settled.clashes
            if spec.intent is perform_nth_gesture and spec.argument <= len(scenario.gestures)
        ]
        sentences = [
            tr("{key} already has another function: “{phrase}” has no key.").format(
                key=cap_text(phrase.key), phrase=phrase.say
            )
            for phrase in keyless
        ]
        sentences += [
            tr("{key} already has another function: the gesture “{gesture}” has no key.").format(
                key=cap_text(gesture.key), gesture=gesture.title
            )
            for gesture in gestures
        ]
        self._keyless.setText(" ".join(sentences))
        self._keyless.setVisible(bool(sentences))

    def _style(self) -> None:
        self._theme.style_text(self._keyless, "amber", tokens.STATUS_PX)
