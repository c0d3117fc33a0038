"""Re-identification: which known person a visit belongs to, from several appearance embeddings; pure logic.

Evidence for a person is the sum over networks of the excess similarity compared with a stranger, so that the confidence
is a softmax over all known people and "new person". A match is sure only if several embeddings over a period agree and
no other person is close.
"""

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.person_values import LooksKind, PersonLooks
from caris_desktop.domain.value_class import Value, dataclass

# Appearance gallery: mean and diverse views of each known person, and cosine similarity to them.

Vectors = NDArray[np.float32]

KEEP = 0.95
GOOD_QUALITY = 0.4
MOST_VIEWS = 7
_ALIKE = 0.93  # a view closer than this to a stored one adds nothing


class Views:
    """Appearance embeddings of one person in one visit by one network: running mean of good views, and a few diverse
    views.

    Bounded to :data:`MOST_VIEWS` vectors and their mean.
    """

    def __init__(self, vectors: Vectors | None = None) -> None:
        """``vectors`` is a result of :meth:`vectors`."""
        self.count = 0
        self._mean: Vectors | None = None
        self._views: list[Vectors] = []
        if vectors is not None and len(vectors):
            self.count = len(vectors)
            self._mean = vectors[0].copy()
            self._views = [view.copy() for view in vectors[1 : MOST_VIEWS + 1]]

    def add(self, vector: Vectors, quality: float) -> bool:
        """Add a view; False if its quality is too low."""
        if quality < GOOD_QUALITY:
            return False
        self.count += 1
        # Equal weights at first: otherwise a bad first view would dominate for long.
        keep = min(KEEP, 1.0 - 1.0 / self.count)
        self._mean = vector.copy() if self._mean is None else unit(keep * self._mean + (1.0 - keep) * vector)
        self._select_diverse(vector)
        return True

    def _select_diverse(self, vector: Vectors) -> None:
        if not self._views:
            self._views.append(vector.copy())
            return
        views = np.stack(self._views)
        if float((views @ vector).max()) > _ALIKE:
            return
        if len(self._views) < MOST_VIEWS:
            self._views.append(vector.copy())
            return
        # Replace one of the two closest views if the new one is farther from all.
        alike = views @ views.T
        np.fill_diagonal(alike, -1.0)
        if float((views @ vector).max()) < float(alike.max()):
            self._views[int(alike.max(axis=1).argmax())] = vector.copy()

    def vectors(self) -> Vectors:
        """float32, shape (1 + views, length): the mean first. (0, 0) before the first good view."""
        if self._mean is None:
            return np.zeros((0, 0), np.float32)
        return np.stack([self._mean, *self._views]).astype(np.float32)


class Gallery(Value, eq=False):
    """Embeddings of many people by one network. ``vectors`` is (n, length), ``begins`` the first row of each person."""

    person_ids: tuple[str, ...]
    vectors: Vectors
    begins: NDArray[np.int64]

    @classmethod
    def of(cls, vectors: Mapping[str, Sequence[Vectors]]) -> "Gallery":
        """Gallery from arrays of shape (n, length) per person; empty ones are ignored."""
        known = {person_id: [each for each in arrays if len(each)] for person_id, arrays in vectors.items()}
        known = {person_id: arrays for person_id, arrays in known.items() if arrays}
        if not known:
            return cls((), np.zeros((0, 0), np.float32), np.zeros(0, np.int64))
        stacked = [np.concatenate(arrays) for arrays in known.values()]
        begins = np.cumsum([0, *(len(array) for array in stacked[:-1])])
        return cls(tuple(known), np.concatenate(stacked).astype(np.float32), begins)

    def likeness(self, vectors: Vectors) -> NDArray[np.float64]:
        """Cosine similarity of each of ``person_ids`` to each of ``vectors``, (m, length), by the closest view. Shape
        (people, m).
        """
        if not self.person_ids or self.vectors.shape[1] != vectors.shape[1]:
            return np.zeros((0, len(vectors)))
        alike = (self.vectors @ vectors.T).astype(np.float64)
        return np.maximum.reduceat(alike, self.begins, axis=0)


def unit(vector: Vectors) -> Vectors:
    """Vector scaled to unit length."""
    length = float(np.linalg.norm(vector))
    return (vector / length).astype(np.float32) if length > 0.0 else vector.astype(np.float32)


SUGGEST_FROM = 0.08
"""Who is less likely than that is not mentioned."""
_MAX_EMBEDDINGS = 12
_SUGGEST_AFTER = 2
_SURE_AFTER = 5
_SURE_AFTER_NS = 1_500_000_000
_SURE_SHARE = 0.8
# Of three consecutive embeddings of the same person, also while turning, at least one reaches 0.84 similarity to
# earlier ones. For different people, in 19 of 20 cases none reaches 0.65.
_MISTAKEN_BELOW, _MISTAKEN_AFTER, _LEARNED_FROM = 0.75, 3, 4
_VISITS_OF_A_PERSON = 3  # in addition to the first, which the wizard identified
MOST_STRANGERS = 60


