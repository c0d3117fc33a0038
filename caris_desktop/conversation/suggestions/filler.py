"""When a reply is late, so that a filler bridges the wait. Time comes from outside."""

from caris_desktop.domain.events import UtteranceChanged

_MISSED_NS = 1_000_000_000


class FillerWait:
    """Waits once for each turn of a participant's, from the end of their voice on."""

    def __init__(self) -> None:
        self.due_ns: int | None = None
        self._turn_id = ""

    def turn_over(self, turn: UtteranceChanged, after_ns: int) -> None:
        """A participant has said all they wanted to."""
        if turn.state == "finished" and turn.text.strip() and turn.utterance_id != self._turn_id:
            self._turn_id = turn.utterance_id
            self.due_ns = turn.stamp_ns + after_ns

    def spoken(self) -> None:
        """Somebody says something, so that there is no wait; or the wizard wants no filler."""
        self.due_ns = None

    def due(self, now_ns: int) -> bool:
        """Whether it is to be said now, which is told once; a wait whose end went by unseen is over."""
        if self.due_ns is None or now_ns < self.due_ns:
            return False
        late_ns = now_ns - self.due_ns
        self.due_ns = None
        return late_ns < _MISSED_NS
