"""ONNX sessions of the recogniser process, limited to minimal processor use."""

from pathlib import Path
from typing import TYPE_CHECKING

from caris_desktop.domain.model_files import read_checked

if TYPE_CHECKING:
    import onnxruntime


def open_network(path: Path) -> "onnxruntime.InferenceSession":
    """Session on one thread without spinning, which delays other processes on a busy computer by milliseconds.

    Raises WrongChecksum.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(read_checked(path)[0], sess_options=options, providers=["CPUExecutionProvider"])
