"""Suggestion cycle: when replies are requested, which are displayed, and the outcome of each. Time is injected.

A round begins at each pause of a participant. It ends when speech resumes, the transcript changes, or the robot speaks:
later replies for it are discarded.
"""

import re
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Literal

from caris_desktop.conversation.suggestions.prompt import same_words, words_of
from caris_desktop.conversation.suggestions.proposable_actions import Proposed
from caris_desktop.domain.actor import CONSOLE, MODEL, Actor
from caris_desktop.domain.events import (
    ProposalChanged,
    ProposalState,
    SuggestionChanged,
    SuggestionState,
    UtteranceChanged,
)
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, Hearing
from caris_desktop.domain.value_class import Value

MOST_REPLIES = 3
PAUSE_NS = 200_000_000
TO_READ_NS = 300_000_000
"""A reply that takes the place of another one is not said before: the key may have been meant for that."""
EXPIRES_NS = 60_000_000_000
_MAX_SENTENCES = 100
_MISSED_NS = 1_000_000_000
"""A countdown that ended unseen while the program was blocked has no effect."""


class Round(Value):
    """Utterance to reply to. ``voice_ended_ns`` is the start of the silence."""

    turn_id: str
    revision: int
    text: str
    voice_ended_ns: int
    person_id: str = ""


class Suggested(Value):
    """Displayed reply. ``rank`` is its position and key number; its key works from ``from_ns``."""

    suggestion_id: str
    turn_id: str
    revision: int
    rank: int
    text: str
    model: str
    shown_ns: int
    from_ns: int = 0


