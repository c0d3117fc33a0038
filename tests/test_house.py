"""Limits for readability, and a GUI thread without file access.

Import cycles are excluded by a contract in pyproject.toml, which test_dependency_rule checks.
"""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.support.parsed_sources import parse_all, parsed

ROOT = Path(__file__).parents[1]
LINES = 1200
"""Limit far above the length of one subject, so that no file is split for its length alone."""
LIMITS = {"live/console.py": 350, "ui/main_window.py": 600}
"""Central files that must stay readable at a glance."""
IN_GUI_THREAD = ("ui/", "live/services/")
WRITING_MODULES = {
    "caris_desktop.domain.file_replacement",
    "caris_desktop.study.study_folder",
    "shutil",
    "sqlite3",
    "tempfile",
}
WRITING_NAMES = {"open", "save_layout", "save_places", "save_profile", "save_scenario"}
WRITING_METHODS = {"fsync", "mkdir", "rmdir", "touch", "unlink", "write_bytes", "write_text"}


# Reading is searched in code of the GUI thread: in all but these files and the functions of ``READ_ASIDE``.
NOT_GUI_THREAD = {
    "live/confirmed_files.py": "slow work, and before the window stands",
    "live/logs.py": "before the window stands, and the log has a thread of its own",
    "live/robot_explorer.py": "its functions run in threads of the asyncio thread",
}
READ_ASIDE = {
    "live/replay_console.py: AnnotationSession.start": "as a replay begins, from which nothing is driven",
    "live/robot_connections.py: _meeting_place": "slow work",
    "live/robot_connections.py: _own_place": "slow work",
    "live/robot_connections.py: _found_consoles": "slow work",
    "live/replay_console.py: _pictures": "slow work",
    "live/speech_history.py: _read": "slow work",
    "live/services/scenario_service.py: _read": "slow work",
    "live/services/photos_service.py": "slow work",
    "live/services/scenario_service.py: ScenarioService._save.work": "slow work",
    "live/session_library.py: _begun_replay": "slow work",
    "live/session_library.py: _holds_something": "slow work",
    "live/session_library.py: LiveSessionLibrary.choose_export_folder.usual_folder": "slow work",
    "ui/export_dialog.py: ExportDialog._choose_folder": "Qt's own file dialog reads the same folder as it opens",
    "ui/help_window.py": "the installed guide, in a window whose opening ends driving",
    "ui/theme.py: _font_files": "the program's own files, once",
    "ui/theme.py: _charmap": "the program's own files, once",
    "ui/window_appearance.py: languages": "the program's own files, once",
    "ui/main_window.py: _read_scenario": "read aside",
    "ui/scenario_editor/saving.py: opened_file": "read aside",
    "ui/scenario_editor/saving.py: opened_as_form": "read aside",
    "ui/scenario_editor/saving.py: reopened": "read aside",
    "ui/scenario_editor/editor_window.py: _names_of_files": "read aside",
    "ui/scenario_editor/editor_window.py: _text_of": "read aside",
    "ui/scenario_editor/editor_window.py: ScenarioEditor._others": "read aside",
    "ui/shortcut_reference.py": "writes the pages of the guide, without a window",
}
READING_NAMES = {
    "check_output", "free_path", "list_profiles", "list_scenarios", "load_documents", "load_profile", "load_scenario",
    "open", "opened_file", "Popen", "scenario_files", "TemporaryFile",
}  # fmt: skip
READING_METHODS = {
    "exists", "glob", "is_dir", "is_file", "is_symlink", "iterdir", "lstat", "read_bytes", "read_text", "resolve",
    "rglob", "samefile", "stat", "walk",
}  # fmt: skip
MODE = re.compile(r"[rwxa][bt]?[+]?$")
READING_OF = {"subprocess": {"Popen", "call", "check_call", "check_output", "run"}, "tempfile": {"TemporaryFile"}}


@pytest.fixture(autouse=True, scope="module")
def all_parsed() -> None:
    parse_all(ROOT / "caris_desktop")


