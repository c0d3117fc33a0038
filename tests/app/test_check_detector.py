"""``caris-desktop check`` for the detector of a scenario."""

from dataclasses import replace
from pathlib import Path

import pytest

from caris_desktop.app import composition
from caris_desktop.app.check_command import detector_finding
from caris_desktop.scenario.scenario_model import PerceptionSettings, Scenario
from tests.perception.served import Serving


def scenario(folder: Path, **told: str) -> Scenario:
    shipped = composition.find_scenario("tour-guide")
    return replace(shipped, path=folder / "mine.yaml", perception=PerceptionSettings(**told))  # type: ignore[arg-type]


def test_a_detector_next_to_the_scenario_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.onnx").write_bytes(b"network")
    finding = detector_finding(scenario(tmp_path, model="mine.onnx"))
    assert (finding.ok, finding.text) == (True, f"mine.onnx ({tmp_path / 'mine.onnx'})")


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"model": "gone.onnx"}, "does not exist"),
        ({"model": "mine.onnx", "sha256": "0" * 64}, "is not the file that the scenario expects"),
        ({"server": "ws://127.0.0.1:1"}, "127.0.0.1:1 does not respond"),
    ],
)
def test_a_faulty_detector_is_reported_with_advice(tmp_path: Path, told: dict[str, str], words: str) -> None:
    (tmp_path / "mine.onnx").write_bytes(b"network")
    finding = detector_finding(scenario(tmp_path, **told))
    assert not finding.ok
    assert words in finding.text
    assert finding.advice


def test_a_detector_on_another_machine_is_checked() -> None:
    server = Serving()
    try:
        finding = detector_finding(scenario(Path(), server=server.address))
    finally:
        server.stop()
    assert (finding.ok, finding.text) == (True, f"bright, torch on CUDA, on 127.0.0.1:{server.port}")
