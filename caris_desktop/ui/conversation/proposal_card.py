"""Proposed action of the language model, with the keys that confirm and reject it."""

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import ProposalStatus
from caris_desktop.ui import tokens
from caris_desktop.ui.banners import Banner
from caris_desktop.ui.conversation.suggestion_cards import LOW_BELOW_PX
from caris_desktop.ui.panel import PanelContext
from caris_desktop.ui.widgets.buttons import ActionButton

_COUNT_EVERY_MS = 100


class ProposalCard(Banner):
    """Visible while an action is proposed. Shows the keys only while they apply: a question about a person takes
    precedence.
    """

    def __init__(self, context: PanelContext, parent: QWidget) -> None:
        super().__init__(context.theme, "proposal_card", role="amber")
        self.setParent(parent)
        self._context = context
        self._state = context.console.state
        self.yes = ActionButton(context.theme, tr("Do it"), look="primary", height_px=32)
        self.yes.setObjectName("proposal_yes")
        self.yes.clicked.connect(lambda: self._answer(intents.ConfirmProposal))
        self.no = ActionButton(context.theme, tr("No"), height_px=32)
        self.no.setObjectName("proposal_no")
        self.no.clicked.connect(lambda: self._answer(intents.VetoProposal))
        self.row.addWidget(self.yes)
        self.row.addWidget(self.no)
        self._counting = QTimer(self, interval=_COUNT_EVERY_MS)
        self._counting.timeout.connect(self._count)
        for value in (self._state.proposal, self._state.asked_person):
            value.changed.connect(self._refresh)
        for changed in (context.actions.keys_changed, context.actions.rebuilt):
            changed.connect(self._refresh)
        self._refresh()

    def fit(self, panel_px: int) -> None:
        """Adapt to the panel's height."""
        low = panel_px < LOW_BELOW_PX
        self.setFixedHeight(34 if low else 44)
        for button in (self.yes, self.no):
            button.set_size(height_px=26 if low else 32, text_px=tokens.STATUS_PX if low else tokens.BODY_PX)

    def _answer(self, answer: type[intents.ConfirmProposal] | type[intents.VetoProposal]) -> None:
        proposal: ProposalStatus = self._state.proposal.value
        if proposal.proposal_id:
            self._context.console.do(answer(proposal.proposal_id))

    def _refresh(self, _value: object = None) -> None:
        proposal: ProposalStatus = self._state.proposal.value
        permissions, live = self._context.console.scenario.permissions, self._state.present.live
        stands = bool(proposal.proposal_id)
        person_first = self._state.asked_person.value is not None and permissions.naming_people
        table = self._context.actions
        self.yes.set_key("" if person_first else table.key_text("answer_yes"))
        self.no.set_key("" if person_first else table.key_text("answer_no"))
        for button in (self.yes, self.no):
            button.setEnabled(live)
        self.setVisible(stands)
        self._count()
        if stands and live and not self._counting.isActive():
            self._counting.start()
        elif not stands or not live:
            self._counting.stop()

    def _count(self) -> None:
        proposal: ProposalStatus = self._state.proposal.value
        now_ns = self._state.present.now_ns()
        waits_s = max(0, proposal.lapses_ns - now_ns) / 1e9
        if proposal.acts_ns is not None and self._state.present.live:
            acts_s = max(0, proposal.acts_ns - now_ns) / 1e9
            self.say(tr("{what}: starts in {time:.1f} s").format(what=tr(proposal.words), time=acts_s))
        elif self._state.present.live:
            lapses = tr("{what}? · proposed by {model}, expires in {time:.0f} s")
            self.say(lapses.format(what=tr(proposal.words), model=proposal.model, time=waits_s))
        else:
            self.say(tr("{what}? · proposed by {model}").format(what=tr(proposal.words), model=proposal.model))
        self.setToolTip(tr("This moves the robot.") if proposal.moves else "")

    def _style(self) -> None:
        super()._style()
        self.text.setFont(self._theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
