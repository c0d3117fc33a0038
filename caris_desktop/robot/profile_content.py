"""Between a robot profile and what its file says: building the one from the other, both ways."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.controls import (
    VALUE,
    RobotControl,
    control_data,
    control_from_data,
    control_problems,
    mentions_value,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.yaml_source import KeyPath
from caris_desktop.robot.profile_file import PROFILE_VERSION, ProfileText
from caris_desktop.robot.profile_model import (
    DEFAULT_ADDRESS,
    CameraTopic,
    EmergencyStopInterface,
    GuardSettings,
    HeadInterface,
    MapServices,
    MotionLimits,
    NavigationServer,
    ProfileError,
    RobotProfile,
    SecuritySettings,
    SpeechAction,
    SpeechInterface,
    SpeedLimitInterface,
    TopicSource,
    TransformFrames,
    VelocityTopic,
    check_address,
)

_SOURCES = ("scan", "odometry", "pose", "tf", "tf_static", "map", "map_updates", "path", "battery")
_ALWAYS_LATCHED = ("map", "tf_static")
_AT_ORIGIN = Pose2D(0.0, 0.0, 0.0)
_FOV_DEG = (5.0, 170.0)  # what the schema accepts


def profile_from(source: ProfileText, name: str) -> RobotProfile:
    """The profile that a checked text describes. Raises ProfileError where its parts do not fit together."""
    return _Builder(source).profile(name)


def profile_data(profile: RobotProfile, folder: Path) -> dict[str, Any]:
    """What a file in ``folder`` says of this profile, in the order in which it is written, without defaults.

    Raises
    ------
    ProfileError
        Where a certificate file is not in ``folder``.
    """
    data: dict[str, Any] = {
        "version": PROFILE_VERSION,
        "title": profile.title,
        "ros": profile.ros,
        "address": profile.address,
    }
    security = _given(profile.security, SecuritySettings())
    if profile.security.ca_file is not None:
        ca_file = Path(profile.security.ca_file)
        if not ca_file.is_relative_to(folder.resolve()):
            raise ProfileError(
                f"Copy the certificate file {ca_file} into {folder} first: a profile names it from there."
            )
        security["ca_file"] = ca_file.relative_to(folder.resolve()).as_posix()
    sections: dict[str, Any] = {
        "security": security,
        "simulation_time": profile.simulation_time,
        "velocity": {"topic": profile.velocity.topic} | _given(profile.velocity, VelocityTopic()),
        "command_rate_hz": profile.command_rate_hz,
        "limits": asdict(profile.limits),
        "guard": _given(profile.guard, GuardSettings()),
        "footprint": (
            {"polygon_m": [list(corner) for corner in profile.footprint_m]}
            if profile.footprint_m
            else {"radius_m": profile.footprint_radius_m}
        ),
        **{key: _source_data(key, getattr(profile, key)) for key in _SOURCES},
        "frames": _given(profile.frames, TransformFrames()),
        "cameras": [_camera_data(camera) for camera in profile.cameras],
        "navigation": profile.navigation and _navigation_data(profile.navigation),
        "initial_pose": profile.initial_pose,
        "maps": profile.maps and _given(profile.maps, MapServices()),
        "speech": profile.speech and {**_given(profile.speech, SpeechInterface()), **_speech_action(profile.speech)},
        "emergency_stop": profile.emergency_stop and _given(profile.emergency_stop, EmergencyStopInterface()),
        "head": profile.head and _head_data(profile.head),
        "controls": [control_data(control) for control in profile.controls],
    }
    if profile.robot_from_laser != _AT_ORIGIN:
        laser = profile.robot_from_laser
        sections["laser"] = {
            "robot_from_laser": {"x_m": laser.x_m, "y_m": laser.y_m} | _angle("heading", laser.heading_rad)
        }
    return data | {key: value for key, value in sections.items() if value not in (None, {}, [], False)}


def _navigation_data(server: NavigationServer) -> dict[str, Any]:
    data: dict[str, Any] = {"kind": server.kind, "name": server.name}
    if server.max_mps is not None:
        data["max_mps"] = server.max_mps
    told_by = server.speed_limit
    if told_by is not None and told_by.topic is not None:
        data["speed_limit"] = {"topic": told_by.topic}
    elif told_by is not None:
        data["speed_limit"] = {"reconfigure": told_by.reconfigure, "parameters": list(told_by.parameters)}
    return data


class _Builder:
    """Makes a profile of data that the schema has accepted, and checks what the schema cannot say."""

    def __init__(self, source: ProfileText) -> None:
        self._source = source
        self._data = source.data
        namespace = source.data.get("namespace", "").strip("/")
        self._prefix = f"/{namespace}/" if namespace else "/"
        self._digits_are_refused = source.data["ros"] == 2

    def profile(self, name: str) -> RobotProfile:
        data = self._data
        footprint_m, radius_m = self._footprint()
        return RobotProfile(
            name=name,
            title=data.get("title", name),
            ros=data["ros"],
            address=self._address(),
            security=self._security(),
            simulation_time=data.get("simulation_time", False),
            velocity=self._velocity(),
            command_rate_hz=float(data.get("command_rate_hz", 20.0)),
            limits=MotionLimits(**_floats(data.get("limits", {}))),
            guard=GuardSettings(**_floats(data.get("guard", {}))),
            **{key: self._topic_source(key) for key in _SOURCES},
            frames=TransformFrames(**{key: frame.lstrip("/") for key, frame in data.get("frames", {}).items()}),
            cameras=self._cameras(),
            navigation=self._navigation(),
            initial_pose=self._name_at(("initial_pose",)),
            maps=self._maps(),
            speech=self._speech(),
            emergency_stop=self._emergency_stop(),
            head=self._head(),
            controls=self._controls(),
            robot_from_laser=self._laser(),
            footprint_radius_m=radius_m,
            footprint_m=footprint_m,
        )

    def _velocity(self) -> VelocityTopic:
        given = dict(self._data["velocity"])
        given["topic"] = self._name(given["topic"], ("velocity", "topic"))
        if "timeout_s" in given:
            given["timeout_s"] = float(given["timeout_s"])
            if "timeout_source" not in given:
                raise self._source.mistake(
                    ("velocity", "timeout_s"), "say beside it in timeout_source where that is documented."
                )
        elif "timeout_source" in given:
            raise self._source.mistake(("velocity", "timeout_source"), "belongs to timeout_s, which is not there.")
        return VelocityTopic(**given)

    def _name(self, name: str, path: KeyPath) -> str:
        """The absolute name: one that does not begin with a slash lies in the namespace."""
        absolute = name if name.startswith("/") else self._prefix + name
        if self._digits_are_refused and (re.search(r"/[0-9]", absolute) or "__" in absolute):
            raise self._source.mistake(
                path, f"{name!r} is no name in ROS 2, where no part begins with a digit or holds two _ in a row."
            )
        return absolute

    def _name_at(self, path: KeyPath) -> str | None:
        found: Any = self._data
        for step in path:
            found = found.get(step) if isinstance(found, Mapping) else found[step]
            if found is None:
                return None
        return self._name(found, path)

    def _names(self, section: str, keys: Iterable[str]) -> dict[str, str | None]:
        return {key: self._name_at((section, key)) for key in keys}

    def _address(self) -> str:
        try:
            return check_address(self._data.get("address", DEFAULT_ADDRESS))
        except ProfileError as error:
            raise self._source.mistake(("address",), str(error)) from error

    def _security(self) -> SecuritySettings:
        security = self._data.get("security", {})
        given = security.get("ca_file")
        if given is None:
            return SecuritySettings(rosauth_secret_env=security.get("rosauth_secret_env"))
        folder = Path(self._source.file_name).parent.resolve()
        ca_file = (folder / given).resolve()
        if Path(given).is_absolute() or not ca_file.is_relative_to(folder):
            raise self._source.mistake(
                ("security", "ca_file"), "the certificates must lie in the folder of the profile."
            )
        if not ca_file.is_file():
            raise self._source.mistake(("security", "ca_file"), f"there is no file {ca_file}.")
        return SecuritySettings(str(ca_file), security.get("rosauth_secret_env"))

    def _topic_source(self, key: str) -> TopicSource | None:
        data = self._data.get(key)
        if data is None:
            return None
        latched = data.get("latched", key in _ALWAYS_LATCHED)
        return TopicSource(self._name(data["topic"], (key, "topic")), data.get("throttle_ms", 0), latched)

    def _footprint(self) -> tuple[tuple[tuple[float, float], ...], float]:
        data = self._data
        if "footprint" in data and "footprint_radius_m" in data:
            raise self._source.mistake(("footprint_radius_m",), "is not needed beside footprint; keep one of the two.")
        footprint = data.get("footprint", {"radius_m": data.get("footprint_radius_m", 0.25)})
        if "radius_m" in footprint:
            return (), float(footprint["radius_m"])
        corners = [(float(x), float(y)) for x, y in footprint["polygon_m"]]
        wrong = polygon_mistake(corners)
        if wrong:
            raise self._source.mistake(("footprint", "polygon_m"), wrong)
        if _area(corners) < 0.0:
            corners.reverse()
        return tuple(corners), max(math.hypot(x, y) for x, y in corners)

    def _cameras(self) -> tuple[CameraTopic, ...]:
        cameras: list[CameraTopic] = []
        for index, camera in enumerate(self._data.get("cameras", ())):
            path: KeyPath = ("cameras", index)
            if any(camera["name"] == other.name for other in cameras):
                raise self._source.mistake((*path, "name"), f"two cameras are named {camera['name']!r}.")
            cameras.append(
                CameraTopic(
                    camera["name"],
                    self._name(camera["topic"], (*path, "topic")),
                    camera.get("throttle_ms", 60),
                    self._camera_model(camera["model"], (*path, "model")) if "model" in camera else None,
                    self._name(camera["info"], (*path, "info")) if "info" in camera else None,
                    camera.get("type", "CompressedImage"),
                )
            )
        return tuple(cameras)

    def _camera_model(self, data: Mapping[str, Any], path: KeyPath) -> CameraModel:
        width_px, height_px = data["width_px"], data["height_px"]
        if "horizontal_fov_deg" in data:
            model = CameraModel.from_field_of_view(
                width_px=width_px, height_px=height_px, horizontal_rad=math.radians(data["horizontal_fov_deg"])
            )
            for key in ("fy_px", "cx_px", "cy_px"):
                if key in data:
                    raise self._source.mistake((*path, key), "belongs to fx_px, not to horizontal_fov_deg.")
        else:
            fx_px = float(data["fx_px"])
            model = CameraModel(
                width_px,
                height_px,
                fx_px,
                float(data.get("fy_px", fx_px)),
                float(data.get("cx_px", width_px / 2.0)),
                float(data.get("cy_px", height_px / 2.0)),
            )
        on_head = data.get("on_head", False)
        if on_head and "head" not in self._data:
            raise self._source.mistake((*path, "on_head"), "the profile names no head that the camera could turn with.")
        return replace(
            model,
            x_m=float(data.get("x_m", 0.0)),
            y_m=float(data.get("y_m", 0.0)),
            z_m=float(data.get("z_m", 1.0)),
            heading_rad=self._angle(data, "heading", path),
            tilt_rad=self._angle(data, "tilt", path),
            on_head=on_head,
        )

    def _angle(self, data: Mapping[str, Any], what: str, path: KeyPath) -> float:
        degrees, radians = data.get(f"{what}_deg"), data.get(f"{what}_rad")
        if degrees is not None and radians is not None:
            raise self._source.mistake((*path, f"{what}_rad"), f"is not needed beside {what}_deg; keep one of the two.")
        return math.radians(degrees) if degrees is not None else float(radians or 0.0)

    def _navigation(self) -> NavigationServer | None:
        data = self._data.get("navigation")
        if data is None:
            return None
        wanted = "move_base" if self._data["ros"] == 1 else "navigate_to_pose"
        if data["kind"] != wanted:
            raise self._source.mistake(
                ("navigation", "kind"), f"is {data['kind']!r}; with ros: {self._data['ros']} it is {wanted!r}."
            )
        name = self._name(data["name"], ("navigation", "name"))
        max_mps = None if data.get("max_mps") is None else float(data["max_mps"])
        return NavigationServer(data["kind"], name, max_mps, self._speed_limit(max_mps))

    def _speed_limit(self, max_mps: float | None) -> SpeedLimitInterface | None:
        path: KeyPath = ("navigation", "speed_limit")
        data = self._data["navigation"].get("speed_limit")
        if data is None:
            return None
        ros1 = self._data["ros"] == 1
        if ("reconfigure" in data) != ros1:
            raise self._source.mistake(
                path, f"with ros: {self._data['ros']} it names {'reconfigure' if ros1 else 'a topic'}."
            )
        if not ros1:
            return SpeedLimitInterface(topic=self._name(data["topic"], (*path, "topic")))
        if max_mps is None:
            # Or a limit of the wizard's above it would make the robot faster than its makers meant.
            raise self._source.mistake(path, "needs max_mps beside it: how fast the navigation is set up to drive.")
        default = SpeedLimitInterface()
        return SpeedLimitInterface(
            reconfigure=self._name(data["reconfigure"], (*path, "reconfigure")),
            parameters=tuple(data.get("parameters", default.parameters)),
        )

    def _maps(self) -> MapServices | None:
        data = self._data.get("maps")
        if data is None:
            return None
        names = self._names("maps", ("slam_toolbox", "map_server", "map_saver"))
        return MapServices(**names, folder=data.get("folder", ""))

    def _speech(self) -> SpeechInterface | None:
        data = self._data.get("speech")
        if data is None:
            return None
        action = None
        if "action" in data:
            for key in ("speaking", "stop"):
                if key in data:
                    raise self._source.mistake(("speech", key), "belongs to a topic; an action tells and stops itself.")
            goal = data["action"]["goal"]
            if not mentions_value(goal):
                raise self._source.mistake(("speech", "action", "goal"), f"nowhere holds {VALUE}, the text to say.")
            name = self._name(data["action"]["name"], ("speech", "action", "name"))
            action = SpeechAction(name, data["action"]["type"], goal)
        return SpeechInterface(**self._names("speech", ("topic", "speaking", "stop")), action=action)

    def _emergency_stop(self) -> EmergencyStopInterface | None:
        data = self._data.get("emergency_stop")
        if data is None:
            return None
        ways = [key for key in ("service", "set_service", "command_topic") if key in data]
        if len(ways) > 1:
            raise self._source.mistake(
                ("emergency_stop", ways[1]), f"the robot is stopped in one way; keep either {' or '.join(ways)}."
            )
        for key, other in (("set_service", "clear_service"), ("clear_service", "set_service")):
            if key in data and other not in data:
                raise self._source.mistake(
                    ("emergency_stop", key), f"needs {other} beside it, or it is never released."
                )
        for key, owner in (
            ("service_field", "service"),
            ("service_stop_value", "service"),
            ("service_type", "set_service"),
            ("inverted", "topic"),
        ):
            if key in data and owner not in data:
                raise self._source.mistake(("emergency_stop", key), f"belongs to {owner}, which is not there.")
        if not ways and "topic" not in data:
            raise self._source.mistake(
                ("emergency_stop",), "name a topic, a service, set_service with clear_service, or a command_topic."
            )
        keys = ("topic", "service", "set_service", "clear_service", "command_topic")
        return EmergencyStopInterface(
            **self._names("emergency_stop", keys),
            inverted=data.get("inverted", False),
            service_field=data.get("service_field", "data"),
            service_stop_value=data.get("service_stop_value", True),
            service_type=data.get("service_type", "std_srvs/Trigger").replace("/srv/", "/"),
        )

    def _head(self) -> HeadInterface | None:
        data = self._data.get("head")
        if data is None:
            return None
        given = dict(data)
        for key in ("pan_range_rad", "tilt_range_rad"):
            if key in given:
                lowest, highest = given[key]
                if not lowest < highest:
                    raise self._source.mistake(
                        ("head", key), f"is [{lowest}, {highest}]; the lower number comes first."
                    )
                given[key] = (float(lowest), float(highest))
        if "speed_radps" in given:
            given["speed_radps"] = float(given["speed_radps"])
        if given["pan_joint"] == given["tilt_joint"]:
            raise self._source.mistake(("head", "tilt_joint"), "is the pan joint too; they are two joints.")
        given["topic"] = self._name(given["topic"], ("head", "topic"))
        given["joint_states"] = self._name(given.get("joint_states", "joint_states"), ("head", "joint_states"))
        return HeadInterface(**given)

    def _controls(self) -> tuple[RobotControl, ...]:
        controls = [
            self._with_absolute_names(control, ("controls", index))
            for index, control in enumerate(self._data.get("controls", []))
        ]
        for index, problem in control_problems(controls, lambda: self._name_at(("velocity", "topic"))):
            raise self._source.mistake(("controls", index), problem)
        return tuple(control_from_data(control) for control in controls)

    def _with_absolute_names(self, control: Mapping[str, Any], path: KeyPath) -> dict[str, Any]:
        absolute = dict(control)
        for part, key in (("publish", "topic"), ("call", "service"), ("action", "name"), ("shows", "topic")):
            if part in control:
                absolute[part] = {**control[part], key: self._name(control[part][key], (*path, part, key))}
        return absolute

    def _laser(self) -> Pose2D:
        laser = self._data.get("laser", {}).get("robot_from_laser", {})
        heading_rad = self._angle(laser, "heading", ("laser", "robot_from_laser"))
        return Pose2D(float(laser.get("x_m", 0.0)), float(laser.get("y_m", 0.0)), heading_rad)


def polygon_mistake(corners: Sequence[tuple[float, float]]) -> str:
    """What is wrong with a footprint; empty when it is a simple polygon with the robot's centre inside."""
    if len(set(corners)) != len(corners):
        return "the same corner is listed twice; the outline closes by itself."
    sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for first, (a, b) in enumerate(sides):
        for second in range(first + 1, len(sides)):
            c, d = sides[second]
            if second - first not in (1, len(sides) - 1) and _cross(a, b, c, d):
                return "two sides of the outline cross; list the corners in their order around the robot."
    if abs(_area(corners)) < 1e-6:
        return "the corners lie on one line."
    turns = sum(math.atan2(ax * by - ay * bx, ax * bx + ay * by) for (ax, ay), (bx, by) in sides)
    if abs(turns) < math.pi:
        return "the outline must lie around the robot's centre [0, 0], around which it turns."
    return ""


