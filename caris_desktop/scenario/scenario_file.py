"""Reading and writing of scenario files; mistakes are reported with file, line and allowed values."""

import functools
import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import platformdirs

from caris_desktop.domain.control_definitions import control_problems
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import read_bounded, typed_path
from caris_desktop.domain.free_names import usable_stem
from caris_desktop.domain.plugins import BUILT_IN, PluginGroup, installed
from caris_desktop.domain.schema_fields import KeyPath, Problem, data_of, leaves, value_from
from caris_desktop.domain.schema_validation import Migration, allowed_words, migrated, problem_lines, problems, quoted
from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml, yaml_text
from caris_desktop.scenario.phrases import Gesture, PhraseEntry, gesture_problems, phrase_groups, phrase_problems
from caris_desktop.scenario.protocol_steps import ProtocolSettings, protocol_problems
from caris_desktop.scenario.scenario_model import DEFAULT_ROBOT, SCENARIO_VERSION, LayoutNode, Scenario, layout_problems

# Versions and migrations of scenario files.


# Version 0 is a file without a version; nothing else differs.
MIGRATIONS: Mapping[int, Migration] = {0: lambda data: data}


def migrate(
    data: dict[str, Any], *, migrations: Mapping[int, Migration] = MIGRATIONS, newest: int = SCENARIO_VERSION
) -> dict[str, Any]:
    """``data`` migrated to the newest version; the argument is unchanged.

    Raises ValueError if the version is no whole number, or newer than ``newest``.
    """
    version = data.get("version", 0)
    if isinstance(version, bool) or not isinstance(version, int) or version < 0:
        raise ValueError(
            tr("the version must be a whole number, found {version}. Allowed: {newest}").format(
                version=repr(version), newest=newest
            )
        )
    if version > newest:
        raise ValueError(
            tr(
                "the file has version {version}, this program reads up to version {newest}. Update CARIS Desktop, or "
                "open an older copy of the file."
            ).format(version=version, newest=newest)
        )
    return migrated(data, migrations, version=version, newest=newest)


MAX_FILE_BYTES = 256 * 1024
LAYOUTS = ("layout", "layout_compact", "layout_large")
"""Fields with the layouts of the panels."""
_SCHEMA_ON_THIS_COMPUTER = re.compile(
    r"""^[ \t]*\#[ \t]*yaml-language-server:[^\n]*\$schema[ \t]*=[ \t"']*(?:file:|/|\\|~|[a-z]:[/\\])[^\n]*(?:\n|\Z)""",
    re.MULTILINE | re.IGNORECASE,
)
_SCHEMA_COMMENT = re.compile(r"^[ \t]*#[ \t]*yaml-language-server:[^\r\n]*", re.MULTILINE)


class ScenarioError(Exception):
    """Unusable scenario file. The text names file, line, mistake and allowed values."""


class OtherFileError(ScenarioError):
    """The target contains a file that must not be replaced."""


def schema_path() -> Path:
    """JSON Schema of scenario files, for the loader and for editors."""
    return resources_dir() / "schemas" / "scenario.schema.json"


def load_scenario(path: Path, velocity_topic_of: Callable[[str], str | None] = lambda _robot: None) -> Scenario:
    """Read, migrate and validate one scenario file.

    ``velocity_topic_of`` returns the velocity topic of a robot by its name in the file: no control may publish there.

    Raises ScenarioError if the file cannot be read, or says something that a scenario may not say.
    """
    raw = _read(path)
    scenario = parse_scenario(_decoded(raw, path), path=path.resolve(), velocity_topic_of=velocity_topic_of)
    return replace(scenario, sha256=hashlib.sha256(raw).hexdigest())


