"""Robot discovery for the connection dialog: runs on the asyncio thread, answers in the GUI thread."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.failure import UserFacingError, reported
from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.confirmed_files import accept_written_profile
from caris_desktop.robot.profile import ListedProfile, list_profiles, load_profile, own_profile_file, save_profile
from caris_desktop.robot.profile_model import ProfileError, RobotProfile, SecuritySettings

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.robot.discovery import Exploration, StreamCheck

logger = logging.getLogger(__name__)

_READ_PROFILES_AFTER_MS = 1500  # the window comes first


class LiveRobotExplorer(QObject):
    """Robot discovery outside the GUI thread. Call from the GUI thread; every call returns at once, and its callbacks
    follow in the GUI thread. A new request replaces the current one.
    """

    _answered = Signal(int, object, object)  # request number, callback, its argument

    def __init__(self, asyncio_thread: AsyncioThread, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._asyncio = asyncio_thread
        self._number = 0
        self._running: Future[None] | None = None
        # Emitted in the asyncio thread and queued, so that callbacks run in this object's thread.
        self._answered.connect(self._on_answered, Qt.ConnectionType.QueuedConnection)
        QTimer.singleShot(_READ_PROFILES_AFTER_MS, self, self._read_profiles)

    def _read_profiles(self) -> None:
        """Load the list of profiles once in the background, ready for menus."""
        work = asyncio.to_thread(list_profiles)
        try:
            self._asyncio.submit(work)
        except RuntimeError:  # the console is closed already
            work.close()

    def explore(
        self,
        address: str,
        *,
        security: SecuritySettings,
        progress: Callable[[str], None],
        done: "Callable[[Exploration | UserFacingError], None]",
    ) -> None:
        """Query topics, services and actions of the robot at ``address``. ``progress`` gets a short text per step."""
        number = self._begin()

        async def ask() -> "Exploration":
            from caris_desktop.robot.discovery import explore_robot

            return await explore_robot(
                address, security=security, on_progress=lambda words: self._answered.emit(number, progress, words)
            )

        self._run(number, ask(), done)

    def check(
        self,
        profile: RobotProfile,
        *,
        progress: "Callable[[StreamCheck], None]",
        done: "Callable[[tuple[StreamCheck, ...] | UserFacingError], None]",
    ) -> None:
        """Check all streams of the profile; ``progress`` gets each result as it arrives."""
        number = self._begin()

        async def listen() -> "tuple[StreamCheck, ...]":
            from caris_desktop.robot.discovery import check_streams

            return await check_streams(profile, on_check=lambda check: self._answered.emit(number, progress, check))

        self._run(number, listen(), done)

    def save(
        self, profile: RobotProfile, title: str, *, done: Callable[[ListedProfile | UserFacingError], None]
    ) -> None:
        """Save the profile as one of the user's under ``title``; an existing one is never overwritten."""
        self._run(self._begin(), asyncio.to_thread(_save, profile, title), done)

    def read(self, name: str, *, done: Callable[[RobotProfile | UserFacingError], None]) -> None:
        self._run(self._begin(), asyncio.to_thread(_read, name), done)

    def cancel(self) -> None:
        """Abort the current operation without callback."""
        self._begin()

    def _begin(self) -> int:
        self._number += 1
        if self._running is not None:
            self._running.cancel()
            self._running = None
        return self._number

    def _run(self, number: int, work: Coroutine[Any, Any, Any], done: Callable[[Any], None]) -> None:
        async def answer() -> None:
            try:
                result: object = await work
            except UserFacingError as failure:
                result = failure
            except Exception as error:
                logger.exception("Looking at a robot failed")
                result = UserFacingError(
                    tr("Inspecting the robot failed ({error}).").format(error=f"{type(error).__name__}: {error}"),
                    tr("The robot's interfaces are not known; nothing was changed."),
                    tr("Check that rosbridge is running on the robot, and try again; the log has the details."),
                )
            self._answered.emit(number, done, result)

        self._running = self._asyncio.submit(answer())

    def _on_answered(self, number: int, callback: Callable[[Any], None], argument: object) -> None:
        if number == self._number:
            callback(argument)


def _read(name: str) -> RobotProfile:
    advice = tr("Choose another profile, or the interfaces found here.")
    with reported(ProfileError, tr("The profile cannot be used."), advice):
        return load_profile(name)


def _save(profile: RobotProfile, title: str) -> ListedProfile:
    path = own_profile_file(title)
    taken = {known.name for known in list_profiles()}
    if path.exists() or path.stem in taken:
        raise UserFacingError(
            tr("A robot named {robot} already exists.").format(robot=path.stem),
            tr("It was not overwritten."),
            tr("Choose another name."),
        )
    advice = tr("Choose another name, or free some disk space.")
    with reported((OSError, ProfileError), tr("The robot was not saved."), advice):
        path.parent.mkdir(parents=True, exist_ok=True)
        save_profile(replace(profile, name=path.stem, title=title), path)
        accept_written_profile(profile, path)
    return ListedProfile(path.stem, title, without_credentials(profile.address), path)
