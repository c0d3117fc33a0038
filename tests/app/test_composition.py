"""Checks of the adapters between packages."""

from pathlib import Path

import pytest

from caris_desktop.app import composition
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.services.cameras_service import CameraSelection
from caris_desktop.perception.weights import DetectorChoice
from caris_desktop.scenario.scenario_model import Scenario


def test_a_scenario_whose_control_publishes_where_its_robot_takes_velocities_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "disguised.yaml"
    publish = "publish: {topic: TOPIC, type: std_msgs/String, message: {linear: {x: 0.3}}}"
    control = f"controls:\n  - {{id: go, title: Go, kind: button, moves: false, {publish}}}\n"
    text = f"version: 1\ntitle: A\nrobot: tiago\nlayout: {{panel: robot}}\n{control}"
    path.write_text(text.replace("TOPIC", "/key_vel"), encoding="utf-8")
    with pytest.raises(composition.StartError, match="line 6: 'go' publishes velocities"):
        composition.find_scenario(str(path))
    path.write_text(text.replace("TOPIC", "/said"), encoding="utf-8")
    assert [control.id for control in composition.find_scenario(str(path), accept_named=True).controls] == ["go"]


def scenario_with(text: str, folder: Path) -> Scenario:
    path = folder / "cameras.yaml"
    path.write_text(f"version: 1\ntitle: A\nlayout: {{panel: video}}\n{text}", encoding="utf-8")
    return composition.find_scenario(str(path), accept_named=True)


def names(wanted: CameraSelection) -> list[str]:
    return [camera.name for camera in wanted.own]


def test_a_scenario_names_its_cameras_and_the_command_line_goes_before_it(tmp_path: Path) -> None:
    study = composition.open_study(tmp_path / "study")
    plain = scenario_with("", tmp_path)
    mount = "mount: {width_px: 1280, height_px: 720, horizontal_fov_deg: 70, x_m: 0.2}"
    text = f"cameras:\n  - source: robot:front\n  - {{source: '0', name: desk, {mount}}}\n  - source: oak\n"
    scenario = scenario_with(text, tmp_path)

    of_scenario = composition.parts(study=study).cameras
    assert of_scenario(plain) == CameraSelection(), "the robot's own, all of them"
    wanted = of_scenario(scenario)
    assert (names(wanted), wanted.of_robot) == (["desk", "oak"], ("front",))
    assert [camera.body.name for camera in wanted.own] == ["camera desk", "camera oak"]
    assert wanted.own[0].model is not None and wanted.own[0].model.x_m == 0.2

    for given, own, of_robot in (
        (["0"], ["camera-0"], ()),
        (["robot", "0"], ["camera-0"], None),
        (["robot:rear", "walk.mp4", "other/walk.mp4"], ["walk", "walk-2"], ("rear",)),
    ):
        wanted = composition.parts(study=study, cameras=given).cameras(scenario)
        assert (names(wanted), wanted.of_robot) == (own, of_robot)


def test_a_camera_on_a_desk_stands_at_one_of_the_places(tmp_path: Path) -> None:
    study = composition.open_study(tmp_path / "study")
    mount = "mount: {width_px: 1280, height_px: 720, horizontal_fov_deg: 70, z_m: 1.2}"
    places = "places:\n  - {name: Desk, x_m: 4.0, y_m: -2.0, heading_deg: 90}\n"
    text = f"{places}cameras:\n  - {{source: '0', name: desk, {mount}, place: PLACE}}\n"
    wanted = composition.parts(study=study).cameras(scenario_with(text.replace("PLACE", "Desk"), tmp_path))
    model = wanted.own[0].model
    assert model is not None and model.stands_in_map is not None
    assert (model.z_m, model.stands_in_map.x_m, model.stands_in_map.y_m) == (1.2, 4.0, -2.0)
    assert wanted.failures == ()
    wanted = composition.parts(study=study).cameras(scenario_with(text.replace("PLACE", "Dusk"), tmp_path))
    assert (names(wanted), wanted.own[0].model) == (["desk"], None), "it is shown all the same"
    assert "“Dusk”" in wanted.failures[0].what
    with pytest.raises(composition.StartError, match="mount"):
        scenario_with("cameras:\n  - {source: '0', place: Desk}\n", tmp_path)


def test_a_camera_that_is_not_understood_is_reported_before_the_start_or_with_its_scenario(tmp_path: Path) -> None:
    study = composition.open_study(tmp_path / "study")
    with pytest.raises(composition.StartError, match="ftp://"):
        composition.parts(study=study, cameras=["ftp://camera/a"])
    scenario = scenario_with("cameras:\n  - source: ftp://camera/a\n  - source: '1'\n", tmp_path)
    wanted = composition.parts(study=study).cameras(scenario)
    assert names(wanted) == ["camera-1"]
    assert ["ftp://" in failure.what for failure in wanted.failures] == [True]


def test_a_scenario_says_how_people_are_found(tmp_path: Path) -> None:
    study = composition.open_study(tmp_path / "study")
    people = composition.parts(study=study).people
    assert people.inference is not None
    told = "model: beside.onnx, input_px: 640, device: cpu, tracker: bytetrack, classes: [chair, dog]"
    body = people.as_configured(
        people.inference, scenario_with(f"perception: {{{told}, server: 'wss://lab:1'}}\n", tmp_path)
    )
    (settings,) = body.arguments
    assert settings.tracker == "bytetrack"
    assert (settings.detector.device, settings.detector.things) == ("cpu", ("chair", "dog"))
    assert settings.detector.server == "wss://lab:1"
    assert settings.detector.model == DetectorChoice("beside.onnx", "", tmp_path, 640)
    assert people.as_configured(people.inference, scenario_with("", tmp_path)) == people.inference, (
        "no change, no new start"
    )


def test_the_shipped_scenarios_share_one_recogniser() -> None:
    scenarios = [composition.find_scenario(str(path)) for path in sorted(layouts_dir().glob("*.yaml"))]
    settings = {composition.recogniser_settings(each) for each in scenarios if each.permissions.transcription}
    assert len(settings) == 1, "another scenario's panels would wait for a model that is loaded anew"
