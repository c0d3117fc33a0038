"""Erasure service: erases a person in a child process, while the wizard continues."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import PersonForgotten
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.erasure_run import ForgettingEnded, ForgettingProgress
from caris_desktop.live.service import ContextService, Handlers, ServiceContext, SupervisedProcess
from caris_desktop.live.services.recording_service import ACTIVE

if TYPE_CHECKING:
    from caris_desktop.recording.forgetting.study_erasure import Forgotten

_log = logging.getLogger(__name__)
_REPORT_EVERY = 0.25


class ForgettingService(ContextService):
    """One person at a time, and not while recording: the file being written cannot change."""

    def __init__(
        self,
        context: ServiceContext,
        body_of: Callable[[str], ProcessSpec],
        *,
        then: Callable[[intents.ForgetPerson], None],
    ) -> None:
        """``body_of`` returns the process body that erases a person id. ``then`` erases the console's own data."""
        super().__init__(context)
        self._body_of = body_of
        self._then = then
        self._process = SupervisedProcess(self._children, ended=self._on_ended, on_message=self._on_heard)
        self._intent = intents.ForgetPerson("")
        self._ended: ForgettingEnded | None = None
        self._reported = 0.0

    def handlers(self) -> Handlers:
        return {intents.ForgetPerson: self._forget}

    def supervised(self) -> tuple[SupervisedProcess, ...]:
        return (self._process,)

    def stop(self) -> None:
        self._process.ask_to_end()  # an interrupted erasure resumes when requested again

    def _forget(self, intent: intents.ForgetPerson) -> None:
        if self._process.child is not None:
            raise RefusedError(
                tr("Another person is already being erased."),
                tr("This person is not erased yet."),
                tr("Try again when that is done."),
            )
        if self._state.recording.value.state in ACTIVE:
            raise RefusedError(
                tr("A session is being recorded."),
                tr("The person is not erased yet: a recording in progress cannot be changed."),
                tr("End the recording, then try again."),
            )
        self._intent, self._ended, self._reported = intent, None, 0.0
        self._process.start(self._body_of(intent.person_id))
        self._bus.inform(
            tr("The person is being erased from all recordings of the study."),
            tr("This takes as long as rewriting the person's videos. You can continue working."),
            tr("Start the next recording when this is done."),
        )

    def _on_heard(self, message: Any) -> None:
        if isinstance(message, ForgettingEnded):
            self._ended = message
        elif isinstance(message, ForgettingProgress) and message.fraction >= self._reported + _REPORT_EVERY:
            self._reported = message.fraction
            self._bus.inform(
                tr("Erasing the person: {fraction} done.").format(fraction=f"{message.fraction:.0%}"),
                tr("{doing}.").format(doing=tr(message.what)),
                tr("No action is needed."),
            )

    def _on_ended(self) -> None:
        ended = self._ended
        if ended is None:
            self._bus.problem(
                "error",
                tr("Erasing the person stopped unexpectedly."),
                tr("The person is not erased yet. Nothing is lost: the next attempt resumes at the same point."),
                tr("Erase the person again; the log has the details."),
                cause="forgetting",
            )
        elif ended.outcome is None:
            what, meaning, advice = ended.failure or (
                QT_TR_NOOP("Erasing the person failed."),
                "",
                QT_TR_NOOP("Erase the person again."),
            )
            self._bus.problem("error", tr(what), tr(meaning), tr(advice), cause="forgetting")
        else:
            # Erase in-memory data after the database.
            try:
                self._then(self._intent)
            except UserFacingError:
                # Without perception nothing is in memory.
                self._bus.publish(PersonForgotten(clock.now_ns(), self._intent.person_id, self._intent.actor))
            self._notify(ended.outcome)

    def _notify(self, outcome: Forgotten) -> None:
        if outcome.review is not None:
            places = tr("1 place") if outcome.waiting == 1 else tr("%n places", "", outcome.waiting)
            self._bus.problem(
                "warning",
                tr(
                    "Erasing is incomplete: the person is erased except for {places} that may name or show them."
                ).format(places=places),
                tr("Someone must read or watch these to decide."),
                tr(
                    "Decide on each in {review}, then run: caris-desktop forget {study} {person} --review {review}"
                ).format(review=outcome.review, study=outcome.receipt.parent.parent, person=self._intent.person_id),
                cause="forgetting",
            )
        for sentence in (
            *map(tr, outcome.problems),
            *(tr("The person is still found in {file}.").format(file=file) for file in outcome.left),
        ):
            self._bus.problem("warning", sentence, tr("This part is not erased."), tr("Erase the person again."))
        if outcome.complete:
            self._bus.inform(
                tr("The person is erased: no data about them is found in the study or in your own files."),
                tr("Recordings that showed or named the person were changed and are marked as changed."),
                tr("The receipt is {receipt}.").format(receipt=outcome.receipt),
            )
