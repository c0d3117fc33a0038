"""Appearance gallery: mean and diverse views of each known person, and cosine similarity to them."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

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
