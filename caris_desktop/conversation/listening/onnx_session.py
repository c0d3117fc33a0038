"""Small networks in the recogniser's process, so that they take no more of the processor than they need."""

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import onnxruntime


def open_network(path: Path) -> "onnxruntime.InferenceSession":
    """On one thread that does not spin: spinning threads delay others on a busy computer by milliseconds."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(path, sess_options=options, providers=["CPUExecutionProvider"])


def file_in_package(package: str, *parts: str) -> Path | None:
    """A file that an installed package brings, found without importing the package; None where it is not there."""
    found = importlib.util.find_spec(package)
    for folder in (found.submodule_search_locations or ()) if found is not None else ():
        path = Path(folder).joinpath(*parts)
        if path.exists():
            return path
    return None
