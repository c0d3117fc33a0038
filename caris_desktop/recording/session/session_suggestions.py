"""Outcome of each suggested reply that was displayed in a session: exactly one, even for interrupted sessions."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import SuggestionChanged
from caris_desktop.domain.value_class import Value

Fate = Literal["taken", "edited", "dismissed", "superseded", "expired"]


class ShownReply(Value):
    """Displayed suggestion. ``told`` is False if the session ended or paused before its outcome; it has then expired,
    as it could no longer be used.
    """

    suggestion_id: str
    turn_id: str
    revision: int
    rank: int
    text: str
    model: str
    shown_ns: int
    latency_ms: float | None
    fate: Fate
    ended_ns: int
    told: bool
    edit_distance: int | None = None
    utterance_id: str = ""
    actor: Actor = ""

    @property
    def was_said(self) -> bool:
        return self.fate in ("taken", "edited")


def replies_of(changes: Iterable[SuggestionChanged], *, ends_ns: Sequence[int]) -> tuple[ShownReply, ...]:
    """Outcomes from ``changes``. ``ends_ns`` are the pauses and the end of the recording. The first outcome counts;
    outcomes of suggestions whose display was not recorded are ignored.
    """
    replies: dict[str, ShownReply] = {}
    for change in changes:
        known = replies.get(change.suggestion_id)
        if change.state == "displayed":
            if known is None:
                replies[change.suggestion_id] = _unended(change, ends_ns)
        elif known is not None and not known.told:
            replies[change.suggestion_id] = replace(
                known,
                fate=change.state,
                ended_ns=change.stamp_ns,
                told=True,
                edit_distance=change.edit_distance,
                utterance_id=change.utterance_id,
                actor=change.actor,
            )
    return tuple(replies.values())


def _unended(suggestion: SuggestionChanged, ends_ns: Sequence[int]) -> ShownReply:
    ended_ns = min((end_ns for end_ns in ends_ns if end_ns >= suggestion.stamp_ns), default=suggestion.stamp_ns)
    return ShownReply(
        suggestion.suggestion_id, suggestion.turn_id, suggestion.revision, suggestion.rank, suggestion.text,
        suggestion.model, suggestion.stamp_ns, suggestion.latency_ms, "expired", ended_ns, told=False,
    )  # fmt: skip
