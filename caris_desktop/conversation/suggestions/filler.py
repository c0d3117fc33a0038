"""Timing of fillers, which bridge the wait for a late reply. Time is injected."""

from caris_desktop.domain.events import UtteranceChanged

_MISSED_NS = 1_000_000_000


class FillerWait:
    """One wait per participant turn, from the end of their voice."""

    def __init__(self) -> None:
        self.due_ns: int | None = None
        self._turn_id = ""

    def turn_over(self, turn: UtteranceChanged, after_ns: int) -> None:
        """The participant's turn is over."""
        if turn.state == "finished" and turn.text.strip() and turn.utterance_id != self._turn_id:
            self._turn_id = turn.utterance_id
            self.due_ns = turn.stamp_ns + after_ns

    def spoken(self) -> None:
        """Cancel the wait: someone speaks, or the wizard wants no filler."""
        self.due_ns = None

    def due(self, now_ns: int) -> bool:
        """True once, when the filler is due; a wait whose end was missed is over."""
        if self.due_ns is None or now_ns < self.due_ns:
            return False
        late_ns = now_ns - self.due_ns
        self.due_ns = None
        return late_ns < _MISSED_NS
