"""``caris-desktop track``: MOTChallenge rows and a JSON line from a video, and error messages."""

import argparse
import json
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from caris_desktop.app import track_command
from tests.perception.shared_data import (
    INT8_WEIGHTS,
    MOT_SCORE,
    OSNET_WEIGHTS,
    TUD_CAMPUS_TRUTH,
    TUD_CAMPUS_VIDEO,
    needs_int8_weights,
    needs_tud_campus,
)
from tests.perception.video_pipeline import score

needs_osnet = pytest.mark.skipif(not OSNET_WEIGHTS.is_file(), reason=f"needs {OSNET_WEIGHTS}")


def write_video(path: Path, pictures: list[np.ndarray], *, fps: int, stamps: list[int] | None = None) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "12", "preset": "ultrafast"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
            frame.pts = number if stamps is None else stamps[number]
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def grey_video(path: Path, count: int = 3) -> Path:
    write_video(path, [np.full((96, 128, 3), 90, np.uint8)] * count, fps=10)
    return path


def campus_pictures() -> list[np.ndarray]:
    with av.open(str(TUD_CAMPUS_VIDEO)) as container:
        return [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]


def track(capsys: pytest.CaptureFixture[str], video: Path, out: Path, *words: str) -> tuple[int, str, str]:
    parser = argparse.ArgumentParser()
    track_command.add_arguments(parser)
    status = track_command.run(parser.parse_args([str(video), "--out", str(out), *words]))
    printed = capsys.readouterr()
    return status, printed.out, printed.err


def scored(result: Path, tmp_path: Path, keep: dict[int, int] | None = None) -> dict[str, float]:
    """Scores of a result; ``keep`` limits the truth to these frames and renumbers them."""
    rows = [line.split(",", 1) for line in TUD_CAMPUS_TRUTH.read_text(encoding="ascii").splitlines()]
    numbers = keep or {int(frame): int(frame) for frame, _ in rows}
    kept = [f"{numbers[int(frame)]},{rest}" for frame, rest in rows if int(frame) in numbers]
    (tmp_path / "truth.txt").write_text("\n".join(kept), encoding="ascii")
    scores = score(tmp_path / "truth.txt", result, MOT_SCORE)
    if scores is None:
        pytest.skip("needs the package trackeval, to be installed with --no-deps")
    return scores


