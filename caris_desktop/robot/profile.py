"""Robot profiles: finding, listing, loading, validating and saving. Plain YAML, never code."""

import math
import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import platformdirs

from caris_desktop.domain.address import plugin_address, without_credentials
from caris_desktop.domain.control_definitions import ROS_NAME, VALUE, control_problems, mentions_value
from caris_desktop.domain.control_effects import moves_or_releases
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import read_bounded
from caris_desktop.domain.free_names import usable_stem
from caris_desktop.domain.schema_fields import KeyPath, Problem, ValueForm, data_of, name_of, replaced, value_from
from caris_desktop.domain.schema_validation import Migration, did_you_mean, migrated, problem_lines, problems
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import YamlSourceError, dumped, parse_yaml
from caris_desktop.robot.profile_model import (
    DEFAULT_ADDRESS,
    PROFILE_VERSION,
    ProfileError,
    ProfileFile,
    RobotProfile,
    RosVersion,
    area_m2,
    check_address,
    interface_names,
)

_NAME = r"[A-Za-z0-9_-]+"
_MAX_FILE_BYTES = 1_000_000


class ListedProfile(Value):
    """One line of the robot list. ``address`` is without credentials. ``error`` says why the file cannot be used;
    ``title`` is then the file's name.
    """

    name: str
    title: str
    address: str
    path: Path = Path()
    shipped: bool = False
    error: str = ""


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles shipped with the program."""
    return tuple(sorted(path.stem for path in _robots_dir().glob("*.yaml")))


def user_robots_dir() -> Path:
    """Folder of the user's own profiles; may not exist."""
    return Path(platformdirs.user_config_dir("caris-desktop", appauthor=False)) / "robots"


def list_profiles(user_dir: Path | None = None) -> tuple[ListedProfile, ...]:
    """User's own profiles, then the shipped ones. An own profile hides a shipped one of the same name.

    The first call takes 0.2 s, later ones 1 ms for unchanged files.
    """
    user_profiles = [_listed(path, shipped=False) for path in _own_files(user_dir or user_robots_dir())]
    names = {profile.name for profile in user_profiles}
    shipped = [_listed(_robots_dir() / f"{name}.yaml", shipped=True) for name in shipped_profiles()]
    return (*user_profiles, *(profile for profile in shipped if profile.name not in names))


def load_profile(name_or_path_or_url: str, *, user_dir: Path | None = None) -> RobotProfile:
    """Load a robot profile.

    By the name of an own or shipped profile (``simulated``), a YAML file, or an address ``ws://HOST:PORT``, which means
    a robot with the usual ROS names. An address without ``?ros=1`` or ``?ros=2`` leaves the ROS version open: see
    :func:`leaves_ros_open`; ``discovery.detect_dialect`` asks the robot, and until then it is ROS 1.

    Raises
    ------
    ProfileError
        If there is no such profile or it has a mistake in it.
    """
    path = profile_file(name_or_path_or_url, user_dir=user_dir)
    return _profile_at_address(name_or_path_or_url.strip()) if path is None else read_profile(path)


def profile_file(name_or_path_or_url: str, *, user_dir: Path | None = None) -> Path | None:
    """File that :func:`load_profile` reads for this robot; None for an address. Raises ProfileError."""
    reference = name_or_path_or_url.strip()
    if "://" in reference or (plugin_address(reference) and not Path(reference).is_file()):
        return None
    if re.fullmatch(_NAME, reference) and not Path(reference).is_file():
        return _file_of(reference, user_dir or user_robots_dir())
    return Path(reference)


def leaves_ros_open(name_or_path_or_url: str) -> bool:
    """True for an address without a ROS version."""
    reference = name_or_path_or_url.strip()
    return "://" in reference and "ros" not in parse_qs(urlsplit(reference).query)


def with_ros(url: str, ros: RosVersion) -> str:
    """Address ``url`` with this ROS version, for :func:`load_profile`."""
    return urlsplit(url.strip())._replace(query=f"ros={ros}", fragment="").geturl()


