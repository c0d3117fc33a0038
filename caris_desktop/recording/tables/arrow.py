"""Arrow arrays of the columns of tables."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from caris_desktop.recording.tables.catalog import Column, Kind, json_text, plain_text, scalar_text

_log = logging.getLogger(__name__)


def array(table: str, column: Column, values: list[Any]) -> Any:
    """Arrow array of a column; values that do not fit (damaged recording) become missing and are logged."""
    import pyarrow as pa

    kind = arrow_type(column.kind)
    if ready := _READY.get(column.kind):
        values = [None if value is None else ready(value) for value in values]
    try:
        return pa.array(values, kind)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        fitting = [_fitting(value, kind) for value in values]
        left_out = sum(one is None for one in fitting) - sum(one is None for one in values)
        _log.warning("%s: %d values are left out: no %s", table, left_out, kind)
        return pa.array(fitting, kind)


def arrow_type(kind: Kind) -> Any:
    import pyarrow as pa

    match kind:
        case "integer":
            return pa.int64()
        case "number":
            return pa.float64()
        case "true or false":
            return pa.bool_()
        case "utc":
            return pa.timestamp("us", tz="UTC")
        case "integers":
            return pa.list_(pa.int64())
        case "numbers":
            return pa.list_(pa.float32())
        case "texts":
            return pa.list_(pa.string())
        case "points":
            return pa.list_(pa.list_(pa.float32()))
        case "cells":
            return pa.list_(pa.int8())
        case "depths":
            return pa.list_(pa.uint16())
        case "text" | "json":
            return pa.string()


_READY: dict[Kind, Callable[[Any], Any]] = {
    "text": scalar_text,
    "json": json_text,
    "utc": lambda value: value // 1000,
    "numbers": lambda value: np.asarray(value, dtype=np.float32).ravel(),
    "points": lambda value: [point.tolist() for point in value],
    "cells": np.ravel,
    "depths": np.ravel,
    "texts": lambda value: [plain_text(str(item)) for item in value],
}
"""Conversion for the column's type, of values that Arrow does not take as they are."""


def _fitting(value: Any, kind: Any) -> Any:
    import pyarrow as pa

    try:
        pa.scalar(value, kind)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        return None
    return value