@needs_int8_weights
@needs_tud_campus
@pytest.mark.parametrize(
    "words", [pytest.param((), marks=needs_osnet, id="looks"), pytest.param(("--no-looks",), marks=pytest.mark.long)]
)
@pytest.mark.long
def test_a_street_is_followed_better_than_by_the_library(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    result = tmp_path / "result.txt"
    status, printed, told = track(capsys, TUD_CAMPUS_VIDEO, result, "--model", str(INT8_WEIGHTS), *words)
    assert status == 0, told
    report: dict[str, Any] = json.loads(printed)
    assert report["frames"] == 71
    assert report["fps"] == pytest.approx(report["frames"] / report["seconds"], abs=0.06)  # one decimal
    rows = np.loadtxt(result, delimiter=",")
    assert rows.shape[1] == 10
    assert (np.diff(rows[:, 0]) >= 0).all()
    scores = scored(result, tmp_path)
    assert scores["HOTA"] >= 52.0, scores
    assert scores["IDF1"] >= 72.0, scores
    assert scores["id_switches"] <= 6, scores


@pytest.mark.long
@needs_int8_weights
@needs_tud_campus
@needs_osnet
def test_seven_pictures_a_second_of_which_a_fifth_is_lost_cost_little(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = campus_pictures()
    chance = np.random.default_rng(4)
    whole = scored_after(tmp_path, capsys, pictures, list(range(len(pictures))))
    losses = []
    for _ in range(2):
        seven = [round(number * 25 / 7) for number in range(20)]
        kept = [number for number in seven if number < len(pictures) and chance.random() >= 0.2]
        losses.append(whole - scored_after(tmp_path, capsys, pictures, kept))
    assert np.mean(losses) <= 5.0, losses


def scored_after(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], pictures: list[np.ndarray], kept: list[int]
) -> float:
    """IDF1 of these frames alone, in a video that shows them at their times."""
    video, result = tmp_path / "kept.mp4", tmp_path / "result.txt"
    write_video(video, [pictures[number] for number in kept], fps=25, stamps=kept)
    status, _, told = track(capsys, video, result, "--model", str(INT8_WEIGHTS))
    assert status == 0, told
    return scored(result, tmp_path, {number + 1: row for row, number in enumerate(kept, start=1)})["IDF1"]


@needs_int8_weights
def test_nobody_in_a_video_is_an_empty_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = tmp_path / "result.txt"
    status, printed, told = track(capsys, grey_video(tmp_path / "grey.mp4"), result, "--model", str(INT8_WEIGHTS))
    assert (status, result.read_text(encoding="ascii")) == (0, ""), told
    assert json.loads(printed)["people"] == 0


@needs_int8_weights
@needs_tud_campus
@pytest.mark.long
def test_a_torn_picture_is_passed_over_and_the_others_keep_their_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = bytearray(TUD_CAMPUS_VIDEO.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 3000] = b"\x55" * 3000
    torn, result = tmp_path / "torn.mp4", tmp_path / "result.txt"
    torn.write_bytes(content)
    status, printed, told = track(capsys, torn, result, "--model", str(INT8_WEIGHTS), "--no-looks")
    assert status == 0, told
    assert "Damaged frames in torn.mp4, skipped: 1." in told
    assert json.loads(printed)["frames"] == 70
    assert np.loadtxt(result, delimiter=",")[:, 0].max() == 71


WRONG: dict[str, tuple[str, str, list[str], str]] = {
    # Video, result, further arguments, and the error message; in the test's folder.
    "missing": ("none.mp4", "result.txt", [], "none.mp4 does not exist"),
    "folder": (".", "result.txt", [], "is not a file"),
    "text": ("text.mp4", "result.txt", [], "text.mp4 cannot be read as a video"),
    "letters": ("text.txt", "result.txt", [], "text.txt cannot be read as a video"),
    "cut": ("cut.mp4", "result.txt", [], "cut.mp4 cannot be read as a video"),
    "result is a folder": ("grey.mp4", ".", [], "is a folder"),
    "no such folder": ("grey.mp4", "none/result.txt", [], "none does not exist"),
    "result is the video": ("grey.mp4", "grey.mp4", [], "would overwrite the video"),
    "no model": ("grey.mp4", "result.txt", ["--model", "none.onnx"], "none.onnx does not exist"),
    "truncated model": ("grey.mp4", "result.txt", ["--model", "short.tflite"], "short.tflite could not be"),
    "truncated network": ("grey.mp4", "result.txt", ["--model", "short.onnx"], "short.onnx could not be"),
    "no threads": ("grey.mp4", "result.txt", ["--threads", "0"], "--threads"),
}


@pytest.mark.logs(r"could not load short\.")
@pytest.mark.parametrize("what", WRONG)
def test_an_error_is_one_sentence_and_nothing_is_written(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    what: str,
) -> None:
    grey = grey_video(tmp_path / "grey.mp4").read_bytes()
    for name in ("text.mp4", "text.txt"):
        (tmp_path / name).write_text("no video at all\n" * 50, encoding="ascii")
    (tmp_path / "cut.mp4").write_bytes(grey[:200])
    (tmp_path / "short.tflite").write_bytes(INT8_WEIGHTS.read_bytes()[:100_000] if INT8_WEIGHTS.is_file() else b"TFL3")
    (tmp_path / "short.onnx").write_bytes(b"\x08\x08\x12\x07py")
    monkeypatch.chdir(tmp_path)
    video, result, words, sentence = WRONG[what]
    status, printed, told = track(capsys, Path(video), Path(result), *words)
    assert (status, printed) == (1, "")
    assert sentence in told
    assert len(told.strip().splitlines()) == 1, told
    assert not (tmp_path / "result.txt").exists()
    assert (tmp_path / "grey.mp4").read_bytes() == grey
