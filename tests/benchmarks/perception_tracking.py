"""Quality and speed of tracking on a street video; prints one JSON object.

    python -m tests.benchmarks.perception_tracking [--video FILE --truth FILE] [--weights FILE] [--threads N] ...

The video runs at its own rate through the camera process, the frame ring and the inference process. HOTA, MOTA and IDF1
need the PyPI package trackeval and the scorer in ../shared/tools.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from caris_desktop.perception.inference_messages import InferenceSettings
from tests.perception.shared_data import MOT_SCORE, TUD_CAMPUS_TRUTH, TUD_CAMPUS_VIDEO
from tests.perception.video_pipeline import play, score, write_mot


def main() -> None:
    defaults = InferenceSettings()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--video", type=Path, default=TUD_CAMPUS_VIDEO)
    parser.add_argument("--truth", type=Path, default=TUD_CAMPUS_TRUTH)
    parser.add_argument("--weights", type=Path, help="default: as the console finds them")
    parser.add_argument("--threads", type=int, default=defaults.threads)
    parser.add_argument("--max-load", type=float, default=defaults.max_load)
    parser.add_argument("--tracker", default=defaults.tracker)
    arguments = parser.parse_args()
    settings = InferenceSettings(
        weights_path=arguments.weights,
        threads=arguments.threads,
        max_load=arguments.max_load,
        tracker=arguments.tracker,
    )
    playback = play(arguments.video, settings)
    inference_ms = [people.inference_ms for people in playback.people]
    report: dict[str, object] = {
        "model": playback.model,
        "tracker": settings.tracker,
        "threads": settings.threads,
        "load_s": round(playback.load_s, 2),
        "frames": len(playback.frames),
        "frames_processed": len(playback.people),
        "inference_ms": _quantiles(inference_ms),
        "frame_to_people_ms": _quantiles(playback.latency_ms),
        "inference_cores": round(playback.inference_cpu_s / playback.wall_s, 2),
    }
    if arguments.truth.is_file() and MOT_SCORE.is_file():
        with tempfile.TemporaryDirectory() as folder:
            result = Path(folder) / "result.txt"
            write_mot(playback.people, result)
            report["scores"] = score(arguments.truth, result, MOT_SCORE)
    print(json.dumps(report))


def _quantiles(values_ms: "list[float] | tuple[float, ...]") -> dict[str, float]:
    return {f"p{p}": round(float(np.percentile(values_ms, p)), 1) for p in (50, 95)}


if __name__ == "__main__":
    main()
