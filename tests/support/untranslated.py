"""Untranslated texts in the sources of the window: user texts that do not go through ``tr``.

``python -m tests.support.untranslated`` counts them by file, and ``python -m tests.support.untranslated
ui/text_formatting.py`` lists those of files whose path starts so. ``--write`` shortens the list of permitted counts.
"""

import argparse
import ast
import re
import sys
from collections import Counter
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import get_args

from caris_desktop.ui.theme import icon_names
from caris_desktop.ui.tokens import Colors
from caris_desktop.ui.widgets.buttons import ButtonRole
from tests.support.parsed_sources import parsed

PACKAGE = Path(__file__).parents[2] / "caris_desktop"
PACKAGES = ("app", "live", "ui")
COUNTS_FILE = Path(__file__).with_suffix(".txt")

_STATE = "internal name of a state, with a separate text in the window"
_PROMPT = "part of a prompt for the language model"
_ROW = "internal name of a timeline row"
_GUIDE = "part of the guide, which is English"
_KEY_NAME = "name of a key in Qt and in the settings"
_ID = "internal name of a palette entry"
_CAP = "label of a key"
_TERMINAL = "output of a command in the terminal, which is English"
_PLAYED = "part of a rehearsal, which is English"
_PROCESS = "name of a process, for the log"
_FOLDER = "name of a folder"
_RECORD = "part of the recording, which is English"
EXEMPT: dict[str, dict[str, str]] = {
    "": {"not checked": _STATE},
    "app/check_command.py": {"*": _TERMINAL},
    "app/anonymise_command.py": {"*": _TERMINAL},
    "app/command_table.py": {"*": _TERMINAL},
    "app/composition.py": {
        "imported bags": _FOLDER,
        "hearing along": _PROCESS,
        "own voice": _PROCESS,
        "camera {}": _PROCESS,
        "keyboard, gamepad or on-screen stick; each command states its source": _RECORD,
        "not permitted": _RECORD,
    },
    "app/export_command.py": {"*": _TERMINAL},
    "app/forget_command.py": {"*": _TERMINAL},
    "app/qt_application.py": {
        "The X11 connection broke": "message of Qt",
        "The Wayland connection broke": "message of Qt",
        "Could not find accessible on path": "message of Qt",
        "Received text event for invalid interface": "message of Qt",
        "Subscription string": "message of Qt",
    },
    "app/perceive_again_command.py": {"*": _TERMINAL},
    "app/plugin_contracts.py": {"*": _TERMINAL},
    "app/statistics_command.py": {"*": _TERMINAL},
    "app/rehearse_command.py": {"*": _PLAYED},
    "app/replay_command.py": {"unsaved annotations": _FOLDER, "CARIS Desktop": "name of the program"},
    "app/robots_command.py": {"ROS {}": _TERMINAL, "Unknown ROS version": _TERMINAL},
    "app/track_command.py": {"*": _TERMINAL},
    "live/services/assistant_service.py": {"Hello.": _PROMPT, "person {}": _PROMPT, "group {}": _PROMPT},
    "live/services/preflight_service.py": {"by hand: {}": "name of a check in the recording"},
    "live/session_library.py": {"{} {} sessions": _FOLDER},
    "live/services/session_service.py": {"plug-in {}": _RECORD},
    "live/services/sound_service.py": {"(the wizard’s own voice)": "recorded instead of the transcript"},
    "live/services/face_service.py": {"face page": _PROCESS},
    "live/services/practice_service.py": {
        "Could you tell me something about this place?": "utterance of the simulated participant"
    },
    "ui/action_rows.py": dict.fromkeys(("Up", "Down", "Left", "Right"), _KEY_NAME),
    "ui/action_bindings.py": {"Enter": _CAP, "Delete": _CAP},
    "ui/key_choices.py": {"phrase: {}": "name of a row in the settings"},
    "ui/robot_dialog.py": {"ROS {} {}": "name of a ROS version"},
    "ui/panels/assistant_panel.py": {"Enter": _CAP},
    "ui/panels/speak_panel.py": {"Tab": _CAP, "Enter": _CAP, "Delete": _CAP},
    "ui/palette/palette_entries.py": {
        "suggest: my key does it": _ID,
        "by itself, after a countdown": _ID,
        "like the system": _ID,
        "{} % from the next start": _ID,
        "as the system has it": _ID,
        "person {}": _ID,
    },
    "ui/replay/timeline_canvas.py": {"tier {}": _ROW},
    "ui/replay/timeline_commands.py": {"tier {}": _ROW},
    "ui/replay/timeline_view.py": {"tier {}": _ROW},
    "ui/replay/timeline_items.py": {"tier {}": _ROW, "pictures {}": _ROW, "sound {}": _ROW, "record {}": _ROW},
    "app/generated_reference.py": {"*": _GUIDE},
    "ui/shortcut_reference.py": {"*": _GUIDE},
    "ui/shortcut_sheet.py": {"Enter": _CAP, "shortcuts unread": "key of the settings"},
    "ui/speak/speak_field.py": {
        "Enter": _CAP,
        "{} (eSpeak)": "names of a voice and its engine",
        "At usual speed": _ID,
    },
    "ui/theme.py": {"*": "names of fonts"},
}
"""Texts that are the same in every language, with the reason, by file ("": all files; "*": all texts)."""

