"""Fault injection into the running simulated robot, for rehearsal and tests."""

import math
from dataclasses import replace
from typing import Any

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value

MAX_LATENCY_MS = 10_000.0
_AMOUNTS: dict[str, tuple[str, float, float, float]] = {
    # field, least, most, and how many of its units are one of the field's
    "latency": ("latency_s", 0.0, MAX_LATENCY_MS, 1000.0),
    "throttle_kbps": ("rate_kbps", 1.0, 1e9, 1.0),
    "sound_dropouts": ("sound_dropouts", 0.0, 1.0, 1.0),
    "sound_noise": ("sound_noise", 0.0, 1.0, 1.0),
    "voice_leak": ("voice_leak", 0.0, 4.0, 1.0),
    "clock_offset": ("clock_offset_s", -1e9, 1e9, 1.0),
    "clock_drift": ("clock_drift_ppm", -5e5, 1e6, 1.0),
    "slow_services": ("service_s", 0.0, 600.0, 1.0),
}
_SWITCHES = {
    "freeze_camera": "camera_frozen",
    "black_camera": "camera_black",
    "silent_camera": "camera_silent",
    "silent_lidar": "lidar_silent",
    "silent_microphone": "microphone_silent",
    "wrong_frame_ids": "frames_wrong",
}
_EFFECTS: dict[str, dict[str, Any]] = {
    "full_battery": {"battery_fraction": 1.0},
    "empty_battery": {"battery_fraction": 0.05},
    "press_stop_button": {"stop_button": True},
    "release_stop_button": {"stop_button": False},
}

HELP = (
    "latency:<ms>, throttle_kbps:<kbit/s>, drop_link[:<seconds>], freeze_camera, black_camera, silent_camera, "
    "silent_lidar, silent_microphone, sound_dropouts:<share>, sound_noise:<share>, voice_leak:<share>, "
    "wrong_frame_ids, malformed:<count>, clock_offset:<seconds>, clock_drift:<millionths>, "
    "slow_services:<seconds>, full_battery, empty_battery, press_stop_button, release_stop_button, "
    "pose:<x>,<y>,<heading in degrees>, clear"
)


class Faults(Value):
    """Present faults."""

    latency_s: float = 0.0
    camera_frozen: bool = False
    camera_black: bool = False
    camera_silent: bool = False
    lidar_silent: bool = False
    frames_wrong: bool = False
    rate_kbps: float | None = None
    clock_offset_s: float = 0.0
    clock_drift_ppm: float = 0.0
    microphone_silent: bool = False
    sound_dropouts: float = 0.0
    sound_noise: float = 0.001
    voice_leak: float = 0.5
    service_s: float = 0.0


class Injection(Value):
    """Result of one fault command: the new faults, and one-time effects."""

    faults: Faults
    drop_link_s: float | None = None
    battery_fraction: float | None = None
    malformed: int = 0
    stop_button: bool | None = None
    pose_in_map: Pose2D | None = None


def inject(faults: Faults, command: str) -> Injection:
    """Apply ``command``, one of :data:`HELP`.

    Raises ValueError when the command is not one of them; the text names what is allowed.
    """
    name, _, argument = command.strip().partition(":")
    if name in _AMOUNTS:
        key, least, most, units = _AMOUNTS[name]
        changed: dict[str, Any] = {key: _amount(argument, name, most, least=least) / units}
        return Injection(replace(faults, **changed))
    if name == "malformed":
        return Injection(faults, malformed=int(_amount(argument, name, 10_000)))
    if name == "drop_link":
        return Injection(faults, drop_link_s=_amount(argument or "2", name, 600.0))
    if name == "pose":
        return Injection(faults, pose_in_map=_pose(argument))
    if not argument and name in _SWITCHES:
        return Injection(replace(faults, **{_SWITCHES[name]: True}))
    if not argument and name in _EFFECTS:
        return Injection(faults, **_EFFECTS[name])
    if not argument and name == "clear":
        return Injection(Faults())
    raise ValueError(f"unknown fault '{command}'; available: {HELP}")


def malformed_messages(count: int, scan_topic: str) -> list[str | bytes]:
    """``count`` messages that no rosbridge should send: broken JSON and CBOR, wrong types, invalid numbers."""
    publish = f'{{"op":"publish","topic":"{scan_topic}","msg":'
    kinds: tuple[str | bytes, ...] = (
        '{"op":"publish","topic":',
        "[]",
        "null",
        '{"op":42}',
        '{"op":"no_such_operation"}',
        f"{publish}null}}",
        publish + '{"ranges":"far","angle_min":[]}}',
        publish + '{"header":{"stamp":"now","frame_id":7},"angle_min":1e999,"angle_increment":NaN,"ranges":[1,"x"]}}',
        publish
        + '{"angle_min":0,"angle_increment":0,"range_min":0,"range_max":-1,"ranges":['
        + "1e308," * 500
        + "1]}}",
        '{"op":"fragment","id":"f","num":7,"total":3,"data":"x"}',
        '{"op":"service_response","service":"/never/asked","values":5,"result":"yes"}',
        '{"op":"action_result","id":[],"action":null}',
        "[" * 20_000,
        b"\xa2\x62op\x67publish\x65topic",
        b"\xd8\x55\x58\xff\x00",
        b"\xff\xfe\xfd",
        b"",
    )
    return [kinds[index % len(kinds)] for index in range(count)]


def _pose(argument: str) -> Pose2D:
    parts = argument.split(",")
    try:
        x_m, y_m, heading_deg = (float(part) for part in parts)
    except ValueError:
        x_m = y_m = heading_deg = math.nan
    if not all(math.isfinite(value) for value in (x_m, y_m, heading_deg)):
        raise ValueError("pose requires three numbers: pose:<x>,<y>,<heading in degrees>")
    return Pose2D(x_m, y_m, math.radians(heading_deg))


def _amount(argument: str, name: str, most: float, *, least: float = 0.0) -> float:
    try:
        amount = float(argument)
    except ValueError:
        amount = math.nan
    if not least <= amount <= most:
        raise ValueError(f"{name} requires a number between {least:g} and {most:g}")
    return amount
