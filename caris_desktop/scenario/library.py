"""Which scenarios there are: those that come with the program and the user's own."""

from dataclasses import dataclass
from pathlib import Path

import platformdirs

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.file import ScenarioError, load_scenario

SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class ScenarioChoice:
    """One file of the library. Of one that cannot be opened the title is its file name."""

    title: str
    path: Path


def user_scenarios_dir() -> Path:
    """Where the user's own scenarios lie; need not exist."""
    return Path(platformdirs.user_config_dir("caris-desktop", appauthor=False)) / "scenarios"


def list_scenarios(*, user_dir: Path | None = None) -> tuple[ScenarioChoice, ...]:
    """Shipped scenarios, then the user's, each by file name. A user's file stands in for a shipped one of its name."""
    user_dir = user_scenarios_dir() if user_dir is None else user_dir
    own = _files(user_dir)
    own_names = {path.stem for path in own}
    shipped = [path for path in _files(layouts_dir()) if path.stem not in own_names]
    return tuple(ScenarioChoice(_title(path), path) for path in (*shipped, *own))


def find_scenario(name_or_path: str | Path, *, user_dir: Path | None = None) -> Path:
    """The file that is meant: a path, or the name of a scenario in the library with or without its suffix.

    Raises
    ------
    ScenarioError
        If there is none; the text lists what there is.
    """
    path = Path(name_or_path).expanduser()
    if path.is_file():
        return path
    user_dir = user_scenarios_dir() if user_dir is None else user_dir
    if path.name == str(name_or_path):
        for folder in (user_dir, layouts_dir()):
            for file in _files(folder):
                if path.name in (file.name, file.stem):
                    return file
    names = sorted({file.stem for folder in (user_dir, layouts_dir()) for file in _files(folder)})
    raise ScenarioError(f"There is no scenario '{name_or_path}'. Allowed: a path to a file, or {', '.join(names)}.")


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix in SUFFIXES and path.is_file())


def _title(path: Path) -> str:
    try:
        return load_scenario(path).title
    except ScenarioError:
        return path.stem
