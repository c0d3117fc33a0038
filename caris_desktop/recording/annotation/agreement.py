"""How far two coders agree: Cohen's kappa, per unit of time and per annotation."""

from collections.abc import Sequence
from dataclasses import dataclass

from caris_desktop.recording.annotation.model import AnnotationDocument

NOTHING = ""  # the code of a unit of time where a coder has no annotation, or an annotation without a value
UNMATCHED = "(unmatched)"  # the code of an annotation that the other coder has no counterpart of


@dataclass(frozen=True, slots=True)
class Agreement:
    """``matrix[i][j]`` counts what the first coder called ``labels[i]`` and the second ``labels[j]``.

    ``kappa`` is None where it is not defined: nothing was coded, or both used one and the same label throughout.
    ``observed`` is the share on which they agree, None where nothing was coded.
    """

    labels: tuple[str, ...]
    matrix: tuple[tuple[int, ...], ...]
    kappa: float | None
    observed: float | None


@dataclass(frozen=True, slots=True)
class BoundaryOffsets:
    """Second coder minus first, over the matched annotations, in milliseconds: of their starts and of their ends."""

    matched: int
    start_mean_ms: float
    start_worst_ms: float
    end_mean_ms: float
    end_worst_ms: float


@dataclass(frozen=True, slots=True)
class TierAgreement:
    """Two coders' tiers of one name compared. ``per_unit`` is by units of ``unit_ms``, ``per_annotation`` by
    annotations whose boundaries lie within ``tolerance_ms`` of one another or that overlap by half.
    """

    tier: str
    coders: tuple[str, str]
    unit_ms: int
    tolerance_ms: int
    per_unit: Agreement
    per_annotation: Agreement
    offsets: BoundaryOffsets | None


def agreement(first: Sequence[str], second: Sequence[str]) -> Agreement:
    """Cohen's kappa of two equally long sequences of codes."""
    raise NotImplementedError


def compare_tiers(
    document: AnnotationDocument,
    first_tier_id: str,
    second_tier_id: str,
    *,
    unit_ms: int = 100,
    tolerance_ms: int = 500,
) -> TierAgreement:
    """Two tiers compared. Raises AnnotationError where one is not there."""
    raise NotImplementedError


def compare_coders(
    document: AnnotationDocument,
    first: str,
    second: str,
    *,
    tier: str = "",
    unit_ms: int = 100,
    tolerance_ms: int = 500,
) -> tuple[TierAgreement, ...]:
    """All tiers that both coders have under one name, or the one named. Raises AnnotationError where there is none."""
    raise NotImplementedError


def report(result: TierAgreement) -> str:
    """The result in words and a table, for people."""
    raise NotImplementedError
