"""Erasing a person from a whole study: recordings are searched for all that the database knows about them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

if TYPE_CHECKING:
    from caris_desktop.people.person_erasure import PersonToForget
    from caris_desktop.recording.forgetting.erasure_files import OwnFiles
    from caris_desktop.recording.forgetting.study_erasure import Forgotten
    from caris_desktop.recording.forgetting.text_erasure import Decision, Review
# Implementation is imported late: the window opens sooner.

_log = logging.getLogger(__name__)
_PROGRESS_STEP = 0.01


class ErasureRequest(Value):
    """Erase request. ``who`` is an id or name, ``also_called`` further names.

    ``texts``: treatment of free text that names them, unless ``review``, a list of decisions, says otherwise; empty to
    write such a list. ``unknown``: permits an id that the database does not have. ``own_files``: files of this user
    outside the study.
    """

    study: Path
    database: Path
    who: str
    also_called: tuple[str, ...] = ()
    recordings: Literal["mask", "remove"] = "mask"
    texts: Decision = ""
    review: Path | None = None
    keep_exports: bool = False
    unknown: bool = False
    own_files: OwnFiles | None = None


class ForgettingProgress(Value):
    """Progress, 0..1, with a description."""

    fraction: float
    what: str


class ForgettingEnded(Value):
    """Outcome, or the failure: what happened, its meaning, advice."""

    outcome: Forgotten | None
    failure: tuple[str, str, str] | None = None


def person_of(request: ErasureRequest) -> tuple[PersonToForget, Review | None, bool]:
    """Person to erase, decisions on texts, and whether the database knows them. Raises UserFacingError."""
    from caris_desktop.people.person_erasure import PersonToForget, find_person
    from caris_desktop.recording.forgetting.study_erasure import unfinished_erasures
    from caris_desktop.recording.forgetting.text_erasure import read_review

    review = None if request.review is None else read_review(request.review)
    known = find_person(request.database, request.who)
    if known is not None:
        return known, review, True
    if review is not None:
        return PersonToForget((review.person_id or request.who,), review.names, ()), review, False
    unfinished = [
        person_id
        for person_id in unfinished_erasures(request.study)
        if find_person(request.database, person_id) is None
    ]
    if request.who in unfinished or len(unfinished) == 1:
        # Only the rest of an interrupted run, which needs no name.
        return PersonToForget((request.who if request.who in unfinished else unfinished[0],), (), ()), None, False
    if request.also_called or request.unknown:
        return PersonToForget((request.who,), (), ()), None, False
    raise UserFacingError(
        localized(QT_TR_NOOP("No person in {study} has the name or id {who}."), study=request.study, who=request.who),
        QT_TR_NOOP("No person was erased; nothing was changed."),
        QT_TR_NOOP(
            "Check the name in the People panel. For a person who is not in the study's database, enter the "
            "id and --also-called NAME."
        ),
    )


def forget(request: ErasureRequest, progress: Callable[[float, str], None] = lambda _f, _w: None) -> Forgotten:
    """Erase a person, or resume an interrupted run. Takes as long as re-encoding the study's videos. Raises
    UserFacingError.
    """
    from caris_desktop.people.person_erasure import erase, rewrite_texts
    from caris_desktop.recording.forgetting.erasure_files import OwnFiles
    from caris_desktop.recording.forgetting.study_erasure import ForgetRequest, forget_person

    person, review, known = person_of(request)
    forget_request = ForgetRequest(
        request.study,
        person.person_ids,
        (*person.names, *request.also_called),
        person.pictures,
        recordings=request.recordings,
        otherwise=request.texts,
        decisions={} if review is None else review.decisions,
        review=request.review,
        keep_exports=request.keep_exports,
        only_texts=review is not None and not known,
        texts_of_people=partial(rewrite_texts, request.database),
        own_files=request.own_files or OwnFiles(),
    )
    reported = -1.0

    def report_progress(fraction: float, what: str) -> None:
        nonlocal reported
        if fraction >= reported + _PROGRESS_STEP or fraction >= 1.0:
            reported = fraction
            progress(fraction, what)

    return forget_person(forget_request, lambda: erase(request.database, person.person_ids), report_progress)


def run_forgetting(connection: Connection, request: ErasureRequest) -> None:
    """Process body: sends ForgettingProgress and finally ForgettingEnded."""
    step_back(10)  # the robot may be driven meanwhile
    try:
        try:
            ended = ForgettingEnded(
                forget(request, lambda fraction, what: connection.send(ForgettingProgress(fraction, what)))
            )
        except UserFacingError as failure:
            ended = ForgettingEnded(None, (failure.what, failure.meaning, failure.advice))
        connection.send(ended)
    except (BrokenPipeError, EOFError):
        _log.warning("the console has gone: forgetting stopped, and goes on when it is asked for again")
