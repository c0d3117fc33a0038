"""Scenario library: shipped scenarios and the user's own."""

import functools
import re
from collections import Counter
from pathlib import Path

import platformdirs

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_file import ScenarioError, load_scenario

SUFFIXES = (".yaml", ".yml")


_LONGEST_STEM = 60


def own_file_called(title: str) -> Path:
    """Path for a new own scenario of that title."""
    stem = re.sub(r"[\W_]+", "-", title.casefold()).strip("-")[:_LONGEST_STEM].strip("-")
    return user_scenarios_dir() / f"{stem or 'scenario'}.yaml"


def own_file(path: Path | None) -> Path:
    """Path for saving: the scenario's own file, or the user's copy of a shipped one."""
    if path is not None and not path.resolve().is_relative_to(layouts_dir().resolve()):
        return path
    return user_scenarios_dir() / (path.name if path is not None else "scenario.yaml")


class ScenarioChoice(Value):
    """One file of the library. An unreadable file is listed by its name; an own file with a duplicate title gets its
    name added.
    """

    title: str
    path: Path


def user_scenarios_dir() -> Path:
    """Folder of the user's own scenarios; may not exist."""
    return Path(platformdirs.user_config_dir("caris-desktop", appauthor=False)) / "scenarios"


def list_scenarios(*, user_dir: Path | None = None) -> tuple[ScenarioChoice, ...]:
    """Shipped scenarios, then the user's, each by file name. An own file replaces a shipped one of the same name."""
    titles = {path: title_of(path) for path in scenario_files(user_dir=user_dir)}
    times = Counter(titles.values())
    return tuple(
        ScenarioChoice(f"{title} ({path.stem})" if times[title] > 1 and path.parent != layouts_dir() else title, path)
        for path, title in titles.items()
    )


def scenario_files(*, user_dir: Path | None = None) -> tuple[Path, ...]:
    """Files of ``list_scenarios``, without reading them."""
    user_files = _files(user_scenarios_dir() if user_dir is None else user_dir)
    user_names = {path.stem for path in user_files}
    return (*(path for path in _files(layouts_dir()) if path.stem not in user_names), *user_files)


def find_scenario(name_or_path: str | Path, *, user_dir: Path | None = None) -> Path:
    """Scenario file by path, or by name in the library with or without its suffix.

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
    raise ScenarioError(
        tr("There is no scenario '{name}'. Allowed: a path to a file, or {names}.").format(
            name=name_or_path, names=", ".join(names)
        )
    )


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix in SUFFIXES and path.is_file())


def title_of(path: Path) -> str:
    """Title, cached until the file changes; for a broken file its name."""
    try:
        stat = path.stat()
    except OSError:
        return path.stem
    return _title_as_it_is(path, stat.st_mtime_ns, stat.st_size)


@functools.lru_cache(maxsize=500)
def _title_as_it_is(path: Path, _mtime_ns: int, _size: int) -> str:
    try:
        return load_scenario(path).title
    except ScenarioError:
        return path.stem