def read_profile(path: Path) -> RobotProfile:
    """Read and validate one profile file.

    Raises
    ------
    ProfileError
        Naming the file, the line, what is wrong and what is allowed.
    """
    try:
        raw = read_bounded(path, _MAX_FILE_BYTES)
        text = raw.decode("utf-8")
    except OSError as error:
        raise ProfileError(
            tr("The robot profile {path} cannot be read: {error}.").format(path=path, error=error)
        ) from error
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ProfileError(
            tr("{file}, line {line}: not UTF-8 text ({why}).").format(file=path, line=line, why=error.reason)
        ) from error
    if len(raw) > _MAX_FILE_BYTES:
        raise ProfileError(
            tr("{path} is too large for a robot profile. Allowed: {most} bytes.").format(
                path=path, most=_MAX_FILE_BYTES
            )
        )
    return parse_profile(text, file_name=str(path), name=path.stem)


def parse_profile(text: str, *, file_name: str, name: str) -> RobotProfile:
    """Parse a profile from YAML text, with absolute names and an absolute certificate path.

    ``file_name`` is for messages and to locate certificates in its folder.

    Raises
    ------
    ProfileError
        As :func:`read_profile`.
    """
    source = ProfileText(text, file_name)
    source.raise_to_newest()
    source.refuse(problems(ProfileFile, source.data))
    folder = Path(file_name).parent.resolve()
    data, wrong = _with_absolute_names(source.data)
    source.refuse([*wrong, *_meaning_problems(data, folder)])
    profile: RobotProfile = value_from(RobotProfile, {"title": name, **data})
    source.refuse(_speech_that_moves(profile))
    ca_file = profile.security.ca_file
    if ca_file is not None:
        profile = replace(profile, security=replace(profile.security, ca_file=str((folder / ca_file).resolve())))
    return replace(profile, name=name)


def save_profile(profile: RobotProfile, path: Path) -> None:
    """Write a profile atomically so that it reads back equal; ``path`` ends in .yaml and names the profile.

    Raises
    ------
    ProfileError
        If it cannot be written or would not read back; a file that was there is as before.
    """
    if path.suffix != ".yaml" or not re.fullmatch(_NAME, path.stem):
        raise ProfileError(
            tr("{name} is not a valid profile name. Use letters, digits, - and _, then .yaml.").format(
                name=repr(path.name)
            )
        )
    text = profile_yaml(profile_data(profile, path.parent))
    read_back = parse_profile(text, file_name=str(path), name=path.stem)
    if read_back != replace(profile, name=path.stem):
        raise ProfileError(
            tr("The profile {title} contains values that cannot be written to a file; it was not saved.").format(
                title=repr(profile.title)
            )
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode(), durable=True)
    except OSError as error:
        raise ProfileError(
            tr("The profile was not written to {path}: {why}.").format(path=path, why=error.strerror or error)
        ) from error


def profile_text(profile: RobotProfile) -> str:
    """Profile as text, without certificates and credentials."""
    public = replace(
        profile, address=without_credentials(profile.address), security=replace(profile.security, ca_file=None)
    )
    return profile_yaml(profile_data(public, Path()))


def own_profile_file(title: str) -> Path:
    """Path for a new own profile of that title: ``My Robot 2`` becomes ``my-robot-2.yaml``."""
    plain = unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode().lower()
    stem = usable_stem(re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:60], "robot")
    return user_robots_dir() / f"{stem}.yaml"


def _profile_at_address(url: str) -> RobotProfile:
    parts = urlsplit(check_address(url))
    query = parse_qs(parts.query)
    ros = query.pop("ros", ["1"])[-1]
    if query or ros not in ("1", "2"):
        raise ProfileError(
            tr("{url}: only ros=1 or ros=2 is allowed after the '?' of an address.").format(url=repr(url))
        )
    address = parts._replace(query="", fragment="").geturl()
    if plugin_address(address):
        ros = "2"
    profile = read_profile(_robots_dir() / f"generic-ros{ros}.yaml")
    return replace(
        profile,
        name="address",
        address=address,
        title=tr("Robot at {address}").format(address=without_credentials(address)),
    )


