"""Lab Streaming Layer outlet: event markers for physiological recorders, if the library is installed."""

import json
import logging
from typing import Any

from caris_desktop.domain import clock, events
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.streams import Delivery, StreamSpec
from caris_desktop.domain.translation import QT_TR_NOOP, localized

_log = logging.getLogger(__name__)
STREAM_NAME, STREAM_TYPE = "CARIS markers", "Markers"
_SOURCE_ID = "caris-desktop-markers"
# Anyone on the network can listen: speech and names go out only if the scenario asks for it. Without ``words``, only
# these fields of these events are sent.
_WITHOUT_WORDS: dict[type, tuple[str, ...]] = {
    events.Marked: ("stamp_ns", "label", "kind", "mark_id", "start_ns", "end_ns", "state"),
    events.StepEntered: ("stamp_ns", "step_id", "title", "number", "how"),
    events.ProtocolEnded: ("stamp_ns", "left_step_id", "skipped"),
    events.RecordingPaused: ("stamp_ns", "paused"),
    events.SessionStarted: ("stamp_ns",),
    events.SessionEnded: ("stamp_ns",),
}
# Many per second, or useless next to a physiological signal.
_NOT_SENT = (events.CommandSent, events.HeadMoved, events.LinkQuality, events.TrafficMeasured)
_LONGEST_TEXT = 1000
_TRIES = 25
_MEASURE_EVERY_NS = 10_000_000_000


class OutletUnavailableError(Exception):
    """The outlet does not work; ``what`` and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.what, self.advice = what, advice


class MarkerOutlet:
    """One JSON string per event: ``event``, ``stamp_ns`` of the session clock, and the event's fields.

    Sends labelled marks, protocol steps, and start, pause and end of the recording; with ``words``, every event with
    all texts. The sample's timestamp is the same moment on LSL's clock. One thread.
    """

    def __init__(self) -> None:
        """Raises OutletUnavailableError if the library is missing or does not work."""
        try:
            import pylsl
        except (ImportError, RuntimeError, OSError) as error:
            # Without its native library the package raises RuntimeError, or OSError if it does not load.
            _log.warning("pylsl: %s", error)
            raise OutletUnavailableError(
                QT_TR_NOOP("No markers are sent: Lab Streaming Layer is not installed."),
                QT_TR_NOOP("Install it (pip install pylsl), then start the recording again."),
            ) from error
        try:
            info = pylsl.StreamInfo(STREAM_NAME, STREAM_TYPE, 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, _SOURCE_ID)
            info.desc().append_child_value("manufacturer", "CARIS Desktop")
            info.desc().append_child_value("format", "one JSON object per event, with stamp_ns of the session clock")
            self._outlet: Any = pylsl.StreamOutlet(info)
        except (RuntimeError, OSError) as error:
            _log.exception("the outlet does not open")
            raise OutletUnavailableError(
                localized(
                    QT_TR_NOOP("No markers are sent: the Lab Streaming Layer outlet could not be opened ({error})."),
                    error=error,
                ),
                QT_TR_NOOP("Check this computer's network, then start the recording again."),
            ) from error
        self._lsl_clock = pylsl.local_clock
        self.words = False
        self._lsl_minus_session_s = 0.0
        self._measured_ns = 0
        self._measure()

    def offer(self, spec: StreamSpec, value: Any) -> None:
        """Send ``value`` if it is an event for markers.

        Raises OutletUnavailableError on failure, with the outlet closed.
        """
        if spec.delivery is not Delivery.LOSSLESS or isinstance(value, _NOT_SENT):
            return
        if not self.words and type(value) not in _WITHOUT_WORDS:
            return
        try:
            self._send(spec, value)
        except Exception as error:
            # An exception in a foreign library must not end the recording.
            _log.exception("%s is not sent", spec.name)
            self.close()
            raise OutletUnavailableError(
                localized(QT_TR_NOOP("Markers are no longer sent: Lab Streaming Layer failed ({error})."), error=error),
                QT_TR_NOOP("Check this computer's network, then start the recording again."),
            ) from error

    def _send(self, spec: StreamSpec, value: Any) -> None:
        if clock.now_ns() - self._measured_ns > _MEASURE_EVERY_NS:
            self._measure()
        fields = _shortened(to_jsonable(value))
        if not self.words:
            fields = {name: fields[name] for name in _WITHOUT_WORDS[type(value)]}
        marker = json.dumps({"event": spec.name.removeprefix("event/"), **fields}, ensure_ascii=False)
        text = marker.encode("utf-8", "replace").decode("utf-8")
        self._outlet.push_sample([text], value.stamp_ns / 1e9 + self._lsl_minus_session_s)

    def close(self) -> None:
        """Remove the stream from the network."""
        self._outlet = None

    def _measure(self) -> None:
        """Measure the clock offset; of several readings, the one with the shortest duration counts."""
        readings = []
        for _ in range(_TRIES):
            before_ns = clock.now_ns()
            lsl_s = self._lsl_clock()
            after_ns = clock.now_ns()
            readings.append((after_ns - before_ns, lsl_s - (before_ns + after_ns) / 2e9))
        self._lsl_minus_session_s = min(readings)[1]
        self._measured_ns = clock.now_ns()


def _shortened(value: Any) -> Any:
    """Shorten long texts at any depth, such as the prompt in an exchange."""
    if isinstance(value, str):
        return f"{value[:_LONGEST_TEXT]}…" if len(value) > _LONGEST_TEXT else value
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in value.items()}
    return [_shortened(item) for item in value] if isinstance(value, list) else value
