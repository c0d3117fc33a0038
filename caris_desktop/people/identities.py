"""Which of the known people somebody is: pure logic on what their looks tell, several at a time.

Evidence for a person is a sum over networks of how much more somebody resembles them than a stranger would, so that
the confidence is a softmax over everybody known and "somebody new". It is sure only where several looks agree, over a
while, that nobody else comes near.
"""

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import field
from typing import Literal

import numpy as np

from caris_desktop.domain.people import LooksKind, PersonLooks
from caris_desktop.domain.value_class import dataclass
from caris_desktop.people.gallery import GOOD_QUALITY, Gallery, Vectors, Views

SUGGEST_FROM = 0.08
"""Who is less likely than that is not mentioned."""
_LOOKS_KEPT = 12
_SUGGEST_AFTER_LOOKS = 2
_SURE_AFTER_LOOKS = 5
_SURE_AFTER_NS = 1_500_000_000
_SURE_SHARE = 0.8
# Of three looks in a row one at least comes to 0.84 of what was seen before of the same person, also of one who turns.
# Of nineteen in twenty others none comes to 0.65.
_MISTAKEN_BELOW, _MISTAKEN_LOOKS, _LEARNED_FROM = 0.75, 3, 4
_VISITS_OF_A_PERSON = 3  # beside the first, of which the wizard said who it was
MOST_STRANGERS = 60


@dataclass(frozen=True, slots=True)
class LooksLine:
    """Of one kind of looks: from which cosine on it speaks for a person, how strongly, and by how much the best has to
    beat the next, as evidence.
    """

    stranger_at: float
    scale: float
    margin: float


# Of OSNet, on the simulator's people in the clothes that the benchmark does not report on: somebody in the same clothes
# comes to 0.89 to 0.98, the stranger who looks most like anybody known to 0.88; people on a real street to 0.85 to 0.91
# and 0.66. Of a face, as ArcFace's models tell people apart: two pictures of one lie above 0.4, of two below 0.3.
LINES: Mapping[LooksKind, LooksLine] = {
    "clothing": LooksLine(stranger_at=0.865, scale=45.0, margin=3.0),
    "face": LooksLine(stranger_at=0.38, scale=30.0, margin=3.0),
}