def _robots_dir() -> Path:
    return resources_dir() / "robots"


def _own_files(user_dir: Path) -> list[Path]:
    return sorted(path for path in user_dir.glob("*.yaml") if path.is_file() and not path.name.startswith("."))


def _file_of(name: str, user_dir: Path) -> Path:
    user_file, shipped = user_dir / f"{name}.yaml", _robots_dir() / f"{name}.yaml"
    if user_file.is_file():
        return user_file
    if shipped.is_file():
        return shipped
    names = sorted({path.stem for path in _own_files(user_dir)} | set(shipped_profiles()))
    raise ProfileError(
        tr("There is no robot profile named {name}.").format(name=repr(name))
        + did_you_mean(name, names)
        + " "
        + tr("Profiles: {names}. A YAML file or an address such as ws://192.168.1.20:9090 works too.").format(
            names=", ".join(names)
        )
    )


def _listed(path: Path, *, shipped: bool) -> ListedProfile:
    try:
        written = path.stat()
    except OSError:
        return _listed_as_written(path, shipped, 0, 0)
    return _listed_as_written(path, shipped, written.st_mtime_ns, written.st_size)


@lru_cache(maxsize=256)
def _listed_as_written(path: Path, shipped: bool, _mtime_ns: int, _size_bytes: int) -> ListedProfile:
    """Cached by modification time and size: the window requests the list at each opening of its menu."""
    name = path.stem if re.fullmatch(_NAME, path.stem) else str(path)
    try:
        profile = read_profile(path)
    except ProfileError as error:
        return ListedProfile(name, path.name, "", path, shipped, str(error))
    return ListedProfile(name, profile.title, without_credentials(profile.address), path, shipped)


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


def _problem(path: KeyPath, template: str, **values: Any) -> Problem:
    return path, template.format(key=name_of(path), **values)


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
        yield _problem(("footprint", "polygon_m"), tr("'footprint.polygon_m': {mistake}"), mistake=mistake)
    seen: set[str] = set()
    for index, camera in enumerate(data.get("cameras", ())):
        if camera["name"] in seen:
            duplicate = tr("duplicate camera name {name}.")
            yield _problem(("cameras", index, "name"), duplicate, name=repr(camera["name"]))
        seen.add(camera["name"])
        if camera.get("model", {}).get("on_head") and "head" not in data:
            headless = tr("{key}: a camera on the head also requires 'head' in the profile.")
            yield _problem(("cameras", index, "model", "on_head"), headless)
    if "navigation" in data:
        yield from _navigation_problems(data["navigation"], data["ros"])
    speech = data.get("speech", {})
    for kind, keys in (("action", ("goal",)), ("service", ("request",)), ("web", ("body", "url"))):
        if kind in speech and not any(mentions_value(speech[kind].get(key)) for key in keys):
            key = next(each for each in keys if each in speech[kind])
            yield _problem(("speech", kind, key), tr("{key} does not contain {value}, the text to say."), value=VALUE)
    head = data.get("head", {})
    for key in ("pan_range_rad", "tilt_range_rad"):
        lowest, highest = head.get(key, (0, 1))
        if not lowest < highest:
            swapped = tr("{key} is [{lowest}, {highest}]; the lower number must come first.")
            yield _problem(("head", key), swapped, lowest=lowest, highest=highest)
    if head and head["pan_joint"] == head["tilt_joint"]:
        yield ("head", "tilt_joint"), tr("'head.tilt_joint' is also the pan joint; use two different joints.")
    for index, problem in control_problems(data.get("controls", ()), lambda: data["velocity"]["topic"]):
        yield ("controls", index), problem


def _certificate_problems(given: str, folder: Path) -> Iterator[Problem]:
    ca_file, path = (folder / given).resolve(), ("security", "ca_file")
    if Path(given).is_absolute() or not ca_file.is_relative_to(folder):
        yield path, tr("'security.ca_file': the certificate file must be in the folder of the profile.")
    elif not ca_file.is_file():
        yield _problem(path, tr("'security.ca_file': the file {ca_file} does not exist."), ca_file=ca_file)


