"""Replay console: shows a recorded session in the same window; nothing can be driven. A stop goes to the robot of a
console that runs at the same time.

GUI thread unless stated otherwise.
"""

import bisect
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

from PySide6.QtCore import QObject, Signal

from caris_desktop.conversation.conversation_transcript import Turn, turns_of
from caris_desktop.domain import intents, person_marks
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import (
    LayoutChanged,
    Marked,
    PhotoDeleted,
    PhotoTagged,
    PhotoTaken,
    Problem,
    RobotChosen,
    ScenarioOpened,
    Severity,
)
from caris_desktop.domain.failure import UserFacingError, reported
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.gate import Gate
from caris_desktop.live.replay_player import PlaybackClock, ReplayPlayer
from caris_desktop.live.replay_video import ReplayFrames, ReplayThumbnails
from caris_desktop.live.robot_connections import LiveRobots
from caris_desktop.live.state import LiveState, LiveValue, PresentClock
from caris_desktop.live.status import LiveRobotsStatus, PhotoEntry
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.recording.annotation.annotation_editing import (
    AnnotationError,
    EditHistory,
    coders_of,
    merge_imported,
    tiers_of_coder,
)
from caris_desktop.recording.annotation.annotation_import import (
    media_spans_ms_of,
    read_csv,
    read_eaf,
)
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.annotation_store import load_documents, save_coder
from caris_desktop.recording.annotation.timeline_builder import run_overview
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.recording.photo_file import PREVIEW_PX, THUMBNAIL_PX, previews
from caris_desktop.recording.session.session_conversation import UTTERANCE_STREAMS
from caris_desktop.recording.session.session_data import read_data
from caris_desktop.recording.session.session_marks import notes_among
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.robot.profile import ListedProfile
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import LayoutNode, Scenario

Tell = Callable[[str, str, str], None]
"""what happened, its meaning, advice"""


