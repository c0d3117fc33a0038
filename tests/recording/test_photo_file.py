"""Metadata of photo files as read by other programs, and files that are not photos."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PySide6.QtGui import QImageReader

from caris_desktop.recording.photo_file import PhotoFileError, change_texts, texts_of, with_texts

PICTURE = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)


@pytest.fixture
def png() -> bytes:
    return bytes(cv2.imencode(".png", PICTURE)[1].tobytes())


def test_other_programs_read_the_texts_and_the_same_picture(png: bytes, tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    path.write_bytes(with_texts(png, {"Camera": "front", "People": "p-1 p-2", "Robot pose": ""}))
    change_texts(path, {"Keywords": "Roböter, tür"})
    change_texts(path, {"Keywords": "Tür, \U0001f916", "Camera": "rear"})
    reader = QImageReader(str(path))
    assert {key: reader.text(key) for key in reader.textKeys()} == {
        "Camera": "rear", "People": "p-1 p-2", "Keywords": "Tür, \U0001f916",
    }  # fmt: skip
    assert np.array_equal(cv2.imread(str(path)), PICTURE)
    assert texts_of(path.read_bytes()) == {"Camera": "rear", "People": "p-1 p-2", "Keywords": "Tür, \U0001f916"}
    change_texts(path, {"Keywords": ""})
    assert "Keywords" not in texts_of(path.read_bytes())


def test_texts_of_other_programs_are_read(png: bytes) -> None:
    ours = with_texts(png, {"Author": "Ada"})
    theirs = ours.replace(b"iTXtAuthor\0\0\0\0\0Ada", b"tEXtAuthor\0Ada\0\0\0\0")
    assert texts_of(theirs)["Author"].startswith("Ada")


@pytest.mark.parametrize(
    "spoil", [lambda png: b"", lambda png: png[:40], lambda png: b"GIF" + png, lambda png: png[:-3]]
)
def test_a_file_that_is_no_photo_is_refused(png: bytes, spoil: object) -> None:
    with pytest.raises(PhotoFileError):
        with_texts(spoil(png), {"Camera": "front"})  # type: ignore[operator]
