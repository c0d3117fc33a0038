"""People service: perception in its own thread."""

import logging
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, get_args

from PySide6.QtCore import QObject, Qt, QThread

from caris_desktop.conversation.conversation_transcript import ResponseTimes, Transcript, UtteranceReport
from caris_desktop.conversation.listening.speaker_attribution import Here, PeopleHere, WizardsVoice, is_wizards
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import (
    Event,
    PersonAttended,
    SessionStarted,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.process_priority import RECORD_NICENESS
from caris_desktop.domain.sensing import CameraLens, DepthGrid, FrameRef, HeadState, LaserScan, Odometry, RobotPose
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead
from caris_desktop.live.perception_worker import PerceptionWorker
from caris_desktop.live.service import ContextService, Follows, Handlers, Restarts, Service, ServiceContext
from caris_desktop.live.status import CrashRecoveryStatus, PerceptionStatus, PracticeStatus
from caris_desktop.people.decisions import PeopleIntent
from caris_desktop.people.presence import HistoryEvent, PersonRow, PortraitsOf, PresenceTracker, RecognitionSettings
from caris_desktop.perception.inference_messages import InferenceSettings
from caris_desktop.robot.profile import RobotProfile
from caris_desktop.scenario.scenario_model import BlurWho, Scenario

_log = logging.getLogger(__name__)
_ENDS_WITHIN_MS = 5000
_PORTRAITS: dict[BlurWho, PortraitsOf] = {
    "nobody": "everybody", "everybody": "nobody", "without_consent": "consenting",
}  # fmt: skip
"""Whom to save portraits of, by blur setting."""


class PeopleAdapters(Value):
    """``inference`` is None without perception; ``as_configured`` adapts it to a scenario."""

    inference: ProcessSpec | None
    open_presence: Callable[[], tuple[PresenceTracker, list[Event]]]
    as_configured: Callable[[ProcessSpec, Scenario], ProcessSpec] = lambda body, _scenario: body


class PeopleService(ContextService):
    """Runs the perception worker."""

    def __init__(
        self,
        context: ServiceContext,
        parts: PeopleAdapters,
        *,
        rings: RingsToRead,
        who_speaks: Callable[[UtteranceChanged], str],
    ) -> None:
        """``who_speaks`` returns the participant id of an utterance, empty if uncertain."""
        super().__init__(context)
        self._who_speaks = who_speaks
        self._parts = parts
        self._rings = rings
        self._thread = QThread(self)
        self._thread.setObjectName("perception")
        self._worker: PerceptionWorker | None = None
        self._inference = parts.inference
        self._recognition = RecognitionSettings()
        self._may_decide = True
        self._cover = False
        self._state.robot.changed.connect(self._on_cameras_changed)
        self._state.own_cameras.changed.connect(self._on_cameras_changed)
        self._state.camera.changed.connect(self._on_camera_changed)
        self._state.going_on.changed.connect(self._on_crash_recovery_changed)
        self._state.practice.changed.connect(self._on_practice_changed)
        self._bus.tap(self._offer, (FrameRef, LaserScan, Odometry, RobotPose, HeadState, CameraLens, DepthGrid))

    def handlers(self) -> Handlers:
        return dict.fromkeys(get_args(PeopleIntent), self.decide) | {
            intents.AttendPerson: self._attend,
            intents.LookUpPerson: self._request_history,
        }

    def follows(self) -> Follows:
        return dict.fromkeys(get_args(HistoryEvent), self._note)

    def use_scenario(self, scenario: Scenario) -> None:
        names = scenario.permissions.naming_people
        settings = scenario.perception
        # Without naming there is nobody to recognise, so nothing is learnt about people.
        self._recognition = RecognitionSettings(
            settings.recognise if names else "nobody",
            settings.confirm_at,
            _PORTRAITS[scenario.blur.who],
            settings.ask_at,
        )
        self._may_decide = names
        self._cover = scenario.covers_people
        body = self._parts.inference
        if body is not None:
            before, self._inference = self._inference, self._parts.as_configured(body, scenario)
            if self._worker is not None and self._inference != before:
                self._worker.use_body(self._placed(self._inference))
        if self._worker is not None:
            self._worker.recognise(self._recognition, may_decide=names)
            self._worker.require_blurring(self._cover)

    def _placed(self, body: ProcessSpec) -> ProcessSpec:
        return replace(body, arguments=(self._rings, *(self._ranked(argument) for argument in body.arguments)))

    def processes(self) -> dict[str, ChildProcess]:
        child = None if self._worker is None else self._worker.child
        return {} if child is None else {child.body.name: child}

    def restarts(self) -> dict[str, Restarts]:
        return {} if self._worker is None else {self._worker.name: self._worker.restarts}

    def start(self) -> None:
        body = self._inference
        if body is None:
            return
        worker = PerceptionWorker(
            self._placed(body), self._parts.open_presence, self._bus.publish, self._state.portraits
        )
        worker.moveToThread(self._thread)
        worker.status_changed.connect(self._on_status, Qt.ConnectionType.QueuedConnection)
        worker.persons_changed.connect(self._state.persons.set, Qt.ConnectionType.QueuedConnection)
        worker.history_found.connect(self._state.person_history.reset_value, Qt.ConnectionType.QueuedConnection)
        worker.everybody_changed.connect(self._state.everybody.set, Qt.ConnectionType.QueuedConnection)
        worker.recognise(self._recognition, may_decide=self._may_decide)
        worker.require_blurring(self._cover)
        worker.ask_consents_again("consent" in self._state.going_on.value.unconfirmed)
        worker.practise(_is_practice(self._state.practice.value))
        self._thread.started.connect(worker.run)
        self._worker = worker
        self._on_cameras_changed(None)
        worker.show_camera(self._state.camera.value)
        self._thread.start(QThread.Priority.LowPriority)

    def _ranked(self, argument: Any) -> Any:
        """Raise the process priority of detection to the recorder's if recordings must be blurred. A process cannot
        raise its priority later, so a later scenario does not change it.
        """
        if self._cover and isinstance(argument, InferenceSettings):
            return replace(argument, niceness=RECORD_NICENESS)
        return argument

    def stop(self) -> None:
        if self._worker is not None:
            self._worker.stop()

    def end(self) -> None:
        if self._worker is not None and not self._thread.wait(_ENDS_WITHIN_MS):
            _log.error("the perception thread did not end")

    def limit_detection_rate(self, seconds: float) -> None:
        """Set the minimum interval between detections; 0 for none."""
        if self._worker is not None:
            self._worker.limit_detection_rate(seconds)

    def forget_robot(self) -> None:
        """Reset for another robot with other cameras: nobody is present."""
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

    def decide(self, intent: PeopleIntent) -> None:
        """Run a decision in the perception thread. Raises UserFacingError without perception."""
        if self._worker is None:
            raise UserFacingError(
                tr("People detection is not available here."),
                tr("Nothing about them was changed."),
                tr("Start with people detection."),
            )
        self._worker.ask(intent)

    def _request_history(self, intent: intents.LookUpPerson) -> None:
        if self._worker is not None:
            self._worker.request_history(intent.person_id, intent.text)

    def _attend(self, intent: intents.AttendPerson) -> None:
        self._state.selected_person.set(intent.person_id)
        self._bus.publish(PersonAttended(clock.now_ns(), intent.person_id, intent.actor))

    def _note(self, event: HistoryEvent) -> None:
        if self._worker is None:
            return
        if isinstance(event, UtteranceChanged) and event.speaker == "participant" and not event.person_id:
            event = replace(event, person_id=self._who_speaks(event))
        self._worker.note(event)

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

    def _on_crash_recovery_changed(self, status: CrashRecoveryStatus) -> None:
        if self._worker is not None:
            self._worker.ask_consents_again("consent" in status.unconfirmed)

    def _on_practice_changed(self, status: PracticeStatus) -> None:
        if self._worker is not None:
            self._worker.practise(_is_practice(status))

    def _on_status(self, status: PerceptionStatus) -> None:
        self._state.perception.set(status)


def _is_practice(status: PracticeStatus) -> bool:
    """Whether people in view belong to the practice, whose robot stays until its result is dismissed."""
    return status.state != PracticeStatus().state


# Transcript service: turns of the session, with the wizard's corrections.


class TranscriptService(ContextService):
    """Maintains ``state.transcript``, and applies corrections."""

    def __init__(self, context: ServiceContext) -> None:
        super().__init__(context)
        self._transcript = Transcript()

    def handlers(self) -> Handlers:
        return {intents.CorrectUtterance: self._correct}

    def follows(self) -> Follows:
        return {UtteranceChanged: self._take, UtteranceCorrected: self._take, SessionStarted: self._restart}

    def _take(self, event: UtteranceReport) -> None:
        self._transcript.add(event)
        self._state.transcript.reset_value(self._transcript.turns)

    def _restart(self, event: SessionStarted) -> None:
        self._transcript.forget_before(event.stamp_ns)
        self._state.transcript.reset_value(self._transcript.turns)

    def _correct(self, intent: intents.CorrectUtterance) -> None:
        if self._transcript.turn(intent.utterance_id) is None:
            raise UserFacingError(
                tr("That utterance belongs to another session."), tr("Nothing was corrected."),
                tr("Correct it in the session in which it was said."), severity="warning",
            )  # fmt: skip
        text = None if intent.text is None else " ".join(intent.text.split())
        self._bus.publish(
            UtteranceCorrected(
                clock.now_ns(), intent.utterance_id, text, intent.speaker, intent.person_id, intent.tags, intent.actor
            )
        )


class ResponseTimeService(Service):
    """Response time service: the participant's waiting time per turn, published once known.

    Publishes ResponseTimed.
    """

    def __init__(self, bus: Bus, parent: QObject) -> None:
        super().__init__(parent)
        self._bus = bus
        self._times = ResponseTimes()

    def follows(self) -> Follows:
        return dict.fromkeys((UtteranceChanged, UtteranceCorrected, SuggestionChanged), self._take)

    def _take(self, event: UtteranceReport | SuggestionChanged) -> None:
        for timed in self._times.add(event, clock.now_ns()):
            self._bus.publish(timed)


_TURNS_AT_MOST = 20


class SpeakersService(ContextService):
    """Speaker service: assigns a participant's turns to people present; the wizard's are detected separately. GUI
    thread.

    Publishes assignments as corrections by the console, which the wizard can change with one key; nothing is learnt
    from them.
    """

    def __init__(self, context: ServiceContext) -> None:
        super().__init__(context)
        self._here = PeopleHere()
        self._began: OrderedDict[str, int] = OrderedDict()
        self._wizards: deque[WizardsVoice] = deque(maxlen=_TURNS_AT_MOST)
        self._state.persons.changed.connect(self._on_people_changed)
        self._state.selected_person.changed.connect(self._on_people_changed)
        self._state.hearing_of(WIZARD_MICROPHONE).changed.connect(self._on_wizard_heard)

    def follows(self) -> Follows:
        return {UtteranceChanged: self._on_utterance}

    def who_speaks(self, utterance: UtteranceChanged) -> str:
        """Person id of the speaker; empty if uncertain."""
        return utterance.person_id or self._who_spoke(utterance)[0]

    def _who_spoke(self, utterance: UtteranceChanged) -> tuple[str, float]:
        started_ns = self._began.get(utterance.utterance_id, utterance.stamp_ns)
        return self._here.who_spoke(started_ns, max(started_ns + 1, utterance.stamp_ns))

    def _on_people_changed(self, _value: object) -> None:
        attended = self._state.selected_person.value
        rows: list[PersonRow] = self._state.persons.value
        self._here.note(
            clock.now_ns(),
            (Here(row.person_id, row.facing, row.distance_m, row.person_id == attended) for row in rows if row.here),
        )

    def _on_wizard_heard(self, hearing: Hearing) -> None:
        if hearing.speech_started_ns is None:
            return
        text = f"{hearing.committed} {hearing.tentative}"
        voice = WizardsVoice(hearing.speech_started_ns, hearing.silent_since_ns, text)
        if self._wizards and self._wizards[-1].started_ns == voice.started_ns:
            self._wizards.pop()
        self._wizards.append(voice)

    def _on_utterance(self, utterance: UtteranceChanged) -> None:
        if utterance.speaker != "participant" or utterance.origin != "heard":
            return
        if utterance.state == "started":
            self._began[utterance.utterance_id] = utterance.stamp_ns
            if len(self._began) > _TURNS_AT_MOST:
                self._began.popitem(last=False)
        if utterance.state != "finished":
            return
        started_ns = self._began.get(utterance.utterance_id, utterance.stamp_ns)
        wizards = is_wizards(utterance.text, started_ns, utterance.stamp_ns, self._wizards)
        person_id, confidence = ("", 0.0) if wizards or utterance.person_id else self._who_spoke(utterance)
        if wizards or person_id:
            self._bus.publish(
                UtteranceCorrected(
                    clock.now_ns(),
                    utterance.utterance_id,
                    speaker="wizard" if wizards else None,
                    person_id=person_id,
                    actor=CONSOLE,
                    person_confidence=round(confidence, 3) if person_id else None,
                )
            )
