"""What all tests share."""

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
    no_unexpected_words,
    nothing_of_the_file_stays,
    nothing_stays,
    remember_failure,
    use_private_folder,
)
from tests.support.workers import FilesOnce, UnderWay, end_of

# Without a screen of its own a test run uses Qt's offscreen platform; tests that need a window manager start a
# virtual screen themselves.
os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
# As in the console on few cores; and what painting costs is then all in the thread that is measured.
os.environ.setdefault("QT_NO_GUI_THREADPOOL", "1")


_TESTS_BETWEEN_COLLECTIONS = 25
_tests = itertools.count(1)

# As in the console: Qt objects that are garbage must not be destroyed in whichever thread allocates next.
gc.disable()


def pytest_collection_finish() -> None:
    """What is there before the first test stays, and need not be looked through each time."""
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """What a file leaves lasts, as what it imported: looked through each time, it would cost more with each file."""
    of_file_end = nextitem is None or nextitem.path != item.path
    if not of_file_end and next(_tests) % _TESTS_BETWEEN_COLLECTIONS == 0:
        gc.collect()
    yield
    if of_file_end:
        gc.collect()
        gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """What a test logged may hold half a character; reports travel between processes as UTF-8, or end the run."""
    report = yield
    remember_failure(item, report)
    report.sections = [(name, text.encode("utf-8", "replace").decode("utf-8")) for name, text in report.sections]
    return report


def pytest_configure(config: pytest.Config) -> None:
    use_private_folder()
    config.pluginmanager.register(UnderWay())
    if config.getoption("--long"):
        os.environ["CARIS_TEST_LONG"] = "1"
    else:
        # A change is judged by the same examples each time; new ones are looked for where there is time for it.
        # No verdict by the clock: how long examples take says how busy the machine is.
        settings.register_profile(
            "same examples", derandomize=True, max_examples=examples(100), deadline=None,
            suppress_health_check=(HealthCheck.too_slow,),
        )  # fmt: skip
        settings.load_profile("same examples")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> FilesOnce | None:
    by_test = [f"tests/{file}" for file in _BY_TEST]
    return FilesOnce(config, log, by_test) if config.getoption("dist") == "loadfile" else None


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: WorkerController, error: object | None) -> None:
    if error:
        print(f"\n{node.gateway.id}: {end_of(node)}")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="also run what takes minutes, and more cases")


# Those that take longest begin first, so that no worker has one of them left when the others are done.
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
    "recording/session/test_two_clocks.py", "live/test_face_page_in_chromium.py", "simulator/test_simulate_command.py",
    "simulator/test_picture.py", "test_workers.py", "ui/test_tab_order.py", "ui/test_switching.py",
    "ui/test_every_window.py", "ui/test_timeline.py", "ui/test_screen_reader.py", "ui/palette/test_palette_entries.py",
    "ui/test_window.py", "ui/test_every_size.py", "ui/test_observer_window.py", "ui/test_permissions.py",
)  # fmt: skip
# A rehearsal is played in real time; beside these, which start one console after the other, too little is left for it.
_NOT_BESIDE_A_REHEARSAL = ("app/test_bad_input.py", "app/test_robot_room.py")
# Long files without anything that their tests share: any worker takes the next test of one.
_BY_TEST = ("app/test_bad_input.py",)


def _turn(item: pytest.Item) -> int:
    file = item.path.relative_to(Path(__file__).parent).as_posix()
    if file in _NOT_BESIDE_A_REHEARSAL:
        return len(_LONGEST_FIRST) + 1
    return _LONGEST_FIRST.index(file) if file in _LONGEST_FIRST else len(_LONGEST_FIRST)


def _is_long(item: pytest.Item) -> bool:
    """Whether a test is marked ``long``, or is one of the variants that its mark names by pattern."""
    variant = item.callspec.id if isinstance(item, pytest.Function) and hasattr(item, "callspec") else ""
    marks = item.iter_markers("long")
    return any(not mark.args or any(fnmatch.fnmatchcase(variant, each) for each in mark.args) for mark in marks)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=_turn)
    if config.getoption("--long"):
        return
    for item in items:
        if _is_long(item):
            item.add_marker(pytest.mark.skip(reason="runs with --long"))


@pytest.fixture
def trial_language() -> Iterator[None]:
    """What is shown goes through ``tr`` and so bears its marks; what stays English bears none."""
    from caris_desktop.domain.translation import use_translator
    from caris_desktop.ui.language import in_trial_language

    use_translator(in_trial_language)
    yield
    use_translator(None)


@pytest.fixture(autouse=True)
def own_settings(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """No test reads or writes the settings, data or documents of whoever runs it."""
    # With a short path, as sockets need.
    home = Path(tempfile.mkdtemp(prefix="home-"))
    of_the_file = Path(os.environ["XDG_CONFIG_HOME"])
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "XDG_DOCUMENTS_DIR"):
        monkeypatch.setenv(name, str(home / name.lower()))
    _keep_settings_in(home / "xdg_config_home")
    yield home
    _keep_settings_in(of_the_file)
    shutil.rmtree(home)


def _keep_settings_in(folder: Path) -> None:
    """Qt looks at XDG_CONFIG_HOME once in a process: a file dialog would write into the home of whichever test had the
    first settings, and so make anew what is gone.
    """
    if "PySide6.QtCore" not in sys.modules:
        return
    from PySide6.QtCore import QSettings

    for form in (QSettings.Format.NativeFormat, QSettings.Format.IniFormat):
        QSettings.setPath(form, QSettings.Scope.UserScope, str(folder))
