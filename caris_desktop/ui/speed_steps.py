"""The three speed settings by name."""

from caris_desktop.live.services.drive import SPEED_STEPS

NAMES = ("Slow", "Normal", "Fast")


def step_at(fraction: float) -> int:
    """Index of the step nearest to a speed setting."""
    return min(range(len(SPEED_STEPS)), key=lambda index: abs(SPEED_STEPS[index] - fraction))


def fraction_after(fraction: float, direction: int) -> float:
    """The next step up (1) or down (-1); the same at the end."""
    return SPEED_STEPS[max(0, min(len(SPEED_STEPS) - 1, step_at(fraction) + direction))]
