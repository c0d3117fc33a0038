"""Conversion between robot profiles and file data, and validation beyond the schema."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from caris_desktop.domain.control_definitions import ROS_NAME, VALUE, control_problems, mentions_value
from caris_desktop.domain.control_effects import moves_or_releases
from caris_desktop.domain.key_path import KeyPath, Problem, name_of
from caris_desktop.domain.schema_fields import ValueForm, data_of, replaced, value_from
from caris_desktop.domain.schema_validation import problems
from caris_desktop.domain.translation import tr
from caris_desktop.robot.profile_file import ProfileText
from caris_desktop.robot.profile_model import (
    DEFAULT_ADDRESS,
    PROFILE_VERSION,
    ProfileError,
    ProfileFile,
    RobotProfile,
    area_m2,
    check_address,
    interface_names,
)


def profile_from(source: ProfileText, name: str) -> RobotProfile:
    """Profile of a text, with absolute names and an absolute certificate path.

    Raises
    ------
    ProfileError
        Naming for each mistake the line, what is wrong and what is allowed.
    """
    source.raise_to_newest()
    source.refuse(problems(ProfileFile, source.data))
    folder = Path(source.file_name).parent.resolve()
    data, wrong = _with_absolute_names(source.data)
    source.refuse([*wrong, *_meaning_problems(data, folder)])
    profile: RobotProfile = value_from(RobotProfile, {"title": name, **data})
    source.refuse(_speech_that_moves(profile))
    ca_file = profile.security.ca_file
    if ca_file is not None:
        profile = replace(profile, security=replace(profile.security, ca_file=str((folder / ca_file).resolve())))
    return replace(profile, name=name)


def _speech_that_moves(profile: RobotProfile) -> Iterator[Problem]:
    """Problems of speech interfaces that would move the robot: speech is exempt from the emergency stop."""
    # Speech may share an interface with a control that speaks.
    speech, robot = profile.speech, interface_names(replace(profile, controls=()))
    if speech is None:
        return
    uses = {
        ("topic",): (speech.topic, "std_msgs/String"),
        ("stop",): (speech.stop, "std_msgs/Empty"),
        ("action",): (speech.action.name, speech.action.type) if speech.action is not None else (None, ""),
        ("service",): (speech.service.name, speech.service.type) if speech.service is not None else (None, ""),
        ("service", "stop"): (speech.service.stop if speech.service is not None else None, "std_srvs/Trigger"),
    }
    for path, (name, type_name) in uses.items():
        if name is not None and moves_or_releases(name, type_name, robot):
            template = tr("{key}: {name} moves the robot or releases its emergency stop, which speech must not do.")
            yield ("speech", *path), template.format(key=name_of(("speech", *path)), name=name)


def profile_data(profile: RobotProfile, folder: Path) -> dict[str, Any]:
    """File content of this profile for ``folder``, in writing order, without defaults.

    Raises
    ------
    ProfileError
        Where a certificate file is not in ``folder``.
    """
    security, folder = profile.security, folder.resolve()
    if security.ca_file is not None:
        ca_file = Path(security.ca_file)
        if not ca_file.is_relative_to(folder):
            raise ProfileError(
                tr(
                    "Copy the certificate file {ca_file} into {folder} first: the profile refers to it in that folder."
                ).format(ca_file=ca_file, folder=folder)
            )
        security = replace(security, ca_file=ca_file.relative_to(folder).as_posix())
    data: dict[str, Any] = data_of(RobotProfile, replace(profile, security=security))
    return {"version": PROFILE_VERSION} | data


def _with_absolute_names(data: Mapping[str, Any]) -> tuple[dict[str, Any], list[Problem]]:
    """Data with absolute ROS names and one footprint, and names that ROS 2 refuses."""
    wrong: list[Problem] = []
    namespace = data.get("namespace", "").strip("/")
    prefix = f"/{namespace}/" if namespace else "/"

    def absolute(form: ValueForm, value: Any, path: KeyPath) -> Any:
        if form.rule.noun != ROS_NAME:
            return value
        name = value if value.startswith("/") else prefix + value
        if data["ros"] == 2 and (re.search(r"/[0-9]", name) or "__" in name):
            template = tr(
                "{key}: {name} is not a valid ROS 2 name: no part may start with a digit or contain two _ in a row."
            )
            wrong.append((path, template.format(key=name_of(path), name=repr(value))))
        return name

    given = dict(data)
    if "head" in given:
        given["head"] = {"joint_states": "joint_states", **given["head"]}
    if "footprint_radius_m" in given:
        given["footprint"] = {"radius_m": given.pop("footprint_radius_m")}
    return replaced(ProfileFile, given, absolute), wrong


def _meaning_problems(data: Mapping[str, Any], folder: Path) -> Iterator[Problem]:
    """Problems that involve several groups of keys."""
    try:
        check_address(data.get("address", DEFAULT_ADDRESS))
    except ProfileError as error:
        yield ("address",), str(error)
    if "ca_file" in data.get("security", {}):
        yield from _certificate_problems(data["security"]["ca_file"], folder)
    mistake = polygon_mistake(tuple((x, y) for x, y in data.get("footprint", {}).get("polygon_m", ())))
    if mistake:
        yield ("footprint", "polygon_m"), tr("'footprint.polygon_m': {mistake}").format(mistake=mistake)
    seen: set[str] = set()
    for index, camera in enumerate(data.get("cameras", ())):
        if camera["name"] in seen:
            yield ("cameras", index, "name"), tr("duplicate camera name {name}.").format(name=repr(camera["name"]))
        seen.add(camera["name"])
        path: KeyPath = ("cameras", index, "model", "on_head")
        if camera.get("model", {}).get("on_head") and "head" not in data:
            yield (
                path,
                tr("{key}: a camera on the head also requires 'head' in the profile.").format(key=name_of(path)),
            )
    if "navigation" in data:
        yield from _navigation_problems(data["navigation"], data["ros"])
    speech = data.get("speech", {})
    for kind, keys in (("action", ("goal",)), ("service", ("request",)), ("web", ("body", "url"))):
        if kind in speech and not any(mentions_value(speech[kind].get(key)) for key in keys):
            key = next(each for each in keys if each in speech[kind])
            yield (
                ("speech", kind, key),
                tr("'speech.{kind}.{key}' does not contain {value}, the text to say.").format(
                    kind=kind, key=key, value=VALUE
                ),
            )
    head = data.get("head", {})
    for key in ("pan_range_rad", "tilt_range_rad"):
        lowest, highest = head.get(key, (0, 1))
        if not lowest < highest:
            yield (
                ("head", key),
                tr("'head.{key}' is [{lowest}, {highest}]; the lower number must come first.").format(
                    key=key, lowest=lowest, highest=highest
                ),
            )
    if head and head["pan_joint"] == head["tilt_joint"]:
        yield ("head", "tilt_joint"), tr("'head.tilt_joint' is also the pan joint; use two different joints.")
    for index, problem in control_problems(data.get("controls", ()), lambda: data["velocity"]["topic"]):
        yield ("controls", index), problem


def _certificate_problems(given: str, folder: Path) -> Iterator[Problem]:
    ca_file, path = (folder / given).resolve(), ("security", "ca_file")
    if Path(given).is_absolute() or not ca_file.is_relative_to(folder):
        yield path, tr("'security.ca_file': the certificate file must be in the folder of the profile.")
    elif not ca_file.is_file():
        yield path, tr("'security.ca_file': the file {ca_file} does not exist.").format(ca_file=ca_file)


def _navigation_problems(navigation: Mapping[str, Any], ros: int) -> Iterator[Problem]:
    kind = "move_base" if ros == 1 else "navigate_to_pose"
    if navigation["kind"] != kind:
        yield (
            ("navigation", "kind"),
            tr("'navigation.kind' is {found}; with ros: {ros} it must be {kind}.").format(
                found=repr(navigation["kind"]), ros=ros, kind=repr(kind)
            ),
        )
    if "speed_limit" in navigation:
        path: KeyPath = ("navigation", "speed_limit")
        if ("reconfigure" if ros == 1 else "topic") not in navigation["speed_limit"]:
            missing = tr("{key}: with ros: 1, reconfigure is required.") if ros == 1 else ""
            missing = missing or tr("{key}: with ros: 2, a topic is required.")
            yield path, missing.format(key=name_of(path))
        elif ros == 1 and "max_mps" not in navigation:
            # Otherwise a higher limit of the wizard would exceed the manufacturer's.
            yield (
                path,
                tr("{key} also requires max_mps: the speed that the navigation is configured for.").format(
                    key=name_of(path)
                ),
            )


def polygon_mistake(corners: tuple[tuple[float, float], ...]) -> str:
    """Problem of a footprint; empty for a simple polygon around the robot's centre, or none."""
    if not corners:
        return ""
    if len(set(corners)) != len(corners):
        return tr("duplicate corner; the outline closes automatically.")
    sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for first, (a, b) in enumerate(sides):
        for second in range(first + 1, len(sides)):
            c, d = sides[second]
            if second - first not in (1, len(sides) - 1) and _cross(a, b, c, d):
                return tr("two sides of the outline cross; list the corners in their order around the robot.")
    if abs(area_m2(corners)) < 1e-6:
        return tr("the corners lie on one line.")
    turns = sum(math.atan2(ax * by - ay * bx, ax * bx + ay * by) for (ax, ay), (bx, by) in sides)
    if abs(turns) < math.pi:
        return tr("the outline must enclose the robot's centre [0, 0], around which the robot turns.")
    return ""


def _cross(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]) -> bool:
    """True if the two segments intersect."""

    def side(p: tuple[float, float], q: tuple[float, float], r: tuple[float, float]) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) <= 0.0 and side(c, d, a) * side(c, d, b) <= 0.0
