"""Runs ONNX detectors for ultralytics with threads that sleep instead of spin."""

from typing import Any


def onnx_backend_class(*, threads: int) -> type[Any]:
    """An ultralytics backend class whose onnxruntime session uses at most ``threads`` threads."""
    import onnxruntime
    from ultralytics.nn.backends.onnx import ONNXBackend

    class QuietOnnxBackend(ONNXBackend):  # type: ignore[misc]  # ultralytics is untyped
        def __init__(self, weight: Any, device: Any, fp16: bool = False) -> None:
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = threads
            options.inter_op_num_threads = 1
            # Spinning threads were measured to delay another process on two cores by up to 11 ms.
            options.add_session_config_entry("session.intra_op.allow_spinning", "0")
            super().__init__(weight, device, fp16, session_options=options)

    return QuietOnnxBackend
