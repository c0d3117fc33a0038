"""Minimal imports and garbage collections before the window accepts keys."""

import json
import subprocess
import sys

_STARTS = """
import builtins, gc, json, linecache, sys
from caris_desktop.app import command_table
plain = builtins.__import__
command_table.begin_quickly()
from caris_desktop.app import console_command
print(json.dumps({
    "plain": builtins.__import__ is plain, "collects": gc.isenabled(), "read": len(linecache.cache),
    "modules": sorted({name.partition(".")[0] for name in sys.modules}),
}))
"""
_REPLAYS = """
import builtins, gc, json, linecache, sys
from unittest import mock
from caris_desktop.app import command_table
plain = builtins.__import__
found = {}
def look(_module):
    found.update(plain=builtins.__import__ is plain, collects=gc.isenabled(), qt="PySide6.QtCore" in sys.modules)
    print(json.dumps(found))
    sys.exit()
with mock.patch("importlib.import_module", look):
    command_table.run(["replay", "nowhere"])
"""
_LATER = {"cryptography", "httpx", "psutil", "pyqtgraph", "roslibpy", "ruamel", "websockets"}
"""Modules that the first window does not need, only a robot, a known person or a question."""


def test_a_replay_begins_as_quickly() -> None:
    """Before any import of the replay, which imports Qt."""
    program = subprocess.run([sys.executable, "-c", _REPLAYS], capture_output=True, text=True, check=True, timeout=100)
    assert json.loads(program.stdout) == {"plain": True, "collects": False, "qt": True}


def test_a_window_comes_without_what_it_does_not_need() -> None:
    program = subprocess.run([sys.executable, "-c", _STARTS], capture_output=True, text=True, check=True, timeout=100)
    found = json.loads(program.stdout)
    assert found["plain"]
    assert found["read"] < 10, "Qt's own import reads the source of every module"
    assert not found["collects"], "the console collects once its window stands"
    assert _LATER.isdisjoint(found["modules"])