class SuggestionCycle:
    """Replies of one conversation. ``acts_after_ns`` is the countdown after which the first is said without a key, None
    for never.

    ``report`` receives each event at once. ``ask`` requests replies from the model, each of which comes back by
    ``offer``; ``drop`` cancels the last request, with a reason.
    """

    def __init__(
        self,
        report: Callable[[SuggestionChanged], None],
        new_id: Callable[[], str],
        *,
        ask: Callable[[Round], None],
        drop: Callable[[str], None],
    ) -> None:
        self._report, self._new_id, self._ask, self._drop = report, new_id, ask, drop
        self.acts_after_ns: int | None = None
        self.round: Round | None = None
        self.cards: tuple[Suggested, ...] = ()
        self._pause: Round | None = None
        self._speaking: str | None = None
        self._last: Round | None = None
        self._done: Round | None = None
        self._spoken_since = False
        self._cards_removed_ns = -TO_READ_NS
        # A queued sentence starts long after its request, which is what moved the conversation on.
        self._robot_utterances: deque[str] = deque(maxlen=_MAX_SENTENCES)

    # Speech input

    def add(self, hearing: Hearing) -> None:
        """Process the present state of a microphone."""
        if hearing.source not in PARTICIPANT_SOURCES or hearing.speaker in ("robot", "wizard"):
            return
        if hearing.speaking:
            self._speaking, self._spoken_since, self._pause = hearing.utterance_id, True, None
            self._end("superseded", hearing.stamp_ns, reason="the participant continues speaking")
            return
        self._speaking = None
        words = " ".join(filter(None, (hearing.committed, hearing.tentative)))
        current = self.round
        if current is not None and (hearing.silent_since_ns or 0) > current.voice_ended_ns + PAUSE_NS:
            # There was speech in between, which the newest value of a stream may not show.
            self._spoken_since = True
            self._end("superseded", hearing.stamp_ns, reason="the participant continued speaking")
        if hearing.utterance_id and words.strip() and hearing.silent_since_ns is not None:
            self._wait_for(
                Round(hearing.utterance_id, hearing.revision, words, hearing.silent_since_ns), hearing.stamp_ns
            )
        elif self._last is not None and self._last != self._done and self.round is None and self._pause is None:
            # It was noise: the speech before it still needs a reply.
            since_ns = hearing.silent_since_ns or hearing.stamp_ns
            self._wait_for(replace(self._last, revision=self._last.revision + 1), since_ns)
        self.pass_time(hearing.stamp_ns)

    def on_participant(self, utterance: UtteranceChanged, now_ns: int) -> None:
        """A participant's turn ended with its final transcript, or was not speech."""
        same_turn = self._last is not None and self._last.turn_id == utterance.utterance_id
        if utterance.state == "failed" and same_turn:
            self._end("superseded", now_ns, reason="it was not speech")
            self._pause = self._last = None
        elif utterance.state == "finished" and utterance.text.strip():
            revision = self._last.revision + 1 if same_turn and self._last is not None else 1
            turn = Round(utterance.utterance_id, revision, utterance.text, utterance.stamp_ns, utterance.person_id)
            if self._speaking in (None, utterance.utterance_id):
                self._wait_for(turn, now_ns)
                self.pass_time(now_ns)
            elif not self._needs_none(turn):
                self._last = turn  # speech has already resumed; if that is noise, this turn gets a reply

    def on_robot(self, utterance: UtteranceChanged, now_ns: int) -> None:
        """The robot speaks, which ends the round, except for a filler."""
        if utterance.state not in ("requested", "started") or utterance.origin == "filler":
            return
        if utterance.utterance_id not in self._robot_utterances:
            self._robot_utterances.append(utterance.utterance_id)
            self._leave("superseded", now_ns, reason="the robot is replying")

    # Model output

    def offer(self, begun: Round, text: str, model: str, now_ns: int) -> bool:
        """Display ``text`` as the next reply. False if it is late or equivalent to a displayed one."""
        current = self.round
        if current is None or (begun.turn_id, begun.revision) != (current.turn_id, current.revision):
            return False
        texts = [card.text for card in self.cards]
        if len(texts) >= MOST_REPLIES or any(same_intention(text, other) for other in texts):
            return False
        rank = len(texts) + 1
        from_ns = now_ns + TO_READ_NS if now_ns - self._cards_removed_ns < TO_READ_NS else 0
        card = Suggested(self._new_id(), begun.turn_id, begun.revision, rank, text, model, now_ns, from_ns)
        self.cards = (*self.cards, card)
        self._notify(card, "displayed", now_ns, latency_ms=(now_ns - current.voice_ended_ns) / 1e6)
        return True

    # Outcomes

    def card(self, suggestion_id: str, now_ns: int) -> Suggested | None:
        """Reply by id, while it is displayed and readable."""
        self.pass_time(now_ns)
        return next(
            (card for card in self.cards if card.suggestion_id == suggestion_id and now_ns >= card.from_ns), None
        )

    def accept(self, card: Suggested, text: str, utterance_id: str, actor: Actor, now_ns: int) -> None:
        """``card`` was said, unchanged or edited, which supersedes the others."""
        distance = characters_changed(card.text, text)
        self._notify(
            card, "edited" if distance else "taken", now_ns,
            edit_distance=distance or None, utterance_id=utterance_id, actor=actor,
        )  # fmt: skip
        self.cards = tuple(other for other in self.cards if other is not card)
        self._robot_utterances.append(utterance_id)
        self._leave("superseded", now_ns, reason="one of the replies was used")

    def dismiss(self, actor: Actor, now_ns: int) -> None:
        """Dismiss all replies."""
        self._leave("dismissed", now_ns, reason="the wizard dismissed them", actor=actor)

    def withdraw(self, reason: str, now_ns: int) -> None:
        """End the round without a need for a reply."""
        self._leave("superseded", now_ns, reason=reason)

    def reword(self, text: str, now_ns: int) -> None:
        """The wizard corrected the transcript."""
        current = self.round
        if current is not None and not same_words(current.text, text):
            self._restart_question(replace(current, text=text), "the transcript was corrected", now_ns)

    def ask_again(self, reason: str, now_ns: int) -> None:
        """Request other replies."""
        if self.round is not None:
            self._restart_question(self.round, reason, now_ns)

    def _restart_question(self, about: Round, reason: str, now_ns: int) -> None:
        self._end("superseded", now_ns, reason=reason)
        self._pause = replace(about, revision=about.revision + 1)
        self.pass_time(now_ns)

    def forget(self, now_ns: int) -> None:
        """Reset for another conversation."""
        self._leave("expired", now_ns, reason="the conversation is over")
        self._pause = self._last = self._done = self._speaking = None

    def pass_time(self, now_ns: int) -> None:
        """Start a round after a pause, and expire unused replies."""
        pause = self._pause
        if pause is not None and now_ns >= pause.voice_ended_ns + PAUSE_NS:
            self._pause, self._last, self.round = None, pause, pause
            self._ask(pause)
        if self.cards and now_ns >= self.cards[0].shown_ns + EXPIRES_NS:
            self._leave("expired", now_ns, reason="they were not used")

    @property
    def says_ns(self) -> int | None:
        """Time at which the first reply is said without a key."""
        if self.acts_after_ns is None or not self.cards:
            return None
        return self.cards[0].shown_ns + self.acts_after_ns

    def due(self, now_ns: int) -> Suggested | None:
        """Reply to say without a key now; None if the end of its countdown was missed."""
        says_ns = self.says_ns
        return self.cards[0] if says_ns is not None and 0 <= now_ns - says_ns < _MISSED_NS else None

    @property
    def next_ns(self) -> int | None:
        """Next time at which ``pass_time`` is needed."""
        moments = [self._pause.voice_ended_ns + PAUSE_NS] if self._pause is not None else []
        if self.cards:
            moments.append(self.cards[0].shown_ns + EXPIRES_NS)
        return min(moments, default=None)

    def _wait_for(self, pause: Round, now_ns: int) -> None:
        """Start a round after a long enough pause, unless one has the same transcript."""
        if self._needs_none(pause):
            return
        for known in (self.round, self._pause):
            if known is not None and known.turn_id == pause.turn_id and same_words(known.text, pause.text):
                if self.round is not None and pause.person_id:
                    self.round = replace(self.round, person_id=pause.person_id)
                return
        self._end("superseded", now_ns, reason="the transcript changed")
        last = self._last
        if last is not None and last.turn_id == pause.turn_id and pause.revision <= last.revision:
            pause = replace(pause, revision=last.revision + 1)
        self._pause = pause

    def _needs_none(self, pause: Round) -> bool:
        """True if that turn was handled and nothing was said in it since."""
        done = self._done
        if done is None or done.turn_id != pause.turn_id:
            return False
        return not self._spoken_since or same_words(done.text, pause.text)

    def _leave(self, fate: SuggestionState, now_ns: int, *, reason: str, actor: Actor = CONSOLE) -> None:
        """End the round: this turn needs no reply, whatever its final transcript."""
        self._done = self._last = self._pause or self.round or self._last
        self._pause, self._spoken_since = None, False
        self._end(fate, now_ns, reason=reason, actor=actor)

    def _end(self, fate: SuggestionState, now_ns: int, *, reason: str, actor: Actor = CONSOLE) -> None:
        if self.round is None:
            return
        for card in self.cards:
            self._notify(card, fate, now_ns, actor=actor)
        if self.cards:
            self._cards_removed_ns = now_ns
        self.cards = ()
        self.round = None
        self._drop(reason)

    def _notify(
        self,
        card: Suggested,
        state: SuggestionState,
        now_ns: int,
        *,
        latency_ms: float | None = None,
        edit_distance: int | None = None,
        utterance_id: str = "",
        actor: Actor = "",
    ) -> None:
        self._report(
            SuggestionChanged(
                now_ns, card.suggestion_id, state, card.turn_id, card.revision, card.rank, card.text, card.model,
                latency_ms, edit_distance, utterance_id, MODEL if state == "displayed" else actor,
            )
        )  # fmt: skip


