"""Inference process: newest camera frame in, people out."""

import contextlib
import logging
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import NoReturn

import numpy as np

from caris_desktop.domain import clock
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.events import Problem
from caris_desktop.domain.person_values import LooksKind, PersonLooks
from caris_desktop.domain.plugins import PluginError, PluginFailed
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.perception.appearance_embedding import EmbeddingModelError
from caris_desktop.perception.detector import DetectorAwayError
from caris_desktop.perception.faces import StudyFaces
from caris_desktop.perception.inference_messages import (
    OWN_TRACKER,
    DetectionRequest,
    DetectorAway,
    FrameSkipped,
    InferenceFailed,
    InferenceReady,
    InferenceSettings,
)
from caris_desktop.perception.perceiver import Perceived, Perceiver, open_perceiver
from caris_desktop.perception.pose import Pose
from caris_desktop.perception.tracker import TrackedBox
from caris_desktop.perception.weights import DetectorChoice, WeightsError

log = logging.getLogger(__name__)

_FAILURES_AT_MOST = 5
_ASK_AGAIN_AFTER_S = 2.0


def run_inference(connection: Connection, frames: FrameReader, settings: InferenceSettings) -> None:
    """Process entry point: receives ``DetectionRequest``s and answers with ``People`` for the newest.

    Sends ``InferenceReady`` or ``InferenceFailed`` first. Of waiting frames only the newest is processed; each
    processed frame yields one ``People`` (possibly empty) or one ``FrameSkipped``. ``People`` are followed by
    ``PersonLooks`` with new embeddings, and a ``PersonPortrait`` for each best view so far. Returns when the connection
    closes.
    """
    step_back(settings.niceness)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        _serve(connection, frames, settings)


def _serve(connection: Connection, frames: FrameReader, settings: InferenceSettings) -> None:
    started_ns = clock.now_ns()
    try:
        perceiver = _open(connection, settings)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        raise
    except WeightsError as error:
        log.error("no detector: %s; searched: %s", error, "; ".join(error.searched))  # noqa: TRY400 - no traceback
        meaning: str = QT_TR_NOOP("People are not detected; everything else works.")
        if error.searched:
            meaning = localized(
                QT_TR_NOOP("People are not detected; everything else works. Searched: {places}."),
                places=joined(error.searched, "; "),
            )
        advice = localized(QT_TR_NOOP("{advice}."), advice=error.advice)
        _fail(connection, localized(QT_TR_NOOP("{error}."), error=error), meaning, advice)
    except Exception:
        log.exception("the detector could not be started")
        _fail(
            connection,
            QT_TR_NOOP("The person detector could not be started."),
            QT_TR_NOOP("People are not detected; everything else works."),
            QT_TR_NOOP("Run the setup again; see the log for details."),
        )
    load_s = (clock.now_ns() - started_ns) / 1e9
    log.info(
        "detector %s ready after %.1f s, looks by %s", perceiver.label, load_s, perceiver.appearance_model or "nothing"
    )
    server = without_credentials(settings.detector.server)
    clothing: tuple[LooksKind, ...] = ("clothing",) if perceiver.appearance_model else ()
    has_faces = settings.face_model is not None and settings.face_model.is_file()
    recognises = (*clothing, "face") if has_faces else clothing
    connection.send(InferenceReady(clock.now_ns(), perceiver.label, load_s, server, recognises, perceiver.plugins))
    if perceiver.trouble:
        connection.send(
            _problem(
                perceiver.trouble,
                QT_TR_NOOP("People are tracked, but a person who returns is not recognised by appearance."),
                QT_TR_NOOP("Replace or remove the file in the models folder; see the log for details."),
            )
        )
    if perceiver.unknown_things:
        connection.send(_things_problem(perceiver))
    _follow(connection, frames, perceiver, settings)


def _open(connection: Connection, settings: InferenceSettings) -> Perceiver:
    """Open the perceiver; waits for a remote detector until it is available, or the connection closes."""
    away = ""
    off = {(plugin.group, plugin.name) for plugin in settings.plugins_off}
    detector = settings.detector
    if ("detectors", detector.model.source.removeprefix("plugin:")) in off:
        detector = replace(detector, model=DetectorChoice(input_px=detector.model.input_px))
    while True:
        try:
            return open_perceiver(
                settings.weights_path,
                tracker=OWN_TRACKER if ("trackers", settings.tracker) in off else settings.tracker,
                threads=settings.threads,
                recognise_appearance=settings.recognise_appearance,
                allow_download=settings.allow_download,
                confidence=settings.confidence,
                settings=detector,
                models_folder=None if settings.face_model is None else settings.face_model.parent,
                notify=connection.send,
            )
        except PluginError as error:
            connection.send(PluginFailed(error.plugin, error.reason))
            if error.plugin.group == "detectors":
                _wait_for_end(connection)
            off.add((error.plugin.group, error.plugin.name))
            continue
        except DetectorAwayError as error:
            if str(error) != away:
                away = str(error)
                connection.send(DetectorAway(clock.now_ns(), _away_problem(away)))
        if connection.poll(_ASK_AGAIN_AFTER_S):
            newest(connection)


