"""Agreement of coders, compared with scikit-learn and krippendorff."""

import argparse
import math
import random
from pathlib import Path

import krippendorff
import numpy as np
import pytest
from sklearn.metrics import cohen_kappa_score, confusion_matrix

from caris_desktop.recording.annotation import agreement_command, annotation_editing
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.annotation.coder_agreement import (
    NOTHING,
    UNMATCHED,
    agreement,
    compare_coders,
    compare_tiers,
    krippendorff_alpha,
    report,
    unit_codes,
)
from tests.recording.told_session import tell

LABELS = ("robot", "away", "floor", "other person")


def coded(**spans: list[tuple[int, int, str]]) -> AnnotationDocument:
    """A tier Gaze of each coder, in a session of a minute."""
    document = AnnotationDocument(duration_ms=60_000)
    for coder, its_spans in spans.items():
        document = annotation_editing.add_tier(document, "Gaze", coder)
        for start_ms, end_ms, value in its_spans:
            document = annotation_editing.add_annotation(document, document.tiers[-1].tier_id, start_ms, end_ms, value)
    return document


@pytest.mark.filterwarnings("ignore:A single label", "ignore:`y1`")
@pytest.mark.parametrize("seed", range(25))
def test_kappa_equals_that_of_scikit_learn(seed: int) -> None:
    rng = random.Random(seed)  # noqa: S311 - a test, not cryptography
    labels = LABELS[: rng.randint(1, 4)]
    first = [rng.choice(labels) for _ in range(rng.randint(1, 400))]
    second = [code if rng.random() < 0.7 else rng.choice(labels) for code in first]
    result = agreement(first, second)
    theirs = cohen_kappa_score(first, second)
    if math.isnan(theirs):
        assert result.kappa is None
    else:
        assert result.kappa == pytest.approx(theirs, abs=1e-12)
    assert result.observed == sum(map(str.__eq__, first, second)) / len(first)
    assert [list(row) for row in result.matrix] == confusion_matrix(first, second, labels=result.labels).tolist()


@pytest.mark.parametrize("seed", range(25))
def test_alpha_equals_that_of_krippendorff(seed: int) -> None:
    rng = random.Random(seed)  # noqa: S311 - a test, not cryptography
    labels = LABELS[: rng.randint(1, 4)]
    first = [rng.choice(labels) for _ in range(rng.randint(2, 400))]
    others = [[code if rng.random() < 0.7 else rng.choice(labels) for code in first] for _ in range(rng.randint(1, 5))]
    codes = [first, *others]
    numbers = np.array([[LABELS.index(code) for code in of_coder] for of_coder in codes], dtype=float)
    if len(np.unique(numbers)) == 1:
        assert krippendorff_alpha(codes) is None
    else:
        theirs = krippendorff.alpha(reliability_data=numbers, level_of_measurement="nominal")
        assert krippendorff_alpha(codes) == pytest.approx(theirs, abs=1e-12)


def random_tier(rng: random.Random) -> list[tuple[int, int, str]]:
    spans, at_ms = [], 0
    while (at_ms := at_ms + rng.randint(0, 3000)) < 57_000:
        end_ms = at_ms + rng.randint(1, 2500)
        spans.append((at_ms, end_ms, rng.choice(LABELS)))
        at_ms = end_ms
    return spans


