"""Video panel: camera picture, detected people, rate and age of the video."""

import math
import time

from PySide6.QtCore import QPointF, QSize, QTimer
from PySide6.QtGui import QImage, QShowEvent
from PySide6.QtWidgets import QBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import DriveEnded, PhotoTaken
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import FrameRef, RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import DriveStatus
from caris_desktop.ui import text_formatting
from caris_desktop.ui.panel import TITLE_HEIGHT_PX, Panel, PanelContext, show_part
from caris_desktop.ui.people.shown_people import IdentityQuestion, as_permitted, with_one_question
from caris_desktop.ui.robot_motion import MOTION_SIGNS, RobotMotion, ahead_of, ahead_words, gaze_is_away
from caris_desktop.ui.widgets.accessible_descriptions import (
    TOLD_EVERY_MS,
    RecentlyVisible,
    ThrottledAccessibleDescription,
    sentences,
    video_description,
)
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.camera_strip import CameraStrip, strip_place, strip_thickness_px
from caris_desktop.ui.widgets.frame_view import FloorSpot, FrameView, model_for, spot_at
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import named
from caris_desktop.ui.widgets.pictures import PhotoThumbnail, thumbnail_of
from caris_desktop.ui.widgets.popups import ChoiceCard

_DRIVE_ENDED_SHOWN_S = 5.0
_NOTE_SHOWN_S = 3.0
_AFTER_A_KEY_MS = 30
_ANY_PX = (1 << 24) - 1  # Qt's QWIDGETSIZE_MAX


def guard_chip(drive: DriveStatus) -> tuple[str, str] | None:
    """Effect of the obstacle guard on the motion as text, with its role; None for no effect."""
    left_m = drive.guard_distance_m
    left = () if left_m is None else (tr("{left:.1f} m left").format(left=left_m),)
    match drive.guard:
        case "blocked":
            return " · ".join((tr("Blocked: the guard stops the robot at an obstacle"), *left)), "blocked"
        case "slowing":
            return " · ".join((tr("The guard is slowing the robot for an obstacle"), *left)), "slowing"
        case "blind":
            reason = tr(drive.guard_detail) or tr("it cannot see obstacles")
            return tr("The guard allows crawling only: {why}").format(why=reason), "warning"
        case "overridden":
            return tr("The guard is off: nothing stops the robot at obstacles"), "override"
        case _:
            return None


