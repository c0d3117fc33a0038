"""Faults that can be injected while the simulated robot runs, for rehearsal and tests."""

from dataclasses import dataclass, replace

MAX_LATENCY_MS = 10_000.0
MAX_DROP_S = 600.0

HELP = (
    "latency:<ms>, drop_link[:<seconds>], freeze_camera, black_camera, silent_camera, silent_lidar, full_battery, "
    "empty_battery, clear"
)


@dataclass(frozen=True, slots=True)
class Faults:
    """What is broken at the moment."""

    latency_s: float = 0.0
    camera_frozen: bool = False
    camera_black: bool = False
    camera_silent: bool = False
    lidar_silent: bool = False


@dataclass(frozen=True, slots=True)
class Injection:
    """The outcome of one fault command: the faults from now on, and what is to be done once."""

    faults: Faults
    drop_link_s: float | None = None
    battery_fraction: float | None = None


def inject(faults: Faults, command: str) -> Injection:
    """The faults after ``command``, one of :data:`HELP`.

    Raises
    ------
    ValueError
        When the command is not one of them; the text names what is allowed.
    """
    name, _, argument = command.strip().partition(":")
    switches = {
        "freeze_camera": replace(faults, camera_frozen=True),
        "black_camera": replace(faults, camera_black=True),
        "silent_camera": replace(faults, camera_silent=True),
        "silent_lidar": replace(faults, lidar_silent=True),
        "clear": Faults(),
    }
    if name in switches and not argument:
        return Injection(switches[name])
    if name == "latency":
        latency_ms = _amount(argument, "latency", MAX_LATENCY_MS)
        return Injection(replace(faults, latency_s=latency_ms / 1000.0))
    if name == "drop_link":
        return Injection(faults, drop_link_s=_amount(argument or "2", "drop_link", MAX_DROP_S))
    if name in ("full_battery", "empty_battery") and not argument:
        return Injection(faults, battery_fraction=1.0 if name == "full_battery" else 0.05)
    raise ValueError(f"'{command}' is no fault; known are {HELP}")


def _amount(argument: str, name: str, most: float) -> float:
    try:
        amount = float(argument)
    except ValueError:
        amount = -1.0
    if not 0.0 <= amount <= most:
        raise ValueError(f"{name} needs a number between 0 and {most:g}")
    return amount
