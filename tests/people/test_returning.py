"""Returning people with a real re-identification network: short version of the benchmark."""

import pytest

from caris_desktop.perception.appearance_embedding import AppearanceModel
from tests.people.returning import RATE_HZ, recognised, seen, visits_of
from tests.perception.shared_data import OSNET_WEIGHTS
from tests.support.walkers import film

pytestmark = pytest.mark.skipif(not OSNET_WEIGHTS.is_file(), reason=f"needs {OSNET_WEIGHTS}")

PEOPLE, KNOWN = (2, 5, 9, 18), (2, 9, 18)


@pytest.mark.long  # test_recognising and test_decisions test the rules alone
def test_in_the_same_clothes_they_get_their_names_back_in_others_nobody_does_and_nobody_a_wrong_one() -> None:
    """One film evaluated twice: people appear in one set of clothes, return in it, and return in another."""
    visits = visits_of(PEOPLE, rounds=3, seed=3, clothes=(0, 0, 1), stays_s=3.0)
    sights = list(seen(film(visits, rate_hz=RATE_HZ, seed=3), AppearanceModel(OSNET_WEIGHTS)))
    changed = {number for number, visit in enumerate(visits) if visit.clothes == 1}
    same = [sight for sight in sights if not changed & set(sight.truly)]
    found = recognised(same, KNOWN)
    assert (found.returns, found.suggested, found.wrong) == (3, 3, 0)
    assert found.named >= 2
    in_both = recognised(sights, KNOWN)
    assert (in_both.returns, in_both.named, in_both.wrong) == (6, found.named, 0)
