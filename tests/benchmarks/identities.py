"""Re-identification of people who leave and return: twenty drawn people, half of them known, in twenty rounds.

``python -m tests.benchmarks.identities [--rounds N] [--seed S] [--whole]`` prints one JSON line. It films them with a
stationary camera, computes OSNet embeddings about twice a second (``CARIS_MODELS_DIR``), and uses the console's
identity logic. The known ones are named at their first visit, without any later action.

The thresholds of ``people/identities.py`` were chosen with the second set of clothes and other orders; this reports the
first. ``--whole`` includes the real detector and tracker (int8 weights, 7.5 frames a second); without it detection and
tracking are perfect, and only the identities are measured.

In changed clothes everybody comes once in the first set and from then on in the second.
"""

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict

from caris_desktop.people.presence import RecognitionSettings
from caris_desktop.perception.appearance_embedding import AppearanceModel
from caris_desktop.perception.perceiver import open_perceiver
from caris_desktop.simulator.simulated_people import Visit
from tests.people.returning import RATE_HZ, Outcome, Sight, found, recognised, seen, visits_of
from tests.perception.shared_data import INT8_WEIGHTS, OSNET_WEIGHTS
from tests.support.walkers import PEOPLE, film

_CHANGED_ROUNDS = 3
_WHOLE_RATE_HZ = 7.5


Perception = Callable[[list[Visit], int], Iterator[Sight]]


def identities_alone(visits: list[Visit], seed: int) -> Iterator[Sight]:
    return seen(film(visits, rate_hz=RATE_HZ, seed=seed), AppearanceModel(OSNET_WEIGHTS))


def whole(visits: list[Visit], seed: int) -> Iterator[Sight]:
    os.environ.setdefault("CARIS_MODELS_DIR", str(OSNET_WEIGHTS.parent))
    perceiver = open_perceiver(INT8_WEIGHTS, tracker="own", threads=1, recognise_appearance=True)
    return found(film(visits, rate_hz=_WHOLE_RATE_HZ, seed=seed), perceiver)


def measured(perception: Perception, clothes: tuple[int, ...], rounds: int, seed: int) -> dict[str, object]:
    visits = visits_of(range(PEOPLE), rounds=rounds, seed=seed, clothes=clothes)
    began_s = time.monotonic()
    outcome = recognised(perception(visits, seed), range(0, PEOPLE, 2), RecognitionSettings())
    return figures(outcome) | {"visits": len(visits), "took_s": round(time.monotonic() - began_s, 1)}


def figures(outcome: Outcome) -> dict[str, object]:
    told = outcome.told
    calibration = {
        f"{low:.1f} to {min(1.0, low + 0.2):.1f}": {
            "shown": len(within),
            "said": round(sum(confidence for confidence, _ in within) / len(within), 2),
            "right": round(sum(right for _, right in within) / len(within), 2),
        }
        for low in (0.1, 0.3, 0.5, 0.7, 0.9)
        if (within := [each for each in told if low <= each[0] < low + 0.2])
    }
    return {
        "returns": outcome.returns,
        "within_first_two": round(outcome.suggested_share, 3),
        "named_by_itself": round(outcome.named_share, 3),
        "wrongly": outcome.wrong,
        "confidence": calibration,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--whole", action="store_true")
    asked = parser.parse_args()
    perception = whole if asked.whole else identities_alone
    changed = (0, *(_CHANGED_ROUNDS - 1) * (1,))
    print(
        json.dumps(
            {
                "settings": asdict(RecognitionSettings()),
                "same clothes": measured(perception, (0,), asked.rounds, asked.seed),
                "changed clothes": measured(perception, changed, _CHANGED_ROUNDS, asked.seed),
            }
        )
    )


if __name__ == "__main__":
    main()
