"""Robot connection service: switches robots, leaving the former one stopped and its state cleared."""

from collections.abc import Callable

from PySide6.QtCore import QObject

from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import ProblemEnd
from caris_desktop.domain.intents import UseRobot, UseSimulatedRobot
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.services.drive_service import DriveService
from caris_desktop.live.services.people_service import PeopleService
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.services.robot_service import RobotConnection, RobotService


class AnotherRobotService(Service):
    """Connects the robot requested last; finding and leaving one may take a while.

    ``by_name`` reads files in a background thread and raises UserFacingError. ``simulated`` starts the simulated robot
    if necessary and connects it for the actor once ready; raises UserFacingError on failure.
    """

    def __init__(
        self,
        bus: Bus,
        slow_work: BackgroundWorker,
        *,
        by_name: Callable[[str], RobotConnection],
        simulated: Callable[[Actor], None],
        robot: RobotService,
        drive: DriveService,
        recording: RecordingService,
        people: PeopleService,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._bus = bus
        self._by_name = by_name
        self._simulated = simulated
        self._slow_work = slow_work
        self._robot = robot
        self._drive = drive
        self._recording = recording
        self._people = people
        self._token: object = None
        self._requested: RobotConnection | None = None
        self._stopped = False

    def handlers(self) -> Handlers:
        return {
            UseRobot: lambda intent: self.use(lambda: self._by_name(intent.robot), intent.actor),
            UseSimulatedRobot: lambda intent: self._use_simulated(intent.actor),
        }

    def _use_simulated(self, actor: Actor) -> None:
        if (leave := self._robot.leave_for_one_that_starts()) is not None:
            self._slow_work.do(leave, lambda _left: None, self._bus.answer)
        self._simulated(actor)

    def use(self, find: Callable[[], RobotConnection], actor: Actor = WIZARD, *, until: ProblemEnd = "") -> None:
        """Connect the robot returned by ``find``, unless another one is requested meanwhile. A robot given at program
        start counts as the wizard's choice.

        ``find`` runs in a background thread; its UserFacingError is reported (``until`` as in Problem).
        """
        token = self._token = object()

        def found(connection: RobotConnection) -> None:
            if token is self._token:
                self.connect_to(connection, actor)

        self._slow_work.do(find, found, lambda failure: self._bus.answer(failure, until))

    def connect_to(self, connection: RobotConnection, actor: Actor = WIZARD) -> None:
        """Connect a robot, leaving a former one stopped; the last request wins."""
        if self._stopped:
            return
        self._token = None
        self._requested = connection
        self._drive.release(QT_TR_NOOP("Another robot is connected"))
        leave = self._robot.leave_for(connection)
        self._slow_work.do(leave, lambda _left: self._connect(connection, actor), self._bus.answer)

    def _connect(self, connection: RobotConnection, actor: Actor) -> None:
        if self._stopped or connection is not self._requested:
            return
        # Process the last values of the former robot first, so that they are not taken for the new one's.
        self._bus.take_in()
        self._recording.forget_robot()
        self._people.forget_robot()
        self._robot.connect_robot(connection, actor)

    def stop(self) -> None:
        self._stopped = True
