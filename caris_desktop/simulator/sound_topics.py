"""Microphone and loudspeaker on ROS, and the simulated participant's speech."""

import time
from collections.abc import Sequence

import numpy as np

from caris_desktop.ros import message_conversion
from caris_desktop.ros.audio_messages import decode_audio_data, encode_audio_data, samples_of
from caris_desktop.ros.message_fields import text
from caris_desktop.simulator.participant import Participant, cache_folder
from caris_desktop.simulator.robot_interface import AudioTopics
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import CallFailed, Message
from caris_desktop.simulator.simulated_microphone import RATE_HZ, Microphone, at_rate
from caris_desktop.simulator.simulated_speech import Spoken

_STEP_SAMPLES = RATE_HZ // 50
_STEPS = 2
SAY_TOPIC = "/simulator/participant/say"
SPEAKING_TOPIC = "/simulator/participant/speaking"


class SoundOnRos:
    """audio_common_msgs/AudioData out and in, plain samples of one channel at 16 kHz.

    The participant speaks with or without subscribers: by std_msgs/String on ``SAY_TOPIC``, or the service
    ``/simulator/say``; ``/simulator/prepare`` only synthesises. std_msgs/Bool on ``SPEAKING_TOPIC`` is true meanwhile.
    """

    def __init__(self, wiring: Wiring, interface: AudioTopics, lines: Sequence[str] = ()) -> None:
        self._wiring = wiring
        self._steps = 0
        self._random = np.random.default_rng(5)
        self._played_s = 0.0
        self.microphone = Microphone()
        self._topic = wiring.publishes(interface.microphone, "audio_common_msgs", "AudioData")
        wiring.obeys(interface.speaker, "audio_common_msgs", "AudioData", self._on_sound)
        wiring.obeys(SAY_TOPIC, "std_msgs", "String", self._on_say)
        wiring.serves("/simulator/prepare", "simulator", "Say", self._prepare)
        wiring.serves("/simulator/say", "simulator", "Say", self._say)
        self._speaking = wiring.publishes(SPEAKING_TOPIC, "std_msgs", "Bool", latched=True)
        self.participant = Participant(
            self.microphone, lines, on_speaking=self._on_speaking, cache=cache_folder()
        )  # fmt: skip
        self._on_speaking(False)

    @property
    def state(self) -> Message:
        """Participant's sentences, in seconds from now (negative: past), and audio received by the loudspeaker."""
        now_ns = time.monotonic_ns()
        return {
            "speaking": self.participant.speaking or "",
            "said": [
                {
                    "text": said.text,
                    "began_s": (said.began_ns - now_ns) / 1e9,
                    "ended_s": None if said.ended_ns is None else (said.ended_ns - now_ns) / 1e9,
                }
                for said in self.participant.said
            ],
            "own_voice_s": self._played_s,
        }

    def publish_due(self) -> None:
        """Publish due messages; called after every simulation step."""
        self._steps += 1
        if self._steps % _STEPS == 0:
            self._publish_sound()

    def skip_time(self, skipped_s: float) -> None:
        """Publish the audio of skipped simulation time at once, as a driver with a buffer would."""
        for _ in range(round(skipped_s * RATE_HZ / (_STEPS * _STEP_SAMPLES))):
            self._publish_sound()

    def _publish_sound(self) -> None:
        faults = self._wiring.faults
        self.microphone.leak, self.microphone.noise = faults.voice_leak, faults.sound_noise
        samples = self.microphone.take(_STEPS * _STEP_SAMPLES)
        lost = faults.microphone_silent or self._random.random() < faults.sound_dropouts
        if not lost and self._wiring.wanted(self._topic):
            self._wiring.publish(self._topic, encode_audio_data(samples))

    def on_voice(self, spoken: Spoken | None) -> None:
        """The robot's voice starts playing this, or stops."""
        if spoken is not None:
            self.microphone.leak_voice(at_rate(spoken.samples, spoken.rate_hz))
        else:
            self.microphone.silence_voice()

    def stop(self) -> None:
        self.participant.stop()

    def _on_sound(self, message: Message) -> None:
        samples = samples_of(decode_audio_data(message).content, 1)
        self._played_s += len(samples) / RATE_HZ
        self.microphone.leak_voice(samples[:, 0].astype(np.float32) / 32768.0)

    def _say(self, arguments: Message) -> Message:
        if not self.participant.say(text(arguments, "text", "args")):
            raise CallFailed("the sentence is empty, or too many sentences are already queued")
        return {"success": True, "message": ""}

    def _on_say(self, sentence: Message) -> None:
        self.participant.say(message_conversion.decode_string(sentence))

    def _prepare(self, arguments: Message) -> Message:
        self.participant.prepare(text(arguments, "text", "args"))
        return {"success": True, "message": ""}

    def _on_speaking(self, speaking: bool) -> None:
        self._wiring.publish(self._speaking, message_conversion.encode_bool(speaking))
