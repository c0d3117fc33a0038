"""Plug-ins: code of others behind Python entry points, listed without importing it, and called under watch.

A plug-in is imported and called only in child processes: of detection, of a language model, of a robot, of commands,
and its own. Never in the console, a link or the recorder. Panels are the exception: a widget is part of the window.
"""

import contextlib
import functools
import importlib
import io
import logging
import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Literal, get_args

from caris_desktop import __version__
from caris_desktop.domain.events import Problem
from caris_desktop.domain.foreign_text import printable
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

if TYPE_CHECKING:
    import importlib.metadata

_log = logging.getLogger(__name__)
PluginGroup = Literal[
    "trackers",
    "language_models",
    "detectors",
    "exporters",
    "measures",
    "speech",
    "cameras",
    "robots",
    "panels",
]
GROUPS: tuple[PluginGroup, ...] = get_args(PluginGroup)
INTERFACES: dict[PluginGroup, int] = dict.fromkeys(GROUPS, 1)
"""Version of each interface; a plug-in declares the one that it is written for, as ``caris_interface``."""
BUILT_IN: dict[PluginGroup, dict[str, str]] = {
    "trackers": {
        "own": "caris_desktop.perception.tracker_plugins:OwnTracker",
        "deepsort": "caris_desktop.perception.tracker_plugins:DeepSortTracker",
        "bytetrack": "caris_desktop.perception.tracker_plugins:ByteTrack",
        "botsort": "caris_desktop.perception.tracker_plugins:BotSort",
    },
    "language_models": {},  # those of the program are servers, which a plug-in need not be
    "detectors": {},  # those of the program are files of networks
    "exporters": {
        "csv": "caris_desktop.recording.exporters.csv:write_csv",
        "parquet": "caris_desktop.recording.exporters.parquet:write_parquet",
        "tables": "caris_desktop.recording.exporters.study_tables:write_tables_of_study",
        "eaf": "caris_desktop.recording.exporters.eaf:write_eaf",
        "textgrid": "caris_desktop.recording.exporters.textgrid:write_textgrid",
        "vtt": "caris_desktop.recording.exporters.vtt:write_vtt",
        "rosbag2": "caris_desktop.recording.exporters.rosbag2:write_rosbag2",
        "frames": "caris_desktop.recording.exporters.frames:write_frames",
        "lerobot": "caris_desktop.recording.exporters.frames:write_dataset_of_study",
        "rocrate": "caris_desktop.recording.exporters.rocrate:write_rocrate",
        "html": "caris_desktop.recording.exporters.html:write_html",
        "methods": "caris_desktop.recording.exporters.methods:write_methods_of_study",
    },
    "measures": {},  # those of the program are one query
    "cameras": {
        "file": "caris_desktop.perception.cameras.stream_camera:StreamCamera",
        "stream": "caris_desktop.perception.cameras.stream_camera:StreamCamera",
        "device": "caris_desktop.perception.cameras.device_camera:DeviceCamera",
        "oak": "caris_desktop.perception.cameras.device_camera:OakCamera",
        "http": "caris_desktop.perception.cameras.camera_process:open_http",
        "whep": "caris_desktop.perception.cameras.webrtc_camera:WebRtcCamera",
        "webrtc": "caris_desktop.perception.cameras.webrtc_camera:WebRtcCamera",
        "simulated": "caris_desktop.app.simulated_camera:SimulatedCamera",
    },
    "speech": {},  # those of the program are files of networks, the system's voices, and servers
    "panels": {
        name: f"caris_desktop.ui.panels.{name}_panel:{name.capitalize()}Panel"
        for name in (
            "video",
            "map",
            "drive",
            "people",
            "speak",
            "conversation",
            "assistant",
            "session",
            "robot",
            "motion",
            "photos",
            "face",
            "notes",
            "diagnostics",
        )
    },
    "robots": {"ros2": "caris_desktop.robot.ros2_robot:Ros2Robot"},  # rosbridge itself is no plug-in
}
"""The entry points of this program: also here, since they must be found without reading the metadata of packages."""
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
_OURS = "caris-desktop"
LOAD_WITHIN_S, CALL_WITHIN_S = 60.0, 5.0
"""Deadlines: importing a library of networks takes tens of seconds on a busy computer."""
_MOST_SAID = 200
ENDED = QT_TR_NOOP("it ended its process")


class Plugin(Value):
    """Entry point: ``value`` is ``module:attribute``; ``distribution`` is the package that brings it."""

    name: str
    group: PluginGroup
    distribution: str
    version: str
    value: str

    @property
    def is_built_in(self) -> bool:
        return self.distribution == _OURS

    @property
    def title(self) -> str:
        """Name with its kind, in English, for the record."""
        return f"{self.group.removesuffix('s').replace('_', ' ')} {self.name}"

    @property
    def software_name(self) -> str:
        """Name among the software of a session."""
        return f"plug-in {self.title}"

    @property
    def package(self) -> str:
        return f"{self.distribution} {self.version}".strip()


class PluginCall(Value):
    """Message of a child process: ``plugin`` is called, and returns within that time; None once it has returned."""

    plugin: Plugin | None = None
    within_s: float = 0.0


