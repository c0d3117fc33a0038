"""How well people who leave and return are known again: twenty drawn people, half of them known, twenty times.

``python -m tests.benchmarks.identities [--rounds N] [--seed S]`` prints one JSON line. It films them with a camera that
stands still, looks at each about twice a second through OSNet (``CARIS_MODELS_DIR``), and lets the console's own
identities decide. The known ones are named at their first visit, and after that nobody does anything.

The lines of ``people/identities.py`` were chosen on the second set of clothes and other orders; this reports the first.
In changed clothes everybody comes once in the first set and from then on in the second.
"""

import argparse
import json
import time
from dataclasses import asdict

from caris_desktop.people.presence import RecognitionSettings
from caris_desktop.perception.appearance import AppearanceModel
from tests.people.returning import RATE_HZ, Outcome, recognised, seen, visits_of
from tests.perception.shared_data import OSNET_WEIGHTS
from tests.support.walkers import PEOPLE, film

_CHANGED_ROUNDS = 3


def measured(network: AppearanceModel, clothes: tuple[int, ...], rounds: int, seed: int) -> dict[str, object]:
    visits = visits_of(range(PEOPLE), rounds=rounds, seed=seed, clothes=clothes)
    began_s = time.monotonic()
    found = recognised(
        seen(film(visits, rate_hz=RATE_HZ, seed=seed), network), range(0, PEOPLE, 2), RecognitionSettings()
    )
    return figures(found) | {"visits": len(visits), "took_s": round(time.monotonic() - began_s, 1)}


def figures(found: Outcome) -> dict[str, object]:
    told = found.told
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
        "returns": found.returns,
        "within_first_two": round(found.suggested_share, 3),
        "named_by_itself": round(found.named_share, 3),
        "wrongly": found.wrong,
        "confidence": calibration,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    network = AppearanceModel(OSNET_WEIGHTS)
    changed = (0, *(_CHANGED_ROUNDS - 1) * (1,))
    print(
        json.dumps(
            {
                "settings": asdict(RecognitionSettings()),
                "same clothes": measured(network, (0,), asked.rounds, asked.seed),
                "changed clothes": measured(network, changed, _CHANGED_ROUNDS, asked.seed),
            }
        )
    )


if __name__ == "__main__":
    main()
