"""Robot speech: requested utterances by the profile's backend, and unprompted ones."""

from collections.abc import Callable

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.link_commands import Say
from caris_desktop.robot.profile import SpeechInterface
from caris_desktop.robot.request_speech import RequestSpeech, ServiceSpeaker, SpeechBackend, WebSpeaker
from caris_desktop.robot.robot_speech import ActionVoice, RobotVoice, TopicVoice
from caris_desktop.robot.transport import RosbridgeClient
from caris_desktop.robot.unprompted_speech import UnpromptedSpeech
from caris_desktop.ros.dialect import Dialect


class RobotSpeech:
    """Robot speech. ``emit`` gets the reports of all utterances."""

    def __init__(
        self,
        ros: RosbridgeClient,
        dialect: Dialect,
        speech: SpeechInterface | None,
        *,
        emit: Callable[[UtteranceChanged], None],
    ) -> None:
        self._voice = _voice_of(ros, dialect, speech, emit)
        self._own = UnpromptedSpeech(ros, dialect, speech.says if speech is not None else None, emit=emit)

    def say(self, command: Say) -> None:
        """Request speech now, or after the present utterance."""
        self._own.asked(command.text)
        self._voice.say(command)

    def silence(self, actor: Actor) -> bool:
        """Interrupt speech. False if the robot does not support it."""
        return self._voice.silence(actor)

    def link_lost(self) -> None:
        self._voice.link_lost()

    def link_connected(self) -> None:
        self._voice.link_connected()

    async def close(self) -> None:
        self._own.close()
        await self._voice.close()


def _voice_of(
    ros: RosbridgeClient, dialect: Dialect, speech: SpeechInterface | None, emit: Callable[[UtteranceChanged], None]
) -> RobotVoice:
    if speech is not None and speech.action is not None:
        return ActionVoice(ros, dialect, speech.action, emit=emit)
    speaker: SpeechBackend
    if speech is not None and speech.service is not None:
        speaker, at_end = ServiceSpeaker(ros, dialect, speech.service), speech.service.answers_at_end
        return RequestSpeech(ros, dialect, speech, speaker, answers_at_end=at_end, emit=emit)
    if speech is not None and speech.web is not None:
        speaker, at_end = WebSpeaker(speech.web), speech.web.answers_at_end
        return RequestSpeech(ros, dialect, speech, speaker, answers_at_end=at_end, emit=emit)
    return TopicVoice(ros, dialect, speech, emit=emit)
