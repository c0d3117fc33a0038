"""Camera service: one child process and frame ring per camera of this computer. GUI thread."""

import logging
from collections.abc import Callable
from dataclasses import replace

from caris_desktop.domain import clock
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sensing import CameraState
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.live.child_process import ProcessSpec, RingToWrite
from caris_desktop.live.frame_ring import FrameRing, FrameRings
from caris_desktop.live.service import ContextService, ServiceContext, SupervisedProcess
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.perception.cameras.camera_process import PlayVideo, StreamSound
from caris_desktop.robot.profile_model import CameraTopic
from caris_desktop.scenario.scenario_model import Scenario

_log = logging.getLogger(__name__)
_RESTART_AFTER_MS = 1000
_GRACE_S = 1.5


class OwnCamera(Value):
    """Camera of this computer. ``body`` additionally gets its ring; ``model``: mounting pose and lens,
    None if unknown.
    """

    name: str
    body: ProcessSpec
    model: CameraModel | None = None


class CameraSelection(Value):
    """Cameras requested by scenario or command line. ``of_robot``: names, None for all of the robot's; ``failures``:
    unusable ones.
    """

    own: tuple[OwnCamera, ...] = ()
    of_robot: tuple[str, ...] | None = None
    failures: tuple[UserFacingError, ...] = ()

    def among(self, cameras: tuple[CameraTopic, ...]) -> tuple[CameraTopic, ...]:
        """Requested cameras of the robot. One with the name of a local camera is renamed, because frames are identified
        by camera name.
        """
        own_names = {camera.name for camera in self.own}
        robot_cameras = [camera for camera in cameras if self.of_robot is None or camera.name in self.of_robot]
        return tuple(
            replace(camera, name=f"robot-{camera.name}") if camera.name in own_names else camera
            for camera in robot_cameras
        )


@dataclass(slots=True, eq=False)
class _Running:
    camera: OwnCamera
    ring: FrameRing
    process: SupervisedProcess
    plays: bool = False


class CamerasService(ContextService):
    """Runs the scenario's cameras, and maintains ``state.own_cameras``: name and model of each."""

    def __init__(
        self, context: ServiceContext, cameras_of: Callable[[Scenario], CameraSelection], *, frames: FrameRings
    ) -> None:
        """``frames`` receives the rings and closes them."""
        super().__init__(context)
        self._cameras_of = cameras_of
        self._frames = frames
        self._free_rings: list[FrameRing] = []
        self._own_cameras: tuple[OwnCamera, ...] = ()
        self._running: dict[str, _Running] = {}
        self._ended: set[str] = set()
        self._audio_camera = ""
        self._started = self._stopped = False
        self._state.perception.changed.connect(self._on_perception)
        self._bus.tap(self._note, (CameraState,))

    def supervised(self) -> list[SupervisedProcess]:
        return [running.process for running in self._running.values()]

    def use_scenario(self, scenario: Scenario) -> None:
        cameras = self._cameras_of(scenario)
        for failure in cameras.failures:
            self._bus.problem(failure.severity, failure.what, failure.meaning, failure.advice)
        if cameras.own != self._own_cameras:
            self._own_cameras = cameras.own
            self._state.own_cameras.set({camera.name: camera.model for camera in cameras.own})
            self._arrange()

    def hear(self, camera: str, on: bool) -> None:
        """Switch audio of a camera's microphone on or off; also applied after a restart."""
        self._audio_camera = camera if on else ""
        running = self._running.get(camera)
        if running is not None:
            running.process.send(StreamSound(on))

    def start(self) -> None:
        self._started = True
        self._arrange()

    def stop(self) -> None:
        self._stopped = True
        for process in self.supervised():
            process.ask_to_end()

    def _arrange(self) -> None:
        if not self._started or self._stopped:
            return
        for running in tuple(self._running.values()):
            if running.camera not in self._own_cameras:
                self._leave(running)
        for camera in self._own_cameras:
            if camera.name not in self._running:
                self._begin(camera)

    def _begin(self, camera: OwnCamera) -> None:
        if self._free_rings:
            ring = self._free_rings.pop()
        else:
            ring = FrameRing.create()
            self._frames.add(ring)
        process = SupervisedProcess(
            self._children,
            ended=lambda: self._on_ended(running),
            on_message=lambda message: _log.info("a camera says %r", message),
            grace_s=_GRACE_S,
        )
        running = self._running[camera.name] = _Running(camera, ring, process)
        self._start(running)

    def _start(self, running: _Running) -> None:
        """Start the process of a camera, at first or again."""
        camera = running.camera
        if self._running.get(camera.name) is not running or self._stopped:
            return
        self._ended.discard(camera.name)
        body = replace(camera.body, arguments=(*camera.body.arguments, RingToWrite(running.ring.name)))
        running.process.start(body)
        running.plays = False
        if camera.name == self._audio_camera:
            running.process.send(StreamSound(True))
        self._on_perception(self._state.perception.value)

    def _leave(self, running: _Running) -> None:
        """End a camera that another scenario does not use."""
        name = running.camera.name
        del self._running[name]
        running.process.ask_to_end()
        self._slow_work.do(running.process.end, lambda _ended: self._left(running), self._bus.answer)
        self._bus.publish(
            CameraState(clock.now_ns(), name, "ended", QT_TR_NOOP("This scenario does not use this camera."))
        )
        self._state.forget_camera(name)

    def _left(self, running: _Running) -> None:
        """Clean up after the exit: process its last values first, so that they do not bring the camera back."""
        self._free_rings.append(running.ring)
        self._bus.take_in()
        if running.camera.name not in self._running:
            self._state.forget_camera(running.camera.name)

    def _note(self, state: CameraState, _raw: bytes | None) -> None:  # any thread
        if state.state == "ended":
            self._ended.add(state.camera)

    def _on_perception(self, status: PerceptionStatus) -> None:
        if status.state not in ("ready", "failed"):
            return
        for running in self._running.values():
            if not running.plays:
                # A recorded video starts once perception is ready to see it.
                running.plays = running.process.send(PlayVideo())

    def _on_ended(self, running: _Running) -> None:
        if self._running.get(running.camera.name) is not running or self._stopped:
            return
        name = running.camera.name
        if name in self._ended:
            self._bus.problem(
                "warning",
                tr("The video from the camera {name} has ended.").format(name=name),
                tr("There is no more video from this camera; a recording continues without it."),
                tr("Choose another camera with --camera or in the scenario, and restart the program."),
                until="picture",
            )
            return

        def report_end(advice: str) -> None:
            self._bus.problem(
                "warning",
                tr("The camera {name} stopped unexpectedly.").format(name=name),
                tr("There is no video from this camera until it works again; everything else continues."),
                advice,
                until="picture",
            )
            self._bus.publish(CameraState(clock.now_ns(), name, "lost", QT_TR_NOOP("It stopped unexpectedly."), advice))

        running.process.restarts.after_end(
            report_end, lambda: self._start(running), after_ms=_RESTART_AFTER_MS, within=self
        )
