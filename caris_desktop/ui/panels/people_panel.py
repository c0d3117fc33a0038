"""People panel: people present, former and known, with their names."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from PySide6.QtCore import QPoint, QRect, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QFrame, QStackedLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.events import PeopleUndone, PersonForgotten, PersonIdentified
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import PerceptionStatus, PersonHistory
from caris_desktop.people.presence import PersonRow, Suggestion
from caris_desktop.ui import event_messages, layouts, text_formatting, tokens
from caris_desktop.ui.action_bindings import cap_text
from caris_desktop.ui.focus_widget import focus_widget, main_of, window_of
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.people.people_list import PeopleList, PeopleModel
from caris_desktop.ui.people.person_card import PersonCard
from caris_desktop.ui.people.portraits import PortraitPixmaps
from caris_desktop.ui.people.shown_people import (
    IdentityQuestion,
    as_permitted,
    everyone,
    found,
    is_nameless_past,
    name_of,
    seen_elsewhere,
    with_one_question,
)
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import SubmitLineEdit, add_clear_button
from caris_desktop.ui.widgets.labels import ElidedLabel, label, named

_LATE_S = 1.5
"""Detection delay in s from which the panel shows it, as recent arrivals are missing."""


class PeoplePanel(Panel):
    """One row per person, with the name edited in place."""

    title = QT_TR_NOOP("People")
    preferred_size, least_size = QSize(340, 220), QSize(220, 68)  # one whole row
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("people_panel")
        self._names_people = False
        self._search_button: ActionButton | None = None
        self._unfold_button: ActionButton | None = None
        self._unfolded = False
        self._shortcuts: list[QShortcut] = []
        self._search = SubmitLineEdit(objectName="people_search", placeholderText=tr("Name, group or tag"))
        self._search.setAccessibleName(tr("Find a person by name, group or tag"))
        add_clear_button(self._search)
        self._search.textChanged.connect(self._on_search_changed)
        self._search.returnPressed.connect(self._pick_first)
        self._search.hide()
        self._empty = label(tone="dim", wraps=True, objectName="people_empty", alignment=Qt.AlignmentFlag.AlignCenter)
        self._empty.setContentsMargins(24, 8, 24, 8)
        self._portraits = PortraitPixmaps(self.state.portraits.get, lambda: self.state.load.value.pays_small)
        self.model = PeopleModel(self.state.present, self)
        self.list = named(PeopleList(self.theme, self.model, self._portraits), "people_list")
        self.list.named.connect(lambda person_id, name: self.console.do(intents.NamePerson(person_id, name)))
        self.list.let_go.connect(self._refresh)
        self.list.naming_changed.connect(self.state.named_person.set)
        self.list.action_requested.connect(self._on_action_requested)
        self.card: PersonCard | None = None
        """The popup, once opened."""
        self._decided: object = None
        self._undo = UndoBar(self.theme)
        self._undo.undone.connect(self._take_back)
        self.hold.escape_pressed.connect(self._on_escape)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        self._stack.addWidget(self._empty)
        self._stack.addWidget(self.list)
        layouts.vbox(self, self._search, (holder, 1), self._undo, margins_px=(2, 6, 2, 8), spacing_px=4)
        self._offer_names()
        state = self.state
        self.watch(
            self._refresh, state.persons.changed, state.everybody.changed, state.camera.changed,
            state.perception.changed, state.frame.freshness_changed, state.selected_person.changed,
            state.asked_person.changed, state.going_on.changed, self.table.keys_changed, self.theme.changed,
        )  # fmt: skip
        state.event_happened.connect(self._on_event)
        state.person_history.changed.connect(self._on_history_found)
        self.every(1000, self._on_second)
        self.update_view()

    def _on_second(self) -> None:
        """Refresh ages."""
        self.model.refresh_ages()
        if self._portraits.put_off:
            self._portraits.put_off = False
            self.list.viewport().update()
        self._renew_card()

    def title_widgets(self) -> list[QWidget]:
        return [button for button in (self._unfold_button, self._search_button) if button is not None]

    def focus_target(self) -> QWidget:
        return self.list.name_field if self.list.naming else self

    def accessible_parts(self) -> list[QWidget]:
        return list(self.list.controls.values()) if self.list.isVisible() else []

    def show_scenario(self) -> None:
        if self.card is not None:
            self.card.close_card()
            self.card.deleteLater()
            self.card = None
        self._offer_names()
        super().show_scenario()

    def _offer_names(self) -> None:
        """Offer naming and identity decisions if the scenario permits them."""
        permitted = self.console.scenario.permissions.naming_people
        if permitted == self._names_people:
            return
        self._names_people = permitted
        decides = permitted and self.state.present.live
        self.list.let_decide(decides)
        for shortcut in self._shortcuts:
            shortcut.setKey(QKeySequence())  # effective now, not only once the object is deleted
            shortcut.deleteLater()
        acts = (("Ctrl+Z", self._take_back), ("Ctrl+F", self._open_search)) if decides else ()
        self._shortcuts = [QShortcut(QKeySequence(keys), self, slot) for keys, slot in acts]
        for shortcut in self._shortcuts:
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        self._search_button = self._unfold_button = None
        if permitted:
            search = ActionButton(self.theme, "", icon="magnifying-glass", role="ghost", height_px=30)
            search.setObjectName("people_search_button")
            search.set_quiet(True)
            search.setAccessibleName(tr("Find a person"))
            search.setToolTip(tr("Find by name, group or tag (Ctrl+F in this panel)"))
            search.clicked.connect(lambda: self._open_search() if self._search.isHidden() else self._close_search())
            unfold = ActionButton(self.theme, "", role="ghost", height_px=30, text_px=tokens.STATUS_PX, checkable=True)
            unfold.setObjectName("people_unfold")
            unfold.setChecked(self._unfolded)
            unfold.toggled.connect(self._on_unfolded)
            unfold.hide()
            self._search_button, self._unfold_button = search, unfold
        self._undo.put_away()
        self._search.clear()
        self._search.hide()
        self.controls_changed.emit()

    def _on_unfolded(self, unfolded: bool) -> None:
        self._unfolded = unfolded
        self._refresh()

    def set_in_view(self, in_view: bool) -> None:
        super().set_in_view(in_view)
        self.state.named_person.set(self.list.naming if in_view else "")
        if not in_view:
            self._undo.put_away()
            if self.card is not None:
                self.card.close_card()

    def _refresh(self, _value: object = None) -> None:
        if self.in_view:
            self.update_view()

    # ---- rows

    @property
    def everyone(self) -> tuple[PersonRow, ...]:
        """People present, former and known; only those present if naming is not permitted."""
        state = self.state
        if not self._names_people:
            return as_permitted(state.persons.value, naming=False)
        return everyone(state.persons.value, state.everybody.value, state.present.now_ns())

    def update_view(self) -> None:
        everybody = self.everyone
        question: IdentityQuestion | None = self.state.asked_person.value
        persons = with_one_question(everybody, question)
        query = "" if self._search.isHidden() else self._search.text()
        self.model.show_unconfirmed(frozenset(self.state.going_on.value.unconfirmed_people))
        self.model.show_persons(
            [person for person in persons if found(person, query) and not self._is_folded(person, query)],
            known=frozenset(person.person_id for person in persons),
            held_rows=0 if self._search.hasFocus() else self.list.held_rows,
            camera=self.state.camera.value,
            may_reset=not self.list.naming,
        )
        self.list.highlight_selected(self.state.selected_person.value)
        keys = self.table.key_text("answer_yes"), self.table.key_text("answer_no")
        self.list.show_asked("" if question is None else question.person_id, *keys)
        self.list.discard_orphaned_name()
        self._report_folded(persons)
        self._report_presence(everybody)
        self._renew_card()
        if not self._undo.isHidden():
            self._report_decision()

    def _is_folded(self, person: PersonRow, query: str) -> bool:
        """Whether a nameless former person is only counted: unless expanded, searched for or in use."""
        if self._unfolded or query.strip() or not is_nameless_past(person):
            return False
        card = self.card.person_id if self.card is not None else ""
        return person.person_id not in (self.list.naming, self.state.selected_person.value, card)

    def _report_folded(self, persons: Sequence[PersonRow]) -> None:
        button = self._unfold_button
        if button is None or button.parent() is None:
            return
        count = sum(is_nameless_past(person) for person in persons)
        button.setVisible(count > 0)
        button.setText(tr("+ %n left", "", count))
        hide = tr("Hide %n who left without a name", "", count)
        button.setToolTip(hide if self._unfolded else tr("Show %n who left without a name", "", count))
        button.setAccessibleName(button.toolTip())

    def _report_presence(self, everybody: Sequence[PersonRow]) -> None:
        """Say in the title who is here, and in an empty list why it is."""
        here = [person for person in self.state.persons.value if person.here]
        elsewhere = sum(bool(seen_elsewhere(person, self.state.camera.value)) for person in here)
        others = (self.state.frame_of(camera).freshness for camera in self.state.cameras.value)
        blind = self.state.frame.freshness == "lost" and "fresh" not in others
        known = sum(person.known for person in everybody)
        late_s = 0.0 if blind else self._late_s()
        if blind:
            first = tr("no picture")
        elif here:
            first = tr("%n here", "", len(here))
        else:
            first = tr("detection is starting") if self._detection_starting() else tr("nobody here")
        facts = (
            first,
            tr("%n in another camera", "", elsewhere) if elsewhere else "",
            tr("%n known", "", known) if known else "",
            tr("{seconds} s behind").format(seconds=round(late_s)) if late_s else "",
        )
        self.set_fact(" · ".join(filter(None, facts)), "amber" if late_s else "dim")
        self._stack.setCurrentIndex(1 if self.model.rowCount() else 0)
        if not self.model.rowCount():
            self._empty.setText(self._why_empty(blind=blind, late_s=late_s))

    def _detection_starting(self) -> bool:
        """Whether detection runs, but no result has arrived yet."""
        perception: PerceptionStatus = self.state.perception.value
        return self.state.present.live and perception.state == "ready" and perception.inference_ms is None

    def _late_s(self) -> float:
        """Detection delay in s for the camera on display; zero if negligible."""
        perception: PerceptionStatus = self.state.perception.value
        if perception.state != "ready":
            return 0.0
        looks_per_s = perception.looks_per_s.get(self.state.camera.value, 0.0)
        late_s = max((perception.inference_ms or 0.0) / 1e3, 1.0 / looks_per_s if looks_per_s else 0.0)
        return late_s if late_s >= _LATE_S else 0.0

    def _why_empty(self, *, blind: bool, late_s: float = 0.0) -> str:
        perception: PerceptionStatus = self.state.perception.value
        if self.everyone and self._search.text().strip() and not self._search.isHidden():
            nobody = tr("No name, group or tag contains “{text}”.")
            return nobody.format(text=text_formatting.shortened(self._search.text(), 40))
        match perception.state:
            case _ if not self.state.present.live:
                return tr("Nobody was seen at this moment.")
            case "ready" if blind:
                return tr("No picture, so nobody can be seen.")
            case "ready" if self._detection_starting():
                return tr("Person detection is starting.\nPeople appear here after its first result.")
            case "ready" if late_s:
                late = tr("Nobody recognised yet.\nRecognition is {seconds} s behind: this computer is busy.")
                return late.format(seconds=round(late_s))
            case "ready":
                return tr("Nobody in view.\nPeople appear here as soon as the camera sees them.")
            case "loading":
                return tr("Starting person detection.\nEverything else works meanwhile.")
            case "failed":
                return tr("Person detection is not working.\n{detail}").format(detail=tr(perception.detail))
            case _:
                return tr("Person detection is off.")

    # ---- searching

    def _open_search(self) -> None:
        self._search.show()
        focus_widget(self._search)
        self._search.selectAll()

    def _close_search(self) -> None:
        if self._search.hasFocus():
            self.list.setFocus(Qt.FocusReason.OtherFocusReason)
        self._search.hide()
        self._refresh()

    def _on_search_changed(self, _text: str) -> None:
        self._refresh()
        self.list.scrollToTop()

    def _pick_first(self) -> None:
        """Enter in the search field selects the first result, as in other lists."""
        if self.model.persons:
            self.console.do(intents.AttendPerson(self.model.persons[0].person_id))

    # ---- person popup

    def open_card(self, person_id: str) -> None:
        person = self._find(person_id)
        if person is None:
            return
        window = main_of(window_of(self))  # a floating panel has no room for it and would take it along
        if self.card is None:
            self.card = PersonCard(self.theme, window, self.console, self._portraits, lambda: self.everyone)
            self.destroyed.connect(self.card.deleteLater)
        self.card.open_for(person, QRect(window.mapFromGlobal(self.mapToGlobal(QPoint())), self.size()))

    def _find(self, person_id: str) -> PersonRow | None:
        return next((person for person in self.everyone if person.person_id == person_id), None)

    def _renew_card(self) -> None:
        if self.card is not None and (person := self._find(self.card.person_id)) is not None:
            self.card.show_person(person)

    def _follow_with_card(self, person_id: str, now_id: str) -> None:
        """Keep the popup on its person after identification; close it if the person is missing."""
        if self.card is None or self.card.person_id != person_id:
            return
        person = self._find(now_id)
        if person is None:
            self.card.close_card()
        else:
            self.card.show_person(person)

    def _on_history_found(self, history: PersonHistory | None) -> None:
        if self.card is not None and history is not None and history.person_id == self.card.person_id:
            entries = tuple(
                replace(entry, text=text_formatting.with_names(entry.text, partial(name_of, self.console)))
                for entry in history.entries
            )
            self.card.show_history(replace(history, entries=entries))

    def _on_escape(self) -> None:
        self.list.give_up_naming()
        if self.card is not None:
            self.card.step_back()
        if not self._search.isHidden():
            self._close_search()

    # ---- decisions

    def show_person(self, person_id: str, *, rename: bool = False, card: bool = False) -> None:
        if self.model.row_of(person_id) is None:
            self._close_search()
        self.list.bring_into_view(person_id)
        if rename:
            self.list.name(person_id)
        if card:
            self.open_card(person_id)

    def _on_action_requested(self, act: str, person_id: str) -> None:
        person = self._find(person_id)
        if person is None:
            return
        match act, person.suggestion:
            case "pick", _:
                # A click on the selected person selects nobody.
                picked = "" if person_id == self.state.selected_person.value else person_id
                self.console.do(intents.AttendPerson(picked))
            case "card", _:
                self.open_card(person_id)
            case "yes", Suggestion() as suggested:
                self.console.do(intents.ConfirmPerson(person_id, suggested.person_id))
            case "no", Suggestion() as suggested:
                self.console.do(intents.RejectPerson(person_id, suggested.person_id))
            case "same", _:
                self.console.do(intents.ConfirmAsBefore("people", person_id))
            case "not", _:
                self.console.do(intents.RejectPerson(person_id, person_id))

    def _take_back(self) -> None:
        self._undo.put_away()
        self.console.do(intents.UndoPeople())

    def _on_event(self, event: object) -> None:
        """Offer to undo the wizard's decision about a person for a while."""
        if not self.in_view or not self._names_people or not self.state.present.live:
            return
        if isinstance(event, PersonIdentified):
            self._follow_with_card(event.person_id, event.is_person_id)
        elif isinstance(event, PersonForgotten):
            self._follow_with_card(event.person_id, "")
        if isinstance(event, PeopleUndone):
            self._undo.put_away()
        elif isinstance(event, event_messages.DECISIONS_ABOUT_PEOPLE) and event.actor == WIZARD:
            self._decided = event
            self._report_decision()
            self._undo.offer()

    def _report_decision(self) -> None:
        """Describe the decision with the current name: the event precedes the rows that follow from it."""
        sentence = event_messages.event_sentence(self._decided, partial(name_of, self.console))
        if sentence is not None:
            self._undo.text.setText(sentence[1])


_SHOWN_MS = 8_000


class UndoBar(QFrame):
    """Bar at the lower edge: the last decision about a person, with an undo button for some seconds."""

    undone = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("people_undo")
        self.text = ElidedLabel(role="small", tone="text")
        self.button = ActionButton(theme, tr("Undo"), icon="arrow-u-up-left", key=cap_text("Ctrl+Z"), height_px=28)
        self.button.setObjectName("people_undo_button")
        self.button.clicked.connect(self.undone)
        row = layouts.hbox(self, margins_px=(14, 2, 10, 2), spacing_px=tokens.GRID_PX)
        row.addWidget(self.text, 1, Qt.AlignmentFlag.AlignVCenter)
        row.addWidget(self.button)
        self._away = QTimer(self, singleShot=True, interval=_SHOWN_MS)
        self._away.timeout.connect(self.hide)
        self.hide()

    def offer(self) -> None:
        self.show()
        self._away.start()

    def put_away(self) -> None:
        self._away.stop()
        self.hide()
