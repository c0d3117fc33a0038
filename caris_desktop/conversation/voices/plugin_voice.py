"""Voice of a plug-in."""

from collections.abc import Callable, Iterator

from caris_desktop.conversation import speech_plugins
from caris_desktop.conversation.speech_plugins import checked_rate, open_speech
from caris_desktop.conversation.voices.utterance_sound import Samples, Stop
from caris_desktop.domain.plugins import PluginError


class PluginVoice:
    """Voice of a plug-in. ``on_failure`` gets the error that switches it off; later utterances fail."""

    least_audible = None

    def __init__(
        self, name: str, language: str, *, rate: float, volume: float, on_failure: Callable[[PluginError], None]
    ) -> None:
        """Raises PluginError."""
        self.name = name
        self._on_failure = on_failure
        self._process, self._plugin = open_speech(name, language)
        self.rate_hz = checked_rate(self._plugin, self._process.ask("rate_hz", within_s=speech_plugins.SPEAK_WITHIN_S))
        self.tune(rate, volume)

    def tune(self, rate: float, volume: float) -> None:
        self._tuned = {"rate": rate, "volume": volume}

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        stop.check()
        try:
            sound = self._process.ask("speak", (text,), self._tuned, within_s=speech_plugins.SPEAK_WITHIN_S)
        except PluginError as error:
            self._on_failure(error)
            raise ValueError(error.reason) from error
        yield sound
