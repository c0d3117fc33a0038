"""CARIS Desktop: an operator console for Wizard-of-Oz studies with mobile robots."""

import os
import sys

# Libraries that tell their makers what runs here, or keep an id of this computer (onnxruntime with the detector, the
# recogniser and Piper; OpenVINO). In every process of the program, before any of them is imported.
sys.modules["openvino_telemetry"] = None  # type: ignore[assignment] # has no switch; OpenVINO does without it
os.environ |= {
    "ORT_DISABLE_TELEMETRY": "1",
    "HF_HUB_DISABLE_TELEMETRY": "1",
    "HF_HUB_OFFLINE": "1",  # models come as packages and from addresses of the scenario
    "DO_NOT_TRACK": "1",
}

__version__ = "0.1.0"
