"""The file of a scenario as the editor opens it. All here waits on files, in another thread."""

import hashlib
from pathlib import Path

from caris_desktop.conversation.face.file import face_names
from caris_desktop.domain.declared import Known
from caris_desktop.domain.value_class import dataclass
from caris_desktop.domain.yaml_source import YamlSourceError
from caris_desktop.domain.yaml_writing import yaml_text
from caris_desktop.robot.profile import list_profiles
from caris_desktop.scenario.document import ScenarioDocument
from caris_desktop.scenario.file import scenario_data
from caris_desktop.scenario.library import own_file
from caris_desktop.scenario.model import Scenario


@dataclass(frozen=True, slots=True)
class Opened:
    """A file as it was read: its ``text``, and the checksum of what may be replaced by what is saved."""

    path: Path
    text: str
    sha256: str


def opened_file(path: Path) -> Opened:
    """Raises OSError, UnicodeDecodeError."""
    raw = path.read_bytes()
    return Opened(path, raw.decode("utf-8-sig"), hashlib.sha256(raw).hexdigest())


def shows_as_form(opened: Opened) -> None:
    """Raises ValueError, with file and line, where the text is none that a form can show."""
    try:
        ScenarioDocument(opened.text, opened.path)
    except YamlSourceError as error:
        raise ValueError(f"{opened.path.name}, line {error.line}: {error}") from error


def opened_as_form(scenario: Scenario) -> tuple[Opened, str]:
    """The file of that scenario; where it cannot be read, what is in force, and why. Waits on files."""
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


def opened_anew(path: Path, opened: Opened) -> Opened | str | None:
    """What the file says now, or why it cannot be read; None where it is another than ``opened``. Waits on files."""
    try:
        return opened_file(path) if path.resolve() == opened.path.resolve() else None
    except (OSError, ValueError) as error:
        return str(error)


def names_of_files() -> dict[Known, tuple[str, ...]]:
    """What a scenario may name that has a file of its own."""
    return {"robots": tuple(profile.name for profile in list_profiles()), "faces": face_names()}


def text_of(path: Path) -> str:
    """Raises OSError, UnicodeDecodeError."""
    return opened_file(path).text
