"""Runtime selection: the fastest inference runtime on this computer whose detections match.

Ultralytics weights (.pt) are exported to ONNX, then each installed runtime is measured on photos of people. The export
and the measurement are cached per user, so that the next start needs neither them nor torch.
"""

import hashlib
import importlib.metadata
import importlib.util
import json
import logging
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop import __version__
from caris_desktop.domain.address import is_loopback, without_credentials
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.model_files import GET_WEIGHTS_ANEW, WrongChecksum, check_file
from caris_desktop.domain.plugins import PluginCall, find
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.backends.network import NetworkDetector, UnknownFormError
from caris_desktop.perception.backends.runtimes import OpenvinoNetwork, open_network, openvino_installed
from caris_desktop.perception.backends.ultralytics_runtime import prepare_runtimes
from caris_desktop.perception.detector import Detections, Detector, person_classes
from caris_desktop.perception.inference_messages import DetectorSettings, Device
from caris_desktop.perception.weights import Weights, WeightsError, find_weights

log = logging.getLogger(__name__)


def check_weights(weights: Weights) -> str:
    """SHA-256 of the file, empty for a folder. Raises WeightsError for a wrong checksum."""
    try:
        return "" if weights.path.is_dir() else check_file(weights.path)
    except WrongChecksum as error:
        raise WeightsError(str(error), searched=(str(weights.path),), advice=GET_WEIGHTS_ANEW) from error
    except OSError as error:
        raise _unreadable(weights) from error


def open_detector(weights: Weights, *, confidence: float, threads: int, device: Device = "auto") -> Detector:
    """Load and warm up a detector; takes seconds. ``confidence`` is its threshold.

    Raises
    ------
    WeightsError
        When the file cannot be loaded.
    """
    check_weights(weights)
    prepare_runtimes(threads=threads)
    network = None
    try:
        network = open_network(weights, threads=threads, device=device)
        if network is not None:
            return NetworkDetector(network, weights, confidence=confidence)
    except UnknownFormError as error:
        if network is None or not network.facts.class_names:
            raise WeightsError(
                localized(
                    QT_TR_NOOP("The file {name} is not a supported detector: {error}"),
                    name=weights.path.name,
                    error=error,
                ),
                searched=(str(weights.path),),
                advice=QT_TR_NOOP("Choose a YOLO detector exported by ultralytics, or a YOLOX detector"),
            ) from error
        # Ultralytics exported it, so it can read it.
        log.info("%s is left to ultralytics: %s", weights.path, error)
    except WeightsError:
        raise
    except Exception as error:  # onnxruntime, LiteRT and OpenVINO raise types of their own for a bad file
        raise _unreadable(weights) from error
    try:
        from caris_desktop.perception.backends.ultralytics_runtime import UltralyticsDetector

        return UltralyticsDetector(weights, confidence=confidence, threads=threads, device=device)
    except Exception as error:
        raise _unreadable(weights) from error


def _unreadable(weights: Weights) -> WeightsError:
    log.exception("could not load %s", weights.path)
    return WeightsError(
        localized(QT_TR_NOOP("The detector {name} could not be loaded"), name=weights.path.name),
        searched=(str(weights.path),),
        advice=QT_TR_NOOP("Replace the file with an intact YOLO detector; see the log for details"),
    )


_REPEATS = 6
_PREFERRED = ("onnxruntime", "OpenVINO", "torch")
_WORTH_IT = 0.9
_WORDS_AT_MOST = 120
# Both must find: confident detections of one must exist in the other, with similar confidence and position.
_SURE = 0.25
_LEAST_OVERLAP = 0.9
_CONFIDENCE_WITHIN = 0.05


class MeasuredChoice(Value):
    """Measurement. ``runtime`` is the selected one; ``ms`` is the time per image by runtime, ``why_not`` the defects of
    the others, as text.
    """

    runtime: str
    ms: dict[str, float]
    why_not: dict[str, str]

    @property
    def label_suffix(self) -> str:
        """Suffix for the detector's label."""
        others = [f"{name} {ms:.0f} ms" for name, ms in self.ms.items() if name != self.runtime]
        others += [f"{name}: {reason}" for name, reason in self.why_not.items()]
        measured = f", {self.ms[self.runtime]:.0f} ms" if self.runtime in self.ms else ""
        return measured + (f" ({'; '.join(others)})" if others else "")