def save_scenario(scenario: Scenario, path: Path, *, only: Sequence[str] = ()) -> Scenario:
    """Write ``scenario`` to ``path`` atomically; return it as loaded from there.

    Text in the target, or else in the scenario's source file, is preserved including comments and order; only
    differences are rewritten. With ``only``, nothing but these fields of an existing file changes.

    Raises ScenarioError if the file cannot be written, has a mistake, or the scenario would not load again.
    """
    known = _known(path)
    if known is not None and only:
        scenario = replace(known[1], **{name: getattr(scenario, name) for name in only})
    data = scenario_data(scenario)
    wrong = next(iter([*problems(Scenario, data), *_meaning_problems(data)]), None)
    if wrong is not None:
        raise ScenarioError(tr("{path} was not written: {wrong}").format(path=_shown(path), wrong=wrong[1]))
    text, saved = _new_file(scenario, data, path) if known is None else changed_text(*known, data, path)
    _write_or_report(path, text)
    return saved


def save_text(
    text: str,
    path: Path,
    *,
    came_from: Path | None = None,
    replaces: str = "",
    velocity_topic_of: Callable[[str], str | None] = lambda _robot: None,
) -> str:
    """Write ``text`` to ``path`` atomically; return the file's content. If the folder differs from that of
    ``came_from``, the schema comment for editors is updated.

    Raises ScenarioError if it has a mistake or the file cannot be written; OtherFileError if what is there has not the
    checksum ``replaces``.
    """
    if path.is_file() and hashlib.sha256(_read(path)).hexdigest() != replaces:
        message = (
            tr("{path} was changed elsewhere in the meantime. It was not overwritten.")
            if replaces
            else tr("{path} already exists. It was not overwritten.")
        )
        raise OtherFileError(message.format(path=_shown(path)))
    if came_from is not None and came_from.resolve().parent != path.resolve().parent:
        text = _SCHEMA_COMMENT.sub(lambda _match: _schema_comment(path), text, count=1)
    if len(text.encode("utf-8")) > MAX_FILE_BYTES:
        raise ScenarioError(
            tr("{path} would be too large for a scenario. Allowed: {most} bytes.").format(
                path=_shown(path), most=MAX_FILE_BYTES
            )
        )
    parse_scenario(text, path=path.resolve(), velocity_topic_of=velocity_topic_of)
    _write_or_report(path, text)
    return text


def _known(path: Path) -> tuple[str, Scenario] | None:
    """Text and content of a file; None if it does not exist. Raises ScenarioError."""
    if not path.is_file():
        return None
    text = _decoded(_read(path), path)
    return text, parse_scenario(text, path=path.resolve())


def scenario_data(scenario: Scenario) -> dict[str, Any]:
    """Content of a scenario file, in writing order."""
    data: dict[str, Any] = data_of(Scenario, scenario)
    return data


def scenario_text(scenario: Scenario) -> str:
    """Text of the scenario's source file, or its generated text if it has changed.

    For recordings: without the schema comment for editors, which contains a local path. ``scenario.sha256`` is that of
    the whole file.
    """
    if scenario.path is not None:
        try:
            raw = _read(scenario.path)
        except ScenarioError:
            raw = b""
        if hashlib.sha256(raw).hexdigest() == scenario.sha256:
            return _SCHEMA_ON_THIS_COMPUTER.sub("", raw.decode("utf-8-sig"))
    return yaml_text(scenario_data(scenario))


def parse_scenario(
    text: str,
    *,
    path: Path,
    velocity_topic_of: Callable[[str], str | None] = lambda _robot: None,
    recorded: bool = False,
) -> Scenario:
    """Parse a scenario, as if from ``path``. One that was ``recorded`` may have used plug-ins that are not installed
    here. Raises ScenarioError.
    """
    try:
        source = parse_yaml(text)
    except YamlSourceError as error:
        raise ScenarioError(_at_line(path, error.line, error)) from error
    if not isinstance(source.data, dict):
        raise ScenarioError(
            tr("{path}, line 1: a scenario must be a list of 'key: value' lines.").format(path=_shown(path))
        )
    try:
        data = migrate(source.data)
    except ValueError as error:
        raise ScenarioError(_at_line(path, source.line_of(("version",)), error)) from error
    wrong = mistakes(data, velocity_topic_of, recorded=recorded)
    if wrong:
        raise ScenarioError(problem_lines(_shown(path), source, wrong))
    scenario: Scenario = value_from(Scenario, data)
    return replace(scenario, path=path, sha256=hashlib.sha256(text.encode("utf-8")).hexdigest())