@dataclass(frozen=True, slots=True)
class Guess:
    """Somebody may be ``person_id``; ``kind`` is what told most."""

    person_id: str
    confidence: float
    evidence: float
    kind: LooksKind


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whom somebody may be, likeliest first. ``sure``: enough looks agree, and nobody else comes near.

    ``stranger`` is how likely it is somebody new.
    """

    guesses: tuple[Guess, ...] = ()
    stranger: float = 1.0
    sure: bool = False
    looks: int = 0

    @property
    def best(self) -> Guess | None:
        return self.guesses[0] if self.guesses else None

    @property
    def runner_up(self) -> Guess | None:
        return self.guesses[1] if len(self.guesses) > 1 else None


UNDECIDED = Judgement()
_By = tuple[LooksKind, str]  # kind and network


@dataclass(slots=True)
class _Recent:
    """The last good looks of a visit by one network."""

    vectors: deque[Vectors] = field(default_factory=lambda: deque(maxlen=_LOOKS_KEPT))
    first_ns: int = 0
    last_ns: int = 0
    count: int = 0
    unlike: int = 0  # so many looks in a row were not like those before


class Identities:
    """Learns how people look, visit by visit, and judges who somebody is.

    A visit learns under an id of its own; ``link`` says whose it is. Only those count as known whose visit was
    ``settle``\\ d: who may still turn out to be somebody else must not stand beside them.
    """

    def __init__(self, lines: Mapping[LooksKind, LooksLine] = LINES) -> None:
        self._lines = lines
        self._views: dict[str, dict[_By, Views]] = {}
        self._recent: dict[str, dict[_By, _Recent]] = {}
        self._root: dict[str, str] = {}
        self._settled: dict[str, None] = {}  # in the order in which they were
        self._lasting: set[str] = set()
        self._galleries: dict[_By, Gallery] | None = None

    # What is known

    def remember(self, person_id: str, kind: LooksKind, model: str, vectors: Vectors) -> None:
        """What was learned before, from the study's database."""
        self._views.setdefault(person_id, {})[kind, model] = Views(vectors)
        self._settled[person_id] = None
        self._galleries = None

    def link(self, person_id: str, root: str) -> None:
        """That id's looks are ``root``'s from now on, or with an empty one its own again."""
        if root:
            for each, its_root in tuple(self._root.items()):
                if its_root == person_id:
                    self._root[each] = root
            self._root[person_id] = root
            self._settled[person_id] = None
        else:
            self._root.pop(person_id, None)
            # Who it is is open again: beside whom they may be they must not stand as somebody else.
            if person_id not in self._lasting:
                self._settled.pop(person_id, None)
        self._galleries = None

    def drop_visit(self, person_id: str) -> None:
        """Nobody decided who that was, and nobody will."""
        if person_id not in self._settled:
            self._views.pop(person_id, None)

    def settle(self, person_id: str, *, lasting: bool = False) -> None:
        """This visit stands for itself: somebody to be recognised. ``lasting``: the wizard knows them."""
        self._settled[person_id] = None
        if lasting:
            self._lasting.add(person_id)
        self._galleries = None

    def end_visit(self, person_id: str) -> None:
        """They left: their last looks are void. What was learned stays, should it be decided later who they were."""
        self._recent.pop(person_id, None)
        root = self._root.get(person_id)
        theirs = [each for each in self._settled if self._root.get(each) == root] if root else []
        for older in theirs[:-_VISITS_OF_A_PERSON]:
            self._views.pop(older, None)
            self._settled.pop(older)
        strangers = [each for each in self._settled if each not in self._lasting and each not in self._root]
        strangers = [each for each in strangers if each not in self._root.values()]
        for stranger in strangers[:-MOST_STRANGERS]:
            self.forget([stranger])
        self._galleries = None

    def forget(self, person_ids: Iterable[str]) -> None:
        for person_id in person_ids:
            self._views.pop(person_id, None)
            self._recent.pop(person_id, None)
            self._root.pop(person_id, None)
            self._settled.pop(person_id, None)
            self._lasting.discard(person_id)
        self._galleries = None

    def drop(self, kind: LooksKind, person_ids: Iterable[str] | None = None) -> None:
        """Looks of this kind are void, as those of clothes at midnight; of everybody, or of these ids."""
        for person_id in tuple(self._views) if person_ids is None else person_ids:
            for held in (self._views.get(person_id, {}), self._recent.get(person_id, {})):
                for by in [by for by in held if by[0] == kind]:
                    held.pop(by)
        self._galleries = None

    def people(self) -> frozenset[str]:
        """Everybody whom somebody can be taken for."""
        return frozenset(self._root.get(each, each) for each in self._settled)

    def knows(self, person_id: str) -> bool:
        """Whether somebody can be taken for this person."""
        return person_id in self._settled

    def views_of(self, person_id: str) -> dict[_By, Vectors]:
        """What there is to keep of that visit."""
        return {by: views.vectors() for by, views in self._views.get(person_id, {}).items() if views.count}

    # What is seen

    def still_the_same(self, person_id: str, looks: PersonLooks) -> Literal["yes", "doubtful", "somebody else"]:
        """Whether somebody who looks like that can be whom that visit's views were learned from.

        One look may be a bad one; several in a row are somebody else, whom a tracker took for the one before.
        """
        by: _By = (looks.kind, looks.model)
        views = self._views.get(person_id, {}).get(by)
        if looks.quality < GOOD_QUALITY or views is None or views.count < _LEARNED_FROM:
            return "yes"
        recent = self._recent.setdefault(person_id, {}).setdefault(by, _Recent(first_ns=looks.stamp_ns))
        alike = float((views.vectors() @ looks.vector).max())
        recent.unlike = 0 if alike >= _MISTAKEN_BELOW else recent.unlike + 1
        if not recent.unlike:
            return "yes"
        return "somebody else" if recent.unlike >= _MISTAKEN_LOOKS else "doubtful"

    def likeness(self, person_id: str, looks: PersonLooks) -> float | None:
        """How much somebody who looks like that resembles whom that visit's views were learned from, as a cosine; None
        where nothing was learned by that network.
        """
        views = self._views.get(person_id, {}).get((looks.kind, looks.model))
        return None if views is None or not views.count else float((views.vectors() @ looks.vector).max())

    def see(self, person_id: str, looks: PersonLooks) -> bool:
        """Somebody looks like that; whether that was a view to learn and to judge from."""
        if looks.quality < GOOD_QUALITY:
            return False
        by: _By = (looks.kind, looks.model)
        self._views.setdefault(person_id, {}).setdefault(by, Views()).add(looks.vector, looks.quality)
        recent = self._recent.setdefault(person_id, {}).setdefault(by, _Recent(first_ns=looks.stamp_ns))
        recent.vectors.append(looks.vector)
        recent.last_ns = looks.stamp_ns
        recent.count += 1
        return True

    def judge(
        self, person_id: str, *, impossible: Collection[str] = (), confused: Collection[frozenset[str]] = ()
    ) -> Judgement:
        """Who that visit's person may be.

        ``impossible`` are people who are here already, or who it is not. ``confused`` are pairs that were mistaken for
        one another before: between them twice the margin is asked for.
        """
        evidence: dict[str, dict[LooksKind, float]] = {}
        wins: dict[str, float] = {}
        looks = lasted_ns = 0
        for by, recent in self._recent.get(person_id, {}).items():
            gallery = self._gallery(by)
            alike = gallery.likeness(np.stack(recent.vectors))
            line = self._lines[by[0]]
            candidates = [
                row for row, known in enumerate(gallery.person_ids) if known not in impossible and known != person_id
            ]
            looks = max(looks, len(recent.vectors))
            lasted_ns = max(lasted_ns, recent.last_ns - recent.first_ns)
            if not candidates or not len(alike):
                continue
            alike = alike[candidates]
            means = alike.mean(axis=1)
            shares = np.bincount(alike.argmax(axis=0), minlength=len(candidates)) / alike.shape[1]
            for row, candidate in enumerate(candidates):
                known = gallery.person_ids[candidate]
                evidence.setdefault(known, {})[by[0]] = line.scale * (float(means[row]) - line.stranger_at)
                wins[known] = max(wins.get(known, 0.0), float(shares[row]))
        if looks < _SUGGEST_AFTER_LOOKS or not evidence:
            return Judgement(looks=looks)
        guesses = _guesses(evidence)
        stranger = 1.0 - sum(guess.confidence for guess in guesses)
        best, second = guesses[0], guesses[1] if len(guesses) > 1 else None
        margin = self._lines[best.kind].margin
        if second is not None and frozenset((best.person_id, second.person_id)) in confused:
            margin *= 2.0
        sure = (
            looks >= _SURE_AFTER_LOOKS
            and lasted_ns >= _SURE_AFTER_NS
            and wins[best.person_id] >= _SURE_SHARE
            and best.evidence - (0.0 if second is None else second.evidence) >= margin
        )
        likely = tuple(guess for guess in guesses if guess.confidence >= SUGGEST_FROM)
        return Judgement(likely, max(stranger, 0.0), sure and bool(likely), looks)

    def held(self) -> int:
        """How many vectors are kept, for whoever looks after memory."""
        learned = sum(len(views.vectors()) for each in self._views.values() for views in each.values())
        return learned + sum(len(recent.vectors) for each in self._recent.values() for recent in each.values())

    def _gallery(self, by: _By) -> Gallery:
        if self._galleries is None:
            self._galleries = {}
        if by not in self._galleries:
            self._galleries[by] = self._built(by)
        return self._galleries[by]

    def _built(self, by: _By) -> Gallery:
        of_person: dict[str, list[Vectors]] = {}
        for person_id in self._settled:
            views = self._views.get(person_id, {}).get(by)
            held = of_person.setdefault(self._root.get(person_id, person_id), [])
            if views is not None:
                held.append(views.vectors())
        return Gallery.of(of_person)


def _guesses(evidence: Mapping[str, Mapping[LooksKind, float]]) -> list[Guess]:
    """Everybody with a confidence, likeliest first: a softmax in which "somebody new" has an evidence of 0."""
    summed = {known: sum(by_kind.values()) for known, by_kind in evidence.items()}
    most = max(0.0, *summed.values())
    shares = {known: math.exp(each - most) for known, each in summed.items()}
    total = sum(shares.values()) + math.exp(-most)
    guesses = [
        Guess(known, share / total, summed[known], max(evidence[known], key=lambda kind: evidence[known][kind]))
        for known, share in shares.items()
    ]
    return sorted(guesses, key=lambda guess: -guess.evidence)
