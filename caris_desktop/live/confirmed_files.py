"""Confirmation of external references in scenarios and robot profiles.

A file from someone else may name addresses, paths, environment variables and models. Nothing in a file is used before
the user has confirmed what it references. The answer is saved in the user's settings by the file's checksum.
"""

import contextlib
import json
import logging
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import platformdirs

from caris_desktop.conversation.models.endpoint import served_name
from caris_desktop.domain.address import plugin_address, without_credentials
from caris_desktop.domain.control_definitions import RobotControl, decided
from caris_desktop.domain.control_effects import NO_NAMES, RobotInterfaceNames
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import printable, typed_path
from caris_desktop.domain.intents import Intent, OpenScenario, UseRobot
from caris_desktop.domain.model_files import sha256_of
from caris_desktop.domain.plugins import BUILT_IN, PluginGroup, installed
from caris_desktop.domain.schema_fields import External, data_of, externals_in
from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.cameras.camera_source import CameraError, parse_camera
from caris_desktop.robot.profile import load_profile, profile_file
from caris_desktop.robot.profile_model import DEFAULT_ADDRESS, ProfileError, RobotProfile, interface_names
from caris_desktop.scenario.scenario_model import Scenario

_log = logging.getLogger(__name__)
_MAX_FILES = 300
_MOST_HASHED_BYTES = 1 << 32  # more than a model has; a file of someone else may name a folder of films
_PLAIN_NAME = re.compile(r"[A-Za-z0-9_-]+")
ReferenceKind = Literal["address", "variable", "path", "model", "network", "plugin", "stop_release", "motion", "held"]
KIND_TITLES: dict[ReferenceKind, str] = {
    "address": QT_TR_NOOP("Addresses it connects to"),
    "variable": QT_TR_NOOP("Environment variables it reads and sends as a secret"),
    "path": QT_TR_NOOP("Files and devices it opens"),
    "model": QT_TR_NOOP("Models it uses"),
    "network": QT_TR_NOOP("Data that others on your network can receive"),
    "plugin": QT_TR_NOOP("Plug-ins it runs: code of others that is installed on this computer"),
    "stop_release": QT_TR_NOOP("Controls that would release the emergency stop; they are refused"),
    "motion": QT_TR_NOOP("Controls that move the robot"),
    "held": QT_TR_NOOP("Controls of an unknown kind; the emergency stop blocks them"),
}
"""In display order: data that leaves this computer first."""
_PURPOSES = {
    "assistant.model": QT_TR_NOOP("questions to the language model"),
    "assistant.models": QT_TR_NOOP("questions to the language model"),
    "cameras.source": QT_TR_NOOP("shown and recorded as a camera"),
    "cameras.source.token-env": QT_TR_NOOP("the secret for the camera"),
    "face.page": QT_TR_NOOP("the robot's face page"),
    "listening.model": QT_TR_NOOP("transcribes speech"),
    "listening.server": QT_TR_NOOP("receives participants' speech"),
    "perception.model": QT_TR_NOOP("detects people in pictures"),
    "perception.tracker": QT_TR_NOOP("follows people from picture to picture"),
    "perception.server": QT_TR_NOOP("receives the camera pictures"),
    "recording.lsl": QT_TR_NOOP("marks and steps, as LSL"),
    "recording.lsl_words": QT_TR_NOOP("everything said and written, as LSL"),
    "robot": QT_TR_NOOP("the robot"),
    "address": QT_TR_NOOP("the robot"),
    "security.ca_file": QT_TR_NOOP("trusted certificates for the robot"),
    "security.rosauth_secret_env": QT_TR_NOOP("the secret for the robot"),
    "speech.name": QT_TR_NOOP("speaks for the robot"),
    "speech.web.stop": QT_TR_NOOP("stops the robot's speech"),
    "speech.web.url": QT_TR_NOOP("receives the robot's speech"),
}


class FileReference(Value):
    """External reference in a file. ``place``: its key path without indices; ``digest``: checksum of a
    referenced file.
    """

    kind: ReferenceKind
    text: str
    place: str
    digest: str = ""

    @property
    def purpose(self) -> str:
        """Purpose of the reference; empty if its key has no description."""
        return tr(_PURPOSES[self.place]) if self.place in _PURPOSES else ""


class FileQuestion(Value):
    """Question whether a file may use its references. ``known``: confirmed for an earlier version. ``then``: intent to
    repeat after a yes.
    """

    title: str
    path: Path
    sha256: str
    named: tuple[FileReference, ...]
    known: frozenset[FileReference]
    then: Intent

    @property
    def is_changed(self) -> bool:
        """Whether an earlier version was confirmed."""
        return bool(self.known)


class _Confirmed(Value):
    """Saved answer: checksum and path of the file."""

    sha256: str
    path: str
    named: tuple[FileReference, ...]


class ConfirmationNeededError(UserFacingError):
    """Raised while the references of a file are unconfirmed; nothing in the file is used."""

    def __init__(self, question: FileQuestion) -> None:
        super().__init__(
            tr(
                "“{title}” refers to resources outside its file, which have not been confirmed on this computer."
            ).format(title=question.title),
            tr("The file is not used."),
            tr("Open it in the console once and confirm its references."),
            severity="warning",
        )
        self.question = question


