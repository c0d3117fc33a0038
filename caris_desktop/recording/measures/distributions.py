"""Distributions of values: summary statistics and quantiles."""

import statistics
from collections.abc import Sequence

import numpy as np

from caris_desktop.domain.value_class import Value


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
