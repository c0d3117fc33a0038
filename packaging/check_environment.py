"""Check the set-up: import required packages, compare the models' checksums, find an OpenCV with its own Qt."""

import importlib
import importlib.metadata
import os
import sys

# Otherwise onnxruntime stores an id of this computer and reports to its maker's server what is run.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"

NEEDED = ("PySide6.QtWidgets", "cv2", "av", "onnxruntime", "sounddevice", "mcap", "roslibpy", "setproctitle", "yaml")


def problems() -> list[str]:
    found = []
    for name in NEEDED:
        try:
            importlib.import_module(name)
        except (ImportError, OSError) as error:
            found.append(f"{name} does not load: {error}")
    installed = {(distribution.metadata["Name"] or "").lower() for distribution in importlib.metadata.distributions()}
    with_qt = sorted(name for name in installed if name.startswith("opencv-") and not name.endswith("-headless"))
    if with_qt:
        found.append(
            f"{', '.join(with_qt)}: its own Qt breaks the window; only opencv-python-headless may be installed"
        )
    return found + problems_of_models()


def problems_of_models() -> list[str]:
    from caris_desktop.domain.model_files import WrongChecksum, check_file, packaged_checksums, packaged_file

    found = []
    for name in packaged_checksums():
        path = packaged_file(name)
        try:
            if path is None:
                found.append(f"{name} is not installed, or its package is another version")
            else:
                check_file(path)
        except (WrongChecksum, OSError) as error:
            found.append(f"{path}: {error}")
    return found


if __name__ == "__main__":
    lines = problems()
    print("\n".join(lines))
    sys.exit(bool(lines))