def _follow(connection: Connection, frames: FrameReader, perceiver: Perceiver, settings: InferenceSettings) -> None:
    failures, away = 0, ""
    faces = StudyFaces(settings.face_model, threads=settings.threads)
    while True:
        request = newest(connection)
        ref = request.frame
        began_ns = clock.now_ns()
        image_bgr = frames.read(ref)
        if image_bgr is None:
            connection.send(FrameSkipped(ref.stamp_ns, ref.camera, ref.sequence))
            continue
        try:
            perceived = perceiver.perceive(image_bgr, request)
        except PluginError as error:
            connection.send(PluginFailed(error.plugin, error.reason))
            if error.plugin.group == "detectors":
                _wait_for_end(connection)
            perceiver.use_own_tracker()
            connection.send(FrameSkipped(ref.stamp_ns, ref.camera, ref.sequence))
            continue
        except DetectorAwayError as error:
            if str(error) != away:
                away = str(error)
                log.warning("pictures are passed over: %s", error)
                connection.send(DetectorAway(clock.now_ns(), _away_problem(away)))
            connection.send(FrameSkipped(ref.stamp_ns, ref.camera, ref.sequence))
            continue
        except Exception:
            failures += 1
            log.exception("frame %d of %s could not be processed", ref.sequence, ref.camera)
            if failures >= _FAILURES_AT_MOST:
                _fail(
                    connection,
                    QT_TR_NOOP("The person detector failed on several camera frames in a row."),
                    QT_TR_NOOP("People are no longer detected; everything else works."),
                    QT_TR_NOOP("Restart the program; see the log for details."),
                )
            connection.send(FrameSkipped(ref.stamp_ns, ref.camera, ref.sequence))
            continue
        failures, away = 0, ""
        work_s = (clock.now_ns() - began_ns) / 1e9
        connection.send(_people(ref, perceived, work_s))
        for message in (*_embeddings(ref, perceived.boxes, perceiver.appearance_model), *perceived.portraits):
            connection.send(message)
        try:
            for face in faces.extract(image_bgr, request, perceived.boxes, perceived.detections.keypoints):
                connection.send(face)
        except EmbeddingModelError as error:
            connection.send(_faces_problem(str(error)))
        time.sleep(rest_s((clock.now_ns() - began_ns) / 1e9, settings))


def _people(ref: FrameRef, perceived: Perceived, work_s: float) -> People:
    return People(
        stamp_ns=ref.stamp_ns,
        camera=ref.camera,
        frame_sequence=ref.sequence,
        frame_width_px=ref.width_px,
        frame_height_px=ref.height_px,
        boxes=tuple(person_box(box, perceived.poses.get(box.track, Pose())) for box in perceived.boxes),
        inference_ms=work_s * 1e3,
        things=perceived.things,
        unfollowed=perceived.unfollowed,
    )


def person_box(box: TrackedBox, pose: Pose) -> PersonBox:
    """PersonBox before identification."""
    return PersonBox(
        box.track,
        "",
        box.left_px,
        box.top_px,
        box.width_px,
        box.height_px,
        box.confidence,
        posture=pose.posture,
        hand_raised=pose.hand_raised,
        facing=pose.facing,
    )


def _embeddings(ref: FrameRef, tracked: list[TrackedBox], model: str) -> list[PersonLooks]:
    return [
        PersonLooks(
            ref.stamp_ns, ref.camera, box.track, "clothing", model, box.embedding.astype(np.float32), box.quality
        )
        for box in tracked
        if box.embedding is not None
    ]


def _fail(connection: Connection, what: str, meaning: str, advice: str) -> NoReturn:
    """Report, then wait for the connection to close: an exit would count as a crash and be restarted."""
    now_ns = clock.now_ns()
    connection.send(InferenceFailed(now_ns, Problem(now_ns, "error", what, meaning, advice, until="people")))
    _wait_for_end(connection)


def _wait_for_end(connection: Connection) -> NoReturn:
    """Wait until the console ends this process: after a detector's failure it starts another one."""
    while True:
        newest(connection)


def newest(connection: Connection) -> DetectionRequest:
    """Wait for a frame; drop all waiting ones but the last. Raises EOFError when the connection closes."""
    request: DetectionRequest = connection.recv()
    while connection.poll():
        request = connection.recv()
    return request


def rest_s(work_s: float, settings: InferenceSettings) -> float:
    """Seconds to idle after ``work_s`` of work.

    A tenth of the period is spared for jitter, else a camera at exactly ``max_hz`` would lose frames.
    """
    for_rate = 0.9 / settings.max_hz - work_s
    for_load = work_s * (1.0 - settings.max_load) / settings.max_load
    return max(0.0, for_rate, for_load)


def _problem(what: str, meaning: str, advice: str) -> Problem:
    return Problem(clock.now_ns(), "warning", what, meaning, advice, until="people")


def _away_problem(reason: str) -> Problem:
    return _problem(
        localized(QT_TR_NOOP("{why}."), why=reason),
        QT_TR_NOOP(
            "The server detects people instead of this computer: no boxes are shown until it responds. "
            "Everything else works."
        ),
        QT_TR_NOOP(
            "The console tries again every two seconds. Check that the server is running, or remove "
            "perception.server from the scenario."
        ),
    )


def _things_problem(perceiver: Perceiver) -> Problem:
    known = ", ".join(sorted(name for name in perceiver.class_names if name))
    return _problem(
        localized(
            QT_TR_NOOP("Classes unknown to the detector: {unknown_things}."),
            unknown_things=", ".join(perceiver.unknown_things),
        ),
        QT_TR_NOOP("These objects get no boxes and are not recorded. People are detected as usual."),
        localized(
            QT_TR_NOOP("Correct perception.classes in the scenario. Classes of this detector: {known}."), known=known
        ),
    )


def _faces_problem(trouble: str) -> Problem:
    return Problem(
        clock.now_ns(),
        "warning",
        trouble,
        QT_TR_NOOP(
            "People are not recognised by their faces. They are still recognised by their clothes if the "
            "scenario permits it."
        ),
        QT_TR_NOOP("Replace or remove models/face.onnx in the study folder, then restart the program."),
    )