def _area(corners: Sequence[tuple[float, float]]) -> float:
    """Positive when the corners go counter-clockwise."""
    following = [*corners[1:], corners[0]]
    return sum(ax * by - ay * bx for (ax, ay), (bx, by) in zip(corners, following, strict=True)) / 2.0


def _cross(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]) -> bool:
    """Whether the two segments meet."""

    def side(p: tuple[float, float], q: tuple[float, float], r: tuple[float, float]) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) <= 0.0 and side(c, d, a) * side(c, d, b) <= 0.0


def _floats(data: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value if isinstance(value, bool) else float(value) for key, value in data.items()}


def _given(value: Any, default: Any) -> dict[str, Any]:
    """The fields of a dataclass that differ from ``default``."""
    pairs = ((each.name, getattr(value, each.name), getattr(default, each.name)) for each in fields(value))
    return {name: found for name, found, usual in pairs if found != usual and not is_dataclass(found)}


def _source_data(key: str, source: TopicSource | None) -> dict[str, Any] | None:
    if source is None:
        return None
    data: dict[str, Any] = {"topic": source.topic}
    if source.throttle_ms:
        data["throttle_ms"] = source.throttle_ms
    if source.latched != (key in _ALWAYS_LATCHED):
        data["latched"] = source.latched
    return data