def mistakes(
    data: dict[str, Any],
    velocity_topic_of: Callable[[str], str | None] = lambda _robot: None,
    *,
    recorded: bool = False,
) -> list[Problem]:
    """All mistakes in the content of a scenario file of any version."""
    data = migrate(data)
    if found := list(problems(Scenario, data)):
        return found
    return [*_meaning_problems(data, velocity_topic_of), *(() if recorded else _missing_plugins(data))]


def _missing_plugins(data: dict[str, Any]) -> Iterator[Problem]:
    """Names of plug-ins that are not installed here. A scenario names them; only the user installs them."""
    name = data.get("perception", {}).get("tracker", "")
    if name and name not in BUILT_IN["trackers"] and name not in (here := installed("trackers")):
        unknown = tr("unknown {noun} {value}.").format(noun="tracker", value=quoted(name))
        yield ("perception", "tracker"), f"{unknown} {allowed_words(name, list(here))}"
    assistant = data.get("assistant", {})
    named: list[tuple[KeyPath, PluginGroup, str]] = [
        (("perception", "model"), "detectors", data.get("perception", {}).get("model", "")),
        (("assistant", "model"), "language_models", assistant.get("model", "")),
        (("speech", "name"), "speech", data.get("speech", {}).get("name", "")),
        (("listening", "model"), "speech", data.get("listening", {}).get("model", "")),
    ]
    for index, model in enumerate(assistant.get("models", ())):
        named.append((("assistant", "models", index), "language_models", model))
    for index, camera in enumerate(data.get("cameras", ())):
        named.append((("cameras", index, "source"), "cameras", camera.get("source", "")))
    for key in LAYOUTS:
        for path, _form, value in leaves(LayoutNode, data.get(key) or {}, (key,)):
            if str(value).startswith("plugin:"):
                named.append((path, "panels", value))
    for path, group, value in named:
        provider, _, name = value.partition(":")
        if provider != "plugin":
            continue
        if group == "cameras":
            name = name.partition(":")[0]
        if group == "speech" and not data.get("permissions", {}).get("cloud_models", True):
            yield path, tr("a plug-in may send speech to other computers, which cloud_models does not permit.")
        others = [one.name for one in installed(group).values() if not one.is_built_in]
        if name not in others:
            unknown = tr("unknown {noun} {value}.").format(noun=tr("plug-in"), value=quoted(name))
            found = [f"plugin:{each}" for each in others]
            allowed = allowed_words(value, found) if found else tr("None is installed.")
            yield path, f"{unknown} {allowed}"


def _new_file(scenario: Scenario, data: dict[str, Any], path: Path) -> tuple[str, Scenario]:
    """Text for a new file, from the scenario's source file if it still exists."""
    comment = _schema_comment(path)
    text = yaml_text(data)
    try:
        origin = None if scenario.path is None else _known(scenario.path)
        if origin is not None:
            text, _scenario = changed_text(*origin, data, path)
    except ScenarioError:
        # The source file has changed; there is nothing to preserve.
        pass
    # A relative schema reference is invalid in another folder.
    text, found = _SCHEMA_COMMENT.subn(lambda _match: comment, text, count=1)
    text = text if found else f"{comment}\n{text}"
    return text, parse_scenario(text, path=path.resolve())


def changed_text(before: str, scenario: Scenario, data: dict[str, Any], path: Path) -> tuple[str, Scenario]:
    """``before`` with content ``scenario``, changed to ``data``; unchanged where both agree."""
    # Not imported with the first window: ruamel.yaml takes a tenth of a second.
    from caris_desktop.scenario.text_editing import edited

    text = edited(before, scenario_data(scenario), data)
    try:
        saved = parse_scenario(text, path=path.resolve())
        if scenario_data(saved) == data:
            return text, saved
    except ScenarioError:
        pass
    text = yaml_text(data)
    return text, parse_scenario(text, path=path.resolve())


