"""Open detector files with the thinnest runner that supports them."""

import logging

from caris_desktop.domain.model_files import GET_WEIGHTS_ANEW, WrongChecksum, check_file
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.backends.network import Network, NetworkDetector, UnknownFormError
from caris_desktop.perception.backends.ultralytics_setup import prepare_runtimes
from caris_desktop.perception.detector import Detector
from caris_desktop.perception.inference_messages import Device
from caris_desktop.perception.weights import Weights, WeightsError

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
        network = _network(weights, confidence=confidence, threads=threads, device=device)
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
    return _by_ultralytics(weights, confidence=confidence, threads=threads, device=device)


def _network(weights: Weights, *, confidence: float, threads: int, device: Device) -> Network | None:
    suffix = weights.path.suffix.lower()
    if suffix == ".onnx":
        from caris_desktop.perception.backends.onnx import OnnxNetwork

        return OnnxNetwork(weights.path, threads=threads, device=device)
    if suffix == ".tflite":
        from caris_desktop.perception.backends.tflite import TfliteNetwork

        return TfliteNetwork(weights.path, threads=threads)
    if suffix == ".xml" or weights.path.is_dir():
        from caris_desktop.perception.backends import openvino

        if not openvino.is_installed():
            raise WeightsError(
                localized(
                    QT_TR_NOOP("The detector {name} needs OpenVINO, which is not installed"), name=weights.path.name
                ),
                searched=(str(weights.path),),
                advice=QT_TR_NOOP("Run: pip install openvino, or choose an .onnx file"),
            )
        return openvino.OpenvinoNetwork(weights.path, threads=threads)
    return None


def _by_ultralytics(weights: Weights, *, confidence: float, threads: int, device: Device) -> Detector:
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