def characters_changed(before: str, after: str) -> int:
    """Levenshtein distance of two texts.

    Bit-parallel (Myers 1999, in Hyyrö's form), so that long texts take less than a display frame.
    """
    if not before or not after:
        return len(before) + len(after)
    where: dict[str, int] = {}
    for place, character in enumerate(before):
        where[character] = where.get(character, 0) | 1 << place
    everything, last = (1 << len(before)) - 1, 1 << (len(before) - 1)
    more, less, distance = everything, 0, len(before)
    for character in after:
        same = where.get(character, 0)
        diagonal = (((same & more) + more) ^ more) | same | less
        across_more = less | ~(diagonal | more) & everything
        across_less = more & diagonal
        distance += bool(across_more & last) - bool(across_less & last)
        across_more = (across_more << 1 | 1) & everything
        across_less = across_less << 1 & everything
        more = across_less | ~(diagonal | across_more) & everything
        less = across_more & diagonal
    return distance


Intention = Literal["question", "yes", "no", "thanks", "greeting", "farewell", "sorry", "acknowledgement", "statement"]

_OPENINGS: Sequence[tuple[Intention, str]] = (
    ("farewell", r"goodbye|bye|see you|take care|have a (nice|good|great)|until next time"),
    ("greeting", r"hello|hi|hey|welcome|good (morning|afternoon|evening)|nice to meet"),
    ("thanks", r"thanks|thank you"),
    ("sorry", r"sorry|i'?m sorry|i am sorry|my apologies|excuse me"),
    ("no", r"no|nope|not really|i'?m afraid not|unfortunately|never"),
    ("yes", r"yes|yeah|yep|sure|of course|certainly|absolutely|definitely|exactly|right"),
    (
        "acknowledgement",
        r"i see|i understand|i hear you|okay|ok|alright|got it|(that'?s |what )?(a |an )?(very )?"
        r"(good|great|nice|interesting|excellent) (question|point|idea|to hear)|that sounds|how (nice|interesting)",
    ),
)
_ONLY_ONE: tuple[Intention, ...] = ("thanks", "greeting", "farewell", "sorry", "acknowledgement")
"""Of these there is no second one to choose from: whatever their words are, they do the same."""
# Stop words.
_SMALL = frozenset(words_of(
    "a an and are as at be been but can could did do does for from had has have he her here him his how i if in is it "
    "its just let me my of on or our out she so some that the their them then there they this to too up us very was we "
    "were what when where which who why will with would you your please may might must should shall about also"
))  # fmt: skip
_NEAR_DUPLICATE, _ALIKE = 0.6, 0.34


