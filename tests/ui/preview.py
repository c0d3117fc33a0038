"""Window filled with plausible values, saved as screenshots: ``python -m tests.ui.preview OUT``.

It needs a display, for example a virtual one with a window manager, or QT_QPA_PLATFORM=offscreen.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

from PySide6.QtCore import QEventLoop, QPoint, Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain.events import Problem, TrialDetails
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import DriveStatus
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.start_dialog import StartDialog
from caris_desktop.ui.theme import ThemeChoice
from tests.ui import samples
from tests.ui.fake_console import FakeConsole

SIZES = ((1366, 768), (1920, 1080), (2560, 1440))


def spin(milliseconds: int) -> None:
    loop = QEventLoop()
    QTimer.singleShot(milliseconds, loop.quit)
    loop.exec()


class Scene:
    """Filled window with continuous fast streams."""

    def __init__(self, scenario: samples.Scenario) -> None:
        self.console = FakeConsole(scenario)
        self.window = MainWindow(self.console)
        self.window._top_bar.show_details(TrialDetails("Lab visit", "P07", "B", "2", "Kim"))
        self.frames = list(samples.video_frames())
        self.index = 20
        self.flowing = True
        samples.fill_console(self.console)
        profile = load_profile("simulated")
        camera = dataclasses.replace(profile.cameras[0], name="front")
        self.console.state.robot.set(dataclasses.replace(profile, cameras=(camera,)))
        samples.drive_along(self.console)
        self.timer = QTimer(interval=66)
        self.timer.timeout.connect(self.step)
        self.timer.start()

    def step(self) -> None:
        if not self.flowing:
            return
        image, boxes = self.frames[self.index % len(self.frames)]
        samples.show_frame(self.console, image, boxes)
        samples.refresh_streams(self.console, Pose2D(6.6, 3.4, 0.55))
        samples.refresh_people_in_map(self.console)

    def save(self, path: Path) -> None:
        self.window.grab().save(str(path))
        print(path)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--shipped", action="store_true", help="the shipped scenario files instead of the samples")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    app = QApplication(sys.argv[:1])
    began = time.monotonic()
    scenarios = {"tour": samples.TOUR, "mental": samples.MENTAL}
    if arguments.shipped:
        names = {"tour": "tour-guide.yaml", "mental": "mental-health-check.yaml"}
        scenarios = {name: load_scenario(layouts_dir() / file_name) for name, file_name in names.items()}
    for name, scenario in scenarios.items():
        scene = Scene(scenario)
        window = scene.window
        window.show()
        for choice in ("dark", "light"):
            theme: ThemeChoice = "dark" if choice == "dark" else "light"
            window.theme.set_choice(theme)
            for width, height in SIZES:
                stem = f"{name}-{choice}-{width}"
                if arguments.only and arguments.only not in stem:
                    continue
                window.resize(width, height)
                samples.converse(scene.console)
                samples.suggest(scene.console)
                spin(700)
                scene.save(arguments.out / f"{stem}.png")
        if name == "tour" and not arguments.only:
            states(scene, arguments.out)
        window.close()
    app.processEvents()
    print(f"{time.monotonic() - began:.1f} s")
    return 0


def states(scene: Scene, out: Path) -> None:
    """Overlays, problems, emergency stop, stale and lost."""
    window, console = scene.window, scene.console
    window.resize(1366, 768)
    window.theme.set_choice("dark")
    window.show_command_palette()
    spin(200)
    scene.save(out / "palette.png")
    window.hold.escape_pressed.emit()
    window.show_shortcuts()
    spin(200)
    scene.save(out / "shortcuts.png")
    window.hold.escape_pressed.emit()
    window._connection.open()
    spin(1500)
    scene.save(out / "connection.png")
    window.hold.escape_pressed.emit()
    window.sessions.open_start_dialog()
    spin(300)
    dialog = window.findChild(StartDialog)
    dialog.grab().save(str(out / "dialog.png"))
    dialog.reject()
    map_panel = window.panels["map"]
    video = window.panels["video"]
    if isinstance(map_panel, MapPanel) and isinstance(video, VideoPanel):
        map_on_show(map_panel, video)
        scene.save(out / "aiming.png")
        window.hold.escape_pressed.emit()
    console.state.add(
        Problem(1, "warning", "The camera sends pictures late", "Driving is slowed down.", "Move closer to the router.")
    )
    console.state.add(Problem(1, "error", "The recording stopped", "Nothing is kept from now on.", "Free disk space."))
    console.emergency_stop()
    spin(300)
    scene.save(out / "emergency.png")
    console.clear_emergency_stop()
    scene.flowing = False
    spin(1100)
    console.state.drive.set(DriveStatus(True, "", 0.5, "the picture is late"))
    spin(100)
    scene.save(out / "stale.png")
    spin(2200)
    console.state.drive.set(DriveStatus(False, "The robot is unreachable"))
    spin(300)
    scene.save(out / "lost.png")
    scene.flowing = True


def map_on_show(map_panel: MapPanel, video: VideoPanel) -> None:
    """A goal with a partly set heading on the map, and a point on the floor in the video."""
    view, picture = map_panel.view, video.view.picture_rect()
    map_panel.view.set_tool("goal")
    start = view.to_view(9.0, 3.0).toPoint()
    QTest.mousePress(view.viewport(), Qt.MouseButton.LeftButton, pos=start)
    QTest.mouseMove(view.viewport(), start + QPoint(40, -30))
    below = QPoint(round(picture.center().x()), round(picture.top() + 0.85 * picture.height()))
    QTest.mouseClick(video.view, Qt.MouseButton.LeftButton, pos=below)
    spin(300)


if __name__ == "__main__":
    sys.exit(main())
