"""Response time service: the participant's waiting time per turn, published once known."""

from PySide6.QtCore import QObject

from caris_desktop.conversation.conversation_transcript import UtteranceReport
from caris_desktop.conversation.response_timing import ResponseTimes
from caris_desktop.domain import clock
from caris_desktop.domain.events import SuggestionChanged, UtteranceChanged, UtteranceCorrected
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import Follows, Service


class ResponseTimeService(Service):
    """Publishes ResponseTimed."""

    def __init__(self, bus: Bus, parent: QObject) -> None:
        super().__init__(parent)
        self._bus = bus
        self._times = ResponseTimes()

    def follows(self) -> Follows:
        return dict.fromkeys((UtteranceChanged, UtteranceCorrected, SuggestionChanged), self._take)

    def _take(self, event: UtteranceReport | SuggestionChanged) -> None:
        for timed in self._times.take(event, clock.now_ns()):
            self._bus.publish(timed)
