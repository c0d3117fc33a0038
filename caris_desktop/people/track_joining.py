"""Track joining: continue a visit on a new track after the camera turned or lost the person, by
appearance and place.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field

from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.domain.value_class import dataclass
from caris_desktop.people.gallery import GOOD_QUALITY
from caris_desktop.people.visit_log import Spot, Visit

JOINED_WITHIN_NS = 30_000_000_000
"""A person lost for longer is identified again."""
SHORT_GAP_NS = 3_000_000_000
"""For so long a tracker or a turn of the camera loses somebody; then appearance or place alone is enough."""
DECIDED_WITHIN_NS = 1_500_000_000
"""A track that may be somebody who was lost waits for its looks no longer than this."""
_LOOKS_KEPT, _LOOKS_TO_JOIN = 6, 2
# The same clothes reach 0.89 to 0.98, the most similar stranger 0.88 (see LINES in identities).
_ALIKE_FROM, _AHEAD_BY = 0.89, 0.02
_STANDS_WITHIN_M, _WALKS_MPS, _NEAR_M = 0.8, 1.5, 0.6
# For a visit without a name, where a wrong match by position passes nothing on.
_NEAR_WITHOUT_NAME_M = 1.0


@dataclass(slots=True)
class Candidate:
    """Track that is not yet confirmed as a person."""

    frames: int
    first_seen_ns: int
    last_seen_ns: int
    looks: list[PersonLooks] = field(default_factory=list)
    spot: Spot | None = None

    def add_embeddings(self, looks: PersonLooks) -> None:
        if looks.kind == "clothing" and looks.quality >= GOOD_QUALITY:
            self.looks = [*self.looks, looks][-_LOOKS_KEPT:]

    def is_undecided(self, now_ns: int) -> bool:
        """True while another embedding may still identify the person."""
        return len(self.looks) < _LOOKS_TO_JOIN and now_ns - self.first_seen_ns < DECIDED_WITHIN_NS


Likeness = Callable[[str, PersonLooks], float | None]


def is_lost(visit: Visit, now_ns: int) -> bool:
    """True if a visit without a track may be continued by a new one."""
    return not visit.forgotten and now_ns - visit.last_seen_ns <= JOINED_WITHIN_NS


def same_visit(
    candidate: Candidate, lost: Iterable[Visit], likeness: Likeness, is_known: Callable[[str], bool], now_ns: int
) -> Visit | None:
    """The ``lost`` visit that the track continues: the only possible one, by appearance or position.

    ``is_known``: whether there are notes on a person.
    """
    possible: list[tuple[float, Visit]] = []
    for visit in lost:
        gap_ns = now_ns - visit.last_seen_ns
        away_m = _apart_m(candidate.spot, visit.spot)
        if away_m is not None and away_m > _STANDS_WITHIN_M + _WALKS_MPS * gap_ns / 1e9:
            continue
        if away_m is None and gap_ns > SHORT_GAP_NS:
            continue
        alike = _alike(visit, candidate.looks, likeness)
        if alike is not None:
            if alike >= _ALIKE_FROM:
                possible.append((alike, visit))
        elif away_m is not None:
            near_m = _NEAR_WITHOUT_NAME_M if not is_known(visit.person_id) else _NEAR_M
            if away_m <= near_m and (gap_ns <= SHORT_GAP_NS or not is_known(visit.person_id)):
                possible.append((0.0, visit))
    possible.sort(key=lambda each: -each[0])
    if not possible or (len(possible) > 1 and possible[0][0] - possible[1][0] < _AHEAD_BY):
        return None
    return possible[0][1]


def _alike(visit: Visit, looks: Sequence[PersonLooks], likeness: Likeness) -> float | None:
    similarities = [alike for each in looks if (alike := likeness(visit.visit_id, each)) is not None]
    return sum(similarities) / len(similarities) if similarities else None


def _apart_m(one: Spot | None, other: Spot | None) -> float | None:
    return None if one is None or other is None else math.dist(one, other)