class AppearanceCalibration(Value):
    """Calibration of one kind of embedding: the cosine from which it is evidence, its scale, and the required margin to
    the second best.
    """

    stranger_at: float
    scale: float
    margin: float


# OSNet on the simulator's people, in clothes outside the benchmark: the same clothes reach 0.89 to 0.98, the most
# similar stranger 0.88; people on a real street 0.85 to 0.91 and 0.66. Faces, with ArcFace models: two images of one
# person exceed 0.4, of two people stay below 0.3.
LINES: Mapping[LooksKind, AppearanceCalibration] = {
    "clothing": AppearanceCalibration(stranger_at=0.865, scale=45.0, margin=3.0),
    "face": AppearanceCalibration(stranger_at=0.38, scale=30.0, margin=3.0),
}


class Guess(Value):
    """Possible match; ``kind`` contributed most."""

    person_id: str
    confidence: float
    evidence: float
    kind: LooksKind


class Judgement(Value):
    """Candidates, most likely first. ``sure``: enough embeddings agree, and no other person is close.

    ``stranger`` is the probability of a new person.
    """

    guesses: tuple[Guess, ...] = ()
    stranger: float = 1.0
    sure: bool = False
    embedding_count: int = 0

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
    """Recent good embeddings of a visit by one network."""

    vectors: deque[Vectors] = field(default_factory=lambda: deque(maxlen=_MAX_EMBEDDINGS))
    first_ns: int = 0
    last_ns: int = 0
    count: int = 0
    unlike: int = 0  # consecutive deviating embeddings


