"""What the adapter table checks where rooms meet."""

from pathlib import Path

import pytest

from caris_desktop.app import composition


def test_a_scenario_whose_control_publishes_where_its_robot_takes_velocities_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "disguised.yaml"
    publish = "publish: {topic: TOPIC, type: std_msgs/String, message: {linear: {x: 0.3}}}"
    control = f"controls:\n  - {{id: go, title: Go, kind: button, moves: false, {publish}}}\n"
    text = f"version: 1\ntitle: A\nrobot: tiago\nlayout: {{panel: robot}}\n{control}"
    path.write_text(text.replace("TOPIC", "/key_vel"), encoding="utf-8")
    with pytest.raises(composition.StartError, match="line 6: 'go' publishes velocities"):
        composition.find_scenario(str(path))
    path.write_text(text.replace("TOPIC", "/said"), encoding="utf-8")
    assert [control.id for control in composition.find_scenario(str(path)).controls] == ["go"]