_MARKS = ("tr", "QT_TR_NOOP")
_LOGGED = ("critical", "debug", "error", "exception", "info", "log", "warning")
_USER_ERRORS = ("UserFacingError",)
"""Errors whose texts the wizard reads; texts of other errors go to the log."""

_USER_ERROR_CLASSES = {
    "AnnotationError", "BundleError", "CameraError", "ExportError", "NotFetched", "PeopleStoreError", "Problem",
    "ProfileError", "ScenarioError", "SessionError", "UserFacingError", "UnreadableMediaError", "WeightsError",
}  # fmt: skip
"""Classes that carry texts to the wizard from any package; their subclasses count too."""

_INTERNAL_CALLS = {
    "Event", "Literal", "NewType", "Path", "Property", "QByteArray", "QKeySequence", "QSettings", "Signal", "Thread",
    "TypeVar", "addFont", "cast", "compile", "decode", "encode", "endswith", "execute", "fetch", "find", "findChild",
    "findChildren", "finditer", "fullmatch", "getLogger", "getattr", "get_context", "hasattr", "import_module", "index",
    "insertRule", "match", "open", "partition", "removeprefix", "removesuffix", "search", "setObjectName",
    "setProperty", "setStyle", "setStyleSheet", "setThreadName", "setValue", "set_key", "setattr", "split",
    "startswith", "strftime", "strptime", "value", "invokeMethod",
}  # fmt: skip
"""Functions whose string arguments are not displayed."""

_TERMINAL_CALLS = {
    "ArgumentParser", "CommandParser", "add_argument", "add_argument_group", "add_parser", "print", "reporting",
}  # fmt: skip
"""Functions whose texts appear in the terminal, which is English only."""

_INTERNAL_ARGUMENTS = {
    "id",
    "name",
    "object_name",
    "objectName",
    "key",
    "role",
    "encoding",
    "errors",
    "mode",
    "thread_name",
}
"""Keyword arguments that are not displayed; values of ``name`` only if they contain no blank."""

_DISPLAY_CALLS = {
    "addAction", "addItem", "addMenu", "addTab", "drawText", "insertItem", "setAccessibleDescription",
    "setAccessibleName", "setPlaceholderText", "setStatusTip", "setTabText", "setText", "setTitle", "setToolTip",
    "setWhatsThis", "setWindowTitle", "QLabel", "QPushButton", "QToolButton", "QCheckBox", "QRadioButton", "QGroupBox",
    "ActionButton", "ElidedLabel",
    "set_fact", "set_label", "set_text", "show_text", "show_title", "show_words",
}  # fmt: skip
"""Functions that display their arguments: a single word counts as text."""

