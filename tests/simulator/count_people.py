"""Number of people that ultralytics finds in each image: ``count_people.py WEIGHTS FOLDER_WITH_PICTURES_NPY``."""

import os
import sys
from pathlib import Path

import numpy as np

from caris_desktop.perception.backends.ultralytics_runtime import prepare_ultralytics


def main(weights: str, folder: str) -> None:
    os.environ["YOLO_VERBOSE"] = "false"
    prepare_ultralytics(threads=1, cache_dir=Path(folder) / "cache")
    from ultralytics import YOLO

    model = YOLO(weights, task="detect")
    counts = [
        len(model.predict(picture, imgsz=320, conf=0.25, classes=[0], verbose=False)[0].boxes)
        for picture in np.load(Path(folder) / "pictures.npy")
    ]
    sys.stdout.write("\n" + " ".join(map(str, counts)) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