class AnnotationSession(QObject):
    """Annotation session. ``coding``: AnnotationDocument of all coders; ``overview``: SessionOverview once computed."""

    _overview_made = Signal(object)
    _overview_missing = Signal()

    def __init__(self, session: Session, problem: Tell, parent: QObject, *, unsaved_dir: Path | None) -> None:
        """``unsaved_dir``: fallback for what cannot be saved in the session folder."""
        super().__init__(parent)
        self._session = session
        self._unsaved_dir = unsaved_dir
        self._problem = problem
        self.overview = LiveValue(None, self)
        self.coding = LiveValue(AnnotationDocument(), self)
        self._history = EditHistory(AnnotationDocument())
        self._slow_work = BackgroundWorker(self)
        self._saved = AnnotationDocument()
        self._overview_maker: ChildProcess | None = None
        self._overview_made.connect(self.overview.set)
        self._overview_missing.connect(self._on_overview_missing)

    def start(self) -> None:
        """Load existing annotations, and compute the overview in the background."""
        document = load_documents(self._session.folder, on_damaged=self._on_damaged)
        self._history = EditHistory(document)
        self._saved = document
        self.coding.set(document)
        # In a separate process: up to a minute of Python, which would make the replay stutter.
        self._overview_maker = ChildProcess(
            ProcessSpec("overview", run_overview, (self._session,)),
            on_message=lambda overview, _raw: self._overview_made.emit(overview),
            on_exit=lambda _code: self._overview_missing.emit(),
        )
        self._overview_maker.start()

    def _on_damaged(self, reason: str) -> None:
        self._problem(
            tr("A coder's annotations cannot be read."),
            tr(reason),
            tr("They are left unchanged; repair or move the file."),
        )

    def close(self) -> str:
        """Wait until everything is saved; returns a message about what could not be, else empty."""
        if self._overview_maker is not None:
            self._overview_maker.stop(grace_s=0.0)
        if self._saved != self._history.document:
            self._save(self._history.document)  # the cause of a failed save may be fixed meanwhile
        self._slow_work.finish(lambda _words, work: work())
        document, saved = self._history.document, self._saved
        if saved == document:
            return ""
        folder = self._session.folder
        lost = tr("The last annotations could not be saved in {folder}.").format(folder=folder)
        try:
            copy = self._store_copy(document, saved)
        except (AnnotationError, OSError):
            _log.exception("not even a copy of the annotations could be kept")
            copy = None
        if copy is not None:
            lost = tr(
                "The last annotations could not be saved in {folder}. A copy is in {copy}: move its files "
                "into the session's folder 'annotations'."
            ).format(folder=folder, copy=copy)
        _log.error(lost)
        return lost

    def _store_copy(self, document: AnnotationDocument, saved: AnnotationDocument) -> Path | None:
        if self._unsaved_dir is None:
            return None
        folder = self._unsaved_dir / f"{self._session.folder.absolute().name} {datetime.now():%Y-%m-%d %H%M%S}"
        folder.mkdir(parents=True, exist_ok=True)
        for coder in coders_of(document):
            if tiers_of_coder(document, coder) != tiers_of_coder(saved, coder):
                save_coder(folder, document, coder)
        return folder / "annotations"

    def edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument]) -> str:
        """Apply a function of ``annotation_editing``, and save the result in the background; returns the reason if
        refused, else empty.
        """
        try:
            document = self._history.apply(edit)
        except AnnotationError as refusal:
            reason = str(refusal)
            return tr(reason)
        self._show(document)
        return ""

    def undo_steps(self) -> tuple[str, str]:
        """Names of the steps that ``undo`` and ``redo`` would change, in the wizard's language; empty for none."""
        return tr(self._history.undo_step), tr(self._history.redo_step)

    def undo(self) -> bool:
        return self._step(self._history.undo)

    def redo(self) -> bool:
        return self._step(self._history.redo)

    def import_annotations(self, path: Path, coder: str, on_result: Callable[[str], None]) -> None:
        """Import an .eaf or CSV file as ``coder``'s; ``on_result`` receives the refusal, or ''."""
        skipped: list[str] = []

        def read() -> AnnotationDocument | str:
            try:
                if path.suffix.lower() == ".eaf":
                    return read_eaf(path, coder=coder, media_spans_ms=media_spans_ms_of(self._session.header))
                return read_csv(
                    path, coder=coder, skipped=skipped, media_spans_ms=media_spans_ms_of(self._session.header)
                )
            except AnnotationError as refusal:
                reason = str(refusal)
                return tr(reason)

        def take(found: AnnotationDocument | str) -> None:
            refused = found if isinstance(found, str) else self.edit(lambda document: merge_imported(document, found))
            if not refused and skipped:
                refused = " ".join([tr("The annotations were imported."), *map(tr, skipped)])
            on_result(refused)

        self._slow_work.do(read, take, lambda failure: on_result(f"{failure.what} {failure.advice}"))

    def _step(self, step: Callable[[], AnnotationDocument]) -> bool:
        before = self.coding.value
        document = step()
        if document == before:
            return False
        self._show(document)
        return True

    def _show(self, document: AnnotationDocument) -> None:
        self.coding.set(document)
        self._save(document)

    def _save(self, document: AnnotationDocument) -> None:
        self._slow_work.do(
            lambda: self._write(document),
            lambda _saved: None,
            lambda failure: self._problem(failure.what, tr(failure.meaning), failure.advice),
        )

    def _write(self, document: AnnotationDocument) -> None:  # background thread
        if document is not self._history.document:
            return  # a newer version is queued
        advice = tr("Free some disk space, or make the session's folder writable; the next change saves them all.")
        with reported((AnnotationError, OSError), tr("Your annotations are not saved."), advice):
            for coder in sorted({*coders_of(document), *coders_of(self._saved)}):
                if tiers_of_coder(document, coder) != tiers_of_coder(self._saved, coder):
                    save_coder(self._session.folder, document, coder)
        self._saved = document

    def _on_overview_missing(self) -> None:
        if self.overview.value is None:
            self._problem(
                tr("The timeline cannot show the recorded data."),
                tr("Replay and annotation still work."),
                tr("Close the replay and open it again; the log has the details."),
            )


_STREAMS = ("event/photo_taken", "event/photo_tagged", "event/photo_deleted")
_AT_MOST = 500


class _SessionReading(QObject):
    """Reads a recorded session in a background thread of its own."""

    def __init__(self, session: Session, state: LiveState, parent: QObject) -> None:
        super().__init__(parent)
        self._session = session
        self._state = state
        self._slow_work = BackgroundWorker(self)

    def close(self) -> None:
        self._slow_work.finish(lambda _what, work: work())

    def _on_failed(self, failure: UserFacingError) -> None:
        _log.warning("%s %s", failure.what, failure.meaning)


