"""Output formats of detectors with synthetic values: position of boxes and keypoints in the image."""

import tracemalloc
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.perception.backends.network import (
    ModelFacts,
    NetworkDetector,
    UnknownFormError,
    facts_of,
    fit,
    form_of,
    input_size,
    person_groups,
    pixels_rgb,
    planes_bgr,
    planes_rgb,
    suppress,
)
from caris_desktop.perception.backends.runtimes import metadata_of
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.weights import Weights

_SIZE = (64, 96)
_PLACES = 8 * 12 + 4 * 6 + 2 * 3
# An image of 180x60 fills 96x32 of the input, 16 pixels from the top.
_PICTURE = np.zeros((60, 180, 3), np.uint8)
_WEIGHTS = Weights(Path("made-by-hand.onnx"), "made by hand", 96)


@dataclass
class Network:
    output: NDArray[np.float32]
    facts: ModelFacts = field(default_factory=ModelFacts)
    runtime: str = "by hand"
    fixed_size: tuple[int, int] | None = _SIZE
    channels_last: bool = False
    relative: bool = False
    taken: tuple[int, ...] = ()

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        self.taken = values.shape
        return self.output


_CAT_AND_PERSON = ModelFacts(("cat", "person"))


def _raw(*places: tuple[float, ...], rows: int) -> NDArray[np.float32]:
    output = np.zeros((1, rows, _PLACES), np.float32)
    for at, values in enumerate(places):
        output[0, : len(values), at * 7] = values
    return output


@pytest.mark.parametrize("facts", [_CAT_AND_PERSON, ModelFacts()], ids=["named", "unnamed"])
def test_places_with_probabilities(facts: ModelFacts) -> None:
    output = _raw((48, 32, 24, 16, 0.2, 0.9), (48, 32, 24, 17, 0.1, 0.8), (10, 30, 4, 4, 0.05, 0.09), rows=6)
    found = NetworkDetector(Network(output, facts), _WEIGHTS, confidence=0.1).detect(_PICTURE)
    # Scaled by 96/180; the second is a duplicate, the third below the threshold.
    np.testing.assert_allclose(found.corners_px, [[67.5, 15.0, 112.5, 45.0]])
    np.testing.assert_allclose(found.confidences, [0.9])
    assert found.classes.tolist() == [1]
    assert found.keypoints is None


def test_boxes_that_the_network_chose_itself_are_not_chosen_again() -> None:
    output = np.zeros((1, 300, 6), np.float32)
    output[0, :4] = [
        (36, 24, 60, 40, 0.9, 0),
        (36, 24, 60, 41, 0.8, 0),
        (0, 0, 500, 60, 0.7, 79),
        (36, 24, 60, 40, 0.6, 99),
    ]
    detector = NetworkDetector(Network(output), _WEIGHTS, confidence=0.1)
    assert (len(detector.class_names), detector.class_names[0]) == (80, "person")
    found = detector.detect(_PICTURE)
    assert found.classes.tolist() == [0, 0, 79], "a class that nobody knows is none"
    np.testing.assert_allclose(found.corners_px[2], [0, 0, 180, 60], err_msg="inside the picture")


def test_boxes_in_parts_of_the_input() -> None:
    output = np.zeros((1, 300, 6), np.float32)
    output[0, 0] = (36 / 96, 24 / 64, 60 / 96, 40 / 64, 0.9, 0)
    network = Network(output, channels_last=True, relative=True)
    found = NetworkDetector(network, _WEIGHTS, confidence=0.1).detect(_PICTURE)
    np.testing.assert_allclose(found.corners_px, [[67.5, 15.0, 112.5, 45.0]], rtol=1e-6)
    assert network.taken == (1, *_SIZE, 3)


def test_yolox_is_recognised_by_its_places_and_pads_in_the_corner() -> None:
    output = np.full((1, _PLACES, 7), -5.0, np.float32)
    output[..., 4] = 0.0
    # Cell (row 1, column 2) of stride 16: centre 2.5 and 1.5 strides, two strides wide, one high.
    output[0, 96 + 6 + 2] = (0.5, 0.5, np.log(2.0), 0.0, 0.9, 0.1, 0.8)
    detector = NetworkDetector(Network(output, _CAT_AND_PERSON), _WEIGHTS, confidence=0.1)
    found = detector.detect(_PICTURE)
    scale = 96 / 180
    np.testing.assert_allclose(found.corners_px, [[24 / scale, 16 / scale, 56 / scale, 32 / scale]])
    np.testing.assert_allclose(found.confidences, [0.72], rtol=1e-6)
    assert found.classes.tolist() == [1]


@pytest.mark.parametrize("values", [2, 3])
@pytest.mark.parametrize("final", [False, True])
def test_points_of_a_pose(final: bool, values: int) -> None:
    points = [(48 + number, 16 + number, 0.5)[:values] for number in range(17)]
    flat = [value for point in points for value in point]
    facts = ModelFacts(("person",), keypoint_values=17 * values)
    if final:
        output = np.zeros((1, 300, 6 + len(flat)), np.float32)
        output[0, 0] = (36, 24, 60, 40, 0.9, 0, *flat)
    else:
        output = _raw((48, 32, 24, 16, 0.9, *flat), rows=5 + len(flat))
    found = NetworkDetector(Network(output, facts), _WEIGHTS, confidence=0.1).detect(_PICTURE)
    assert found.keypoints is not None
    np.testing.assert_allclose(found.corners_px, [[67.5, 15.0, 112.5, 45.0]])
    np.testing.assert_allclose(found.keypoints[0, 0], [90.0, 0.0, 0.5 if values == 3 else 1.0])
    np.testing.assert_allclose(found.keypoints[0, 16, :2], [120.0, 30.0])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_network_that_overflows_finds_nothing(value: float) -> None:
    output = _raw((value, 32, 24, 16, 0.9, 0.1), rows=6)
    found = NetworkDetector(Network(output, _CAT_AND_PERSON), _WEIGHTS, confidence=0.1).detect(_PICTURE)
    assert found.corners_px.shape == (0, 4)


