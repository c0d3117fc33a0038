"""Scenario bundles: a scenario and its referenced files in one file, for sharing. Nothing in it is ever executed.

A zip archive of plain YAML files: ``scenario/NAME.yaml``, and ``robot/NAME.yaml`` and ``face/NAME.yaml`` if the
scenario refers to ones that are not shipped with the program.
"""

import io
import json
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.free_names import RESERVED_ON_WINDOWS
from caris_desktop.domain.intents import SameName
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_file import (
    MAX_FILE_BYTES,
    ScenarioError,
    changed_text,
    parse_scenario,
    scenario_data,
)

SUFFIX = ".caris"
BUNDLE_VERSION = 1
MOST_PARTS = 12
MAX_BUNDLE_BYTES = MOST_PARTS * MAX_FILE_BYTES
PartKind = Literal["scenario", "robot", "face"]
REPLACED = "replaced"
"""Folder next to the user's own files, for those that an imported one replaced."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_THERE_ALREADY: dict[PartKind, str] = {
    "scenario": QT_TR_NOOP("A scenario named '{name}' already exists. Choose another name."),
    "robot": QT_TR_NOOP("A robot named '{name}' already exists. Choose another name."),
    "face": QT_TR_NOOP("A face named '{name}' already exists. Choose another name."),
}
_ABOUT = "about.json"
_PART = re.compile(r"(scenario|robot|face)/([A-Za-z0-9][A-Za-z0-9_-]{0,59})\.yaml")
_AT_FIRST = (1980, 1, 1, 0, 0, 0)  # the same content gives the same file


class BundleError(Exception):
    """Unusable or unwritable bundle; the text says what is wrong and what is allowed."""


class BundledFile(Value):
    """One YAML file, named without its suffix."""

    kind: PartKind
    name: str
    text: str


class Bundle(Value):
    scenario: BundledFile
    beside: tuple[BundledFile, ...] = ()


class Unpacked(Value):
    """Path of the imported scenario; files renamed because of a conflict without a decision; and paths of replaced
    files.
    """

    path: Path
    renamed: tuple[tuple[BundledFile, str], ...] = ()
    put_aside: tuple[Path, ...] = ()


class NameConflict(Value):
    """Import conflict: ``part`` has the name of another file at ``there`` with ``text``. ``own``: it is the user's and
    may be replaced; shipped files may not. ``free`` is an unused name.
    """

    part: BundledFile
    there: Path
    text: str
    own: bool
    free: str


class ImportQuestion(Value):
    """Bundle with name conflicts that need a decision."""

    path: Path
    conflicts: tuple[NameConflict, ...]


Known = Callable[[PartKind, str], tuple[Path, str] | None]
"""Gives the file that goes by a name already, of the user's own and of what comes with the program, and its text."""


def bundle_name(stem: str) -> str:
    """Name for a bundle's file."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", stem).strip("-_")[:60] or "scenario"


def write_bundle(bundle: Bundle, path: Path) -> None:
    """Write a bundle. Raises BundleError."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        about = json.dumps({"format": "caris-scenario", "version": BUNDLE_VERSION})
        archive.writestr(zipfile.ZipInfo(_ABOUT, _AT_FIRST), about)
        for part in (bundle.scenario, *bundle.beside):
            archive.writestr(zipfile.ZipInfo(f"{part.kind}/{part.name}.yaml", _AT_FIRST), part.text)
    try:
        replace_file(path, packed.getvalue(), durable=True)
    except OSError as error:
        raise BundleError(
            tr("{path} was not written ({why}).").format(path=path, why=error.strerror or error)
        ) from error


def read_bundle(path: Path) -> Bundle:
    """Read a bundle, with validation of its scenario. Raises BundleError."""
    try:
        if path.stat().st_size > MAX_BUNDLE_BYTES:
            raise BundleError(
                tr("{name} is too large for a scenario. Allowed: {most} bytes.").format(
                    name=path.name, most=MAX_BUNDLE_BYTES
                )
            )
        with zipfile.ZipFile(path) as archive:
            texts = dict(_texts(archive))
    except OSError as error:
        raise BundleError(
            tr("{name} cannot be read: {why}.").format(name=path.name, why=error.strerror or error)
        ) from error
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, RuntimeError, EOFError, ValueError) as error:
        raise BundleError(tr("{name} is not a scenario file, or it is damaged.").format(name=path.name)) from error
    _check_version(texts.pop(_ABOUT, ""), path)
    parts = [
        BundledFile(cast(PartKind, kind), file_name.removesuffix(".yaml"), text)
        for entry, text in texts.items()
        for kind, file_name in [entry.split("/")]
    ]
    scenarios = [part for part in parts if part.kind == "scenario"]
    if len(scenarios) != 1:
        raise BundleError(
            tr("{name} contains {scenarios} scenarios. Allowed: one.").format(name=path.name, scenarios=len(scenarios))
        )
    try:
        parse_scenario(scenarios[0].text, path=Path(f"{scenarios[0].name}.yaml"))
    except ScenarioError as error:
        raise BundleError(str(error)) from error
    return Bundle(scenarios[0], tuple(part for part in parts if part.kind != "scenario"))


def conflicts_of(bundle: Bundle, folders: Mapping[PartKind, Path], known: Known) -> tuple[NameConflict, ...]:
    """Name conflicts, the scenario's first."""
    found = []
    for part in (bundle.scenario, *bundle.beside):
        there = known(part.kind, part.name)
        if there is not None and there[1].strip() != part.text.strip():
            is_users = there[0].parent == folders[part.kind]
            found.append(NameConflict(part, *there, is_users, _free(part, known)))
    return tuple(found)


