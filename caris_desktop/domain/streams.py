"""Stream table: all streams and event types of the program, declared once.

Recorder, reader, exporters and live state are driven by this table, so that a new stream or event type is added here
only.
"""

import re
from enum import Enum
from typing import Any, Literal

from caris_desktop.domain import events, foxglove, sensing, sound_values
from caris_desktop.domain.foxglove import WellKnown
from caris_desktop.domain.value_class import Value


class Delivery(Enum):
    """How values travel from their source to the panels and the recorder."""

    LATEST = "latest"  # the newest value wins in the panels; the recorder gets every one
    LOSSLESS = "lossless"  # every value reaches every consumer
    MEDIA = "media"  # pixels in a shared ring; recorded as video


Freshness = Literal["none", "fresh", "stale", "lost"]
ShownAs = Literal["panels", "picture"]
"""What a busy machine updates less often: first all panels, including the map, and only then the image."""


class StreamSpec(Value):
    """One stream. ``expected_period_s`` is None if silence means nothing (latched values, events).

    ``keyed_by`` names the field that divides the stream into separate values: the newest of each counts. ``source``
    does the same if all of them share one topic of the recording. ``record_every_s`` keeps large values out of the
    recording if they are replaced sooner than that. ``well_known`` is the schema of other programs as which the stream
    is recorded, if there is one.
    """

    name: str
    value_type: type[Any]
    delivery: Delivery
    expected_period_s: float | None = None
    keyed_by: str = ""
    source: str = ""
    record_every_s: float = 0.0
    well_known: WellKnown | None = None

    def topic_of(self, value: Any) -> str:
        """Topic of the recording's channel for ``value``: one per key."""
        return f"/{self.name}/{getattr(value, self.keyed_by)}" if self.keyed_by else f"/{self.name}"

    def key_of(self, value: Any) -> str:
        """Key under which ``value`` replaces the newest: its stream, or its camera or microphone within it."""
        return f"/{self.name}/{getattr(value, self.source)}" if self.source else self.topic_of(value)

    @property
    def latched(self) -> bool:
        """Whether the newest value holds until the next one, however long that takes."""
        return self.delivery is Delivery.LATEST and self.expected_period_s is None

    @property
    def shown_as(self) -> ShownAs:
        return "picture" if self.delivery is Delivery.MEDIA else "panels"

    @property
    def stale_after_s(self) -> float | None:
        """Age in seconds from which a value is stale: max(0.5 s, three expected periods)."""
        if self.expected_period_s is None:
            return None
        return max(0.5, 3.0 * self.expected_period_s)


def _event_name(value_type: type[Any]) -> str:
    return "event/" + re.sub(r"(?<=[a-z])(?=[A-Z])", "_", value_type.__name__).lower()


STATE_STREAMS: tuple[StreamSpec, ...] = (
    StreamSpec("scan", sensing.LaserScan, Delivery.LATEST, 0.1, well_known=foxglove.LASER_SCAN),
    StreamSpec("odometry", sensing.Odometry, Delivery.LATEST, 0.1),
    StreamSpec("pose", sensing.RobotPose, Delivery.LATEST, 0.2, well_known=foxglove.POSE),
    StreamSpec("map", sensing.OccupancyGrid, Delivery.LATEST, record_every_s=1.0, well_known=foxglove.GRID),
    StreamSpec("battery", sensing.BatteryState, Delivery.LATEST),
    StreamSpec("people", sensing.People, Delivery.LATEST, 0.3, source="camera", well_known=foxglove.ANNOTATIONS),
    StreamSpec("people_in_map", sensing.PeopleInMap, Delivery.LATEST, 0.3, source="camera"),
    StreamSpec("path", sensing.PlannedPath, Delivery.LATEST, well_known=foxglove.PATH),
    StreamSpec("head", sensing.HeadState, Delivery.LATEST, 0.2),
    StreamSpec("readings", sensing.ControlReadings, Delivery.LATEST),
    StreamSpec("lens", sensing.CameraLens, Delivery.LATEST, source="camera", well_known=foxglove.CALIBRATION),
    StreamSpec("audio", sensing.AudioBlock, Delivery.LATEST, 0.2, keyed_by="source"),
    StreamSpec("hearing", sound_values.Hearing, Delivery.LATEST, source="source"),
    StreamSpec("status", sensing.StatusShown, Delivery.LATEST, keyed_by="name"),
    StreamSpec("depth", sensing.DepthGrid, Delivery.LATEST, 0.3, source="camera", record_every_s=0.5),
    StreamSpec("camera_state", sensing.CameraState, Delivery.LATEST, source="camera"),
    StreamSpec("frame", sensing.FrameRef, Delivery.MEDIA, 0.1, source="camera"),
)

# For taps only, never in the log itself: sound goes into its own file, and played sound is the echo reference.
CARRIER_STREAMS: tuple[StreamSpec, ...] = (
    StreamSpec("audio_chunk", sensing.AudioChunk, Delivery.MEDIA),
    StreamSpec("played_sound", sound_values.PlayedSound, Delivery.MEDIA),
    StreamSpec("played_sound_ended", sound_values.PlayedSoundEnded, Delivery.MEDIA),
)

_WELL_KNOWN_EVENTS: dict[type[Any], WellKnown] = {
    events.UtteranceChanged: foxglove.UTTERANCE_LOG,
    events.UtteranceCorrected: foxglove.CORRECTION_LOG,
    events.Problem: foxglove.PROBLEM_LOG,
}

EVENT_STREAMS: tuple[StreamSpec, ...] = tuple(
    StreamSpec(_event_name(kind), kind, Delivery.LOSSLESS, well_known=_WELL_KNOWN_EVENTS.get(kind))
    for kind in events.EVENTS
)

STREAMS: tuple[StreamSpec, ...] = STATE_STREAMS + EVENT_STREAMS
BY_TYPE: dict[type[Any], StreamSpec] = {spec.value_type: spec for spec in STREAMS + CARRIER_STREAMS}
BY_NAME: dict[str, StreamSpec] = {spec.name: spec for spec in STREAMS}


STREAMS_OF_LINK = {
    "control": ("scan", "odometry", "pose", "battery", "people_in_map", "path", "head", "readings"),
    "media": ("frame", "map"),
}
"""Streams that are valid only while their link is up."""
_GONE = ("lost", "closed")


def streams_voided_by(value: Any) -> tuple[str, ...]:
    """Streams whose values from before ``value`` become void. A link in trouble, or only connecting, voids none: a
    robot sends its map once per subscription, so it would be lost.
    """
    if isinstance(value, events.LinkChanged) and value.state in _GONE:
        return STREAMS_OF_LINK.get(value.link, ())
    if isinstance(value, events.RobotChosen):
        return (*STREAMS_OF_LINK["control"], *STREAMS_OF_LINK["media"])
    return ()


def spec_of_topic(topic: str) -> StreamSpec | None:
    """Stream of a recorded channel; None if unknown."""
    name = topic.removeprefix("/")
    if name in BY_NAME:
        return BY_NAME[name]
    parent = BY_NAME.get(name.partition("/")[0])
    return parent if parent is not None and parent.keyed_by else None