def intention_of(text: str) -> Intention:
    """Dialogue act by the beginning and end; after a polite opening, that of the longer rest."""
    lowered = " ".join(text.lower().replace("’", "'").split())
    for intention, opening in _OPENINGS:
        match = re.match(rf"(?:{opening})\b[\s,.!?-]*", lowered)
        if match is None:
            continue
        rest = lowered[match.end() :]
        if intention in ("yes", "no") or len(rest.split()) < 4:
            return intention
        return intention_of(rest)
    return "question" if lowered.endswith("?") else "statement"


def same_intention(text: str, other: str) -> bool:
    """True if two replies are equivalent, leaving nothing to choose."""
    does, other_does = intention_of(text), intention_of(other)
    if {does, other_does} == {"yes", "no"}:
        return False
    alike = _alike(text, other)
    if does != other_does:
        return alike >= _NEAR_DUPLICATE
    return does in _ONLY_ONE or alike >= _ALIKE


def _alike(text: str, other: str) -> float:
    """Share of common content words."""
    words, others = (frozenset(words_of(each)) - _SMALL for each in (text, other))
    if not words or not others:
        return 1.0 if words == others else 0.0
    common = len(words & others)
    return common / (min(len(words), len(others)) if common > 1 else len(words | others))


# Timing of fillers, which bridge the wait for a late reply. Time is injected.


class FillerWait:
    """One wait per participant turn, from the end of their voice."""

    def __init__(self) -> None:
        self.due_ns: int | None = None
        self._turn_id = ""

    def turn_over(self, turn: UtteranceChanged, after_ns: int) -> None:
        """The participant's turn is over."""
        if turn.state == "finished" and turn.text.strip() and turn.utterance_id != self._turn_id:
            self._turn_id = turn.utterance_id
            self.due_ns = turn.stamp_ns + after_ns

    def spoken(self) -> None:
        """Cancel the wait: someone speaks, or the wizard wants no filler."""
        self.due_ns = None

    def due(self, now_ns: int) -> bool:
        """True once, when the filler is due; a wait whose end was missed is over."""
        if self.due_ns is None or now_ns < self.due_ns:
            return False
        late_ns = now_ns - self.due_ns
        self.due_ns = None
        return late_ns < _MISSED_NS


