"""Hooks and fixtures of all tests."""

import fnmatch
import gc
import itertools
import os
import shutil
import sys
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from xdist.workermanage import WorkerController

from tests.support.examples import examples
from tests.support.leak_checks import (  # noqa: F401 - fixtures of every test
    no_leaks,
    no_leaks_of_module,
    no_unexpected_warnings,
    record_failure,
    use_private_temp_dir,
)
from tests.support.workers import LoadFileOnceScheduling, RunningTests, exit_description

# Default to Qt's offscreen platform; tests that need a window manager start a virtual screen themselves.
os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
# As in the console on few cores. All painting time is then spent in the measured thread.
os.environ.setdefault("QT_NO_GUI_THREADPOOL", "1")


_TESTS_BETWEEN_COLLECTIONS = 25
_tests = itertools.count(1)

# As in the console: garbage Qt objects must not be destroyed in the thread that happens to allocate next.
gc.disable()


def pytest_collection_finish() -> None:
    """Exclude objects that exist before the first test from garbage collection."""
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """Freeze the objects that a test file leaves, such as imported modules, to keep later collections short."""
    ends_module = nextitem is None or nextitem.path != item.path
    if not ends_module and next(_tests) % _TESTS_BETWEEN_COLLECTIONS == 0:
        gc.collect()
    yield
    if ends_module:
        gc.collect()
        gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Replace lone surrogates in captured logs: xdist sends reports as UTF-8 and would abort the run."""
    report = yield
    record_failure(item, report)
    report.sections = [(name, text.encode("utf-8", "replace").decode("utf-8")) for name, text in report.sections]
    return report


def pytest_configure(config: pytest.Config) -> None:
    use_private_temp_dir()
    config.pluginmanager.register(RunningTests())
    if config.getoption("--long"):
        os.environ["CARIS_TEST_LONG"] = "1"
    else:
        # The same examples in each run, so that a change is judged alike; ``--long`` runs search for new ones. No
        # deadline: the duration of an example depends on the load of the machine.
        settings.register_profile(
            "same examples", derandomize=True, max_examples=examples(100), deadline=None,
            suppress_health_check=(HealthCheck.too_slow,),
        )  # fmt: skip
        settings.load_profile("same examples")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileOnceScheduling | None:
    split_files = [f"tests/{file}" for file in _SPLIT_BY_TEST]
    return LoadFileOnceScheduling(config, log, split_files) if config.getoption("dist") == "loadfile" else None


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: WorkerController, error: object | None) -> None:
    if error:
        print(f"\n{node.gateway.id}: {exit_description(node)}")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="also run what takes minutes, and more cases")


# The longest files start first, so that no worker is left with one of them at the end.
_LONGEST_FIRST = (
    "app/test_rehearsal.py",
    "app/test_safety.py", "robot/test_link.py", "app/test_type_and_drive.py", "app/test_console_and_robot.py",
    "app/test_stops_and_kills.py", "app/test_beside_a_misbehaving_model.py", "ui/test_desktop.py",
    "app/test_nothing_lost.py",
    "robot/test_link_faults.py", "conversation/test_synthesis.py", "robot/test_every_profile.py",
    "robot/test_guard_in_simulator.py",
    "robot/test_link_and_simulator.py", "perception/test_inference.py", "app/test_track_command.py",
    "recording/recorder/test_recorder_process.py", "perception/backends/test_onnx_export.py",
    "simulator/test_slow_link.py", "recording/forgetting/test_study_erasure.py",
    "recording/session/test_two_clocks.py", "test_plugin_examples.py",
    "live/test_face_page_in_chromium.py", "simulator/test_simulate_command.py",
    "simulator/test_picture.py", "test_workers.py", "ui/test_tab_order.py", "ui/test_switching.py",
    "ui/test_every_window.py", "ui/test_timeline.py", "ui/test_screen_reader.py", "ui/palette/test_palette_entries.py",
    "ui/test_window.py", "ui/test_every_size.py", "ui/test_observer_window.py", "ui/test_permissions.py",
)  # fmt: skip
# A rehearsal runs in real time. These files start one console after another and would leave it too little CPU time.
_NOT_DURING_REHEARSAL = ("app/test_bad_input.py", "app/test_robot_room.py")
# Long files whose tests share no fixture: the tests are distributed over all workers.
_SPLIT_BY_TEST = ("app/test_bad_input.py",)


def _sort_key(item: pytest.Item) -> int:
    file = item.path.relative_to(Path(__file__).parent).as_posix()
    if file in _NOT_DURING_REHEARSAL:
        return len(_LONGEST_FIRST) + 1
    return _LONGEST_FIRST.index(file) if file in _LONGEST_FIRST else len(_LONGEST_FIRST)


def _is_long(item: pytest.Item) -> bool:
    """True if a test is marked ``long``, or is a variant whose id matches the pattern of its mark."""
    variant = item.callspec.id if isinstance(item, pytest.Function) and hasattr(item, "callspec") else ""
    marks = item.iter_markers("long")
    return any(not mark.args or any(fnmatch.fnmatchcase(variant, each) for each in mark.args) for mark in marks)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=_sort_key)
    if config.getoption("--long"):
        return
    for item in items:
        if _is_long(item):
            item.add_marker(pytest.mark.skip(reason="runs with --long"))


@pytest.fixture
def trial_language() -> Iterator[None]:
    """Translate with the trial language: texts that go through ``tr`` get its marks, other texts stay English."""
    from caris_desktop.domain.translation import use_translator
    from caris_desktop.ui.window_appearance import in_trial_language

    use_translator(in_trial_language)
    yield
    use_translator(None)


@pytest.fixture(autouse=True)
def isolated_settings(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Separate home for each test: the user's settings, data and documents are neither read nor written."""
    # A short path: socket paths are limited to 107 characters.
    home = Path(tempfile.mkdtemp(prefix="home-"))
    module_folder = Path(os.environ["XDG_CONFIG_HOME"])
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "XDG_DOCUMENTS_DIR"):
        monkeypatch.setenv(name, str(home / name.lower()))
    _set_qt_settings_folder(home / "xdg_config_home")
    yield home
    _set_qt_settings_folder(module_folder)
    shutil.rmtree(home)


def _set_qt_settings_folder(folder: Path) -> None:
    """Set the settings folder of Qt, which reads XDG_CONFIG_HOME only once per process.

    Without this, a file dialog would write into the removed home of an earlier test.
    """
    if "PySide6.QtCore" not in sys.modules:
        return
    from PySide6.QtCore import QSettings

    for form in (QSettings.Format.NativeFormat, QSettings.Format.IniFormat):
        QSettings.setPath(form, QSettings.Scope.UserScope, str(folder))