_NO_WORDS = {*get_args(ButtonRole), *icon_names(), *(color.name for color in fields(Colors))}
_UNITS = re.compile(r"(?<=\x00)[ \u202f]?(?:ms|s|min|h|Hz|kHz|[kMG]?B(?:/s)?|m|m/s|rad|px|dB|fps)\b")
_ONE_KEY = (
    r"(?:[A-Z\d]|F\d+|Up|Down|Left|Right|Esc|Pause|Backspace|Del|Ins|Home|End|Tab|Space|Return|Enter|PgUp|PgDown)"
)
_KEY = re.compile(rf"(?:(?:Ctrl|Alt|Shift|Meta)\+)*{_ONE_KEY}(?:, {_ONE_KEY})*")
_WORD = r"[A-Za-z]{2,}"
_PROSE = re.compile(rf"(?:^|[\s“(\"\x00])(?:{_WORD}(?:['’-][A-Za-z]+)*)[,.:;!?…”)]*\s+[“(]?[a-zA-Z\x00\d]")
_AFTER_A_VALUE = re.compile(rf"\x00[\s:,]+[“(]?{_WORD}\b")
_LABEL = re.compile(r"^[A-Z][a-z]+(?:[-/][A-Za-z]+)?[.…:!?]*$")
_CODE = re.compile(
    r"[{};]\s*$|\b(?:px|rgba?)\b.*[;}]|^[\w.]+\(|^[A-Z]+ [A-Z]+|^<[^<>]+>$|^\s*--|://|^[\w/.*-]+$|#[0-9a-f]{6}|\w-src "
)


@dataclass(frozen=True, slots=True)
class Found:
    """Untranslated text with file (below ``caris_desktop``) and line; {} marks placeholders."""

    file: str
    line: int
    text: str


def untranslated() -> list[Found]:
    return [found for found in _all() if not _exempt(found)]