@pytest.mark.parametrize("seed", range(3))
def test_units_of_time_are_coded_by_what_holds_in_their_middle(seed: int) -> None:
    """Compared with codes looked up at the middle of each unit, and scikit-learn's kappa of them."""
    rng = random.Random(seed)  # noqa: S311 - a test, not cryptography
    document = coded(anna=random_tier(rng), ben=random_tier(rng))
    unit_ms = rng.choice([1, 40, 100, 333])
    codes = []
    for tier in document.tiers:
        tier_codes = []
        for number in range(-(-60_000 // unit_ms)):
            middle_ms = (number + 0.5) * unit_ms
            here = [item.value for item in document.of_tier(tier.tier_id) if item.start_ms <= middle_ms < item.end_ms]
            tier_codes.append(here[0] if here else NOTHING)
        assert unit_codes(document.of_tier(tier.tier_id), 60_000, unit_ms) == tier_codes
        codes.append(tier_codes)
    ((result,),) = (of_coders.pairs for of_coders in compare_coders(document, ("anna", "ben"), unit_ms=unit_ms))
    assert result.per_unit.kappa == pytest.approx(cohen_kappa_score(*codes), abs=1e-12)


def test_annotations_match_within_the_tolerance_or_by_overlap() -> None:
    document = coded(
        anna=[(0, 100, "robot"), (1000, 2000, "away"), (3000, 4000, "robot"), (6000, 7000, "floor"), (9000, 9050, "x")],
        ben=[(80, 190, "robot"), (1100, 2050, "robot"), (3400, 4400, "robot"), (6900, 7900, "floor")],
    )
    ((result,),) = (of_coders.pairs for of_coders in compare_coders(document, ("anna", "ben"), tolerance_ms=100))
    pairs = {
        (one, other): count
        for one, row in zip(result.per_annotation.labels, result.per_annotation.matrix, strict=True)
        for other, count in zip(result.per_annotation.labels, row, strict=True)
        if count
    }
    # (3000, 4000) and (3400, 4400) share 600 of 1400 ms: less than half.
    assert pairs == {
        ("robot", "robot"): 1,
        ("away", "robot"): 1,
        ("robot", UNMATCHED): 1,
        ("floor", UNMATCHED): 1,
        ("x", UNMATCHED): 1,
        (UNMATCHED, "robot"): 1,
        (UNMATCHED, "floor"): 1,
    }
    codes = list(pairs.items())
    first = [pair[0] for pair, count in codes for _ in range(count)]
    second = [pair[1] for pair, count in codes for _ in range(count)]
    assert result.per_annotation.kappa == pytest.approx(cohen_kappa_score(first, second), abs=1e-12)
    assert result.offsets is not None
    assert (result.offsets.matched, result.offsets.start_mean_ms, result.offsets.start_worst_ms) == (2, 90.0, 100)
    assert (result.offsets.end_mean_ms, result.offsets.end_worst_ms) == (70.0, 90)
    ((tolerant,),) = (of_coders.pairs for of_coders in compare_coders(document, ("anna", "ben"), tolerance_ms=400))
    assert tolerant.offsets is not None
    assert tolerant.offsets.matched == 3


def test_the_best_counterpart_is_taken_and_only_once() -> None:
    document = coded(anna=[(0, 1000, "a"), (1000, 2000, "b")], ben=[(0, 600, "a"), (600, 1900, "b")])
    ((result,),) = (of_coders.pairs for of_coders in compare_coders(document, ("anna", "ben"), tolerance_ms=1000))
    assert result.per_annotation.labels == ("a", "b")
    assert result.per_annotation.matrix == ((1, 0), (0, 1))
    assert result.per_annotation.kappa == 1.0


def test_an_undefined_kappa_is_reported() -> None:
    ((nothing,),) = (of_coders.pairs for of_coders in compare_coders(coded(anna=[], ben=[]), ("anna", "ben")))
    assert (nothing.per_annotation.kappa, nothing.per_annotation.observed, nothing.offsets) == (None, None, None)
    assert "not defined" in report(nothing)
    with pytest.raises(AnnotationError, match=r"no annotations by zoe\. Available coders: anna, ben\."):
        compare_coders(coded(anna=[], ben=[]), ("anna", "zoe"))
    with pytest.raises(AnnotationError, match=r"Fewer than two of the coders .anna, ben. have the tier “Talk”"):
        compare_coders(coded(anna=[], ben=[]), ("anna", "ben"), tier="Talk")
    with pytest.raises(AnnotationError, match="cannot be compared"):
        compare_coders(coded(anna=[], ben=[]), ("anna", "ben"), unit_ms=0)


def test_three_coders_are_compared_at_once_and_in_pairs() -> None:
    document = coded(
        anna=[(0, 30_000, "robot")], ben=[(0, 24_000, "robot")], cleo=[(0, 30_000, "away")], dan=[(0, 10, "robot")]
    )
    (result,) = compare_coders(document, ("ben", "anna", "cleo"))
    assert result.coders == ("ben", "anna", "cleo")
    assert [pair.coders for pair in result.pairs] == [("ben", "anna"), ("ben", "cleo"), ("anna", "cleo")]
    codes = np.zeros((3, 600))  # per unit of 100 ms: nothing 0, robot 1, away 2
    codes[0, :240], codes[1, :300], codes[2, :300] = 1, 1, 2
    theirs = krippendorff.alpha(reliability_data=codes, level_of_measurement="nominal")
    assert result.alpha == pytest.approx(theirs, abs=1e-12)
    (everybody,) = compare_coders(document)
    assert everybody.coders == ("anna", "ben", "cleo", "dan")
    assert len(everybody.pairs) == 6
    (unequal,) = compare_coders(annotation_editing.add_tier(document, "Talk", "anna"))
    assert unequal.tier == "Gaze"


def test_a_long_session_is_compared_at_once() -> None:
    """Matching must not compare every pair."""
    document = coded(anna=[], ben=[])
    annotations = tuple(
        Annotation(f"{tier.tier_id}-{number}", tier.tier_id, number * 1000, number * 1000 + 700, LABELS[number % 4])
        for tier in document.tiers
        for number in range(20_000)
    )
    document = AnnotationDocument(document.tiers, (), annotations, 20_000_000)
    result = compare_tiers(document, document.tiers[0].tier_id, document.tiers[1].tier_id)
    assert (result.per_unit.kappa, result.per_annotation.kappa) == (1.0, 1.0)


def test_the_command_prints_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tell(tmp_path / "s", [], lasts_s=60.0)
    document = coded(anna=[(0, 30_000, "robot"), (40_000, 50_000, "away")], ben=[(0, 31_000, "robot")])
    for coder in ("anna", "ben"):
        save_coder(folder, document, coder)
    parser = argparse.ArgumentParser()
    agreement_command.add_arguments(parser)
    assert agreement_command.run(parser.parse_args([str(folder), "anna", "ben", "--tier", "Gaze"])) == 0
    told = capsys.readouterr().out
    first, second = [unit_codes(document.of_tier(tier.tier_id), 60_000, 100) for tier in document.tiers]
    assert f"Cohen's kappa {cohen_kappa_score(first, second):.3f}" in told
    assert "1 matched, 1 only by anna, 0 only by ben" in told
    assert (
        f"Krippendorff's alpha (nominal) per unit of time (100 ms): {krippendorff_alpha([first, second]):.3f}" in told
    )
    assert agreement_command.run(parser.parse_args([str(folder)])) == 0
    assert capsys.readouterr().out == told
    assert "end +1000 ms on average" in told or "end +1000 ms (at most 1000 ms)" in told
    assert agreement_command.run(parser.parse_args([str(folder), "anna", "zoe"])) == 1
    assert "Available coders: anna, ben." in capsys.readouterr().err
    assert agreement_command.run(parser.parse_args([str(tmp_path), "anna", "ben"])) == 1
    assert "is not a session" in capsys.readouterr().err