def _read(path: Path) -> bytes:
    try:
        raw = read_bounded(path, MAX_FILE_BYTES)
    except OSError as error:
        raise ScenarioError(
            tr("{path} cannot be read: {why}.").format(path=_shown(path), why=error.strerror or error)
        ) from error
    if len(raw) > MAX_FILE_BYTES:
        raise ScenarioError(
            tr("{path}: too large for a scenario. Allowed: {most} bytes.").format(
                path=_shown(path), most=MAX_FILE_BYTES
            )
        )
    return raw


def _decoded(raw: bytes, path: Path) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ScenarioError(
            tr("{path}, line {line}: not UTF-8 text ({why}).").format(path=_shown(path), line=line, why=error.reason)
        ) from error


def _at_line(path: Path, line: int, problem: object) -> str:
    return tr("{file}, line {line}: {problem}").format(file=_shown(path), line=line, problem=problem)


def _shown(path: Path) -> str:
    """Path for display, shortened for shipped files."""
    try:
        return str(Path(layouts_dir().name) / path.resolve().relative_to(layouts_dir().resolve()))
    except (ValueError, OSError):
        return str(path)


def _meaning_problems(
    data: dict[str, Any], velocity_topic_of: Callable[[str], str | None] = lambda _robot: None
) -> Iterator[Problem]:
    """Mistakes that a schema cannot express."""
    seen_places: set[str] = set()
    for index, place in enumerate(data.get("places", [])):
        name = place["name"].casefold()
        if name in seen_places:
            yield ("places", index), tr("duplicate place '{name}'.").format(name=place["name"])
        seen_places.add(name)
    phrases: tuple[PhraseEntry, ...] = value_from(tuple[PhraseEntry, ...], data.get("phrases", []))
    for path, problem in phrase_problems(phrases):
        yield ("phrases", *path), problem
    keys = [phrase.key for group in phrase_groups(phrases) for phrase in group.phrases]
    for path, problem in gesture_problems(value_from(tuple[Gesture, ...], data.get("gestures", [])), keys):
        yield ("gestures", *path), problem
    protocol = value_from(ProtocolSettings, data.get("protocol", {}))
    for path, problem in protocol_problems(protocol, [place["name"] for place in data.get("places", [])]):
        yield ("protocol", *path), problem
    robot = data.get("robot", DEFAULT_ROBOT)
    for index, problem in control_problems(data.get("controls", []), lambda: velocity_topic_of(robot)):
        yield ("controls", index), problem
    for key in LAYOUTS:
        if data.get(key) is not None:
            yield from layout_problems(data[key], (key,), set())


def _schema_comment(path: Path) -> str:
    is_shipped = path.resolve().parent == layouts_dir().resolve()
    reference = "../resources/schemas/scenario.schema.json" if is_shipped else schema_path().as_uri()
    return f"# yaml-language-server: $schema={reference}"


def _write_or_report(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, text.encode(), durable=True)
    except OSError as error:
        raise ScenarioError(
            tr("{path} was not written ({why}). The file on disk is unchanged.").format(
                path=_shown(path), why=error.strerror or error
            )
        ) from error


# Scenario library: shipped scenarios and the user's own.

SUFFIXES = (".yaml", ".yml")


_LONGEST_STEM = 60


def own_file_called(title: str) -> Path:
    """Path for a new own scenario of that title."""
    stem = re.sub(r"[\W_]+", "-", title.casefold()).strip("-")[:_LONGEST_STEM].strip("-")
    return user_scenarios_dir() / f"{usable_stem(stem, 'scenario')}.yaml"


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

    Raises ScenarioError if there is none; the text lists what there is.
    """
    path = typed_path(name_or_path)
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