def open_fastest(
    weights: Weights,
    *,
    confidence: float,
    threads: int,
    device: Device = "auto",
    cache_dir: Path | None = None,
    pictures: Sequence[NDArray[np.uint8]] | None = None,
) -> Detector:
    """Like :func:`open_detector`, with the fastest runtime whose detections match the reference.

    The reference is torch for .pt and onnxruntime for .onnx. May take half a minute with new weights. ``pictures``
    replace ultralytics' photos.
    """
    suffix = weights.path.suffix.lower()
    if suffix != ".pt" and not (suffix == ".onnx" and openvino_installed()):
        return open_detector(weights, confidence=confidence, threads=threads, device=device)
    folder = cache_dir or _user_cache_dir()
    export = folder / f"{check_weights(weights)[:24]}-{__version__}.onnx"
    openers = _openers(weights, export, confidence=confidence, threads=threads, device=device)
    # Hash of everything but the weights that affects the measurement.
    packages = ("torch", "ultralytics-opencv-headless", "onnxruntime", "openvino")
    circumstances = [
        __version__, platform.node(), platform.machine(), platform.processor(), os.cpu_count(), threads, device,
        weights.input_px, tuple(openers), [_version(package) for package in packages],
    ]  # fmt: skip
    remembered = folder / f"{export.stem}-{hashlib.sha256(repr(circumstances).encode()).hexdigest()[:16]}.json"
    choice = _recall(remembered)
    if choice is not None and choice.runtime in openers:
        try:
            return _labelled(openers[choice.runtime](), choice)
        except WeightsError as error:
            log.warning("the %s form of %s does not open any more: %s", choice.runtime, weights.path.name, error)
    detector, choice = _measure(openers, _photos() if pictures is None else pictures)
    log.info("%s runs by %s: %s", weights.path.name, choice.runtime, choice)
    try:
        remembered.parent.mkdir(parents=True, exist_ok=True)
        replace_file(remembered, json.dumps(asdict(choice), indent=1).encode(), durable=False)
    except OSError as error:
        log.info("what was measured is not kept: %s", error)
    return _labelled(detector, choice)


def _openers(
    weights: Weights, export: Path, *, confidence: float, threads: int, device: Device
) -> dict[str, Callable[[], Detector]]:
    """Openers of the weights by runtime; the first is the reference."""

    def opened(path: Path) -> Detector:
        at = replace(weights, path=path)
        return open_detector(at, confidence=confidence, threads=threads, device=device)

    def by_openvino(path: Path) -> Detector:
        return NetworkDetector(OpenvinoNetwork(path, threads=threads), weights, confidence=confidence)

    def exported() -> Path:
        if not _is_whole(export):
            from caris_desktop.perception.backends.ultralytics_runtime import ModelExportError, export_onnx

            try:
                export_onnx(weights, export, threads=threads)
            except ModelExportError as error:
                raise WeightsError(localized(QT_TR_NOOP("it cannot be exported ({error})"), error=error)) from error
        return export

    suffix = weights.path.suffix.lower()
    if suffix == ".pt":
        openers = {"torch": lambda: opened(weights.path), "onnxruntime": lambda: opened(exported())}
        if openvino_installed():
            openers["OpenVINO"] = lambda: by_openvino(exported())
        return openers
    return {"onnxruntime": lambda: opened(weights.path), "OpenVINO": lambda: by_openvino(weights.path)}


