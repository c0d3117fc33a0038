"""Set-up of a process for ultralytics: no telemetry, no installs, few threads, and a torchvision that loads.

It changes process-wide state, so it is for the inference process only, never for the console.
"""

import importlib
import importlib.machinery
import importlib.util
import logging
import os
import sys
import types
from pathlib import Path
from typing import Any

log = logging.getLogger(__name__)


def prepare_runtimes(*, threads: int) -> None:
    """Limit the threads of onnxruntime and cv2. Call before their first use."""
    os.environ["OMP_NUM_THREADS"] = str(threads)

    import cv2

    cv2.setNumThreads(threads)


def prepare_ultralytics(*, threads: int, cache_dir: Path | None = None) -> None:
    """Prepare the import of ultralytics and torch. Call before the first one; once is enough.

    Parameters
    ----------
    threads
        Threads that one inference may use, at least 1, whatever runtime the weights need.
    cache_dir
        Where ultralytics keeps its settings and fonts; the user's cache folder when None.
    """
    if "ultralytics" in sys.modules:
        return
    if cache_dir is None:
        import platformdirs

        cache_dir = platformdirs.user_cache_path("caris-desktop", appauthor=False) / "ultralytics"
    cache_dir.mkdir(parents=True, exist_ok=True)
    os.environ["YOLO_CONFIG_DIR"] = str(cache_dir)
    os.environ["YOLO_OFFLINE"] = "true"
    os.environ["YOLO_AUTOINSTALL"] = "false"
    os.environ["YOLO_VERBOSE"] = "false"
    # A .pt is a pickle: it may contain only the classes that models consist of.
    os.environ["ULTRALYTICS_SAFE_LOAD"] = "true"
    prepare_runtimes(threads=threads)

    import torch

    torch.set_num_threads(threads)
    ensure_torchvision()

    import ultralytics.utils

    if ultralytics.utils.SETTINGS["sync"]:
        ultralytics.utils.SETTINGS.update({"sync": False})
    _limit_runtimes(threads)


def ensure_torchvision() -> bool:
    """Replace a torchvision that does not load by a stand-in. True if the real one loads.

    A torchvision built for CUDA does not load with a CPU build of torch. Ultralytics needs it only for non-maximum
    suppression, which it also implements itself.
    """
    try:
        importlib.import_module("torchvision")
    except (ImportError, RuntimeError, OSError) as error:
        log.info("torchvision does not load (%s); using ultralytics' own suppression", error)
        for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            del sys.modules[name]
        sys.modules.update(_torchvision_stand_in())
        return False
    return True


def _torchvision_stand_in() -> dict[str, types.ModuleType]:
    def nms(boxes: Any, scores: Any, iou_threshold: float) -> Any:
        from ultralytics.utils.nms import TorchNMS

        return TorchNMS.nms(boxes, scores, iou_threshold)

    package, ops = types.ModuleType("torchvision"), types.ModuleType("torchvision.ops")
    for module in (package, ops):
        module.__spec__ = importlib.machinery.ModuleSpec(module.__name__, None)
    package.__path__ = []
    vars(ops)["nms"] = nms
    vars(package)["ops"] = ops
    return {"torchvision": package, "torchvision.ops": ops}


def _limit_runtimes(threads: int) -> None:
    """Limit the threads of runtimes that ultralytics opens itself, which has no setting for them."""
    from ultralytics.nn import autobackend
    from ultralytics.nn.backends import litert
    from ultralytics.nn.backends.onnx import ONNXBackend

    from caris_desktop.perception.backends.onnx import session_options

    class QuietOnnxBackend(ONNXBackend):  # type: ignore[misc]  # ultralytics is untyped
        def __init__(self, weight: Any, device: Any, fp16: bool = False) -> None:
            super().__init__(weight, device, fp16, session_options=session_options(threads))

    litert.NUM_THREADS = threads
    autobackend.AutoBackend._BACKEND_MAP["onnx"] = QuietOnnxBackend


def torch_device(device: str) -> str:
    """torch device: the wanted one if available, for ``auto`` the best available."""
    import torch

    cuda, mps = torch.cuda.is_available(), torch.backends.mps.is_available()
    if device in ("auto", "cuda") and cuda:
        return "cuda:0"
    return "mps" if device in ("auto", "mps") and mps else "cpu"