def question_words(question: FileQuestion) -> str:
    """The question as text, for commands without a window."""
    lines = [tr("“{title}” ({path}) refers to:").format(title=question.title, path=question.path)]
    for kind, title in KIND_TITLES.items():
        of_kind = [one for one in question.named if one.kind == kind]
        if of_kind:
            lines.append(f"  {tr(title)}:")
            lines += [f"    {one.text}{f' ({one.purpose})' if one.purpose else ''}" for one in of_kind]
    return "\n".join(printable(line) for line in lines)


def check_scenario(scenario: Scenario) -> None:
    """Raise ConfirmationNeededError if the scenario's references are unconfirmed. May read models."""
    if scenario.path is None or _is_shipped(scenario.path):
        return
    question = FileQuestion(
        scenario.title, scenario.path, scenario.sha256, scenario_references(scenario), frozenset(),
        OpenScenario(scenario.path),
    )  # fmt: skip
    _check(question)


def check_profile(profile: RobotProfile, name: str) -> None:
    """Raise ConfirmationNeededError if the profile's references are unconfirmed.

    ``name``: the robot as requested. An address was entered by the user, or confirmed with the scenario.
    """
    path = profile_file(name)
    if path is None or _is_shipped(path):
        return
    try:
        sha256 = sha256_of(path)
    except OSError:
        return  # the profile was just read; its next use reports the missing file
    _check(FileQuestion(profile.title, path, sha256, profile_references(profile), frozenset(), UseRobot(name)))


def accept(question: FileQuestion) -> None:
    """Save the user's confirmation. Raises OSError."""
    entries = [one for one in _entries() if one.sha256 != question.sha256]
    entries.append(_Confirmed(question.sha256, _key(question.path), question.named))
    files = [
        {
            "sha256": one.sha256,
            "path": one.path,
            "named": [[named.kind, named.text, named.place, named.digest] for named in one.named],
        }
        for one in entries[-_MAX_FILES:]
    ]
    file = _file()
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_file(file, json.dumps({"version": 1, "files": files}, indent=1).encode(), durable=True)
    with contextlib.suppress(OSError):
        file.chmod(0o600)


def carry(open_now: Scenario, saved: Scenario) -> None:
    """Transfer the confirmation of the open scenario to a version that the program wrote.

    Raises ConfirmationNeededError if the file has further references, and OSError.
    """
    try:
        check_scenario(saved)
    except ConfirmationNeededError as needed:
        if not set(needed.question.named) <= set(scenario_references(open_now)):
            raise
        accept(needed.question)


def accept_written_profile(profile: RobotProfile, path: Path) -> None:
    """Confirm a profile that the program wrote after discovery at the user's address; further references still need a
    question. Raises OSError.
    """
    try:
        check_profile(profile, str(path))
    except ConfirmationNeededError as needed:
        if all(one.kind in ("motion", "held") or one.place == "address" for one in needed.question.named):
            accept(needed.question)


def scenario_references(scenario: Scenario) -> tuple[FileReference, ...]:
    """References of the scenario, including controls affected by a stop."""
    data = data_of(Scenario, scenario)
    found = [
        reference
        for external, value, place in externals_in(Scenario, data)
        for reference in _references(external, value, place)
        if not _lies_next_to(reference, scenario.path)
    ]
    robot = NO_NAMES
    with contextlib.suppress(ProfileError):
        robot = interface_names(load_profile(scenario.robot))
    found += _of_controls(scenario.controls, robot)
    return tuple(dict.fromkeys(_with_digest(one, scenario.path) for one in found))


def profile_references(profile: RobotProfile) -> tuple[FileReference, ...]:
    """References of the profile, including controls affected by a stop."""
    data = data_of(RobotProfile, profile)
    found = [
        reference
        for external, value, place in externals_in(RobotProfile, data)
        if value != DEFAULT_ADDRESS
        for reference in _references(external, value, place)
    ]
    found += _of_controls(profile.controls, interface_names(profile))
    return tuple(dict.fromkeys(_with_digest(one, None) for one in found))


def _check(question: FileQuestion) -> None:
    if not question.named:
        return
    entries = _entries()
    named = set(question.named)
    known: set[FileReference] = set()
    for entry in entries:
        confirmed = set(entry.named)
        if entry.sha256 == question.sha256 and named <= confirmed:
            return
        if entry.path == _key(question.path):
            known = confirmed
    if named <= known:
        return  # an edit without new references needs no question
    raise ConfirmationNeededError(replace(question, known=frozenset(known)))


