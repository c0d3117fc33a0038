"""TensorFlow Lite networks (float or int8) by LiteRT."""

import ast
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.perception.backends.network import ModelFacts, UnknownFormError, facts_of

_WHOLE = (np.dtype(np.int8), np.dtype(np.uint8), np.dtype(np.int16))


class TfliteNetwork:
    """``Network`` by LiteRT. Raises UnknownFormError, and what LiteRT raises for a bad file."""

    def __init__(self, path: Path, *, threads: int) -> None:
        from ai_edge_litert.interpreter import Interpreter

        self._interpreter: Any = Interpreter(str(path), num_threads=threads)
        self._interpreter.allocate_tensors()
        (self._input, *more) = self._interpreter.get_input_details()
        if more or len(self._input["shape"]) != 4:
            raise UnknownFormError(QT_TR_NOOP("its input is not a single image"))
        self._given = self._interpreter.get_output_details()[0]
        self.runtime = "LiteRT on CPU"
        self.facts: ModelFacts = facts_of(metadata_of(path))
        shape = [int(side) for side in self._input["shape"]]
        self.channels_last = shape[3] == 3
        self.fixed_size: tuple[int, int] | None = (shape[1], shape[2]) if self.channels_last else (shape[2], shape[3])
        # As in ultralytics: relative coordinates, except for boxes of a channels-first network with built-in
        # suppression.
        chosen = int(self._given["shape"][-1]) == 6 + self.facts.keypoint_values
        self.relative = self.channels_last or not chosen

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        if self._input["dtype"] in _WHOLE:
            limits = np.iinfo(self._input["dtype"])
            scale, zero = self._input["quantization"]
            values = np.rint(values / scale + zero).clip(limits.min, limits.max).astype(self._input["dtype"])
        self._interpreter.set_tensor(self._input["index"], values)
        self._interpreter.invoke()
        output = self._interpreter.get_tensor(self._given["index"])
        if self._given["dtype"] in _WHOLE:
            scale, zero = self._given["quantization"]
            output = (output.astype(np.float32) - zero) * scale
        result: NDArray[np.float32] = output.astype(np.float32, copy=False)
        return result


def metadata_of(path: Path) -> Mapping[str, object]:
    """Metadata that ultralytics appended to the file as a zip archive; empty if there is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            text = archive.read("metadata.json" if "metadata.json" in names else names[0]).decode()
    except (zipfile.BadZipFile, OSError, IndexError, UnicodeDecodeError):
        return {}
    try:
        found = json.loads(text)
    except ValueError:
        try:
            found = ast.literal_eval(text)
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            return {}
    return found if isinstance(found, dict) else {}