def _measure(
    openers: dict[str, Callable[[], Detector]], pictures: Sequence[NDArray[np.uint8]]
) -> tuple[Detector, MeasuredChoice]:
    first, *others = openers
    opened = {first: openers[first]()}
    why_not: dict[str, str] = {}
    expected = [opened[first].detect(picture) for picture in pictures]
    comparable = any((one.confidences > _SURE).any() for one in expected)
    for name in others:
        try:
            detector = openers[name]()
            found = [detector.detect(picture) for picture in pictures]
        except Exception as error:  # a runtime that fails is not selected
            log.info("%s is not used", name, exc_info=True)
            why_not[name] = " ".join(str(error).split())[:_WORDS_AT_MOST] or type(error).__name__
            continue
        if not comparable:
            why_not[name] = "no people were detected in the comparison photos"
        elif all(_agree(*pair) for pair in zip(expected, found, strict=True)):
            opened[name] = detector
        else:
            why_not[name] = "its detections differ"
    ms = _time(opened, pictures)
    # Another package than the preferred one must be clearly faster.
    preferred = sorted(opened, key=_PREFERRED.index)
    runtime = preferred[0]
    for name in preferred[1:]:
        if ms[name] < _WORTH_IT * ms[runtime]:
            runtime = name
    return opened[runtime], MeasuredChoice(runtime, ms, why_not)


def _time(opened: dict[str, Detector], pictures: Sequence[NDArray[np.uint8]]) -> dict[str, float]:
    """Milliseconds per image: the minimum of several, against other load."""
    if len(opened) == 1:
        return {}
    spans_ns: dict[str, list[int]] = {name: [] for name in opened}
    for number in range(_REPEATS):
        for name, detector in opened.items():
            began_ns = time.perf_counter_ns()
            detector.detect(pictures[number % len(pictures)])
            spans_ns[name].append(time.perf_counter_ns() - began_ns)
    return {name: round(min(spans) / 1e6, 1) for name, spans in spans_ns.items()}


def _agree(one: Detections, other: Detections) -> bool:
    return _has_all(one, other) and _has_all(other, one)


def _has_all(expected: Detections, found: Detections) -> bool:
    for corners, confidence, kind in zip(expected.corners_px, expected.confidences, expected.classes, strict=True):
        if confidence <= _SURE + _CONFIDENCE_WITHIN:
            continue
        near = np.maximum(found.corners_px[:, :2], corners[:2])
        far = np.minimum(found.corners_px[:, 2:], corners[2:])
        shared = np.prod(np.maximum(far - near, 0.0), axis=1)
        areas = np.prod(found.corners_px[:, 2:] - found.corners_px[:, :2], axis=1)
        overlaps = shared / (areas + np.prod(corners[2:] - corners[:2]) - shared)
        surely = np.abs(found.confidences - confidence) < _CONFIDENCE_WITHIN
        if not ((overlaps > _LEAST_OVERLAP) & surely & (found.classes == kind)).any():
            return False
    return True


def _labelled(detector: Detector, choice: MeasuredChoice) -> Detector:
    detector.label += choice.label_suffix
    return detector


def _photos() -> list[NDArray[np.uint8]]:
    """Two photos of people from ultralytics; without them no runtime is exchanged."""
    import cv2

    spec = importlib.util.find_spec("ultralytics")
    if spec is None or spec.origin is None:
        return []
    pictures = [cv2.imread(str(Path(spec.origin).parent / "assets" / name)) for name in ("bus.jpg", "zidane.jpg")]
    return [np.asarray(picture, np.uint8) for picture in pictures if picture is not None]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _is_whole(export: Path) -> bool:
    try:
        return bool(check_file(export))
    except (OSError, WrongChecksum):
        return False


def _user_cache_dir() -> Path:
    import platformdirs

    return platformdirs.user_cache_path("caris-desktop", appauthor=False) / "detectors"


def _recall(path: Path) -> MeasuredChoice | None:
    try:
        stored: Any = parse_json(path.read_text(encoding="utf-8"))
        return MeasuredChoice(
            str(stored["runtime"]),
            {str(name): float(ms) for name, ms in stored["ms"].items()},
            {str(name): str(reason) for name, reason in stored["why_not"].items()},
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


# Open the detector selected by scenario or user, or the default one, locally or on another machine.


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
        from caris_desktop.perception.detector import WatchedDetector

        plugin = find("detectors", source.removeprefix("plugin:"))
        watched = WatchedDetector(plugin, confidence=confidence, threads=threads, notify=notify)
        return Chosen(watched, watched.people, None)
    if settings.server:
        from caris_desktop.perception.backends.remote_detector import RemoteDetector

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