@pytest.mark.parametrize("shape", [(1, 7, _PLACES), (1, 6, 5, 5), (2, 6, _PLACES), (1, _PLACES, 6 + 80)])
def test_other_forms_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(UnknownFormError, match="output"):
        NetworkDetector(Network(np.zeros(shape, np.float32), _CAT_AND_PERSON), _WEIGHTS, confidence=0.1)


def test_a_network_for_something_else_is_refused() -> None:
    facts = facts_of({"task": "segment", "names": "{0: 'person'}"})
    with pytest.raises(UnknownFormError, match="not a bounding-box detector"):
        NetworkDetector(Network(_raw(rows=37), facts), _WEIGHTS, confidence=0.1)


def test_forms_by_shape() -> None:
    def form(shape: tuple[int, ...], **told: int | None) -> str | None:
        return form_of(shape, (640, 640), **{"class_count": None} | told)  # type: ignore[arg-type]

    assert form((1, 84, 8400)) == "raw"
    assert form((1, 84, 8500), class_count=80) == "raw", "a head with more places"
    assert form((1, 56, 8400), class_count=1, keypoint_values=51) == "raw"
    assert form((1, 300, 6)) == form((1, 300, 6), class_count=80) == "final"
    assert form((1, 300, 57), class_count=1, keypoint_values=51) == "final"
    assert form((1, 8400, 85)) == form((1, 8400, 85), class_count=80) == "yolox"
    assert form((1, 25200, 85)) is None, "YOLOv5"
    assert form((1, 1000)) is None


def test_metadata_of_a_file_is_read_and_never_run(tmp_path: Path) -> None:
    told = {"task": "pose", "names": "{0: 'person', 2: 'cat'}", "kpt_shape": "[17, 3]"}
    assert facts_of(told) == ModelFacts(("person", "", "cat"), 51, True)
    assert facts_of({"names": ["a", "b"]}) == ModelFacts(("a", "b"))
    trap = f"__import__('pathlib').Path({str(tmp_path / 'made')!r}).touch()"
    assert facts_of({"names": trap, "kpt_shape": "(" * 500}) == ModelFacts()
    assert not (tmp_path / "made").exists()
    assert len(facts_of({"names": "{0: 'person', 999999999: 'x'}"}).class_names) <= 10_000
    with zipfile.ZipFile(tmp_path / "a.tflite", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("metadata.json", '{"task": "pose", "x": "' + " " * 100_000_000 + '"}')
    tracemalloc.start()
    assert metadata_of(tmp_path / "a.tflite") == {}
    assert tracemalloc.get_traced_memory()[1] < 20_000_000
    tracemalloc.stop()


def test_of_boxes_of_one_group_the_surest_stays() -> None:
    corners = np.array([[0, 0, 10, 10], [0, 0, 10, 9], [0, 0, 10, 10], [0, 0, 10, 6], [50, 0, 60, 10]], float)
    found = Detections(corners, np.array([0.5, 0.9, 0.7, 0.6, 0.3]), np.array([0, 1, 2, 0, 1]))
    groups = person_groups(("Fall", "Normal", "dog"), ("normal", "fall"))
    kept = suppress(found, groups)
    assert kept.confidences.tolist() == [0.9, 0.7, 0.6, 0.3]
    assert kept.classes.tolist() == [1, 2, 0, 1]


def test_pictures_are_fitted_without_a_squeeze() -> None:
    assert input_size((480, 640), 416) == (320, 416)
    assert input_size((1, 1), 416) == (416, 416)
    assert input_size((1, 3000), 416) == (32, 416)
    picture = np.full((60, 180, 3), (1, 2, 3), np.uint8)
    middle, how = fit(picture, _SIZE)
    assert middle[15].tolist() == middle[48].tolist() == [[114, 114, 114]] * 96
    assert middle[16:48].reshape(-1, 3).tolist() == [[1, 2, 3]] * 96 * 32
    np.testing.assert_allclose(how.to_picture(np.array([[96.0, 48.0]])), [[180.0, 60.0]])
    corner, _ = fit(picture, _SIZE, centred=False)
    assert corner[31, 0].tolist() == [1, 2, 3]
    assert corner[32, 0].tolist() == [114, 114, 114]
    same, _ = fit(middle, _SIZE)
    assert same is middle, "nothing to do"


def test_inputs_of_networks() -> None:
    picture = np.array([[[255, 51, 0]]], np.uint8)
    assert planes_rgb(picture).tolist() == [[[[0.0]], [[np.float32(0.2)]], [[1.0]]]]
    assert pixels_rgb(picture).tolist() == [[[[0.0, np.float32(0.2), 1.0]]]]
    assert planes_bgr(picture).tolist() == [[[[255.0]], [[51.0]], [[0.0]]]]
    assert {values.dtype for values in (planes_rgb(picture), pixels_rgb(picture), planes_bgr(picture))} == {
        np.dtype(np.float32)
    }
