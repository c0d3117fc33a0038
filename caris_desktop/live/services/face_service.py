"""Face service: contents, animation with speech, and outputs of the robot's face. GUI thread."""

import asyncio
import logging
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal

from caris_desktop.conversation.face.drawing import (
    Drawing,
    FaceMotion,
    SpokenLoudness,
    drawing_of,
    loudness,
    words_alone,
)
from caris_desktop.conversation.face.face_file import DEFAULT_FACE, Face, FaceError, load_face, parse_face, save_face
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import FaceChanged, UtteranceChanged
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.media_checks import jpeg_of
from caris_desktop.domain.person_marks import with_names
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, Hearing, PlayedSound, joined
from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import AsyncioThread, new_timer
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext, SupervisedProcess
from caris_desktop.live.status import FaceStatus
from caris_desktop.scenario.scenario_model import Scenario

_log = logging.getLogger(__name__)
_DRAW_EVERY_MS = 40
_PICTURE_EVERY_NS = 200_000_000
_PICTURE_PX = 960
_PAGE_ENDS_WITHIN_S = 2.0
_MAX_VOICES = 8
_HEAD_SHARE = 0.12
"""Eye height in a person's box, as a share from its top."""


class FaceService(ContextService):
    """Maintains ``state.face`` and, while an output is open, ``state.face_drawing`` at up to 25 Hz.

    Nothing is drawn while nothing moves. Contents are recorded, eye motion is not.
    """

    _sound_reported = Signal(object)

    def __init__(
        self,
        context: ServiceContext,
        asyncio_thread: AsyncioThread,
        *,
        frames: FrameReader,
        load: Callable[[str], Face] = load_face,
        save: Callable[[Face], object] = save_face,
    ) -> None:
        super().__init__(context)
        self._asyncio = asyncio_thread
        self._frames = frames
        self._load = load
        self._save = save
        self._face: Face | None = None
        self._motion: FaceMotion | None = None
        self._requested_face = ""
        self._caption = ""
        self._speaking_id = ""
        self._voices: dict[str, PlayedSound] = {}
        self._page = SupervisedProcess(
            self._children, ended=self._on_page_ended, on_message=self._on_page_message, grace_s=_PAGE_ENDS_WITHIN_S
        )
        self._newest_for_page: Drawing | bytes | NDArray[np.uint8] | None = None
        self._delivering = False
        self._requested_by: Actor = CONSOLE
        self._picture_ns = 0
        self._contents: Drawing | bytes | None = None
        self._drawing = new_timer(self, self._draw, _DRAW_EVERY_MS)
        self._sound_reported.connect(self._on_sound, Qt.ConnectionType.QueuedConnection)
        self._bus.tap(lambda sound, _raw: self._sound_reported.emit(sound), (PlayedSound,))
        self._state.people.changed.connect(self._on_people)
        self._state.frame.changed.connect(self._on_frame)
        for source in PARTICIPANT_SOURCES:
            self._state.hearing_of(source).changed.connect(self._on_hearing)

    def handlers(self) -> Handlers:
        return {
            intents.UseFace: lambda intent: self._use(intent.face, intent.actor),
            intents.KeepFace: self._persist,
            intents.ShowExpression: self._express,
            intents.ShowOnFace: self._show_on_face,
            intents.ShowFaceWindow: self._show_window,
            intents.ServeFace: self._serve,
        }

    def follows(self) -> Follows:
        return {UtteranceChanged: self._on_utterance}

    def use_scenario(self, scenario: Scenario) -> None:
        self._scenario = scenario
        if not scenario.permissions.face:
            self._put_away()
        elif self._requested_face != scenario.face.face or self._face is None:
            self._use(scenario.face.face, CONSOLE)

    def stop(self) -> None:
        self._put_away()

    def _put_away(self) -> None:
        self._drawing.stop()
        self._close_page()
        self._requested_face = self._speaking_id = self._caption = ""
        self._face = self._motion = None
        self._voices.clear()
        self._state.face.set(FaceStatus())
        self._contents = None
        self._state.face_drawing.reset_value(None)

    # Face and contents

    def _use(self, name: str, actor: Actor) -> None:
        self._requested_face = name

        def loaded(face: Face) -> None:
            if self._requested_face == name:
                if self._motion is None:
                    self._motion = FaceMotion(face)
                else:
                    self._motion.use(face)
                self._face = face
                before: FaceStatus = self._state.face.value
                self._change(
                    replace(
                        before, face=face.name, title=face.title, expression=self._motion.expression.name,
                        expressions=tuple(one.name for one in face.expressions),
                        what="face" if before.what == "off" else before.what,
                    ),
                    actor,
                )  # fmt: skip
                self._move()

        self._slow_work.do(lambda: self._load(name), loaded, self._notify)

    def _persist(self, intent: intents.KeepFace) -> None:
        face = parse_face(intent.content, file_name=tr("The face"), name=intent.name)
        self._slow_work.do(lambda: self._save(face), lambda _path: self._use(intent.name, intent.actor), self._notify)

    def _express(self, intent: intents.ShowExpression) -> None:
        motion = self._motion_or_raise()
        status: FaceStatus = self._state.face.value
        if intent.expression not in status.expressions:
            raise RefusedError(
                tr("This face has no expression “{expression}”.").format(expression=intent.expression),
                tr("The expression is unchanged."),
                tr("Choose one of these: {expressions}.").format(expressions=", ".join(status.expressions)),
            )  # fmt: skip
        motion.express(intent.expression)
        self._change(replace(status, expression=intent.expression), intent.actor)
        self._move()

    def _show_on_face(self, intent: intents.ShowOnFace) -> None:
        self._motion_or_raise()
        text = " ".join(intent.text.split())
        if intent.what == "text" and not text:
            raise RefusedError(tr("There is nothing to show."), tr("The face is unchanged."), tr("Enter a text first."))
        if intent.what == "live" and not self._scenario.face.live_picture:
            raise RefusedError(
                tr("This scenario does not show people what the robot sees."), tr("The face is unchanged."),
                tr("To allow this, set face.live_picture in the scenario."),
            )  # fmt: skip
        if intent.what == "photo":
            photo = next((one for one in self._state.photos.value if one.file_name == text and not one.deleted), None)
            if photo is None or not self._scenario.permissions.photos:
                raise RefusedError(
                    tr("That photo is not available."),
                    tr("The face is unchanged."),
                    tr("Choose one from the Photos panel."),
                )
            self._change(replace(self._state.face.value, what="photo", text=text), intent.actor)
            self._show(photo.preview_jpeg)
            return
        changed = replace(self._state.face.value, what=intent.what, text=text if intent.what == "text" else "")
        self._change(changed, intent.actor)
        self._move()

    def _change(self, status: FaceStatus, actor: Actor) -> None:
        self._state.face.set(status)
        self._bus.publish(
            FaceChanged(
                clock.now_ns(), status.expression, status.text if status.what == "text" else "",
                status.text if status.what == "photo" else "", status.what == "live",
                status.pages + (1 if status.window else 0), actor,
            )
        )  # fmt: skip

    def _motion_or_raise(self) -> FaceMotion:
        if self._motion is None:
            raise RefusedError(tr("The face is not ready."), tr("Nothing is shown."), tr("Try again in a moment."))
        return self._motion

    def _notify(self, failure: UserFacingError) -> None:
        self._bus.answer(failure)
        if self._face is None and isinstance(failure, FaceError) and self._requested_face != DEFAULT_FACE:
            self._use(DEFAULT_FACE, CONSOLE)

    # Outputs

    def _show_window(self, intent: intents.ShowFaceWindow) -> None:
        self._motion_or_raise()
        self._change(replace(self._state.face.value, window=intent.on), intent.actor)

    def _serve(self, intent: intents.ServeFace) -> None:
        from caris_desktop.conversation.face.page import run_face_page

        self._motion_or_raise()
        if not intent.on:
            self._close_page()
            self._change(self._state.face.value, intent.actor)
            return
        if self._page.child is None:
            on_network = self._scenario.face.page == "network"
            self._page.start(ProcessSpec("face page", run_face_page, (on_network,)))
            self._requested_by = intent.actor

    def _on_page_message(self, message: Any) -> None:
        from caris_desktop.conversation.face.page import PageFailed, PageOpened, PagesOpen

        match message:
            case PageOpened(address):
                self._state.face_page.set(address)
                self._change(replace(self._state.face.value, served=True), self._requested_by)
                if self._contents is not None:
                    self._show_on_page(self._contents)
            case PageFailed(reason):
                self._report_not_served(tr("The face page cannot be served ({error}).").format(error=reason))
            case PagesOpen(pages) if pages != self._state.face.value.pages:
                self._change(replace(self._state.face.value, pages=pages), CONSOLE)

    def _on_page_ended(self) -> None:
        self._reset_page()
        self._report_not_served(tr("The face page stopped unexpectedly."))

    def _report_not_served(self, what: str) -> None:
        self._close_page()
        self._bus.answer(
            UserFacingError(
                what,
                tr("The face window on this computer still works."),
                tr("Try again, or use the window."),
                severity="warning",
            )
        )

    def _close_page(self) -> None:
        if self._page.dismiss():
            self._reset_page()

    def _reset_page(self) -> None:
        self._state.face_page.set("")
        self._state.face.update(served=False, pages=0)

    def _show_on_page(self, contents: Drawing | bytes | NDArray[np.uint8]) -> None:
        """Show a drawing or an image (JPEG or BGR) on the pages, unless a newer one follows before it is delivered."""
        self._newest_for_page = contents
        if self._page.child is not None and not self._delivering:
            self._delivering = True
            self._asyncio.submit(self._deliver())

    async def _deliver(self) -> None:
        while self._newest_for_page is not None:
            contents, self._newest_for_page = self._newest_for_page, None
            await asyncio.to_thread(self._send_to_page, contents)
        self._delivering = False

    def _send_to_page(self, contents: Drawing | bytes | NDArray[np.uint8]) -> None:
        from caris_desktop.conversation.face.page import drawn

        if isinstance(contents, np.ndarray):
            contents = jpeg_of(contents, quality=75, most_px=_PICTURE_PX)
        if (child := self._page.child) is not None:
            child.send_raw_waiting(pickle.dumps(contents if isinstance(contents, bytes) else drawn(contents)))

    # Animation

    def _on_utterance(self, event: UtteranceChanged) -> None:
        if event.speaker != "robot" or self._motion is None:
            return
        if event.state == "started":
            self._speaking_id = event.utterance_id
            played = self._voices.get(event.utterance_id)
            self._motion.speak(SpokenLoudness(event.stamp_ns) if played is None else _voice_of(played))
            # Caption for the addressee, with the spoken name.
            names = {row.person_id: row.name for row in self._state.everybody.value if row.known}
            self._caption = with_names(event.text, lambda person_id: names.get(person_id, "")).strip()
            self._state.face.update(speaking=True)
            self._move()
        elif event.state != "requested" and event.utterance_id == self._speaking_id:
            self._speaking_id = self._caption = ""
            self._motion.speak(None)
            self._state.face.update(speaking=False)
            self._move()

    def _on_sound(self, sound: PlayedSound) -> None:
        """Add played audio, which is reported slightly before or after it is audible."""
        if self._motion is None or not sound.utterance_id:
            return
        before = self._voices.get(sound.utterance_id)
        full_sound = self._voices[sound.utterance_id] = sound if before is None else joined(before, sound)
        while len(self._voices) > _MAX_VOICES:
            del self._voices[next(iter(self._voices))]
        if sound.utterance_id == self._speaking_id:
            self._motion.speak(_voice_of(full_sound))

    def _on_hearing(self, hearing: Hearing) -> None:
        listening = hearing.speaking and hearing.speaker in ("", "participant")
        if self._motion is not None and listening != self._state.face.value.listening:
            self._motion.hear(listening)
            self._state.face.update(listening=listening)
            self._move()

    def _on_people(self, people: People) -> None:
        """Look at the selected person, else at the nearest, with the tallest box."""
        if self._motion is None:
            return
        selected = self._state.selected_person.value
        box = next((one for one in people.boxes if one.person_id == selected), None)
        box = box or max(people.boxes, key=lambda one: one.height_px, default=None)
        if box is None or not people.frame_width_px or not people.frame_height_px:
            self._motion.turn_gaze_to(0.0, 0.0)
        else:
            middle = (box.left_px + box.width_px / 2) / people.frame_width_px
            eyes = (box.top_px + _HEAD_SHARE * box.height_px) / people.frame_height_px
            # The left of the camera picture is the robot's left, which is the right of its screen.
            self._motion.turn_gaze_to(1.0 - 2.0 * middle, 1.0 - 2.0 * eyes)
        self._move()

    def _on_frame(self, frame: FrameRef) -> None:
        if self._state.face.value.what != "live" or frame.stamp_ns - self._picture_ns < _PICTURE_EVERY_NS:
            return
        self._picture_ns = frame.stamp_ns
        image_bgr = self._frames.read(frame)
        if image_bgr is not None:
            self._contents = None
            self._state.face_drawing.reset_value(image_bgr)
            self._show_on_page(image_bgr)

    def _move(self) -> None:
        """Start animating."""
        if self._state.face.value.what in ("face", "text"):
            self._drawing.start(_DRAW_EVERY_MS)

    def _draw(self) -> None:
        motion, face = self._motion, self._face
        status: FaceStatus = self._state.face.value
        if motion is None or face is None or status.what not in ("face", "text"):
            self._drawing.stop()
            return
        if status.what == "text":
            self._drawing.stop()
            self._show(words_alone(face, status.text))
            return
        now_ns = clock.now_ns()
        expression = motion.at(now_ns)
        self._show(drawing_of(face, expression, caption=self._caption if self._scenario.face.captions else ""))
        if motion.still:
            blink_ns = motion.next_blink_ns
            if blink_ns is None:
                self._drawing.stop()
            else:
                self._drawing.start(max(_DRAW_EVERY_MS, (blink_ns - now_ns) // 1_000_000))
        elif self._drawing.interval() != _DRAW_EVERY_MS:
            self._drawing.start(_DRAW_EVERY_MS)

    def _show(self, contents: Drawing | bytes) -> None:
        if contents != self._contents:
            self._contents = contents
            self._state.face_drawing.reset_value(contents)
            self._show_on_page(contents)


def _voice_of(played: PlayedSound) -> SpokenLoudness:
    return SpokenLoudness(played.stamp_ns, shares=loudness(played.samples[:, 0], played.sample_rate_hz))
