"""Distributions of values: summary statistics, quantiles, shares and rates."""

import statistics
from collections.abc import Sequence

import numpy as np

from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.responses import AT_ONCE_S


class SummaryStats(Value):
    """Distribution of values. ``sd`` is the sample standard deviation, None for a single value."""

    n: int
    mean: float
    sd: float | None
    median: float
    smallest: float
    largest: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "SummaryStats | None":
        """None for no values."""
        if not values:
            return None
        return cls(
            n=len(values),
            mean=statistics.fmean(values),
            sd=statistics.stdev(values) if len(values) > 1 else None,
            median=statistics.median(values),
            smallest=min(values),
            largest=max(values),
        )


def quantile(values: Sequence[float], share: float) -> float | None:
    """Quantile; None for no values."""
    return float(np.quantile(values, share)) if values else None


def share_at_once(gaps_s: Sequence[float]) -> float | None:
    """Share of gaps shorter than ``AT_ONCE_S``; None for none."""
    return sum(gap_s < AT_ONCE_S for gap_s in gaps_s) / len(gaps_s) if gaps_s else None


def per_10_min(count: float, seconds: float) -> float | None:
    """Rate per 10 minutes; None for zero time."""
    return count * 600.0 / seconds if seconds > 0.0 else None
