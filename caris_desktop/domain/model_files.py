"""Model weights on this computer: search folders, checksums, download.

Files from packages are listed with their SHA-256 in ``resources/models.sha256``, in the format of ``sha256sum``.
"""

import functools
import hashlib
import importlib.util
import logging
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from caris_desktop.domain.address import is_encrypted_or_local, is_loopback, without_credentials
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import typed_path
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import QT_TR_NOOP, localized

_log = logging.getLogger(__name__)
_CONNECT_TIMEOUT_S = 3.0
GET_WEIGHTS_ANEW = QT_TR_NOOP(
    "Remove the folder .venv and run packaging/setup.sh, or get the file again from its original source."
)


class NotFetched(Exception):  # noqa: N818 - says what did not happen; the text says why, in words for the wizard
    """A model file could not be downloaded."""


class WrongChecksum(Exception):  # noqa: N818 - says what is wrong with the file
    """The file has another checksum than expected. The text is for the wizard."""


def _user_models_dir() -> Path:
    """Models folder in the user's data folder, the target of downloads. Not created here."""
    import platformdirs

    return platformdirs.user_data_path("caris-desktop", appauthor=False) / "models"


def models_dirs() -> tuple[Path, ...]:
    """Folders that are searched for weights, in this order."""
    configured = os.environ.get("CARIS_MODELS_DIR", "").strip()
    return (*([typed_path(configured)] if configured else []), _user_models_dir())


def packaged_file(name: str) -> Path | None:
    """File or folder of an installed package, given as ``package/data/file``; None if missing.

    Does not import the package.
    """
    package, _, rest = name.partition("/")
    found = importlib.util.find_spec(package)
    for folder in (found.submodule_search_locations or ()) if found is not None else ():
        path = Path(folder) / rest
        if path.exists():
            return path
    return None


@functools.cache
def packaged_checksums() -> dict[str, str]:
    """SHA-256 of all packaged model files, by name as for :func:`packaged_file`."""
    lines = (resources_dir() / "models.sha256").read_text(encoding="ascii").splitlines()
    return {name: checksum for checksum, name in (line.split() for line in lines)}


def check_file(path: Path) -> str:
    """SHA-256 of the file. Raises OSError, and WrongChecksum as :func:`read_checked` does."""
    with path.open("rb") as file:
        return _checked(path, hashlib.file_digest(file, "sha256").hexdigest())


def read_checked(path: Path) -> tuple[bytes, str]:
    """Content and SHA-256 of a model file, checked before it is parsed.

    Raises OSError if it cannot be read. Raises WrongChecksum if it differs from the listed file of its package, or from
    the checksum in a ``.sha256`` file of its name next to it.
    """
    content = path.read_bytes()
    return content, _checked(path, hashlib.sha256(content).hexdigest())


def _checked(path: Path, digest: str) -> str:
    if expected_of(path) - {digest}:
        raise WrongChecksum(
            localized(
                QT_TR_NOOP(
                    "The model file {name} does not match its checksum: it is damaged or was replaced. The "
                    "file is not used."
                ),
                name=path.name,
            )
        )
    return digest


def expected_of(path: Path) -> set[str]:
    """Expected checksum; empty for the user's own files. With more than one, none matches."""
    listed = (name for name in packaged_checksums() if path.as_posix().endswith(f"/{name}"))
    expected = {packaged_checksums()[name] for name in listed if packaged_file(name) == path}
    beside = path.with_name(f"{path.name}.sha256")
    if beside.is_file():
        expected |= set(beside.read_text("ascii", "replace").lower().split()[:1])
    return expected


def sha256_of(*files: Path) -> str:
    """Checksum of these files, concatenated, each as long as it says: some of the system's never end. Raises
    OSError.
    """
    checksum = hashlib.sha256()
    for each in files:
        with each.open("rb") as file:
            left_bytes = os.fstat(file.fileno()).st_size
            while chunk := file.read(min(left_bytes, 1 << 20)):
                checksum.update(chunk)
                left_bytes -= len(chunk)
    return checksum.hexdigest()


def onnx_options(threads: int) -> Any:
    """onnxruntime's session options with a thread limit and no spinning, which delayed other processes on two cores by
    up to 11 ms.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    return options


def named_path(name: str, folder: Path | None, folders: tuple[Path, ...]) -> Path | None:
    """Path that a scenario in ``folder`` names: there or in one of the models ``folders``; None if it leads out of
    them.
    """
    path = typed_path(name)
    if path.is_absolute():
        return path
    if ".." in path.parts:
        return None
    places = [each / path for each in (*([folder] if folder else []), *folders)]
    return next((place for place in places if place.exists()), places[0])


def fetch(url: str, target: Path, *, sha256: str, at_most_bytes: int) -> None:
    """Download to ``target``, which is created only if the checksum matches. Raises NotFetched.

    Every address, redirects included, must be `https://`, or on this computer from the start.
    """
    import httpx

    def check_address(request: httpx.Request) -> None:
        address = str(request.url)
        if not is_encrypted_or_local(address) or (is_loopback(address) and not is_loopback(url)):
            raise NotFetched(
                localized(QT_TR_NOOP("{address} is not an https:// address"), address=without_credentials(address))
            )

    def expected(chunks: Iterable[bytes]) -> Iterator[bytes]:
        checksum, arrived_bytes = hashlib.sha256(), 0
        for chunk in chunks:
            checksum.update(chunk)
            arrived_bytes += len(chunk)
            if arrived_bytes > at_most_bytes:
                break
            yield chunk
        if checksum.hexdigest() != sha256:
            raise NotFetched(QT_TR_NOOP("the downloaded file is not the published one and was discarded"))

    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        timeout = httpx.Timeout(30.0, connect=_CONNECT_TIMEOUT_S)
        with (
            httpx.Client(timeout=timeout, follow_redirects=True, event_hooks={"request": [check_address]}) as client,
            # As it comes: httpx would unpack a block, however much it becomes, at once.
            client.stream("GET", url, headers={"Accept-Encoding": "identity"}) as response,
        ):
            response.raise_for_status()
            replace_file(target, expected(response.iter_raw()), durable=False)
    except httpx.ConnectError as error:
        _log.info("no download of %s: %s", target.name, error)
        raise NotFetched(QT_TR_NOOP("this computer is offline")) from error
    except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
        _log.warning("download of %s failed: %s", target.name, error)
        raise NotFetched(localized(QT_TR_NOOP("network or server error ({error})"), error=error)) from error