class PluginFailed(Value):
    """Message of a child process: the plug-in is switched off, and the built-in one is used instead."""

    plugin: Plugin
    reason: str


class PluginError(Exception):
    """Failure of a plug-in; ``reason`` is a clause for the user."""

    def __init__(self, plugin: Plugin, reason: str) -> None:
        super().__init__(reason)
        self.plugin = plugin
        self.reason = reason


def installed(group: PluginGroup) -> dict[str, Plugin]:
    """Plug-ins of a group by name, the built-in ones first. Reads the metadata of all packages, imports nothing."""
    import importlib.metadata  # late: the window's start needs no plug-ins

    found = {name: Plugin(name, group, _OURS, __version__, value) for name, value in BUILT_IN[group].items()}
    others = [
        (*_package(entry), entry.name, entry.value)
        for entry in importlib.metadata.entry_points(group=f"caris_desktop.{group}")
    ]
    for package, version, name, value in sorted(others):
        if package == _OURS:
            continue
        if not re.fullmatch(NAME_PATTERN, name):
            _log.warning("%s of %s is ignored: it is no name for a scenario", printable(name), package)
        elif name in found:  # nobody replaces the meaning of a name that a scenario uses
            _log.warning("%s of %s is ignored: %s has that name", name, package, found[name].distribution)
        else:
            found[name] = Plugin(name, group, package, version, value)
    return found


def _package(entry: "importlib.metadata.EntryPoint") -> tuple[str, str]:
    """Name and version of the package that brings it; empty where its metadata are damaged."""
    try:
        words = (entry.dist.name, entry.dist.version) if entry.dist else ("", "")
    except Exception:  # whatever reading a damaged file raises: one package must not hide the others
        _log.warning("the metadata of the plug-in %s cannot be read", entry.name, exc_info=True)
        words = ("", "")
    package, version = (printable(str(word or "")) for word in words)
    return package, version


def find(group: PluginGroup, name: str) -> Plugin:
    """Plug-in of this name. Raises PluginError if it is not installed."""
    if name in BUILT_IN[group]:
        return Plugin(name, group, _OURS, __version__, BUILT_IN[group][name])
    here = installed(group)
    if name not in here:
        reason = localized(QT_TR_NOOP("it is not installed; installed are {names}"), names=", ".join(here))
        raise PluginError(Plugin(name, group, "", "", ""), reason)
    return here[name]


def load(plugin: Plugin) -> Any:
    """Import a plug-in and check its interface version, which is ours if it is built in.

    Raises PluginError, and whatever its module raises.
    """
    module, _, attributes = plugin.value.partition(":")
    loaded = functools.reduce(getattr, attributes.split("."), importlib.import_module(module))
    written_for, ours = getattr(loaded, "caris_interface", None), INTERFACES[plugin.group]
    if written_for != ours and not plugin.is_built_in:
        reason = QT_TR_NOOP("it is written for version {theirs} of the interface, and this program has version {ours}")
        raise PluginError(plugin, localized(reason, theirs=_shortened(written_for), ours=ours))
    return loaded


@contextlib.contextmanager
def watched(
    plugin: Plugin, notify: Callable[[PluginCall], None] = lambda _call: None, within_s: float = CALL_WITHIN_S
) -> Iterator[None]:
    """Call a plug-in within this block: ``notify`` gets its beginning and end, so that another process can end it.

    Raises PluginError for every failure of the block, and if it has printed: standard output is the result of some
    commands.
    """
    if plugin.is_built_in:
        yield
        return
    notify(PluginCall(plugin, within_s))
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            yield
    except PluginError:
        raise
    except (Exception, SystemExit) as error:
        _log.exception("the plug-in %s of %s failed", plugin.name, plugin.distribution)
        words = f"{type(error).__name__}: {error}".rstrip(": ")
        raise PluginError(plugin, localized(QT_TR_NOOP("it raised {error}"), error=_shortened(words))) from error
    finally:
        notify(PluginCall())
    if printed.getvalue():
        reason = localized(QT_TR_NOOP("it printed “{text}”"), text=_shortened(printed.getvalue()))
        raise PluginError(plugin, reason)


def not_returned(within_s: float) -> str:
    """Reason why a hung plug-in is switched off."""
    return localized(QT_TR_NOOP("it did not return within {seconds} s"), seconds=f"{within_s:g}")


def switched_off(stamp_ns: int, name: str, package: str, reason: str) -> Problem:
    """Alarm about a plug-in that is not used any more."""
    return Problem(
        stamp_ns, "warning",
        localized(
            QT_TR_NOOP("The plug-in {name} was switched off: {reason}."),
            name=f"{name} ({package})" if package else name, reason=reason,
        ),
        QT_TR_NOOP("The built-in one is used until the program is started again; everything else works."),
        QT_TR_NOOP("Update the plug-in, or remove its name from the scenario; the log has details."),
    )  # fmt: skip


def _shortened(text: object) -> str:
    words = printable(" ".join(str(text).split()))
    return words if len(words) <= _MOST_SAID else f"{words[:_MOST_SAID]}…"