@cache
def files() -> dict[str, str]:
    """Source files by their path below the package."""
    folder = ROOT / "caris_desktop"
    return {path.relative_to(folder).as_posix(): path.read_text("utf-8") for path in folder.rglob("*.py")}


def too_long() -> set[str]:
    return {name for name, text in files().items() if text.count("\n") > LINES}


def files_written(text: str) -> list[str]:
    """Modules and calls in this source that write to a disk."""
    found = []
    for node in ast.walk(parsed(text)):
        match node:
            case ast.Import(names=names):
                found += [each.name for each in names if each.name in WRITING_MODULES]
            case ast.ImportFrom(module=str(module), names=names):
                found += [module] if module in WRITING_MODULES else []
                found += [each.name for each in names if each.name in WRITING_NAMES]
            case ast.Call(func=ast.Name(id=name)) if name in WRITING_NAMES:
                found.append(name)
            case ast.Call(func=ast.Attribute(attr=name)) if name in WRITING_METHODS:
                found.append(name)
    return found


def reads_in(text: str) -> list[tuple[str, str]]:
    """(function, call) of all calls in this source that read files, query a disk or start a program."""
    found = []

    def look(node: ast.AST, within: str) -> None:
        for child in ast.iter_child_nodes(node):
            inside = within
            if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
                inside = f"{within}.{child.name}" if within else child.name
            match child:
                case ast.Call(func=ast.Name(id=name)) if name in READING_NAMES:
                    found.append((within, name))
                case ast.Call(func=ast.Attribute(value=ast.Name(id=module), attr=name)) if name in READING_OF.get(
                    module, ()
                ):
                    found.append((within, name))
                case ast.Call(func=ast.Attribute(attr="open"), args=[ast.Constant(value=str(mode)), *_]) if (
                    re.fullmatch("[rwxa][bt]?[+]?", mode)
                ):
                    found.append((within, "open"))
                case ast.Call(func=ast.Attribute(attr=name)) if name in READING_METHODS:
                    found.append((within, name))
            look(child, inside)

    look(parsed(text), "")
    return found


def excused(name: str, function: str) -> set[str]:
    """Lines of ``READ_ASIDE`` for this function: of the file, the function, or an enclosing function."""
    parts = function.split(".")
    within = {f"{name}: {'.'.join(parts[:count])}" for count in range(1, len(parts) + 1)}
    return {each for each in READ_ASIDE if each == name or each in within}


def test_code_in_the_gui_thread_reads_no_file() -> None:
    """A disk may be on the network. Reads in another thread or without effect on driving are listed above."""
    read, used = list[str](), set[str]()
    for name, text in files().items():
        if name.startswith(("ui/", "live/")) and name not in NOT_GUI_THREAD:
            for function, what in reads_in(text):
                used |= excused(name, function)
                if not excused(name, function):
                    read.append(f"{name}: {function} {what}")
    assert read == []
    assert set(READ_ASIDE) - used == set(), "no exception outlives its reason"
    assert [name for name in NOT_GUI_THREAD if not reads_in(files()[name])] == []


def test_reading_is_seen_however_it_is_done() -> None:
    source = """
class Dialog:
    def show(self):
        self.open()
        path.open("rb")
        if path.parent.exists():
            subprocess.run(["ls"])
        def later():
            return load_profile("mine")
"""
    assert reads_in(source) == [
        ("Dialog.show", "open"), ("Dialog.show", "exists"), ("Dialog.show", "run"),
        ("Dialog.show.later", "load_profile"),
    ]  # fmt: skip
    assert excused("live/speech_history.py", "_read.inner") == {"live/speech_history.py: _read"}
    assert excused("live/speech_history.py", "_read_more") == set()


def test_no_file_is_too_long() -> None:
    assert too_long() == set(), f"over {LINES} lines: split it by subject"


@pytest.mark.parametrize(("name", "lines"), LIMITS.items())
def test_central_files_are_short(name: str, lines: int) -> None:
    assert files()[name].count("\n") <= lines