class ReplayPhotos(_SessionReading):
    """Photos of a recorded session at the replay's position.

    Maintains ``state.photos``. Photos are read one by one.
    """

    def __init__(self, session: Session, state: LiveState, parent: QObject) -> None:
        super().__init__(session, state, parent)
        self._events: list[Any] = []
        self._pictures: dict[str, tuple[bytes, bytes]] = {}
        state.event_happened.connect(self._on_event)
        state.time_jumped.connect(self._show)

    def start(self) -> None:
        def read() -> list[Any]:
            return [value for _, value in self._session.values(*_STREAMS)]

        def done(events: list[Any]) -> None:
            self._events = events
            self._show()
            self._read_next([event.file_name for event in events if isinstance(event, PhotoTaken)][:_AT_MOST])

        self._slow_work.do(read, done, self._on_failed)

    def _read_next(self, file_names: list[str]) -> None:
        if not file_names:
            return

        def done(pictures: tuple[bytes, bytes]) -> None:
            self._pictures[file_names[0]] = pictures
            self._show()
            self._read_next(file_names[1:])

        self._slow_work.do(lambda: _pictures(self._session.folder, file_names[0]), done, self._on_failed)

    def _on_event(self, event: object) -> None:
        if isinstance(event, PhotoTaken | PhotoTagged | PhotoDeleted):
            self._show()

    def _show(self, _events: object = None) -> None:
        now_ns, utc_ns_at = self._state.present.now_ns(), self._session.clock.anchor.utc_ns_at
        entries: dict[str, PhotoEntry] = {}
        for event in self._events:
            if event.stamp_ns > now_ns:
                continue
            entry = entries.get(event.file_name)
            if isinstance(event, PhotoTaken):
                large, small = self._pictures.get(event.file_name, (b"", b""))
                entries[event.file_name] = PhotoEntry(
                    event.file_name, utc_ns_at(event.stamp_ns), event.camera, event.person_ids, event.pose_in_map,
                    preview_jpeg=large, thumbnail_jpeg=small, changeable=False,
                )  # fmt: skip
            elif entry is not None and isinstance(event, PhotoTagged):
                entries[event.file_name] = replace(entry, tags=event.tags)
            elif entry is not None:
                entries[event.file_name] = replace(entry, deleted=not event.restored)
        there = (entry for entry in entries.values() if not entry.deleted)
        self._state.photos.set(tuple(sorted(there, key=lambda entry: entry.utc_ns, reverse=True)))


def _pictures(folder: Path, file_name: str) -> tuple[bytes, bytes]:
    """Preview and thumbnail; empty for a missing or deleted photo, or one outside the session folder."""
    try:
        path = (folder / file_name).resolve()
        if not path.is_relative_to(folder.resolve()):
            _log.warning("%s names a photo outside of the session: %.200r", folder, file_name)
            return b"", b""
        large, small = previews(path, PREVIEW_PX, THUMBNAIL_PX)
    except (OSError, ValueError) as error:  # PhotoFileError is a ValueError, as is an impossible file name
        _log.info("%.200r is not shown: %.200s", file_name, error)
        return b"", b""
    return large, small


class ReplayTranscript(_SessionReading):
    """Complete transcript and notes of a recorded session.

    Sets ``state.transcript`` and ``state.notes`` once, including later corrections.
    """

    def start(self) -> None:
        self._slow_work.do(self._read_turns, self._state.transcript.reset_value, self._on_failed)
        self._slow_work.do(
            lambda: notes_among(read_data(self._session, (Marked,)).marks),
            self._state.notes.reset_value,
            self._on_failed,
        )

    def _read_turns(self) -> tuple[Turn, ...]:
        return turns_of(value for _, value in self._session.values(*UTTERANCE_STREAMS))


_log = logging.getLogger(__name__)
_REFUSE_EVERY_NS = 8_000_000_000
# Tolerance so that "next" leaves the current event.
_SAME_MOMENT_NS = 20_000_000
T = TypeVar("T")


class ReplayAdapters(Value):
    """Adapters of a replay, chosen in ``app``. ``read_scenario``, ``read_layout`` and ``read_robot`` raise ValueError
    for unsupported records; ``start_scenario`` is the default until the record names one. ``name_of`` returns names of
    people. ``unsaved_dir``: fallback for annotations that cannot be saved in the session. ``live_consoles``: folder of
    running consoles, whose robots can be stopped from here.
    """

    start_scenario: Scenario
    read_scenario: Callable[[ScenarioOpened], Scenario]
    read_layout: Callable[[LayoutChanged], LayoutNode]
    read_robot: Callable[[RobotChosen], RobotProfile]
    name_of: Callable[[str], str | None]
    end_ns: int
    cameras: tuple[str, ...]
    frame_times: Callable[[str], list[int]]
    monotonic_ns: Callable[[], int]
    unsaved_dir: Path | None = None
    live_consoles: Path | None = None


