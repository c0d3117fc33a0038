"""Three speed settings: names, and fractions of the scenario's limits."""

from caris_desktop.domain.translation import QT_TR_NOOP

FRACTIONS = (0.3, 0.6, 1.0)
NAMES = (QT_TR_NOOP("Slow"), QT_TR_NOOP("Normal"), QT_TR_NOOP("Fast"))


def step_at(fraction: float) -> int:
    """Index of the step nearest to a speed setting."""
    return min(range(len(FRACTIONS)), key=lambda index: abs(FRACTIONS[index] - fraction))


def fraction_after(fraction: float, direction: int) -> float:
    """The next step up (1) or down (-1); unchanged at the end."""
    return FRACTIONS[max(0, min(len(FRACTIONS) - 1, step_at(fraction) + direction))]