def untranslated_errors() -> list[Found]:
    """Texts of errors and problems, in all packages, without tr and QT_TR_NOOP."""
    trees = {path: parsed(path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    classes = [node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    error_classes = set(_USER_ERROR_CLASSES)
    while more := {
        one.name for one in classes if one.name not in error_classes and error_classes & set(map(_name_of, one.bases))
    }:
        error_classes |= more
    found = []
    for path, tree in trees.items():
        finder = _Finder(path.relative_to(PACKAGE).as_posix())
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and _name_of(node.func) in error_classes:
                for argument in (*node.args, *(keyword.value for keyword in node.keywords)):
                    finder.visit(argument)
        found += finder.found
    return [one for one in found if not _exempt(one)]


def counts_by_file() -> dict[str, int]:
    """Number of untranslated texts by file, sorted."""
    return dict(sorted(Counter(found.file for found in untranslated()).items()))


def listed_counts() -> dict[str, int]:
    """Permitted number of untranslated texts by file."""
    lines = (line.split() for line in COUNTS_FILE.read_text("utf-8").splitlines() if line and not line.startswith("#"))
    return {file: int(count) for file, count in lines}


def texts_in(source: str, file: str = "") -> list[Found]:
    """All texts of a source that do not go through ``tr``."""
    finder = _Finder(file)
    finder.visit(parsed(source))
    return finder.found


def unused_exemptions() -> list[str]:
    """Entries of the exemption table that occur in no file any more."""
    said = {(file, text) for one in _all() for file in (one.file, "") for text in (one.text, "*")}
    return [f"{file}: {text!r}" for file, texts in EXEMPT.items() for text in texts if (file, text) not in said]


def _exempt(found: Found) -> bool:
    return any(text in EXEMPT.get(file, {}) for file in (found.file, "") for text in (found.text, "*"))


@cache
def _all() -> tuple[Found, ...]:
    files = sorted(path for package in PACKAGES for path in (PACKAGE / package).rglob("*.py"))
    named = ((path.read_text("utf-8"), path.relative_to(PACKAGE).as_posix()) for path in files)
    return tuple(found for source, file in named for found in texts_in(source, file))


class _Finder(ast.NodeVisitor):
    """Visitor of all string literals that users may read."""

    def __init__(self, file: str) -> None:
        self.found: list[Found] = []
        self._file = file
        self._shown = False

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self._judge(node, node.value)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pieces = [piece.value if isinstance(piece, ast.Constant) else "\0" for piece in node.values]
        self._judge(node, "".join(str(piece) for piece in pieces))
        for piece in node.values:
            if isinstance(piece, ast.FormattedValue):
                self.visit(piece.value)

    def visit_Call(self, node: ast.Call) -> None:
        name = _name_of(node.func)
        if name in _MARKS or name in _TERMINAL_CALLS:
            return
        logged = name in _LOGGED and "log" in _name_of(getattr(node.func, "value", None)).lower()
        if logged or name in _INTERNAL_CALLS or (_raises(name) and name not in _USER_ERRORS):
            self.visit(node.func)  # a chain: "...".join(...).encode("...")
            for argument in node.args:
                if not isinstance(argument, (ast.Constant, ast.JoinedStr)):
                    self.visit(argument)
            return
        self.visit(node.func)
        before, self._shown = self._shown, name in _DISPLAY_CALLS
        for argument in node.args:
            self.visit(argument)
        for keyword in node.keywords:
            if keyword.arg not in _INTERNAL_ARGUMENTS:
                self.visit(keyword.value)
        self._shown = before

    def visit_Dict(self, node: ast.Dict) -> None:
        for key, value in zip(node.keys, node.values, strict=True):
            if key is not None and not isinstance(key, ast.Constant):
                self.visit(key)
            self.visit(value)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.visit(node.value)

    def visit_Compare(self, node: ast.Compare) -> None:
        for side in (node.left, *node.comparators):
            if not isinstance(side, (ast.Constant, ast.Tuple, ast.Set, ast.List)):
                self.visit(side)

    def visit_Tuple(self, node: ast.Tuple) -> None:
        self._visit_all(node.elts)

    def visit_List(self, node: ast.List) -> None:
        self._visit_all(node.elts)

    def visit_Set(self, node: ast.Set) -> None:
        self._visit_all(node.elts)

    def _visit_all(self, elements: list[ast.expr]) -> None:
        if not all(isinstance(one, ast.Constant) and _KEY.fullmatch(str(one.value)) for one in elements):
            for element in elements:
                self.visit(element)

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_Assert(self, _node: ast.Assert) -> None:
        return

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        if not any(isinstance(target, ast.Name) and target.id in ("__all__", "__slots__") for target in node.targets):
            self.visit(node.value)

    def visit_arg(self, _node: ast.arg) -> None:
        return

    def visit_match_case(self, node: ast.match_case) -> None:
        if node.guard is not None:
            self.visit(node.guard)
        for each in node.body:
            self.visit(each)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for each in (*node.decorator_list, node.args, *node.body):
            self.visit(each)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
        for each in (*node.decorator_list, node.args, *node.body):
            self.visit(each)

    def _judge(self, node: ast.expr, text: str) -> None:
        word = self._shown and re.search(rf"(?<![\w#./-]){_WORD}", _UNITS.sub("", text)) and text not in _NO_WORDS
        if word or reads_as_text(text):
            self.found.append(Found(self._file, node.lineno, text.replace("\0", "{}")))


def reads_as_text(text: str) -> bool:
    r"""True if a string looks like text for users; \0 stands for a placeholder."""
    bare = _UNITS.sub("", re.sub(r"</?[a-z][^<>]*>", " ", text)).strip()
    if not re.search(_WORD, bare) or (_CODE.search(bare) and not _LABEL.match(bare)):
        return False
    return bool(_LABEL.match(bare) or _PROSE.search(bare) or _AFTER_A_VALUE.search(bare))


def _name_of(node: ast.AST | None) -> str:
    if isinstance(node, ast.Call):
        return _name_of(node.func)
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _raises(name: str) -> bool:
    return name.endswith(("Error", "Exception")) or name in _USER_ERRORS


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", nargs="?", default="", help="file or folder whose texts are listed")
    parser.add_argument("--write", action="store_true", help="write the shortened list of untranslated texts")
    arguments = parser.parse_args()
    now = counts_by_file()
    if arguments.write:
        before = listed_counts() if COUNTS_FILE.exists() else now
        more = [file for file, count in now.items() if count > before.get(file, 0)]
        for file in more:
            print(f"{file} has {now[file]}, permitted are {before.get(file, 0)}: use tr")
        lower_counts = {file: min(count, before.get(file, 0)) for file, count in now.items() if before.get(file, 0)}
        heading = (
            "# Texts that do not go through tr yet, by file. Written by python -m tests.support.untranslated --write"
        )
        COUNTS_FILE.write_text(
            "\n".join([heading, *(f"{file} {count}" for file, count in lower_counts.items()), ""]), "utf-8"
        )
        return 1 if more else 0
    for found in untranslated() if arguments.file else ():
        if found.file.startswith(arguments.file):
            print(f"{found.file}:{found.line}: {found.text!r}")
    if not arguments.file:
        for file, count in now.items():
            print(f"{count:4} {file}")
        folders = Counter[str]()
        for file, count in now.items():
            folders["/".join(file.split("/")[:-1])] += count
        print(*(f"{count:4} {folder}/" for folder, count in folders.most_common()), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