class Identities:
    """Learns appearances visit by visit, and identifies people.

    Visits learn under their own id; ``link`` assigns them to a person. Only ``settle``\\ d visits are in the gallery:
    an undecided visit must not compete with its own person.
    """

    def __init__(self) -> None:
        self._views: dict[str, dict[_By, Views]] = {}
        self._recent: dict[str, dict[_By, _Recent]] = {}
        self._root: dict[str, str] = {}
        self._settled: dict[str, None] = {}  # in order of time
        self._lasting: set[str] = set()
        self._galleries: dict[_By, Gallery] | None = None

    # Known people

    def remember(self, person_id: str, kind: LooksKind, model: str, vectors: Vectors) -> None:
        """Load embeddings from the study's database."""
        self._views.setdefault(person_id, {})[kind, model] = Views(vectors)
        self._settled[person_id] = None
        self._galleries = None

    def link(self, person_id: str, root: str) -> None:
        """Assign the id's embeddings to ``root``, or with an empty one to itself again."""
        if root:
            for each, its_root in tuple(self._root.items()):
                if its_root == person_id:
                    self._root[each] = root
            self._root[person_id] = root
            self._settled[person_id] = None
        else:
            self._root.pop(person_id, None)
            # The decision is open again: the visit must not compete with its own person.
            if person_id not in self._lasting:
                self._settled.pop(person_id, None)
        self._galleries = None

    def drop_visit(self, person_id: str) -> None:
        """Drop an undecided visit."""
        if person_id not in self._settled:
            self._views.pop(person_id, None)

    def settle(self, person_id: str, *, lasting: bool = False) -> None:
        """Add the visit to the gallery. ``lasting``: the wizard knows the person."""
        self._settled[person_id] = None
        if lasting:
            self._lasting.add(person_id)
        self._galleries = None

    def end_visit(self, person_id: str) -> None:
        """Clear the recent embeddings of a visit that ended. Learned views stay for later decisions."""
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
        """Drop embeddings of a kind, such as clothing at midnight; of everybody or of these ids."""
        for person_id in tuple(self._views) if person_ids is None else person_ids:
            for held in (self._views.get(person_id, {}), self._recent.get(person_id, {})):
                for by in [by for by in held if by[0] == kind]:
                    held.pop(by)
        self._galleries = None

    def people(self) -> frozenset[str]:
        """All people in the gallery."""
        return frozenset(self._root.get(each, each) for each in self._settled)

    def knows(self, person_id: str) -> bool:
        """True if the person is in the gallery."""
        return person_id in self._settled

    def views_of(self, person_id: str) -> dict[_By, Vectors]:
        """Views to store for that visit."""
        return {by: views.vectors() for by, views in self._views.get(person_id, {}).items() if views.count}

    # Embeddings

    def still_the_same(self, person_id: str, embedding: PersonLooks) -> Literal["yes", "doubtful", "somebody else"]:
        """Check an embedding against the visit's views, to detect a track that switched to another person.

        One deviating embedding may be bad; several in a row are another person.
        """
        by: _By = (embedding.kind, embedding.model)
        views = self._views.get(person_id, {}).get(by)
        if embedding.quality < GOOD_QUALITY or views is None or views.count < _LEARNED_FROM:
            return "yes"
        recent = self._recent.setdefault(person_id, {}).setdefault(by, _Recent(first_ns=embedding.stamp_ns))
        alike = float((views.vectors() @ embedding.vector).max())
        recent.unlike = 0 if alike >= _MISTAKEN_BELOW else recent.unlike + 1
        if not recent.unlike:
            return "yes"
        return "somebody else" if recent.unlike >= _MISTAKEN_AFTER else "doubtful"

    def likeness(self, person_id: str, embedding: PersonLooks) -> float | None:
        """Cosine similarity of an embedding to the visit's views; None without views by that network."""
        views = self._views.get(person_id, {}).get((embedding.kind, embedding.model))
        return None if views is None or not views.count else float((views.vectors() @ embedding.vector).max())

    def see(self, person_id: str, embedding: PersonLooks) -> bool:
        """Add an embedding; False if its quality is too low."""
        if embedding.quality < GOOD_QUALITY:
            return False
        by: _By = (embedding.kind, embedding.model)
        self._views.setdefault(person_id, {}).setdefault(by, Views()).add(embedding.vector, embedding.quality)
        recent = self._recent.setdefault(person_id, {}).setdefault(by, _Recent(first_ns=embedding.stamp_ns))
        recent.vectors.append(embedding.vector)
        recent.last_ns = embedding.stamp_ns
        recent.count += 1
        return True

    def judge(
        self, person_id: str, *, impossible: Collection[str] = (), confused: Collection[frozenset[str]] = ()
    ) -> Judgement:
        """Identify the person of a visit.

        ``impossible`` are people who are present already or were rejected. ``confused`` are pairs with an earlier
        mix-up, which require twice the margin.
        """
        evidence: dict[str, dict[LooksKind, float]] = {}
        wins: dict[str, float] = {}
        embedding_count = lasted_ns = 0
        for by, recent in self._recent.get(person_id, {}).items():
            if self._galleries is None:
                self._galleries = {}
            if by not in self._galleries:
                self._galleries[by] = self._built(by)
            gallery = self._galleries[by]
            alike = gallery.likeness(np.stack(recent.vectors))
            line = LINES[by[0]]
            candidates = [
                row for row, known in enumerate(gallery.person_ids) if known not in impossible and known != person_id
            ]
            embedding_count = max(embedding_count, len(recent.vectors))
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
        if embedding_count < _SUGGEST_AFTER or not evidence:
            return Judgement(embedding_count=embedding_count)
        guesses = _guesses(evidence)
        stranger = 1.0 - sum(guess.confidence for guess in guesses)
        best, second = guesses[0], guesses[1] if len(guesses) > 1 else None
        margin = LINES[best.kind].margin
        if second is not None and frozenset((best.person_id, second.person_id)) in confused:
            margin *= 2.0
        sure = (
            embedding_count >= _SURE_AFTER
            and lasted_ns >= _SURE_AFTER_NS
            and wins[best.person_id] >= _SURE_SHARE
            and best.evidence - (0.0 if second is None else second.evidence) >= margin
        )
        likely = tuple(guess for guess in guesses if guess.confidence >= SUGGEST_FROM)
        return Judgement(likely, max(stranger, 0.0), sure and bool(likely), embedding_count)

    def held(self) -> int:
        """Number of stored vectors, for memory monitoring."""
        learned = sum(len(views.vectors()) for each in self._views.values() for views in each.values())
        return learned + sum(len(recent.vectors) for each in self._recent.values() for recent in each.values())

    def _built(self, by: _By) -> Gallery:
        of_person: dict[str, list[Vectors]] = {}
        for person_id in self._settled:
            views = self._views.get(person_id, {}).get(by)
            held = of_person.setdefault(self._root.get(person_id, person_id), [])
            if views is not None:
                held.append(views.vectors())
        return Gallery.of(of_person)


def _guesses(evidence: Mapping[str, Mapping[LooksKind, float]]) -> list[Guess]:
    """Softmax over all candidates, most likely first; "new person" has evidence 0."""
    summed = {known: sum(by_kind.values()) for known, by_kind in evidence.items()}
    most = max(0.0, *summed.values())
    shares = {known: math.exp(each - most) for known, each in summed.items()}
    total = sum(shares.values()) + math.exp(-most)
    guesses = [
        Guess(known, share / total, summed[known], max(evidence[known], key=lambda kind: evidence[known][kind]))
        for known, share in shares.items()
    ]
    return sorted(guesses, key=lambda guess: -guess.evidence)