# Current action proposal of the language model, and its outcome. Time is injected.

LAPSES_NS = 15_000_000_000


class Card(Value):
    """Displayed proposal. Keys work from ``from_ns``; it is executed at ``acts_ns`` without a key, or lapses."""

    proposal_id: str
    proposed: Proposed
    begun: Round
    model: str
    from_ns: int
    lapses_ns: int
    acts_ns: int | None = None


def arguments_of(proposed: Proposed) -> dict[str, float | str | bool]:
    """Arguments of the intent without the actor."""
    intent = proposed.intent
    return {each.name: getattr(intent, each.name) for each in fields(intent) if each.name != "actor"}


class Proposals:
    """Holds one proposal at a time. ``report`` receives each event at once."""

    def __init__(self, report: Callable[[ProposalChanged], None], new_id: Callable[[], str]) -> None:
        self._report = report
        self._new_id = new_id
        self.card: Card | None = None

    def offer(self, begun: Round, proposed: Proposed, model: str, now_ns: int, *, acts_after_ns: int | None) -> None:
        """Display a proposal in place of the present one. Robot motion requires a key, whatever the countdown."""
        self.lapse(now_ns, "replaced by another proposal")
        acts_ns = None if acts_after_ns is None or proposed.moves else now_ns + acts_after_ns
        lapses_ns = max(now_ns + LAPSES_NS, (acts_ns or 0) + _MISSED_NS)
        self.card = Card(self._new_id(), proposed, begun, model, now_ns + TO_READ_NS, lapses_ns, acts_ns)
        self._report_state(self.card, "displayed" if acts_ns is None else "counting", now_ns, actor=MODEL)

    def refuse(self, begun: Round, model: str, reason: str, now_ns: int) -> None:
        """Record an invalid proposal without displaying it."""
        self._report(
            ProposalChanged(
                now_ns, self._new_id(), "refused", begun.turn_id, begun.revision, "", {}, model, reason, CONSOLE
            )
        )

    def answered(self, proposal_id: str, now_ns: int, *, readable: bool = True) -> Card | None:
        """Proposal that a key refers to; None if it is not current. ``readable``: only after ``from_ns``."""
        self.pass_time(now_ns)
        card = self.card
        if card is None or card.proposal_id != proposal_id or (readable and now_ns < card.from_ns):
            return None
        return card

    def end(self, state: ProposalState, now_ns: int, actor: Actor, detail: str = "") -> None:
        """End the proposal with this state."""
        if self.card is not None:
            card, self.card = self.card, None
            self._report_state(card, state, now_ns, actor=actor, detail=detail)

    def lapse(self, now_ns: int, reason: str) -> None:
        self.end("lapsed", now_ns, CONSOLE, reason)

    def pass_time(self, now_ns: int) -> None:
        card = self.card
        if card is not None and now_ns >= card.lapses_ns:
            self.lapse(now_ns, "it was not confirmed")
        elif card is not None and card.acts_ns is not None and now_ns - card.acts_ns >= _MISSED_NS:
            self.wait_for_key()

    def wait_for_key(self) -> None:
        """Cancel the countdown."""
        if self.card is not None:
            self.card = replace(self.card, acts_ns=None)

    def due(self, now_ns: int) -> Card | None:
        """Proposal whose countdown ends now; None if the end was missed, as while the program was suspended."""
        card = self.card
        ends = card is not None and card.acts_ns is not None and 0 <= now_ns - card.acts_ns < _MISSED_NS
        return card if ends else None

    @property
    def next_ns(self) -> int | None:
        """Next time at which ``pass_time`` is needed."""
        if self.card is None:
            return None
        return min(self.card.lapses_ns, self.card.acts_ns or self.card.lapses_ns)

    def _report_state(self, card: Card, state: ProposalState, now_ns: int, *, actor: Actor, detail: str = "") -> None:
        self._report(
            ProposalChanged(
                now_ns, card.proposal_id, state, card.begun.turn_id, card.begun.revision,
                type(card.proposed.intent).__name__, arguments_of(card.proposed), card.model, detail, actor,
            )
        )  # fmt: skip