class ReplayConsole(QObject):
    """Implements WizardConsole, refusing intents, and controls the replay. Every call returns at once.

    ``playback`` holds a PlaybackStatus, ``overview`` a SessionOverview once computed (None until then), ``coding`` the
    annotations of all coders as an AnnotationDocument. ``live_robots`` holds a LiveRobotsStatus of robots that intents
    to stop affect.
    """

    thumbnail_made = Signal(str, object, object)
    """(camera, at_ns, image_bgr): a requested thumbnail; an empty array if there is no image."""
    noticed = Signal(object)
    """(Problem): problems of the replay itself; those of the session are in its log."""
    microphone: str | None = None
    wizard_microphone: str | None = None

    def __init__(self, parts: ReplayAdapters, session: Session, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._parts = parts
        self.session = session
        # A bag of another program has unknown places; those of the default scenario would be wrong.
        foreign = bool(session.header.source)
        self._stand_in = replace(parts.start_scenario, places=()) if foreign else parts.start_scenario
        self.scenario = self._stand_in
        # Scenario as in its file, without the wizard's layout.
        self._opened = self._stand_in
        self._layout: LayoutNode | None = None
        self.unsaved = ""
        self._unreadable: set[Any] = set()
        self._refused_ns = 0
        self._clock = PlaybackClock(session.started_ns, parts.end_ns, now_ns=parts.monotonic_ns)
        anchor: ClockAnchor = session.clock.anchor
        self.state = LiveState(self, present=PresentClock(self._clock.position_ns, anchor, live=False))
        self.frames = ReplayFrames()
        self._slow_work = BackgroundWorker(self)
        self._player = ReplayPlayer(
            session,
            self._clock,
            self.state,
            self.frames,
            name_of=parts.name_of,
            frame_times=parts.frame_times,
            parent=self,
        )
        self._player.standing_changed.connect(self._on_state_changed)
        self._player.standing_jumped.connect(self._on_state_jumped)
        self._coding = AnnotationSession(session, partial(self._notify, "error"), self, unsaved_dir=parts.unsaved_dir)
        self._thumbnails = ReplayThumbnails(session, self.thumbnail_made.emit)
        self.play, self.pause, self.set_rate = self._player.play, self._player.pause, self._player.set_rate
        self.seek, self.step = self._player.seek, self._player.step
        self.edit, self.import_annotations = self._coding.edit, self._coding.import_annotations
        self.undo, self.redo, self.undo_steps = self._coding.undo, self._coding.redo, self._coding.undo_steps
        self.playback, self.overview, self.coding = self._player.playback, self._coding.overview, self._coding.coding
        self.request_thumbnail = self._thumbnails.request
        self._photos = ReplayPhotos(session, self.state, self)
        self._transcript = ReplayTranscript(session, self.state, self)
        self._live = None if parts.live_consoles is None else LiveRobots(parts.live_consoles, self._notify, self)
        self.live_robots = LiveValue(LiveRobotsStatus(), self) if self._live is None else self._live.status
        self.report = self.noticed.emit
        self._gate = Gate(self.state, lambda: self.scenario.permissions, replay=True)
        self.state.scenario.set(self.scenario)
        self.state.places.set(self.scenario.places)
        self.state.cameras.set(parts.cameras)

    def with_names(self, text: str) -> str:
        """Transcript text with names in place of recorded ids, if the scenario permits them."""
        naming = self.scenario.permissions.naming_people

        def name_of(person_id: str) -> str:
            return (self._parts.name_of(person_id) if naming else None) or "somebody"

        return person_marks.with_names(text, name_of)

    # Start and shutdown

    def start(self) -> None:
        self._player.start()
        self._thumbnails.start()
        self._photos.start()
        self._transcript.start()
        self._coding.start()
        if self._live is not None:
            self._live.start()
        session = self.session
        notices = dict.fromkeys((*session.notices, *session.losses))
        if notices:
            cut = not session.closed_properly
            self._notify(
                "warning",
                tr("This session was interrupted while it was being recorded.")
                if cut
                else tr("Part of this session is missing."),
                " ".join(map(tr, notices)),
                tr("The remaining data is shown. Data found by a repair is saved in the session's folder 'recovered'.")
                if session.header.repairs
                else tr("The remaining data is shown. If there is a copy of the session, restore the files from it."),
            )

    def shutdown(self) -> None:
        """Save annotations and end the threads; blocks some seconds at most. ``unsaved`` reports what could not be
        saved.
        """
        self.unsaved = self._coding.close() or self.unsaved
        if self._live is not None:
            self._live.shutdown()
        self._player.close()
        self._thumbnails.close()
        self._photos.close()
        self._transcript.close()
        self._slow_work.finish(lambda _words, wait: wait())
        self.state.close()

    # State for the window

    @property
    def settled(self) -> bool:
        """Whether the display matches the position."""
        return self._player.settled

    def jump(self, kind: Literal["mark", "utterance"], direction: Literal[-1, 1]) -> bool:
        """Go to the next mark or utterance in that direction; False if there is none."""
        overview: SessionOverview | None = self._coding.overview.value
        if overview is None:
            return False
        moments = sorted(moment.at_ns for moment in overview.moments if moment.kind == kind)
        position_ns = self._clock.position_ns()
        if direction > 0:
            index = bisect.bisect_right(moments, position_ns + _SAME_MOMENT_NS)
        else:
            # Going back right after an event goes to the one before it.
            index = bisect.bisect_left(moments, position_ns - (500_000_000 if self._clock.playing else 0)) - 1
        if not 0 <= index < len(moments):
            return False
        self._player.seek(moments[index])
        return True

    # Recorded scenario, robot and layout

    def _on_state_changed(self, event: Any) -> None:
        self._hold(event)
        self._show_scenario()

    def _on_state_jumped(self, events: Sequence[Any]) -> None:
        self._opened, self._layout = self._stand_in, None
        for event in events:
            self._hold(event)
        self._show_scenario()

    def _hold(self, event: Any) -> None:
        try:
            if isinstance(event, ScenarioOpened):
                opened = replace(self._parts.read_scenario(event), sha256=event.sha256)
                before = self._opened
                # Saving a place rewrites the file but leaves the panels.
                if replace(opened, places=before.places, path=before.path, sha256=before.sha256) != before:
                    self._layout = None
                self._opened = opened
            elif isinstance(event, LayoutChanged):
                self._layout = self._parts.read_layout(event)
            elif isinstance(event, RobotChosen):
                self.state.robot.set(self._parts.read_robot(event))
        except ValueError as error:
            if event not in self._unreadable:
                self._unreadable.add(event)
                _log.warning("%s of the session is not shown: %s", type(event).__name__, error)

    def _show_scenario(self) -> None:
        displayed = self._opened if self._layout is None else replace(self._opened, layout=self._layout)
        if displayed != self.scenario:
            self.scenario = displayed
            self.state.scenario.set(displayed)

    # Intents: refused, because the session is over

    def do(self, intent: Intent) -> str:
        refusal = self._gate.refusal(intent)
        if refusal is None:
            if isinstance(intent, intents.Stop):
                if self._live is not None:  # Esc also closes popups, so it is not refused without a live robot
                    self._live.stop()
            elif isinstance(intent, intents.EmergencyStop):
                if self._live is None:
                    self._report_no_robot()
                else:
                    self._live.emergency_stop(self._report_no_robot)
            return ""
        if not refusal.quiet:
            now_ns = self._parts.monotonic_ns()
            if now_ns - self._refused_ns >= _REFUSE_EVERY_NS:
                self._refused_ns = now_ns
                self._notify(refusal.severity, refusal.what, refusal.meaning, refusal.advice)
        return refusal.what

    def _notify(self, severity: Severity, what: str, meaning: str, advice: str) -> None:
        _log.info("%s %s %s", what, meaning, advice)
        self.report(Problem(self._clock.position_ns(), severity, what, meaning, advice))

    def _report_no_robot(self) -> None:
        self._notify(
            "info",
            tr("There is no live robot to stop."),
            tr("This is a replay, and no live console of yours is running on this computer."),
            "",
        )

    def robots(self) -> Sequence[ListedProfile]:
        return ()

    def check_before_recording(self, on_result: Callable[[BeforeRecording], None]) -> None:
        on_result(BeforeRecording())

    def run_in_background(
        self, read: Callable[[], T], done: Callable[[T], None], failed: Callable[[UserFacingError], None] | None = None
    ) -> None:
        def report(failure: UserFacingError) -> None:
            self._notify("error", failure.what, failure.meaning, failure.advice)

        self._slow_work.do(read, done, report if failed is None else failed)

    def microphones(self) -> Sequence[str]:
        return ()