def unpack(
    bundle: Bundle, folders: Mapping[PartKind, Path], known: Known, decided: Iterable[SameName] = ()
) -> Unpacked:
    """Write the files to their folders, without overwriting unless ``decided``.

    Identical files are reused; different ones are renamed, with references updated in the scenario, or replace the file
    that is moved aside. Raises BundleError, with everything unchanged.
    """
    renamed: list[tuple[BundledFile, str]] = []
    written: list[Path] = []
    aside: dict[Path, Path] = {}
    choices = {(one.kind, one.name): one for one in decided}

    def name_for(part: BundledFile) -> str:
        if _is_free(part.kind, part.name, known):
            return part.name
        choice = choices.get((part.kind, part.name))
        if choice is None:
            return _free(part, known)
        if choice.new_name and (not NAME.fullmatch(choice.new_name) or RESERVED_ON_WINDOWS.fullmatch(choice.new_name)):
            raise BundleError(
                tr("'{name}' is not a valid name. Allowed: letters, digits, - and _.").format(name=choice.new_name)
            )
        if choice.new_name and known(part.kind, choice.new_name) is not None:
            raise BundleError(tr(_THERE_ALREADY[part.kind]).format(name=choice.new_name))
        return choice.new_name or part.name

    def put_aside(path: Path) -> None:
        if path.exists():
            folder = path.parent / REPLACED
            folder.mkdir(exist_ok=True)
            places = (folder / f"{path.stem}-{number}{path.suffix}" for number in range(1, 1000))
            aside[path] = next(place for place in places if not place.exists())
            path.rename(aside[path])

    def put(part: BundledFile) -> Path:
        there = known(part.kind, part.name)
        if there is not None and there[1].strip() == part.text.strip():
            return there[0]
        name = name_for(part)
        path = folders[part.kind] / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        if there is not None and there[0] == path:
            put_aside(path)
        with path.open("x", encoding="utf-8") as file:
            written.append(path)
            file.write(part.text)
        if name != part.name and (part.kind, part.name) not in choices:
            renamed.append((part, name))
        return path

    try:
        names = {(part.kind, part.name): put(part).stem for part in bundle.beside}
        scenario = replace(bundle.scenario, text=_referring(bundle.scenario.text, names))
        path = put(scenario)
    except (OSError, BundleError) as error:
        for path in written:
            path.unlink(missing_ok=True)
        for path, place in aside.items():
            place.rename(path)
        if isinstance(error, BundleError):
            raise
        raise BundleError(tr("Nothing was imported ({why}).").format(why=error.strerror or error)) from error
    return Unpacked(path, tuple(renamed), tuple(aside.values()))


def _free(part: BundledFile, known: Known) -> str:
    names = (part.name, *(f"{part.name[:56]}-{number}" for number in range(2, 1000)))
    return next(name for name in names if _is_free(part.kind, name, known))


def _is_free(kind: PartKind, name: str, known: Known) -> bool:
    return known(kind, name) is None and not RESERVED_ON_WINDOWS.fullmatch(name)


def _texts(archive: zipfile.ZipFile) -> Iterator[tuple[str, str]]:
    entries = archive.infolist()
    if len(entries) > MOST_PARTS:
        raise BundleError(
            tr("The scenario file contains {entries} files. Allowed: {most}.").format(
                entries=len(entries), most=MOST_PARTS
            )
        )
    seen: set[str] = set()
    for entry in entries:
        if entry.filename != _ABOUT and not _PART.fullmatch(entry.filename):
            raise BundleError(
                tr(
                    "The scenario file contains '{filename}'. Allowed: scenario/NAME.yaml, robot/NAME.yaml, "
                    "face/NAME.yaml."
                ).format(filename=entry.filename)
            )
        if entry.filename.casefold() in seen:
            raise BundleError(tr("The scenario file contains '{filename}' twice.").format(filename=entry.filename))
        seen.add(entry.filename.casefold())
        with archive.open(entry) as file:
            raw = file.read(MAX_FILE_BYTES + 1)  # the declared size is untrusted
        if len(raw) > MAX_FILE_BYTES:
            raise BundleError(
                tr("'{filename}' is too large. Allowed: {most} bytes.").format(
                    filename=entry.filename, most=MAX_FILE_BYTES
                )
            )
        yield entry.filename, raw.decode("utf-8-sig")


def _check_version(about: str, path: Path) -> None:
    try:
        manifest = parse_json(about)
    except ValueError:
        manifest = None
    if not isinstance(manifest, dict) or manifest.get("format") != "caris-scenario":
        raise BundleError(tr("{name} is not a scenario file, or it is damaged.").format(name=path.name))
    if manifest.get("version") != BUNDLE_VERSION:
        raise BundleError(
            tr("{name} was written by another version of this program. Update the program to read the file.").format(
                name=path.name
            )
        )


def _referring(text: str, names: Mapping[tuple[PartKind, str], str]) -> str:
    """``text`` with renamed robot and face."""
    path = Path("scenario.yaml")
    scenario = parse_scenario(text, path=path)
    robot = names.get(("robot", scenario.robot), scenario.robot)
    face = names.get(("face", scenario.face.face), scenario.face.face)
    changed = replace(scenario, robot=robot, face=replace(scenario.face, face=face))
    return text if changed == scenario else changed_text(text, scenario, scenario_data(changed), path)[0]


def names_of(parts: Iterable[tuple[BundledFile, str]]) -> str:
    """Renamed files, for the wizard."""
    return ", ".join(f"{part.name} → {name}" for part, name in parts)
