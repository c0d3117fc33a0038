"""Robot profiles: finding, listing, loading and saving. Plain YAML, never code."""

import re
import unicodedata
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import platformdirs

from caris_desktop.domain.address import plugin_address, without_credentials
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import (
    DEFAULT_ADDRESS,
    AudioInterface,
    CameraTopic,
    EmergencyStopInterface,
    FloorOutline,
    GuardSettings,
    HeadInterface,
    LaserMount,
    MapServices,
    MotionLimits,
    NavigationServer,
    ProfileError,
    RobotProfile,
    RosVersion,
    SecuritySettings,
    SpeechAction,
    SpeechInterface,
    SpeechService,
    SpeechWeb,
    SpeedLimitInterface,
    TopicSource,
    TransformFrames,
    VelocityTopic,
    check_address,
    interface_names,
)

# Includes the parts of a profile, so that callers need not know the modules that define them.
__all__ = [
    "DEFAULT_ADDRESS",
    "AudioInterface",
    "CameraTopic",
    "EmergencyStopInterface",
    "FloorOutline",
    "GuardSettings",
    "HeadInterface",
    "LaserMount",
    "ListedProfile",
    "MapServices",
    "MotionLimits",
    "NavigationServer",
    "ProfileError",
    "RobotProfile",
    "SecuritySettings",
    "SpeechAction",
    "SpeechInterface",
    "SpeechService",
    "SpeechWeb",
    "SpeedLimitInterface",
    "TopicSource",
    "TransformFrames",
    "VelocityTopic",
    "check_address",
    "interface_names",
    "leaves_ros_open",
    "list_profiles",
    "load_profile",
    "parse_profile",
    "profile_file",
    "profile_file_name",
    "profile_text",
    "read_profile",
    "save_profile",
    "shipped_profiles",
    "user_robots_dir",
    "with_ros",
]

_NAME = r"[A-Za-z0-9_-]+"


class ListedProfile(Value):
    """One line of the robot list. ``error`` says why the file cannot be used; ``title`` is then the file's name."""

    name: str
    title: str
    address: str
    path: Path
    shipped: bool
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
    :func:`leaves_ros_open`; ``explore.detect_dialect`` asks the robot, and until then it is ROS 1.

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
        raw = path.read_bytes()
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
    return parse_profile(text, file_name=str(path), name=path.stem)


def parse_profile(text: str, *, file_name: str, name: str) -> RobotProfile:
    """Parse a profile from YAML text; ``file_name`` is for messages and to locate certificates in its folder.

    Raises
    ------
    ProfileError
        As :func:`read_profile`.
    """
    # Late import: link processes use profiles without YAML.
    from caris_desktop.robot.profile_content import profile_from
    from caris_desktop.robot.profile_file import ProfileText

    return profile_from(ProfileText(text, file_name), name)


def save_profile(profile: RobotProfile, path: Path) -> None:
    """Write a profile atomically so that it reads back equal; ``path`` ends in .yaml and names the profile.

    Raises
    ------
    ProfileError
        If it cannot be written or would not read back; a file that was there is as before.
    """
    from caris_desktop.robot.profile_content import profile_data
    from caris_desktop.robot.profile_file import profile_yaml

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
    from caris_desktop.robot.profile_content import profile_data
    from caris_desktop.robot.profile_file import profile_yaml

    public = replace(
        profile, address=without_credentials(profile.address), security=replace(profile.security, ca_file=None)
    )
    return profile_yaml(profile_data(public, Path()))


def profile_file_name(title: str) -> str:
    """File name for a robot's title: ``My Robot 2`` becomes ``my-robot-2.yaml``."""
    plain = unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode().lower()
    return (re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:60] or "robot") + ".yaml"


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
    from caris_desktop.domain.schema_validation import did_you_mean

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