def _camera_data(camera: CameraTopic) -> dict[str, Any]:
    data: dict[str, Any] = {"name": camera.name, "topic": camera.topic, "throttle_ms": camera.throttle_ms}
    if camera.type != "CompressedImage":
        data["type"] = camera.type
    if camera.info is not None:
        data["info"] = camera.info
    if camera.model is not None:
        data["model"] = _model_data(camera.model)
    return data


def _model_data(model: CameraModel) -> dict[str, Any]:
    data: dict[str, Any] = {"width_px": model.width_px, "height_px": model.height_px}
    horizontal_deg = _degrees(2.0 * math.atan2(model.width_px / 2.0, model.fx_px))
    from_angle = None
    if horizontal_deg is not None and _FOV_DEG[0] <= horizontal_deg <= _FOV_DEG[1]:
        from_angle = CameraModel.from_field_of_view(
            width_px=model.width_px, height_px=model.height_px, horizontal_rad=math.radians(horizontal_deg)
        )
    lens = ("fx_px", "fy_px", "cx_px", "cy_px")
    if from_angle is not None and all(getattr(model, key) == getattr(from_angle, key) for key in lens):
        data["horizontal_fov_deg"] = horizontal_deg
    else:
        data |= {key: getattr(model, key) for key in lens}
    data |= {"x_m": model.x_m, "y_m": model.y_m, "z_m": model.z_m}
    data |= _angle("heading", model.heading_rad) | _angle("tilt", model.tilt_rad)
    return data | ({"on_head": True} if model.on_head else {})


def _angle(what: str, angle_rad: float) -> dict[str, float]:
    """An angle in degrees where that says it exactly."""
    degrees = _degrees(angle_rad)
    return (
        {f"{what}_rad": angle_rad}
        if degrees is None or math.radians(degrees) != angle_rad
        else {f"{what}_deg": degrees}
    )


def _degrees(angle_rad: float) -> float | None:
    """The shortest number of degrees that is nearly this angle."""
    exact = math.degrees(angle_rad)
    rounded = (round(exact, digits) for digits in range(16))
    return next((degrees for degrees in rounded if math.isclose(math.radians(degrees), angle_rad, rel_tol=1e-15)), None)


def _speech_action(speech: SpeechInterface) -> dict[str, Any]:
    if speech.action is None:
        return {}
    return {"action": {"name": speech.action.name, "type": speech.action.type, "goal": dict(speech.action.goal)}}


def _head_data(head: HeadInterface) -> dict[str, Any]:
    data = {each.name: getattr(head, each.name) for each in fields(head)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in data.items()}
