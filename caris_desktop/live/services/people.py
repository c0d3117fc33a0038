"""Who is in front of the robot: perception in a thread of its own."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from PySide6.QtCore import QObject, Qt, QThread

from caris_desktop.domain import intents
from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.events import Event
from caris_desktop.domain.sensing import CameraLens, FrameRef, HeadState, LaserScan, Odometry, RobotPose
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessBody, RingsToRead
from caris_desktop.live.perception_worker import PerceptionWorker
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.people.presence import Presence
from caris_desktop.robot.profile import RobotProfile

_log = logging.getLogger(__name__)
_ENDS_WITHIN_MS = 5000


@dataclass(frozen=True, slots=True)
class PeopleParts:
    """``inference`` is None where nobody is looked for."""

    inference: ProcessBody | None
    open_presence: Callable[[], tuple[Presence, list[Event]]]


class PeopleService(Service):
    """Runs the perception worker."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        parts: PeopleParts,
        *,
        rings: RingsToRead,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._parts = parts
        self._rings = rings
        self._thread = QThread(self)
        self._thread.setObjectName("perception")
        self._worker: PerceptionWorker | None = None
        state.robot.changed.connect(self._on_cameras_changed)
        state.own_cameras.changed.connect(self._on_cameras_changed)
        state.camera.changed.connect(self._on_camera_changed)
        bus.tap(self._offer, (FrameRef, LaserScan, Odometry, RobotPose, HeadState, CameraLens))

    def handlers(self) -> Handlers:
        return {intents.NamePerson: self._name}

    @property
    def inference_pid(self) -> int | None:
        return None if self._worker is None else self._worker.child_pid

    def start(self) -> None:
        body = self._parts.inference
        if body is None:
            return
        worker = PerceptionWorker(
            replace(body, arguments=(self._rings, *body.arguments)), self._parts.open_presence, self._bus.publish
        )
        worker.moveToThread(self._thread)
        worker.status_changed.connect(self._on_status, Qt.ConnectionType.QueuedConnection)
        worker.persons_changed.connect(self._state.persons.set, Qt.ConnectionType.QueuedConnection)
        self._thread.started.connect(worker.run)
        self._worker = worker
        self._on_cameras_changed(None)
        worker.show_camera(self._state.camera.value)
        self._thread.start(QThread.Priority.LowPriority)

    def stop(self) -> None:
        if self._worker is not None:
            self._worker.stop()

    def end(self) -> None:
        if self._worker is not None and not self._thread.wait(_ENDS_WITHIN_MS):
            _log.error("the perception thread did not end")

    def look_at_most_every(self, seconds: float) -> None:
        """How often people are looked for at most; 0 for as often as the machine can."""
        if self._worker is not None:
            self._worker.look_at_most_every(seconds)

    def forget_robot(self) -> None:
        """Another robot has other cameras: nobody whom they saw is here any more."""
        robot: RobotProfile | None = self._state.robot.value
        if self._worker is not None and robot is not None and robot.cameras:
            self._worker.forget_cameras()

    def _offer(self, value: Any, _raw: bytes | None) -> None:  # any thread
        worker = self._worker
        if worker is None:
            return
        if isinstance(value, FrameRef):
            worker.offer(value)
        elif isinstance(value, CameraLens):
            worker.use_lens(value)
        else:
            worker.offer_evidence(value)

    def _name(self, asked: intents.NamePerson) -> None:
        if self._worker is not None:
            self._worker.rename(asked.person_id, asked.name, asked.actor)

    def _on_cameras_changed(self, _value: object) -> None:
        if self._worker is None:
            return
        robot: RobotProfile | None = self._state.robot.value
        models: dict[str, CameraModel | None] = dict(self._state.own_cameras.value)
        models.update({camera.name: camera.model for camera in (robot.cameras if robot is not None else ())})
        self._worker.use_cameras({name: model for name, model in models.items() if model is not None})

    def _on_camera_changed(self, name: str) -> None:
        if self._worker is not None:
            self._worker.show_camera(name)

    def _on_status(self, status: PerceptionStatus) -> None:
        self._state.perception.set(status)
