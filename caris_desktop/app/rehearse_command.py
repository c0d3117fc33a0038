"""``caris-desktop rehearse``: scripted wizard in the real console on a simulated robot."""

import argparse
import os
import sys
from collections import Counter
from pathlib import Path

from caris_desktop.app import composition
from caris_desktop.app.arguments import add_accept_named
from caris_desktop.domain.streams import BY_NAME, STATE_STREAMS, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.live.logs import configure_logging
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_reader import Session, SessionError, open_session
from caris_desktop.recording.session_export import FORMATS, ExportContext, ExportError, export_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file or name")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder")
    parser.add_argument("--seconds", metavar="N", type=float, default=0.0, help="minimum duration in seconds")
    parser.add_argument("--seed", metavar="N", type=int, default=7, help="seed of the simulated robot")
    parser.add_argument("--participant", metavar="CODE", default="P07", help="the participant (default: %(default)s)")
    parser.add_argument("--condition", metavar="NAME", default="B", help="the condition (default: %(default)s)")
    parser.add_argument(
        "--camera",
        metavar="SOURCE",
        action="append",
        help="use this camera instead of the simulated robot's; can be repeated, also with 'robot'",
    )
    add_accept_named(parser)
    parser.add_argument("--theme", choices=("system", "dark", "light"), default="dark")
    parser.add_argument("--size", metavar="WxH", help="size of the window (default: as large as the screen)")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 0 if all steps succeeded and the session can be read, replayed and exported."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or sys.platform in ("win32", "darwin")):
        os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    out: Path = arguments.out.resolve()
    try:
        out.mkdir(parents=True, exist_ok=True)
        size_px = [int(number) for number in arguments.size.split("x")] if arguments.size else None
    except OSError as error:
        print(f"Cannot write to {out}: {error}. Choose another --out.", file=sys.stderr)
        return 2
    except ValueError:
        print(f"--size {arguments.size} is not a size such as 1920x1080.", file=sys.stderr)
        return 2
    configure_logging(out / "console.log")

    from PySide6.QtCore import QSettings, Qt
    from PySide6.QtWidgets import QApplication

    from caris_desktop.app.console_command import ConsoleRun, default_arguments
    from caris_desktop.app.demo_robot import PROFILE, DemoRobot
    from caris_desktop.app.rehearsal import Rehearsal, RehearsedParticipant
    from caris_desktop.app.rehearse_command import ReadBack, read_back

    try:
        console_run = ConsoleRun(
            default_arguments(
                scenario=arguments.scenario,
                study=out / "study",
                camera=arguments.camera,
                theme=arguments.theme,
                accept_named=arguments.accept_named,
            ),
            settings=QSettings(str(out / "settings.ini"), QSettings.Format.IniFormat),
            robot=lambda console: DemoRobot(console, seed=arguments.seed),
        )
    except composition.StartError as refusal:
        print(refusal, file=sys.stderr)
        return 2
    if size_px is not None:
        console_run.window.resize(*size_px)
    elif QApplication.platformName() == "offscreen":
        console_run.window.resize(1920, 1080)
    else:
        console_run.window.setWindowState(Qt.WindowState.WindowMaximized)

    def robot_address() -> str | None:
        robot = console_run.demo_robot
        return None if robot is None else robot.address_of(PROFILE)

    participant = RehearsedParticipant(console_run.console.asyncio_thread, robot_address)
    rehearsal = Rehearsal(
        console_run.window,
        console_run.console,
        out,
        seconds=arguments.seconds,
        participant=participant,
        trial={"participant": arguments.participant, "condition": arguments.condition, "wizard": "W1"},
    )
    failures: list[str] = []

    def on_finished(failure: str) -> None:
        failures.append(failure)
        console_run.application.exit(0)

    rehearsal.finished.connect(on_finished)
    console_run.show()
    rehearsal.start()
    try:
        console_run.application.exec()
    finally:
        console_run.close()
    failure = failures[0] if failures else "the window was closed"
    exports, back = out / "exports", ReadBack((), ())
    if not failure and rehearsal.session_folder is not None:
        print("Reading back and exporting the session; this takes a moment.", flush=True)
        back = read_back(rehearsal.session_folder, exports)
    print(f"Session:     {rehearsal.session_folder or console_run.console.session_folder or 'none'}")
    for sentence in back.found:
        print(f"Read back:   {sentence}")
    print(f"Exports:     {exports if exports.is_dir() else 'none'}")
    print(f"Screenshots: {out / 'screenshots'}")
    print(f"Log:         {out / 'console.log'}")
    if failure:
        print(f"The rehearsal stopped: {failure}", file=sys.stderr)
        return 1
    if back.problems:
        print("The rehearsal is complete, but its session has problems:", file=sys.stderr)
        print(
            *back.problems,
            "Do not record with this installation until the problems are solved.",
            sep="\n",
            file=sys.stderr,
        )
        return 1
    print("The rehearsal is complete, and its session is intact.")
    return 0


# Verification of a new recording: read back, replayed and exported to every format.

_OF_FORMAT = QT_TR_NOOP("Export as {format}: {told}")


class ReadBack(Value):
    """Sentences: results ``found``, and ``problems``; without problems the session is complete."""

    found: tuple[str, ...]
    problems: tuple[str, ...]


def read_back(folder: Path, exports: Path) -> ReadBack:
    """Read the closed session in ``folder`` in every supported way; each format has a folder in ``exports``."""
    found: list[str] = []
    problems: list[str] = []
    try:
        session = open_session(folder)
        read = Counter(spec.name for spec, _ in session.values())
        problems += [*session.notices, *session.losses, *_missing(session, read), *_not_replayed(session, read)]
    except SessionError as error:
        return ReadBack((), (str(error),))
    found.append(f"{read.total()} values from {len(read)} streams read back, {session.duration_s:.0f} s replayed.")
    written: list[str] = []
    for each in FORMATS:
        notes: list[str] = []
        try:
            export_session(folder, each.name, exports / each.name, ExportContext(warn=notes.append))
            written.append(each.name)
        except ExportError as error:
            problems.append(localized(_OF_FORMAT, format=each.name, told=localized(str(error))))
        found += [localized(_OF_FORMAT, format=each.name, told=note) for note in dict.fromkeys(notes)]
    return ReadBack((*found, f"Exported formats: {', '.join(written) or 'none'}."), tuple(problems))


def _missing(session: Session, read: Counter[str]) -> list[str]:
    """Streams with more or fewer values in the record than the recorder counted."""
    counted = Counter({name: count for name, count in session.header.counts.items() if name in BY_NAME})
    if not counted:
        return ["The recorder counted no values, so it is unknown whether the recording is complete."]
    return [
        f"{read[name]} of {counted[name]} values of {name} can be read."
        for name in sorted(counted | read)
        if counted[name] != read[name]
    ]


def _not_replayed(session: Session, read: Counter[str]) -> list[str]:
    with SessionTimeline(session) as timeline:
        shown_types = {type(value) for value in timeline.state_at(timeline.end_ns)}
    expected = [spec for spec in STATE_STREAMS if spec.delivery is Delivery.LATEST and read[spec.name]]
    lost = [spec.name for spec in expected if spec.value_type not in shown_types]
    return [f"Missing in the replay: {', '.join(lost)}."] if lost else []
