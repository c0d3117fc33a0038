"""Scenario file as read by the editor. All functions read files; run them in a background thread."""

import hashlib
from pathlib import Path

from caris_desktop.conversation.face.face_file import face_names
from caris_desktop.domain.schema_fields import Known
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_source import YamlSourceError
from caris_desktop.domain.yaml_writing import yaml_text
from caris_desktop.robot.profile import list_profiles
from caris_desktop.scenario.document import ScenarioDocument
from caris_desktop.scenario.scenario_file import scenario_data
from caris_desktop.scenario.scenario_library import own_file
from caris_desktop.scenario.scenario_model import Scenario


class Opened(Value):
    """File contents, with the checksum that detects changes before saving."""

    path: Path
    text: str
    sha256: str


def opened_file(path: Path) -> Opened:
    """Read a file. Raises OSError, UnicodeDecodeError."""
    raw = path.read_bytes()
    return Opened(path, raw.decode("utf-8-sig"), hashlib.sha256(raw).hexdigest())


def shows_as_form(opened: Opened) -> None:
    """Raise ValueError, with file and line, if the form cannot show the text."""
    try:
        ScenarioDocument(opened.text, opened.path)
    except YamlSourceError as error:
        raise ValueError(f"{opened.path.name}, line {error.line}: {error}") from error


def opened_as_form(scenario: Scenario) -> tuple[Opened, str]:
    """File of the scenario; if unreadable, the scenario in force, with the reason. Reads files."""
    problem, sha256 = "", ""
    if scenario.path is not None:
        try:
            opened = opened_file(scenario.path)
            sha256 = opened.sha256
            shows_as_form(opened)
        except (OSError, ValueError) as error:
            problem = str(error)
        else:
            return opened, ""
    path = scenario.path if scenario.path is not None else own_file(None)
    return Opened(path, yaml_text(scenario_data(scenario)), sha256), problem


def reopened(path: Path, opened: Opened) -> Opened | str | None:
    """Current contents of the file, or why it is unreadable; None if it is not the file of ``opened``. Reads files."""
    try:
        return opened_file(path) if path.resolve() == opened.path.resolve() else None
    except (OSError, ValueError) as error:
        return str(error)


def names_of_files() -> dict[Known, tuple[str, ...]]:
    """Names of existing robot profiles and faces."""
    return {"robots": tuple(profile.name for profile in list_profiles()), "faces": face_names()}


def text_of(path: Path) -> str:
    """Text of a file. Raises OSError, UnicodeDecodeError."""
    return opened_file(path).text
