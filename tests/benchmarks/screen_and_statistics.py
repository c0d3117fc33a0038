"""Virtual screen and statistics for benchmarks; imports nothing heavy, so that start-up can be measured."""

import os
import sys

VIRTUAL_SCREEN = "1920x1080x24"


def on_a_screen() -> None:
    """Restart this script on a virtual screen with a window manager if there is no screen."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    command = ["xvfb-run", "-a", "-s", f"-screen 0 {VIRTUAL_SCREEN}", "sh", "-c", 'openbox & exec "$@"', "sh"]
    os.execvp(command[0], [*command, sys.executable, *sys.argv])  # noqa: S606 (our own arguments)


def percentiles(samples: list[float]) -> dict[str, float]:
    """p50, p95, p99, max and count of the samples (any unit)."""
    ordered = sorted(samples)

    def at(fraction: float) -> float:
        return round(ordered[min(len(ordered) - 1, int(fraction * len(ordered)))], 3) if ordered else float("nan")

    return {"p50": at(0.5), "p95": at(0.95), "p99": at(0.99), "max": at(1.0), "samples": len(ordered)}


def above(samples: list[float], floor: list[float]) -> dict[str, float]:
    """Differences between the percentiles of ``samples`` and those of ``floor``."""
    ours, base = percentiles(samples), percentiles(floor)
    return {name: round(ours[name] - base[name], 3) for name in ("p50", "p95", "p99")}
