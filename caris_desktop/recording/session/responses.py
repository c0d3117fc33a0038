"""Response times: the gap between each participant turn and its answer, and the means of the answer."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import get_args

from caris_desktop.domain.events import RESPONSE_LIMIT_S, ReplyMeans, ResponseTimed
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.utterances import SpokenUtterance

AT_ONCE_S = 1.0
"""Answers that come sooner are counted: from here on a pause is noticed."""
_MEANS: tuple[ReplyMeans, ...] = get_args(ReplyMeans)


class Response(Value):
    """One answer. ``gap_s`` is from the end of the participant's voice to the first sound, negative for overlaps.
    ``first``: no filler or other answer came before it. Values that older recordings lack are None.
    """

    turn_id: str
    reply_id: str
    means: ReplyMeans
    voice_ended_ns: int
    first_sound_ns: int
    first: bool
    asked_ns: int | None = None
    text_ns: int | None = None
    suggested_ns: int | None = None
    person_id: str = ""

    @property
    def gap_s(self) -> float:
        return (self.first_sound_ns - self.voice_ended_ns) / 1e9


def responses_of(
    utterances: Iterable[SpokenUtterance], timed: Iterable[ResponseTimed] = (), pauses: Sequence[tuple[int, int]] = ()
) -> tuple[Response, ...]:
    """Responses from corrected utterances: turns of speakers found not to be participants have none. ``timed`` adds
    details that utterances lack. A turn is answered by the first filler after it and by the first other reply.

    Excludes replies after ``RESPONSE_LIMIT_S``, and after a pause of the recording.
    """
    ordered = sorted((item for item in utterances if item.said), key=lambda item: item.start_ns or 0)
    turns = [item for item in ordered if item.speaker == "participant"]
    starts_ns = [turn.start_ns or 0 for turn in turns]
    by_reply = {(event.turn_id, event.reply_id): event for event in timed}
    found: list[Response] = []
    answered: set[tuple[str, bool]] = set()
    for reply in ordered:
        number = bisect_right(starts_ns, reply.start_ns or 0) - 1
        if number < 0 or reply.speaker == "participant" or reply.origin not in _MEANS:
            continue
        turn, filler = turns[number], reply.origin == "filler"
        ended_ns, reply_ns = turn.end_ns or turn.start_ns or 0, reply.start_ns or 0
        paused = any(start_ns < reply_ns and end_ns > ended_ns for start_ns, end_ns in pauses)
        late = reply_ns - ended_ns > RESPONSE_LIMIT_S * 1e9
        if paused or late or (turn.utterance_id, False) in answered or (turn.utterance_id, filler) in answered:
            continue
        first = (turn.utterance_id, not filler) not in answered
        answered.add((turn.utterance_id, filler))
        response = Response(
            turn.utterance_id, reply.utterance_id, reply.origin, ended_ns, reply_ns, first, reply.requested_ns,
            person_id=turn.person_id,
        )  # fmt: skip
        event = by_reply.get((turn.utterance_id, reply.utterance_id))
        if event is not None:
            response = replace(
                response, means=event.means, text_ns=event.text_ns, suggested_ns=event.suggested_ns
            )  # fmt: skip
        found.append(response)
    return tuple(found)