def test_code_in_the_gui_thread_writes_no_file() -> None:
    """``live/background_worker.py`` or a process writes instead: a disk may take too long for driving."""
    written = {name: files_written(text) for name, text in files().items() if name.startswith(IN_GUI_THREAD)}
    assert len(written) > 20
    assert {name: found for name, found in written.items() if found} == {}


def test_writing_is_seen_however_it_is_done() -> None:
    assert files_written("import sqlite3, json\n") == ["sqlite3"]
    assert files_written("from caris_desktop.scenario.scenario_file import load_scenario, save_places\n") == [
        "save_places"
    ]
    assert files_written("from caris_desktop.domain.file_replacement import replace_file\n")
    assert files_written("open(path)\npath.parent.mkdir()\npath.read_text()\nos.fsync(3)\n") == [
        "open",
        "mkdir",
        "fsync",
    ]


def test_threads_are_started_where_they_are_looked_after() -> None:
    starts = re.compile(r"\b(?:Thread|QThread|ThreadPoolExecutor|QThreadPool)\(")
    assert [name for name, text in files().items() if name.startswith("ui/") and starts.search(text)] == []


def test_yaml_has_one_reader_and_one_place_that_writes_it() -> None:
    reads, writes = re.compile(r"\byaml\.(?:\w+_)?load\w*\("), re.compile(r"\byaml\.(?:\w+_)?dump\w*\(")
    one_text = {"scenario/text_editing.py"}  # edits a single text in a file and checks it as other editors do
    of_the_map_server = {"simulator/simulated_mapping.py"}  # the format of that program
    shipped = {"simulator/shipped_data.py"}  # only files of the program itself, which use references
    assert {name for name, text in files().items() if reads.search(text)} <= one_text | shipped
    assert {name for name, text in files().items() if writes.search(text)} <= (
        {"domain/yaml_files.py"} | one_text | of_the_map_server
    )


CLAUSE = re.compile(r"(What|Who|Whoever|Whatever|Where|Wherever|How|Which|Whether|That|Of what|By which|For how)\b")
"""Clauses at the start of a docstring, which describe behaviour instead of the thing."""
OWN_WORDS = re.compile(
    r"(?:^|_)(told|tells?|telling|kept|keeps?|beside|anew|wish|wishes|meant|patience|looks?|whose|heir|doubt|stretch|"
    r"stretches|way|ways|along|riddle|doubted|spoken_of|going_on|standing|together|distant|ear|painted_once|glance|bands?|"
    r"boxes|give_keys|canaries|wardrobe|dress|gadgets|take_over|catch_up|what_lasts)(?:_|$)"
)
"""Words that an engineer of the field would not search for."""
RECORDED_NAMES = {"look_at", "keep_face", "stretch_mark", "look_up_person", "keep_layout", "person_looks", "tell"}
"""Recorded names, which must stay readable, and a method of Python files."""


def defined_names() -> list[str]:
    """Functions and classes of the program, in snake case."""
    definitions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    nodes = (node for text in files().values() for node in ast.walk(parsed(text)) if isinstance(node, definitions))
    return [re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", node.name).lower() for node in nodes]


def test_a_module_name_exists_once() -> None:
    """A file search must find a single file."""
    names = Counter(Path(name).stem for name in files() if not Path(name).stem.startswith("__"))
    assert [name for name, count in names.items() if count > 1] == []


def test_names_are_words_of_the_field() -> None:
    assert {name for name in defined_names() if OWN_WORDS.search(name)} <= RECORDED_NAMES


def test_a_module_says_what_it_is() -> None:
    docstrings = {name: ast.get_docstring(parsed(text)) or "" for name, text in files().items()}
    empty = {name for name, text in files().items() if not text.strip()}
    assert [name for name, docstring in docstrings.items() if not docstring and name not in empty] == []
    assert [name for name, docstring in docstrings.items() if CLAUSE.match(docstring)] == []