class VideoPanel(Panel):
    """Video with labels on its edges, and a photo button where permitted."""

    title = QT_TR_NOOP("Video")
    preferred_size, least_size = QSize(720, 480), QSize(260, 150)
    reads = ("permissions.driving",)
    drives = True

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("video_panel")
        self.view = named(FrameView(self.theme, self), "video_view")
        self._seen = RecentlyVisible()
        self._description = ThrottledAccessibleDescription(self.view, self._accessible_text, every_ms=TOLD_EVERY_MS)
        self.strip = CameraStrip(self.theme, self)
        self.strip.chosen.connect(self.state.choose_camera)
        self._parts = QBoxLayout(QBoxLayout.Direction.TopToBottom, self)
        self._parts.setContentsMargins(0, 0, 0, 0)
        self._parts.setSpacing(0)
        self._parts.addWidget(self.view, 1)
        self._parts.addWidget(self.strip)
        self._photo: ActionButton | None = None
        self._offer_photos()
        self._cameras = DropDown(self.theme, "video_camera", tr("Camera to show"), minimumContentsLength=6)
        self._cameras.activated.connect(lambda index: self.state.choose_camera(str(self._cameras.itemData(index))))
        self.motion = None if context.observed else RobotMotion(self.state, self)
        if self.motion is not None:
            self.motion.changed.connect(self._on_motion_changed)
        self._frame_times_s: list[float] = []
        self._aspect = 4 / 3
        self._remembered: tuple[str, int, QImage] | None = None
        self._thumbnail = PhotoThumbnail(self.theme, self.view)
        self._ended = ("", 0.0)
        self._note = ("", 0.0)
        self._target: Pose2D | None = None  # in the map frame, while the popup asks about it
        self._card = ChoiceCard(self.theme, self.view, name="video_card")
        self._may_go = self.console.scenario.permissions.driving
        self.view.hovered.connect(self._on_hovered)
        self.view.floor_clicked.connect(self._on_floor_clicked)
        self.hold.escape_pressed.connect(self._card.hide)
        state = self.state
        self.watch(self._on_frame_changed, state.frame.changed)
        self.watch(self._on_freshness_changed, state.frame.freshness_changed)
        self.watch(self.view.show_people, state.people.changed)
        self.watch(self._name_people, state.persons.changed, state.asked_person.changed, self.table.keys_changed)
        self.watch(self.view.show_selected, state.selected_person.changed)
        self.watch(self.view.show_naming, state.named_person.changed)
        # After a key, the command goes to the robot first; the display can wait.
        self._soon = QTimer(self, singleShot=True, interval=_AFTER_A_KEY_MS)
        self._soon.timeout.connect(self._refresh)
        self.watch(self._refresh_soon, state.drive.changed, state.goal.changed)
        self.watch(self._refresh, state.link.changed, self.table.keys_changed)
        self.watch(self._on_cameras_changed, state.cameras.changed, state.camera.changed)
        state.event_happened.connect(self._on_event)
        self.table.asking.connect(self._on_asking)
        self.every(250, self._refresh)
        self.update_view()

    def update_view(self) -> None:
        state = self.state
        self._on_cameras_changed(None)
        self._name_people()
        self.view.show_selected(state.selected_person.value)
        self.view.show_naming(state.named_person.value)
        if state.people.value is not None:
            self.view.show_people(state.people.value)
        # Frames are not read while hidden; an old one must not pass for the present.
        if state.frame.value is not None and state.frame.freshness == "fresh":
            self._on_frame_changed(state.frame.value)
        self._on_freshness_changed(state.frame.freshness)
        self.strip.refresh_all()

    def show_scenario(self) -> None:
        self._offer_photos()
        if self.in_view:
            self._name_people()

    def _offer_photos(self) -> None:
        permitted = self.table.spec("photo") is not None
        if permitted == (self._photo is not None):
            return
        self._photo = None
        if permitted:
            self._photo = ActionButton(self.theme, tr("Photo"), icon="camera", height_px=30, may_lose_words=True)
            self._photo.setObjectName("photo_button")
            self._photo.setToolTip(tr("Photo"))
            self._photo.bind(self.table, "photo")
        self.controls_changed.emit()

    def picture(self) -> QWidget | None:
        self.view.whole_card = True
        return self.view

    def title_widgets(self) -> list[QWidget]:
        return [self._cameras, *([self._photo] if self._photo is not None else [])]

    def _on_cameras_changed(self, _value: object) -> None:
        names: tuple[str, ...] = self.state.cameras.value
        self.show_title(text_formatting.camera_title(self.state.camera.value) or self.title)
        # "camera" is implied by the title.
        self._cameras.fill([(text_formatting.camera_name(name), name) for name in names], self.state.camera.value)
        show_part(self._cameras, len(names) > 1)
        self.view.show_camera(self.state.camera.value if len(names) > 1 else "")
        self.strip.show_cameras(names if len(names) > 1 else (), self.state.camera.value)
        self.fit()

    def fit(self) -> None:
        """Place the camera strip next to or below the image, whichever leaves more room; hide it in a small panel."""
        place = strip_place(self.size(), len(self.state.cameras.value) - 1, self._aspect)
        below = place.side == "below"
        self._parts.setDirection(QBoxLayout.Direction.TopToBottom if below else QBoxLayout.Direction.LeftToRight)
        thick_px = strip_thickness_px(place)
        self.strip.setMinimumSize(0 if below else thick_px, thick_px if below else 0)
        self.strip.setMaximumSize(_ANY_PX if below else thick_px, thick_px if below else _ANY_PX)
        self.strip.use_place(place)
        self.strip.refresh_all()
        # Below the photo button, away from the hints on driving at the lower edge.
        self._thumbnail.top_px = TITLE_HEIGHT_PX + max(0, self.covered.bottom() + 1)
        self._thumbnail.place()

    def focus_target(self) -> QWidget:
        return self.view

    def _on_frame_changed(self, frame: FrameRef) -> None:
        self._frame_times_s.append(time.monotonic())
        aspect = min(max(frame.width_px / max(1, frame.height_px), 1.0), 2.0)
        if aspect != self._aspect:
            self._aspect = aspect
            self.fit()
        self.view.show_model(self._model(frame))
        self._hold_ring_in_place()
        if not self.view.isVisible() or self.state.frame.freshness == "lost":
            return
        image_bgr = self.console.frames.read(frame)
        if image_bgr is not None:
            self.view.show_frame(image_bgr, frame)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        if self.in_view:
            self.update_view()

    def _name_people(self, _value: object = None) -> None:
        """Label the boxes with names; the one of the pending question with its suggestion and key."""
        naming = self.console.scenario.permissions.naming_people
        question: IdentityQuestion | None = self.state.asked_person.value
        persons = with_one_question(as_permitted(self.state.persons.value, naming=naming), question)
        keys = {} if question is None else {question.person_id: self.table.key_text("answer_yes")}
        names = {}
        for person in persons:
            words = text_formatting.on_box(person, keys.get(person.person_id, ""))
            names[person.person_id] = words, text_formatting.has_given_name(person)
        self.view.show_names(names, frozenset(person.person_id for person in persons if person.suggestion is not None))

    def _on_freshness_changed(self, freshness: str) -> None:
        self.view.show_freshness(freshness)
        self._refresh()

    def _refresh_soon(self, _status: object) -> None:
        if not self._soon.isActive():
            self._soon.start()

    def _refresh(self) -> None:
        """Refresh the text around the picture (4 Hz)."""
        if not self.in_view:
            return
        state, now_s = self.state, time.monotonic()
        self._frame_times_s = [moment for moment in self._frame_times_s if now_s - moment <= 2.0]
        age_s = state.frame.age_s()
        match state.frame.freshness:
            case "fresh":
                # A live picture that is as it should be says nothing; Diagnostics has rate and age.
                parts = [] if state.present.live else [tr("recorded")]
                if len(self._frame_times_s) > 2 and not state.present.live:
                    shown_s = max(0.001, self._frame_times_s[-1] - self._frame_times_s[0])
                    parts.append(tr("{rate:.0f} fps").format(rate=(len(self._frame_times_s) - 1) / shown_s))
                if state.present.live and not state.frame.age_known:
                    parts.append(tr("age unknown"))
                self.set_fact(" · ".join(parts), "" if state.frame.age_known else "amber")
            case "stale":
                self.set_fact(tr("delayed · {age} old").format(age=text_formatting.age(age_s or 0.0)), "amber")
            case "lost":
                silent = tr("no picture for {age}").format(age=text_formatting.age(state.frame.silent_s() or 0.0))
                late = tr("video latency {age}").format(age=text_formatting.age(age_s or 0.0))
                self.set_fact(late if state.frame.arrives_late else silent, "red")
            case _:
                self.set_fact(tr("no picture yet") if state.present.live else tr("no picture"))
        chips: list[tuple[str, str]] = []
        if self.view.whole_card and state.frame.freshness == "fresh" and self.fact[0]:
            chips.append((self.fact[0], "warning" if self.fact[1] == "amber" else "video_text"))
        if self.motion is not None:
            chips.append((self.motion.text, self.motion.role))
        ahead: list[tuple[str, str]] = []
        if state.scan.value is not None and state.scan.value.robot_from_laser is None:
            ahead = [(tr("The direction of the LIDAR is unknown"), "video_text")]
        elif state.scan.freshness == "fresh":
            head = state.head.value if state.head.freshness == "fresh" else None
            away = gaze_is_away(state.robot.value, self.view.frame, head)
            text, warns = ahead_words(ahead_of(state.scan.value), away)
            ahead = [(text, "warning" if warns else "video_text")]
        elif state.scan.freshness in ("stale", "lost"):
            late = tr("LIDAR latency {age}").format(age=text_formatting.age(state.scan.age_s() or 0.0))
            ahead = [(late if state.scan.arrives_late else tr("LIDAR is silent"), "warning")]
        if going := text_formatting.goal_now(state.goal.value):
            # A small picture has room for the first labels only: for the goal rather than for what is far ahead.
            far = bool(ahead) and ahead[0][1] == "video_text"
            ahead.insert(0 if far else len(ahead), (going, "hint"))
        chips += ahead
        chips += self._hints()
        self.view.show_chips(chips)
        self.view.show_lost_reason(tr("Drive with care.") if self._linked else tr("The robot is out of reach."))
        self.view.show_out_of_reach(state.link.value.state == "lost")
        self.view.show_state(state.state_of(state.camera.value).value)
        self.view.show_age(age_s, late=state.frame.arrives_late)
        self._seen.add(self.view, now_s)
        self._description.changed()
        self.strip.refresh()

    def _on_motion_changed(self) -> None:
        self._refresh()
        if self.motion is not None and self.motion.sign is MOTION_SIGNS["unlinked"]:
            self._description.changed_urgently()

    def _accessible_text(self) -> str:
        """People in view, warnings, and whether the robot moves, without its speed, which always changes."""
        moving = "" if self.motion is None else tr(self.motion.sign.word)
        return sentences((video_description(self.view, self._seen.names), moving))

    @property
    def _linked(self) -> bool:
        return self.state.link.value.state in ("connected", "trouble")

    def _hints(self) -> list[tuple[str, str]]:
        """Hints on how to drive, or why driving is refused."""
        drive: DriveStatus = self.state.drive.value
        hints: list[tuple[str, str]] = []
        if time.monotonic() < self._note[1]:
            hints.append((self._note[0], "warning"))
        if self.table.spec("drive_forward") is None:
            return hints
        if drive.emergency_stop or not self._linked:
            return hints  # the banner says so, or the words in place of the picture
        if not drive.allowed:
            off = tr("Driving is off: {reason}") if drive.reason else tr("Driving is off")
            hints.append((off.format(reason=tr(drive.reason)), "warning"))
        elif not self.hold.held and (self.hold.must_let_go or time.monotonic() < self._ended[1]):
            if self.hold.must_let_go:
                hints.append((tr("Release and press again to drive"), "warning"))
            if time.monotonic() < self._ended[1]:
                hints.append((tr("Driving ended: {reason}").format(reason=tr(self._ended[0])), "warning"))
        elif drive.cap_reason or guard_chip(drive) is not None:
            guard = guard_chip(drive)
            if guard is not None:
                hints.append(guard)
            if drive.cap_reason:
                hints.append((tr("Slowed down: {reason}").format(reason=tr(drive.cap_reason)), "warning"))
        else:
            free = self.table.driving_focus
            text = tr("{keys} or arrows drive") if free else tr("Alt+{keys} drives while you type")
            hints.append((text.format(keys=self._drive_keys()), "hint"))
        return hints

    def _drive_keys(self) -> str:
        """The four drive keys, by keyboard layout and the wizard's bindings."""
        rows = (self.table.spec(name) for name in ("drive_forward", "turn_left", "drive_back", "turn_right"))
        return " ".join(cap for row in rows if row is not None for cap in self.table.caps(row, row.driving_keys[:1]))

    # ---- click on the floor

    def _model(self, frame: FrameRef) -> CameraModel | None:
        """Camera model for clicks that send the robot; None if that is not possible."""
        robot = self.state.robot.value
        if not self._may_go or robot is None or robot.navigation is None:
            return None
        head = self.state.head
        return model_for(robot, frame, head.value if head.freshness == "fresh" else None)

    def _pose_now(self) -> Pose2D | None:
        pose: RobotPose | None = self.state.pose.value
        return pose.pose_in_map if pose is not None and self.state.pose.freshness == "fresh" else None

    def _hold_ring_in_place(self) -> None:
        """Keep the target marker on the floor while the robot moves; drop it when the popup closes."""
        pose = self._pose_now()
        if self._target is None:
            return
        if self._card.isHidden() or pose is None:
            self._target = None
            self._card.hide()
            self.view.show_spot(None)
            return
        target_in_robot = pose.inverse() @ self._target
        self.view.show_spot(FloorSpot(target_in_robot.x_m, target_in_robot.y_m))

    def _on_hovered(self, at: QPointF | None) -> None:
        model = self.view.model
        spot = spot_at(model, at.x(), at.y()) if model is not None and at is not None else None
        visible = isinstance(spot, FloorSpot) and self.state.frame.freshness == "fresh" and self._card.isHidden()
        if visible or self._card.isHidden():
            self.view.show_spot(spot if visible and isinstance(spot, FloorSpot) else None)

    def _on_floor_clicked(self, at: QPointF, where: QPointF) -> None:
        if not self._card.isHidden():
            self._card.hide()
            self.view.show_spot(None)
            return
        model, pose = self.view.model, self._pose_now()
        if model is None:
            return
        spot = spot_at(model, at.x(), at.y())
        if self.state.frame.freshness != "fresh":
            spot = tr("The picture is too old to choose a target")
        elif pose is None and isinstance(spot, FloorSpot):
            spot = tr("The robot's position is unknown")
        if isinstance(spot, str) or pose is None:
            self._note = (str(spot), time.monotonic() + _NOTE_SHOWN_S)
            self._refresh()
            return
        target = pose @ Pose2D(spot.x_m, spot.y_m, math.atan2(spot.y_m, spot.x_m))
        self.view.show_spot(spot)
        self._target = target
        speed, _by_speed_setting = text_formatting.goal_speed(self.state.robot.value, self.state.drive.value)
        away = tr("{distance:.1f} m from the robot").format(distance=spot.distance_m)
        self._card.offer(
            where, " · ".join(part for part in (away, speed) if part),
            [("video_go_there", tr("Go there"), "navigation-arrow", lambda: self._go(target))],
        )  # fmt: skip

    def _go(self, target: Pose2D) -> None:
        self.view.show_spot(None)
        self.console.do(intents.GoToPoint(target))

    def _on_event(self, event: object) -> None:
        if isinstance(event, DriveEnded):
            self._ended = (event.reason, time.monotonic() + _DRIVE_ENDED_SHOWN_S)
            self._refresh()
        elif isinstance(event, PhotoTaken):
            taken = self._remembered
            known = taken is not None and (taken[0], taken[1]) == (event.camera, event.frame_sequence)
            in_session = self.state.recording.value.state in ("starting", "recording", "paused")
            text = tr("Photo saved with the session") if in_session else tr("Photo saved in the study’s folder")
            self._thumbnail.show_photo(taken[2] if known and taken is not None else None, text, event.file_name)

    def _on_asking(self, intent: Intent) -> None:
        """Show a preview of a requested photo; the current frame is a good approximation."""
        if not isinstance(intent, intents.TakePhoto):
            return
        frame: FrameRef | None = self.state.frame.value
        image_bgr = self.console.frames.read(frame) if frame is not None else None
        if frame is not None and image_bgr is not None:
            self._remembered = (frame.camera, frame.sequence, thumbnail_of(image_bgr))