def _references(external: External, value: Any, place: str) -> Iterator[FileReference]:
    text = str(value).strip()
    match external:
        case "network" if value is True or value == "network":
            yield FileReference("network", tr("{key} is on").format(key=place), place)
        case "variable" | "path":
            yield FileReference(external, text, place)
        case "model" | "recogniser" | "voice":
            if text.startswith("plugin:"):
                yield _plugin("detectors" if external == "model" else "speech", text.partition(":")[2], place)
            elif external == "voice":
                # Other names are those of files next to the scenario or in the models folders.
                path = text.removeprefix("piper:")
                if typed_path(path).is_absolute():
                    yield FileReference("path", path, place)
            elif text:
                yield FileReference("model", text, place)
        case "language_model":
            if text.startswith("plugin:"):
                yield _plugin("language_models", text.partition(":")[2], place)
            elif served_name(text) is None:  # such a name leads to a file that the user has added
                yield FileReference("model", text, place)
        case "address" | "robot" if (of_plugin := plugin_address(text)) is not None:
            yield FileReference("address", text, place)
            if of_plugin[0] not in BUILT_IN["robots"]:
                yield _plugin("robots", of_plugin[0], place)
        case "address" | "robot" if "://" in text:
            yield FileReference("address", _shown(text), place)
        case "robot" if not _PLAIN_NAME.fullmatch(text):
            yield FileReference("path", text, place)
        case "tracker" if text not in BUILT_IN["trackers"]:
            yield _plugin("trackers", text, place)
        case "panel" if text.startswith("plugin:"):
            yield _plugin("panels", text.partition(":")[2], place)
        case "camera":
            yield from _camera(text, place)


def _plugin(group: PluginGroup, name: str, place: str) -> FileReference:
    plugin = installed(group).get(name)
    return FileReference("plugin", f"{name} ({plugin.package})" if plugin else name, place)


def _camera(text: str, place: str) -> Iterator[FileReference]:
    if text in ("robot", "oak", "simulated") or re.fullmatch(r"(robot|oak):[^/]*", text):
        return
    if text.startswith("plugin:"):
        _, name, *target = text.split(":", 2)
        yield _plugin("cameras", name, place)
        yield from (FileReference("address" if "://" in one else "path", one, place) for one in target)
    elif "://" in text:
        yield FileReference("address", _shown(text), place)
        with contextlib.suppress(ValueError):
            for name in parse_qs(urlsplit(text).fragment).get("token-env", []):
                yield FileReference("variable", name, f"{place}.token-env")
    else:
        yield FileReference("path", f"/dev/video{text}" if text.isdecimal() else text, place)


def _of_controls(controls: Iterable[RobotControl], robot: RobotInterfaceNames) -> Iterator[FileReference]:
    for control in controls:
        known = decided(control, robot)
        if not known.is_held_by_stop:
            continue
        effect = known.effect
        target = next(getattr(effect, name) for name in ("topic", "service", "action") if hasattr(effect, name))
        kind: ReferenceKind = "stop_release" if known.releases_stop else "motion" if known.is_motion else "held"
        yield FileReference(kind, f"{control.title}: {target} ({getattr(effect, 'type', '')})", "controls")


def _shown(address: str) -> str:
    """Address without credentials; one that cannot be parsed stays as it is, since nothing connects to it."""
    return without_credentials(address) or address.rpartition("@")[2]


def _lies_next_to(reference: FileReference, path: Path | None) -> bool:
    """Whether a camera's file is in the scenario's folder, also through links."""
    if path is None or reference.kind != "path" or reference.place != "cameras.source":
        return False
    try:
        file = Path(parse_camera(reference.text).target)  # as it is opened: a name may contain a question mark
        return file.is_file() and file.resolve().is_relative_to(path.resolve().parent)
    except (CameraError, OSError, ValueError):
        return False


def _with_digest(reference: FileReference, path: Path | None) -> FileReference:
    """Add the checksum of a local model or certificate, unless too large for one: another content is a new
    reference.
    """
    if reference.kind not in ("model", "path") or reference.place == "cameras.source":
        return reference
    if reference.kind == "model" and not reference.place.startswith(("perception.", "listening.")):
        return reference
    file = typed_path(reference.text)
    if path is not None and not file.is_absolute():
        file = path.parent / file
    try:
        files = sorted(one for one in file.iterdir() if one.is_file()) if file.is_dir() else [file]
        if not all(one.is_file() for one in files) or sum(one.stat().st_size for one in files) > _MOST_HASHED_BYTES:
            return reference
        return replace(reference, digest=sha256_of(*files))
    except (OSError, ValueError):
        return reference


def _is_shipped(path: Path) -> bool:
    resolved = path.resolve()
    return any(resolved.is_relative_to(folder.resolve()) for folder in (layouts_dir(), resources_dir() / "robots"))


def _key(path: Path) -> str:
    return str(path.resolve())


def _file() -> Path:
    return platformdirs.user_config_path("caris-desktop", appauthor=False) / "confirmed-files.json"


def _entries() -> list[_Confirmed]:
    """Confirmed files, newest last; empty if unreadable, which leads to new questions."""
    try:
        files = json.loads(_file().read_text(encoding="utf-8"))["files"]
        return [
            _Confirmed(
                str(one["sha256"]),
                str(one["path"]),
                tuple(FileReference(kind, *map(str, rest)) for kind, *rest in one["named"]),
            )
            for one in files
        ]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        _log.warning("what was confirmed of files cannot be read", exc_info=True)
        return []
