"""Robot speech on ROS: a topic of sentences, or PAL's text-to-speech action."""

import logging

from caris_desktop.ros import action_messages, message_conversion
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.message_fields import message_of, text_or_empty
from caris_desktop.simulator.actionlib import ActionlibServer
from caris_desktop.simulator.robot_interface import SpeechAction, SpeechTopics
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import Message
from caris_desktop.simulator.simulated_speech import Voice

logger = logging.getLogger(__name__)


class SpeechOnTopics:
    """std_msgs/String in; Bool while it speaks, and Empty to stop it, if the model has them."""

    def __init__(self, wiring: Wiring, interface: SpeechTopics, *, muted: bool) -> None:
        self._wiring = wiring
        self.voice = Voice(self._on_speaking, muted=muted)
        wiring.obeys(interface.topic, "std_msgs", "String", self._on_say)
        if interface.stop is not None:
            wiring.obeys(interface.stop, "std_msgs", "Empty", lambda _: self.voice.stop())
        self._speaking = (
            wiring.publishes(interface.speaking, "std_msgs", "Bool", latched=True) if interface.speaking else None
        )
        self._on_speaking(False)

    def publish_due(self) -> None:
        """Do nothing: messages are published when they occur."""

    def _on_say(self, message: Message) -> None:
        if not self.voice.say(message_conversion.decode_string(message)):
            logger.warning("A sentence was not taken: it is empty, or too many wait already")

    def _on_speaking(self, speaking: bool) -> None:
        if self._speaking is not None:
            self._wiring.publish(self._speaking, message_conversion.encode_bool(speaking))


class SpeechOnAction:
    """pal_interaction_msgs/TtsAction: one sentence at a time; a newer goal preempts the present one."""

    def __init__(self, wiring: Wiring, interface: SpeechAction, *, muted: bool) -> None:
        self.voice = Voice(self._on_speaking, muted=muted)
        self._goal_id: str | None = None
        self._text = ""
        self._begun = False
        self._server = ActionlibServer(
            wiring, interface.name, "pal_interaction_msgs", "Tts", on_goal=self._on_goal, on_cancel=self._on_cancel
        )

    def publish_due(self) -> None:
        """Publish due messages; called after every simulation step."""
        self._server.publish_due()

    def _on_goal(self, goal_id: str, goal: Message) -> None:
        raw = message_of(goal.get("rawtext", {}), "TtsGoal.rawtext")
        sentence = text_or_empty(raw, "text", "TtsGoal.rawtext").strip()
        language = text_or_empty(raw, "lang_id", "TtsGoal.rawtext")
        if not sentence or not language:
            # PAL's server requires both; the language selects the voice
            missing = "rawtext.text" if not sentence else "rawtext.lang_id"
            self._server.finish(
                GoalStatus(goal_id, action_messages.ABORTED, f"{missing} is empty"), _result("", "aborted")
            )
            return
        self._end(action_messages.PREEMPTED, "replaced by a newer sentence")
        self._goal_id, self._text, self._begun = goal_id, sentence, False
        self._server.accept(goal_id)
        self.voice.say(sentence)

    def _on_cancel(self, wanted: str) -> None:
        if wanted in ("", self._goal_id):
            self._end(action_messages.PREEMPTED, "cancelled")

    def _on_speaking(self, speaking: bool) -> None:
        if self._goal_id is None:
            return
        if speaking:
            self._begun = True
            feedback = {
                "event_type": 1,  # TTS_EVENT_STARTED_PLAYING_UTTERANCE
                "timestamp": {"secs": 0, "nsecs": 0},
                "text_said": "",
                "next_word": self._text.split()[0],
                "viseme_id": "",
                "marks": {"type": "", "name": ""},
            }
            self._server.progress(GoalStatus(self._goal_id, action_messages.ACTIVE), feedback)
        elif self._begun:
            self._finish(action_messages.SUCCEEDED, "")

    def _end(self, status: int, detail: str) -> None:
        if self._goal_id is None:
            return
        self._finish(status, detail)
        self.voice.stop()

    def _finish(self, status: int, detail: str) -> None:
        if self._goal_id is not None:
            goal_id, self._goal_id = self._goal_id, None
            self._server.finish(GoalStatus(goal_id, status, detail), _result(self._text, detail or "succeeded"))


def _result(said: str, msg: str) -> Message:
    return {"text": said, "msg": msg}
