"""Command table and dispatch. The console needs Qt; the other commands are composed without it."""

import argparse
import builtins
import gc
import importlib
import io
import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout

from caris_desktop.app.arguments import CommandParser, build_parser
from caris_desktop.domain.foreign_text import PrintableStream, printable
from caris_desktop.live.logs import configure_logging, log_file


def begin_quickly() -> None:
    """Import Qt cheaply, and collect no garbage until the window is shown.

    PySide6 replaces Python's ``import`` for ``from __feature__ import snake_case``: it reads and keeps the source of
    each module imported later, in search of PySide6. Nothing here uses that. Objects created until the first window
    stay, so that collections would only traverse them in vain.
    :class:`~caris_desktop.app.qt_application.GarbageCollector` collects from then on.
    """
    gc.disable()
    plain_import = builtins.__import__
    import PySide6.QtCore  # noqa: F401 - that it is imported now is the point

    builtins.__import__ = plain_import


# Each module has add_arguments(parser) and run(arguments) -> exit status.
COMMANDS = {
    "simulate": ("caris_desktop.simulator.simulate_command", "run a simulated robot behind a rosbridge websocket"),
    "rehearse": ("caris_desktop.app.rehearse_command", "play a scenario in the real console with a scripted wizard"),
    "replay": ("caris_desktop.app.replay_command", "open a recorded session in the console's window"),
    "export": ("caris_desktop.app.export_command", "export recorded sessions as files for analysis"),
    "anonymise": ("caris_desktop.app.anonymise_command", "copy sessions without names, faces and voices"),
    "sessions": ("caris_desktop.recording.studies.sessions_command", "find sessions by what was said in them"),
    "statistics": (
        "caris_desktop.app.statistics_command",
        "compute measures over all sessions of a study",
    ),
    "agreement": (
        "caris_desktop.recording.annotation.agreement_command",
        "compute the agreement between the coders of a session",
    ),
    "track": ("caris_desktop.app.track_command", "track people in a recorded video, as the console does"),
    "forget": ("caris_desktop.app.forget_command", "erase a person from a study"),
    "perceive-again": ("caris_desktop.app.perceive_again_command", "detect people in recordings with another model"),
    "transcribe-again": ("caris_desktop.app.transcribe_again_command", "transcribe recorded speech with another model"),
    "robots": ("caris_desktop.app.robots_command", "list the known robots, and explore an unknown one"),
    "models": (
        "caris_desktop.app.models_command",
        "list, add, remove and serve language models that run in this program",
    ),
    "plugins": ("caris_desktop.app.plugins_command", "list the plug-ins on this computer, and try to load each"),
    "camera-server": ("caris_desktop.app.camera_server_command", "serve a camera to the console on another computer"),
    "perceive": ("caris_desktop.app.perceive_command", "detect people for a console on another computer"),
    "check": ("caris_desktop.app.check_command", "check that everything is ready for a session"),
}

# As for the console, the user waits for a window; importing its parts is half of that time.
_OPEN_A_WINDOW = ("replay",)
# Their output is sentences about events; details for developers go to the log.
_DETAILS_IN_LOG = (
    "export",
    "anonymise",
    "sessions",
    "statistics",
    "agreement",
    "forget",
    "track",
    "perceive-again",
    "transcribe-again",
    "models",
)
_READER_GONE = 141
"""As of a program that SIGPIPE ended, by the rule of shells."""


def run(words: Sequence[str]) -> int:
    """Run a command; without one, open the console."""
    if words and words[0] in COMMANDS:
        if words[0] in _OPEN_A_WINDOW:
            begin_quickly()
        arguments = parser_of(words[0]).parse_args(list(words[1:]))
        if words[0] in _DETAILS_IN_LOG:
            configure_logging(log_file(), terminal=False)
        return _run(COMMANDS[words[0]][0], arguments)
    if words and not words[0].startswith("-"):
        known = f"Commands: {', '.join(COMMANDS)}; without one the console opens."
        print(f"There is no command '{printable(words[0])}'. {known}", file=sys.stderr)
        return 2
    parser = build_parser()
    parser.epilog = f"Other commands: {', '.join(COMMANDS)}. Each has --help."
    arguments = parser.parse_args(list(words))
    begin_quickly()
    return _run("caris_desktop.app.console_command", arguments)


def _run(module_name: str, arguments: argparse.Namespace) -> int:
    """Exit status of a command, whatever its output is connected to."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Names have letters that the encoding of a terminal or file may lack.
            stream.reconfigure(errors="backslashreplace")
    # Titles, words and file names are foreign text; a terminal would execute escape sequences in them. Python leaves a
    # program without a stream that was closed before.
    out, err = (None if stream is None else PrintableStream(stream) for stream in (sys.stdout, sys.stderr))
    try:
        with redirect_stdout(out), redirect_stderr(err):
            status = int(importlib.import_module(module_name).run(arguments))
        if out is not None:
            out.flush()
    except OSError as error:
        if out is None or out.failure is not error:
            raise
        # Python writes what is left once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return _READER_GONE
        print(f"The output could not be written: {error.strerror or error}.", file=sys.stderr)
        return 1
    return status


def parser_of(command: str) -> argparse.ArgumentParser:
    """Argument parser of a command."""
    module_name, description = COMMANDS[command]
    parser = CommandParser(prog=f"caris-desktop {command}")
    parser.description = description[0].upper() + description[1:] + "."
    importlib.import_module(module_name).add_arguments(parser)
    return parser
