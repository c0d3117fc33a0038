"""Detector for microphones without signal: muted, unplugged at the other end, or the wrong one."""

_NOTHING = 0.0008
"""A peak, of 1: the noise of a microphone that is on is louder even in a quiet room."""
_TOLD_AFTER_NS = 45_000_000_000


class SignalWatch:
    """Reports each microphone once, and again only after a signal."""

    def __init__(self) -> None:
        self._heard_ns: dict[str, int] = {}
        self._reported: set[str] = set()

    def hear(self, source: str, stamp_ns: int, peak: float) -> bool:
        """Add the peak level. True when a missing signal is to be reported."""
        if peak > _NOTHING:
            self._heard_ns[source] = stamp_ns
            self._reported.discard(source)
            return False
        since_ns = self._heard_ns.setdefault(source, stamp_ns)
        if source in self._reported or stamp_ns - since_ns < _TOLD_AFTER_NS:
            return False
        self._reported.add(source)
        return True

    def closed(self, source: str) -> None:
        """Expect no sound from this microphone for now."""
        self._heard_ns.pop(source, None)