def _navigation_problems(navigation: Mapping[str, Any], ros: int) -> Iterator[Problem]:
    kind = "move_base" if ros == 1 else "navigate_to_pose"
    if navigation["kind"] != kind:
        other = tr("'navigation.kind' is {found}; with ros: {ros} it must be {kind}.")
        yield _problem(("navigation", "kind"), other, found=repr(navigation["kind"]), ros=ros, kind=repr(kind))
    if "speed_limit" in navigation:
        path: KeyPath = ("navigation", "speed_limit")
        if ("reconfigure" if ros == 1 else "topic") not in navigation["speed_limit"]:
            missing = tr("{key}: with ros: 1, reconfigure is required.") if ros == 1 else ""
            yield _problem(path, missing or tr("{key}: with ros: 2, a topic is required."))
        elif ros == 1 and "max_mps" not in navigation:
            # Otherwise a higher limit of the wizard would exceed the manufacturer's.
            unknown = tr("{key} also requires max_mps: the speed that the navigation is configured for.")
            yield _problem(path, unknown)


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


MIGRATIONS: Mapping[int, Migration] = {}
MAX_BYTES = 2**20


class ProfileText:
    """Data of one profile in the newest version, with line numbers."""

    def __init__(self, text: str, file_name: str) -> None:
        """Parse ``text``; ``file_name`` is used in messages only. Raises ProfileError."""
        self.file_name = file_name
        if len(text) > MAX_BYTES:
            raise ProfileError(
                tr("{file_name}: the file is larger than 1 MB and is not a robot profile.").format(file_name=file_name)
            )
        try:
            self._source = parse_yaml(text)
        except YamlSourceError as error:
            message = tr("{file}, line {line}: {problem}").format(file=file_name, line=error.line, problem=error)
            raise ProfileError(f"{message.rstrip('.')}.") from error
        if not isinstance(self._source.data, dict):
            raise ProfileError(
                tr("{file_name}: a robot profile must be a list of 'name: value' lines.").format(file_name=file_name)
            )
        self.data: dict[str, Any] = self._source.data

    def raise_to_newest(self) -> None:
        """Migrate the data to the newest version. Raises ProfileError."""
        version, newest = self.data.get("version"), PROFILE_VERSION
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            wrong = tr("'version' is missing or not a whole number; write 'version: {newest}'.").format(newest=newest)
            self.refuse([(("version",), wrong)])
        elif version > newest:
            newer = tr(
                "this profile has version {version}, made for a newer CARIS Desktop; this program reads "
                "version {newest}. Update the program or use an older profile."
            )
            self.refuse([(("version",), newer.format(version=version, newest=newest))])
        else:
            self.data = migrated(self.data, MIGRATIONS, version=version, newest=newest)

    def refuse(self, found: Iterable[Problem]) -> None:
        """Raises ProfileError if there are problems."""
        if message := problem_lines(self.file_name, self._source, found):
            raise ProfileError(message)


def profile_yaml(data: Mapping[str, Any]) -> str:
    """Profile as text: sections separated, short values on one line."""
    chunks = ["# A robot profile of CARIS Desktop. The guide of robot profiles explains every line.\n"]
    previous = ""
    for key, value in data.items():
        chunk = _section(key, value, default_flow_style=None)
        if isinstance(value, Mapping) and chunk.count("\n") > 1 and chunk.startswith(f"{key}: {{"):
            # too long for one line
            chunk = _section(key, value, default_flow_style=False)
        if previous and (chunk.count("\n") > 1 or previous.count("\n") > 1):
            chunks.append("\n")
        chunks.append(chunk)
        previous = chunk
    return "".join(chunks)


def _section(key: str, value: Any, *, default_flow_style: bool | None) -> str:
    flow = default_flow_style if isinstance(value, (Mapping, list)) else False
    return dumped({key: value}, default_flow_style=flow, width=110, plain=True)
