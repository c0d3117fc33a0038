"""Scenario bundles: one file with the user's own robot profile and face, for passing on and import."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from caris_desktop.conversation.face.face_file import FaceError, parse_face, user_faces_dir
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import SameName
from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.domain.translation import tr
from caris_desktop.live.services.scenario_service import Imported
from caris_desktop.robot.profile import (
    ProfileError,
    load_profile,
    parse_profile,
    profile_text,
    read_profile,
    user_robots_dir,
)
from caris_desktop.scenario.bundle import (
    Bundle,
    BundledFile,
    BundleError,
    NameConflict,
    PartKind,
    bundle_name,
    conflicts_of,
    names_of,
    read_bundle,
    unpack,
    write_bundle,
)
from caris_desktop.scenario.scenario_file import scenario_text
from caris_desktop.scenario.scenario_library import user_scenarios_dir
from caris_desktop.scenario.scenario_model import Scenario


def share_scenario(scenario: Scenario, path: Path) -> None:
    """Write the scenario with the user's own files that it refers to. Raises UserFacingError."""
    stem = scenario.path.stem if scenario.path is not None else scenario.title
    scenario_file = BundledFile("scenario", bundle_name(stem), scenario_text(scenario))
    try:
        write_bundle(Bundle(scenario_file, tuple(_next_to(scenario))), path)
    except (BundleError, ProfileError, OSError) as error:
        raise UserFacingError(
            tr("The scenario was not exported as one file."), str(error), tr("Choose another folder or another name.")
        ) from error


def import_conflicts(path: Path) -> tuple[NameConflict, ...]:
    """Name conflicts of this bundle with existing files. Raises UserFacingError."""
    with _reported_errors():
        return conflicts_of(_checked(path), _folders(), _known)


def import_scenario(path: Path, decided: Sequence[SameName] = ()) -> Imported:
    """Import it into the user's own files, with name conflicts resolved as ``decided``. Raises UserFacingError."""
    with _reported_errors():
        unpacked = unpack(_checked(path), _folders(), _known, decided)
    aside = ", ".join(str(place) for place in unpacked.put_aside)
    return Imported(unpacked.path, names_of(unpacked.renamed), aside)


def _folders() -> dict[PartKind, Path]:
    return {"scenario": user_scenarios_dir(), "robot": user_robots_dir(), "face": user_faces_dir()}


def _checked(path: Path) -> Bundle:
    bundle = read_bundle(path)
    for part in bundle.beside:
        _check(part, path)
    return bundle


@contextmanager
def _reported_errors() -> Iterator[None]:
    try:
        yield
    except (BundleError, ProfileError, FaceError) as error:
        reason = error.what if isinstance(error, FaceError) else str(error)
        raise UserFacingError(
            tr("The scenario was not imported."), reason, tr("Nothing was changed. Ask the sender for the file again.")
        ) from error


def _next_to(scenario: Scenario) -> list[BundledFile]:
    """Robot and face of the scenario, if they are the user's own. A profile's text contains no secrets."""
    parts = []
    if (user_robots_dir() / f"{scenario.robot}.yaml").is_file():
        parts.append(BundledFile("robot", scenario.robot, profile_text(load_profile(scenario.robot))))
    face = user_faces_dir() / f"{scenario.face.face}.yaml"
    if face.is_file():
        parts.append(BundledFile("face", scenario.face.face, face.read_text(encoding="utf-8-sig")))
    return parts


def _check(part: BundledFile, bundle: Path) -> None:
    file_name = f"{bundle.name}, {part.kind}/{part.name}.yaml"
    if part.kind == "robot":
        parse_profile(part.text, file_name=file_name, name=part.name)
    else:
        parse_face(part.text, file_name=file_name, name=part.name)


def _known(kind: PartKind, name: str) -> tuple[Path, str] | None:
    """Existing file of that name, and its text; no text if it is unusable."""
    folders = {
        "scenario": (user_scenarios_dir(), layouts_dir()),
        "robot": (user_robots_dir(), resources_dir() / "robots"),
        "face": (user_faces_dir(), resources_dir() / "faces"),
    }
    paths = (folder / f"{name}.yaml" for folder in folders[kind])
    there = next((path for path in paths if path.is_file()), None)
    if there is None:
        return None
    try:
        text = profile_text(read_profile(there)) if kind == "robot" else there.read_text(encoding="utf-8-sig")
    except (OSError, ValueError, ProfileError):
        text = ""
    return there, text
