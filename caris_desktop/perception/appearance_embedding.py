"""Appearance embeddings of people: crops through a re-identification network (OSNet, ONNX)."""

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.model_files import WrongChecksum, onnx_options, read_checked
from caris_desktop.domain.translation import QT_TR_NOOP, localized

log = logging.getLogger(__name__)

WIDTH_PX, HEIGHT_PX = 128, 256
_NAMES = "osnet*.onnx"
_PREFERRED = "osnet_x0_25_msmt17.onnx"
# ImageNet's, in RGB. With images that are only scaled, OSNet recognises half as many.
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)


class EmbeddingModelError(Exception):
    """Unusable network file. The message is for the wizard."""


class EmbeddingModel:
    """ONNX network for embeddings of images of ``size_px`` (height, width). For one thread. ``name`` is the file's name
    and the beginning of its checksum, since vectors of two networks are not comparable.

    A checksum next to the file (``.sha256``) must match. The texts say for the wizard why a file cannot be used.

    Raises
    ------
    EmbeddingModelError
        When the file cannot be used.
    """

    def __init__(
        self, path: Path, *, threads: int, size_px: tuple[int, int], unreadable: str, unloadable: str, wrong_input: str
    ) -> None:
        # The console imports this module for its types, without onnxruntime.
        from caris_desktop.perception.backends.ultralytics_runtime import prepare_runtimes

        prepare_runtimes(threads=threads)
        import onnxruntime

        try:
            content, digest = read_checked(path)
            self._session: Any = onnxruntime.InferenceSession(
                content, onnx_options(threads), providers=["CPUExecutionProvider"]
            )
        except WrongChecksum as error:
            raise EmbeddingModelError(str(error)) from error
        except OSError as error:
            raise EmbeddingModelError(localized(unreadable, name=path.name)) from error
        except Exception as error:  # onnxruntime raises undocumented types
            log.info("could not load %s", path, exc_info=True)
            raise EmbeddingModelError(localized(unloadable, name=path.name)) from error
        self.name = f"{path.stem}-{digest[:8]}"
        first = self._session.get_inputs()[0]
        self._input = first.name
        if len(first.shape) != 4 or list(first.shape[1:]) != [3, *size_px]:
            raise EmbeddingModelError(localized(wrong_input, name=path.name))
        self._one_by_one = first.shape[0] == 1


class AppearanceModel(EmbeddingModel):
    """Re-identification network. Raises EmbeddingModelError."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        unloadable = QT_TR_NOOP("The re-identification model {name} could not be loaded.")
        super().__init__(
            path,
            threads=threads,
            size_px=(HEIGHT_PX, WIDTH_PX),
            unreadable=unloadable,
            unloadable=unloadable,
            wrong_input=QT_TR_NOOP("{name} is not a re-identification model: its input is not 3 x 256 x 128."),
        )
        self.embed(np.zeros((4, 4, 3), np.uint8), [np.array([0.0, 0.0, 4.0, 4.0])])  # warm-up: slow

    def embed(self, image_bgr: NDArray[np.uint8], corners_px: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """One row of unit length for each box (left, top, right, bottom), shape (boxes, length of a vector)."""
        crops = np.stack([_crop(image_bgr, corners) for corners in corners_px])
        batches = crops[:, np.newaxis] if self._one_by_one else [crops]
        found = [self._session.run(None, {self._input: batch})[0].reshape(len(batch), -1) for batch in batches]
        vectors = np.concatenate(found).astype(np.float64)
        return np.asarray(vectors / np.maximum(1e-12, np.linalg.norm(vectors, axis=1, keepdims=True)))


def find_appearance(folders: Iterable[Path]) -> Path | None:
    """First re-identification network in these folders; None if there is none."""
    for folder in folders:
        preferred = folder / _PREFERRED
        if preferred.is_file():
            return preferred
        try:
            found = sorted(path for path in folder.glob(_NAMES) if path.is_file())
        except OSError:
            continue
        if found:
            return found[0]
    return None


def _crop(image_bgr: NDArray[np.uint8], corners: NDArray[np.float64]) -> NDArray[np.float32]:
    height, width = image_bgr.shape[:2]
    left, top, right, bottom = corners.round().astype(int)
    left, top = min(max(left, 0), width - 1), min(max(top, 0), height - 1)
    right, bottom = min(max(right, left + 1), width), min(max(bottom, top + 1), height)
    crop = cv2.resize(image_bgr[top:bottom, left:right], (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_LINEAR)
    rgb = crop[:, :, ::-1].astype(np.float32) / 255.0
    return np.ascontiguousarray(((rgb - _MEAN) / _DEVIATION).transpose(2, 0, 1))
