"""Reads a file that may have its checksum beside it."""

import hashlib
from pathlib import Path

from caris_desktop.domain.translation import QT_TR_NOOP, filled


class WrongChecksum(Exception):  # noqa: N818 - says what is wrong with the file
    """It is another file than the one whose checksum lies beside it."""


def read_checked(path: Path) -> tuple[bytes, str]:
    """Content and SHA-256. Where a file of the same name with ``.sha256`` behind it lies beside it, the checksum has to
    be the one in there.

    Raises
    ------
    OSError
        Where one of them cannot be read.
    WrongChecksum
        Where the checksum is another.
    """
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    expected = path.with_name(f"{path.name}.sha256")
    if expected.is_file() and expected.read_text("ascii", "replace").lower().split()[:1] != [digest]:
        raise WrongChecksum(
            filled(
                QT_TR_NOOP("{name} is not the network whose checksum is in {checksums}."),
                name=path.name,
                checksums=expected.name,
            )
        )
    return content, digest
