"""Who is in front of the robot: perception in a thread of its own, and what this computer's own camera shows it."""

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
from caris_desktop.live.child_process import ChildProcess, ProcessBody, RingsToRead, RingToWrite
from caris_desktop.live.children import Children
from caris_desktop.live.perception_worker import PerceptionWorker
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.people.presence import Presence
from caris_desktop.perception.cameras import PlayVideo
from caris_desktop.robot.profile import RobotProfile

_log = logging.getLogger(__name__)
_ENDS_WITHIN_MS = 5000


@dataclass(frozen=True, slots=True)
class PeopleParts:
    """``inference`` is None where nobody is looked for, ``camera`` where the pictures are the robot's."""

    inference: ProcessBody | None
    camera: ProcessBody | None
    open_presence: Callable[[], tuple[Presence, list[Event]]]


class PeopleService(Service):
    """Runs the perception worker and the camera of this computer, if there is one."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        children: Children,
        parts: PeopleParts,
        *,
        rings: RingsToRead,
        camera_ring: str,
        parent: QObject,
    ) -> None:
        """``camera_ring`` is what this computer's camera writes to, empty without one."""
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._children = children
        self._parts = parts
        self._rings = rings
        self._camera_ring = camera_ring
        self._camera: ChildProcess | None = None
        self._video_plays = False
        self._thread = QThread(self)
        self._thread.setObjectName("perception")
        self._worker: PerceptionWorker | None = None
        state.robot.changed.connect(self._on_robot_changed)
        state.camera.changed.connect(self._on_camera_changed)
        bus.tap(self._offer, (FrameRef, LaserScan, Odometry, RobotPose, HeadState, CameraLens))

    def handlers(self) -> Handlers:
        return {intents.NamePerson: self._name}

    def processes(self) -> dict[str, ChildProcess]:
        return {} if self._camera is None or self._parts.camera is None else {self._parts.camera.name: self._camera}

    @property
    def inference_pid(self) -> int | None:
        return None if self._worker is None else self._worker.child_pid

    def start(self) -> None:
        camera = self._parts.camera
        if camera is not None and self._camera_ring:
            camera = replace(camera, arguments=(*camera.arguments, RingToWrite(self._camera_ring)))
            self._camera = self._children.start(camera, ended=self._on_camera_ended, heard=self._on_heard)
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
        worker.use_cameras(_camera_models(self._state.robot.value))
        worker.show_camera(self._state.camera.value)
        self._thread.start(QThread.Priority.LowPriority)

    def stop(self) -> None:
        if self._camera is not None:
            self._camera.ask_to_end()
        if self._worker is not None:
            self._worker.stop()

    def end(self) -> None:
        if self._camera is not None:
            self._camera.stop(grace_s=1.5)
        if self._worker is not None and not self._thread.wait(_ENDS_WITHIN_MS):
            _log.error("the perception thread did not end")

    def look_at_most_every(self, seconds: float) -> None:
        """How often people are looked for at most; 0 for as often as the machine can."""
        if self._worker is not None:
            self._worker.look_at_most_every(seconds)

    def forget_robot(self) -> None:
        """Another robot has other cameras: nobody whom they saw is here any more."""
        if self._worker is not None and self._parts.camera is None:
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

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        if self._worker is not None:
            self._worker.use_cameras(_camera_models(robot))

    def _on_camera_changed(self, name: str) -> None:
        if self._worker is not None:
            self._worker.show_camera(name)

    def _on_status(self, status: PerceptionStatus) -> None:
        self._state.perception.set(status)
        if self._camera is not None and status.state in ("ready", "failed") and not self._video_plays:
            # A recorded video waits for whoever shall see it from its start.
            self._video_plays = self._camera.send(PlayVideo())

    def _on_heard(self, message: Any) -> None:
        _log.info("the camera says %r", message)

    def _on_camera_ended(self, child: ChildProcess) -> None:
        if child is not self._camera:
            return
        self._camera = None
        self._bus.problem(
            "warning",
            "The camera's pictures have ended.",
            "There is no video from now on; a recording goes on without it.",
            "Start again with another --camera, or without one for the robot's own.",
            until="picture",
        )


def _camera_models(robot: RobotProfile | None) -> dict[str, CameraModel]:
    cameras = robot.cameras if robot is not None else ()
    return {camera.name: camera.model for camera in cameras if camera.model is not None}
