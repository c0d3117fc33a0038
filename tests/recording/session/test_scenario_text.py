"""Recorded scenario text: read quickly or skipped, whatever it contains."""

import time

import pytest

from caris_desktop.domain.events import ScenarioOpened
from caris_desktop.recording.session.session_protocol import ScenarioText, read_scenario


def read(content: str) -> ScenarioText:
    return read_scenario(ScenarioOpened(1, "a.yaml", "A", "", content))


@pytest.mark.logs(r"session\.session_protocol: ")
def test_references_that_unfold_to_billions_are_not_followed() -> None:
    lines = ["l0: &l0 {panel: video}"]
    lines += [f"l{level}: &l{level} {{children: [{', '.join([f'*l{level - 1}'] * 6)}]}}" for level in range(1, 19)]
    bomb = "\n".join(lines) + "\nlayout: *l18\n"
    assert len(bomb) < 1100
    begin_s = time.monotonic()
    assert read(bomb).panels == ()
    assert time.monotonic() - begin_s < 1.0


@pytest.mark.logs(r"session\.session_protocol: ")
@pytest.mark.parametrize(
    "content",
    ["a: !!int x", "a: !!timestamp x", "a: !!bool x", "a: !!python/object/apply:os.getcwd []", "[" * 5000, "- a\n- b",
     "? {}\n: 1", "\x00", "a: *b", "places: 5\nassistant: []\nphrases: x\npermissions: {a: 1}", "x" * 1_000_000],
)  # fmt: skip
def test_an_invalid_scenario_gives_no_text(content: str) -> None:
    assert read(content) == ScenarioText("A", "a.yaml", "")


def test_places_are_where_a_robot_can_be() -> None:
    places = f"[{{name: a, x_m: 1, y_m: 2.5}}, {{name: b, x_m: {10**400}, y_m: 1}}, {{name: c, x_m: .inf, y_m: 1}},"
    places += " {name: d, x_m: true, y_m: 1}, {name: [e], x_m: 1, y_m: 1}]"
    assert [(name, pose.x_m, pose.y_m) for name, pose in read(f"places: {places}").places] == [("a", 1.0, 2.5)]


def test_an_anchor_that_nobody_refers_to_does_no_harm() -> None:
    assert read("phrases: &p [Hello]\nlayout: {children: [{panel: video}, {tabs: [map, video]}]}").phrases == ("Hello",)
