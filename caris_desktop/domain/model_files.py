"""Where weights of models lie on this computer, and how a file of them is fetched: whole and right, or not at all."""

import hashlib
import logging
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from caris_desktop.domain.address import is_encrypted_or_local, is_loopback, without_credentials
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.translation import QT_TR_NOOP, filled

_log = logging.getLogger(__name__)
_CONNECT_TIMEOUT_S = 3.0


class NotFetched(Exception):  # noqa: N818 - says what did not happen; the text says why, in words for the wizard
    """A file of a model did not arrive."""


def _user_models_dir() -> Path:
    """The models folder in the user's data folder, which downloads go to. Not created here."""
    import platformdirs

    return platformdirs.user_data_path("caris-desktop", appauthor=False) / "models"


def models_dirs() -> tuple[Path, ...]:
    """Folders that are searched for weights, in this order."""
    configured = os.environ.get("CARIS_MODELS_DIR", "").strip()
    return (*([Path(configured).expanduser()] if configured else []), _user_models_dir())


def sha256_of(*files: Path) -> str:
    """The checksum of these files one after the other. Raises OSError."""
    checksum = hashlib.sha256()
    for each in files:
        with each.open("rb") as file:
            while chunk := file.read(1 << 20):
                checksum.update(chunk)
    return checksum.hexdigest()


def fetch(url: str, target: Path, *, sha256: str, at_most_bytes: int) -> None:
    """Download to ``target``, which appears only when it is the file with this checksum. Raises NotFetched.

    Each address on the way, also one that a server redirects to, is `https://`, or on this computer from the start.
    """
    import httpx

    def check_address(request: httpx.Request) -> None:
        asked = str(request.url)
        if not is_encrypted_or_local(asked) or (is_loopback(asked) and not is_loopback(url)):
            raise NotFetched(
                filled(QT_TR_NOOP("{address} is not an https:// address"), address=without_credentials(asked))
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
            raise NotFetched(QT_TR_NOOP("what arrived is not the published file, so it was thrown away"))

    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        timeout = httpx.Timeout(30.0, connect=_CONNECT_TIMEOUT_S)
        with (
            httpx.Client(timeout=timeout, follow_redirects=True, event_hooks={"request": [check_address]}) as client,
            client.stream("GET", url) as response,
        ):
            response.raise_for_status()
            replace_file(target, expected(response.iter_bytes()), durable=False)
    except httpx.ConnectError as error:
        _log.info("no download of %s: %s", target.name, error)
        raise NotFetched(QT_TR_NOOP("this computer is offline")) from error
    except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
        _log.warning("download of %s failed: %s", target.name, error)
        raise NotFetched(filled(QT_TR_NOOP("failed: {error}"), error=error)) from error
