"""Open the detector selected by scenario or user, or the default one, locally or on another machine."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from caris_desktop.domain.address import is_loopback, without_credentials
from caris_desktop.domain.plugins import PluginCall, find
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.backends.runtime_selection import open_fastest
from caris_desktop.perception.detector import Detector, person_classes
from caris_desktop.perception.inference_settings import DetectorSettings
from caris_desktop.perception.weights import WeightsError, find_weights


class Chosen(Value, eq=False):
    """``people`` are the class rows that mean a person.

    ``folder`` contains the detector's file, None if that is remote.
    """

    detector: Detector
    people: tuple[int, ...]
    folder: Path | None


def open_chosen(
    own: Path | None,
    settings: DetectorSettings,
    *,
    confidence: float,
    threads: int,
    allow_download: bool,
    notify: Callable[[PluginCall], None] = lambda _call: None,
) -> Chosen:
    """Open a detector; takes seconds. ``own`` is the user's file, which precedes the scenario's. ``notify`` gets the
    calls of a plug-in.

    Raises
    ------
    WeightsError
        When there is no detector, it cannot be loaded, or it finds no people.
    DetectorAwayError
        When the other machine cannot be asked now.
    PluginError
        When a plug-in cannot be used.
    """
    if settings.server and not settings.other_computers and not is_loopback(settings.server):
        raise WeightsError(
            localized(
                QT_TR_NOOP(
                    "This scenario does not permit models on other computers, but uses {server} to detect people"
                ),
                server=without_credentials(settings.server),
            ),
            advice=localized(QT_TR_NOOP("Remove perception.server from the scenario, or permit cloud_models")),
        )
    source = settings.model.source if own is None else str(own)
    if source.startswith("plugin:") and (own is not None or not settings.server):
        from caris_desktop.perception.detector_plugins import WatchedDetector

        plugin = find("detectors", source.removeprefix("plugin:"))
        watched = WatchedDetector(plugin, confidence=confidence, threads=threads, notify=notify)
        return Chosen(watched, watched.people, None)
    if settings.server:
        from caris_desktop.perception.backends.remote import RemoteDetector

        remote = RemoteDetector(settings.server, confidence=confidence)
        if not remote.people:
            raise WeightsError(
                localized(QT_TR_NOOP("The detector at {server} does not detect people"), server=settings.server),
                advice=QT_TR_NOOP("Start the server with a detector that has a class named person"),
            )
        return Chosen(remote, remote.people, None)
    weights = find_weights(own or settings.model, allow_download=allow_download)
    weights = replace(weights, input_px=settings.model.input_px)
    detector = open_fastest(weights, confidence=confidence, threads=threads, device=settings.device)
    return Chosen(detector, person_classes(detector, weights), weights.path.parent)
