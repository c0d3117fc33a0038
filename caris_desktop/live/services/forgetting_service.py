"""Erasure service: erases a person in a child process, while the wizard continues."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import ANSWER, PersonForgotten
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.erasure_run import ForgettingEnded, ForgettingProgress
from caris_desktop.live.process_manager import ProcessManager
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.services.recording_service import ACTIVE
from caris_desktop.live.state import LiveState

if TYPE_CHECKING:
    from caris_desktop.recording.forgetting.study_erasure import Forgotten

_log = logging.getLogger(__name__)
_TOLD_EVERY = 0.25
_ENDS_WITHIN_S = 1.0


class ForgettingService(Service):
    """One person at a time, and not while recording: the file being written cannot change."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: ProcessManager,
        body_of: Callable[[str], ProcessSpec],
        *,
        then: Callable[[intents.ForgetPerson], None],
        parent: QObject,
    ) -> None:
        """``body_of`` returns the process body that erases a person id. ``then`` erases the console's own data."""
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._children = children
        self._body_of = body_of
        self._then = then
        self._child: ChildProcess | None = None
        self._asked = intents.ForgetPerson("")
        self._ended: ForgettingEnded | None = None
        self._told = 0.0

    def handlers(self) -> Handlers:
        return {intents.ForgetPerson: self._forget}

    def processes(self) -> Mapping[str, ChildProcess]:
        return {} if self._child is None else {self._child.body.name: self._child}

    def stop(self) -> None:
        if self._child is not None:
            self._child.ask_to_end()

    def end(self) -> None:
        # An interrupted erasure resumes when requested again.
        if self._child is not None:
            self._child.stop(grace_s=_ENDS_WITHIN_S)

    def _forget(self, asked: intents.ForgetPerson) -> None:
        if self._child is not None:
            raise UserFacingError(
                tr("Somebody is being forgotten already."),
                tr("The other person is not forgotten yet."),
                tr("Ask again once that is done."),
                severity="warning",
            )
        if self._state.recording.value.state in ACTIVE:
            raise UserFacingError(
                tr("A session is being recorded."),
                tr("The person is not forgotten yet: what is being written cannot be changed."),
                tr("End the recording, then ask again."),
                severity="warning",
            )
        self._asked, self._ended, self._told = asked, None, 0.0
        self._child = self._children.start(self._body_of(asked.person_id), ended=self._on_ended, heard=self._on_heard)
        self._bus.problem(
            "info",
            tr("The person is being forgotten in all recordings of the study."),
            tr("That takes as long as their films take to be written anew. You can go on meanwhile."),
            tr("Begin the next recording once it is done."),
            cause=ANSWER,
        )

    def _on_heard(self, message: Any) -> None:
        if isinstance(message, ForgettingEnded):
            self._ended = message
        elif isinstance(message, ForgettingProgress) and message.fraction >= self._told + _TOLD_EVERY:
            self._told = message.fraction
            self._bus.problem(
                "info",
                tr("Forgetting the person: {fraction} is done.").format(fraction=f"{message.fraction:.0%}"),
                tr("{doing}.").format(doing=tr(message.what)),
                tr("Nothing is to be done."),
                cause=ANSWER,
            )

    def _on_ended(self, child: ChildProcess) -> None:
        if child is not self._child:
            return
        self._child = None
        ended = self._ended
        if ended is None:
            self._bus.problem(
                "error",
                tr("Forgetting the person has stopped by itself."),
                tr("They are not forgotten yet. Nothing is lost: it goes on where it stopped."),
                tr("Ask for it again; the log has the details."),
                cause="forgetting",
            )
        elif ended.outcome is None:
            what, meaning, advice = ended.failure or (
                QT_TR_NOOP("Forgetting the person has failed."),
                "",
                QT_TR_NOOP("Ask for it again."),
            )
            self._bus.problem("error", tr(what), tr(meaning), tr(advice), cause="forgetting")
        else:
            self._forget_here()
            self._notify(ended.outcome)

    def _forget_here(self) -> None:
        """Erase in-memory data after the database."""
        try:
            self._then(self._asked)
        except UserFacingError:
            # Without perception nothing is in memory.
            self._bus.publish(PersonForgotten(clock.now_ns(), self._asked.person_id, self._asked.actor))

    def _notify(self, outcome: Forgotten) -> None:
        if outcome.review is not None:
            places = tr("1 place") if outcome.waiting == 1 else tr("%n places", "", outcome.waiting)
            self._bus.problem(
                "warning",
                tr(
                    "Forgetting is incomplete: the person is forgotten but for {places} that may name or show them."
                ).format(places=places),
                tr("Only somebody who reads or watches them can say whether they do."),
                tr(
                    "Decide on each in {review}, then run: caris-desktop forget {study} {person} --review {review}"
                ).format(review=outcome.review, study=outcome.receipt.parent.parent, person=self._asked.person_id),
                cause="forgetting",
            )
        for sentence in (
            *map(tr, outcome.problems),
            *(tr("They are still found in {file}.").format(file=file) for file in outcome.left),
        ):
            self._bus.problem("warning", sentence, tr("That part of forgetting is not done."), tr("Ask for it again."))
        if outcome.complete:
            self._bus.problem(
                "info",
                tr("The person is forgotten: nothing of them is found any more in the study or in your own files."),
                tr("Recordings in which they were seen or named were changed, and say so."),
                tr("The receipt is {receipt}.").format(receipt=outcome.receipt),
                cause=ANSWER,
            )
