"""Edits of a hand-written file: only the affected text changes."""

import dataclasses
import difflib
import math
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.domain.yaml_files import parse_yaml
from caris_desktop.scenario.scenario_file import (
    LAYOUTS,
    OtherFileError,
    ScenarioError,
    load_scenario,
    save_scenario,
    save_text,
    schema_path,
)
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, Place, Scenario, SplitNode, TabNode
from caris_desktop.scenario.text_editing import edited, with_entry_moved
from tests.support.examples import examples

save_places, save_layout = (partial(save_scenario, only=names) for names in (("places",), LAYOUTS))
WRITTEN = """\
# Written by Anna for the second study.

title:   Café study     # shown in the menu
version: 1
# --- what the robot says ---
phrases:
- "Hello, it's me"   # F1
# the next one is for the end
- Good bye!          # F2

filler: >-   # folded
  Let me
  # think

places:   # measured with a tape
  # the door
  - name: Door      # north
    x_m: 1.00
    y_m: 2.50       # from the wall
  # the window
  - {name: Window, x_m: 3, y_m: 4, heading_deg: 90}   # sunny
  # nothing after this one
# --- what is allowed ---
permissions:
  photos: false     # no consent
  # the rest is as usual
layout:   # by Anna
  split: horizontal
  # left, right
  weights: [60, 40]     # percent
  children:
    # large
    - panel: video      # the camera
    - tabs: [speak, map]   # both
      current: map
# end of the file
"""
DOOR, WINDOW = Place("Door", Pose2D(1.0, 2.5, 0.0)), Place("Window", Pose2D(3.0, 4.0, math.pi / 2))
KITCHEN = Place("Kitchen, large", Pose2D(1.25, -2.0, 0.0))
VIDEO, BOTH = PanelLeaf("video"), TabNode(("speak", "map"), "map")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(WRITTEN, encoding="utf-8")
    return path


def changes(before: str, after: str) -> list[str]:
    """Removed and added lines."""
    old, new = before.splitlines(), after.splitlines()
    found = []
    for what, start, end, new_start, new_end in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if what != "equal":
            found += [f"- {line}" for line in old[start:end]] + [f"+ {line}" for line in new[new_start:new_end]]
    return found


def changed_places(path: Path, *places: Place) -> list[str]:
    saved = save_places(dataclasses.replace(load_scenario(path), places=places), path)
    assert saved == load_scenario(path)
    assert [place.name for place in saved.places] == [place.name for place in places]
    for place, wanted in zip(saved.places, places, strict=True):
        assert place.pose_in_map.heading_rad == pytest.approx(wanted.pose_in_map.heading_rad)
    return changes(WRITTEN, path.read_text(encoding="utf-8"))


def changed_layout(path: Path, layout: LayoutNode) -> list[str]:
    saved = save_layout(dataclasses.replace(load_scenario(path), layout=layout), path)
    assert saved == load_scenario(path)
    assert saved.layout == layout
    return changes(WRITTEN, path.read_text(encoding="utf-8"))


def test_unchanged_text_is_not_touched(path: Path) -> None:
    scenario = load_scenario(path)
    save_scenario(scenario, path)
    assert changed_places(path, DOOR, WINDOW) == []
    assert changed_layout(path, scenario.layout) == []


def test_a_place_that_moved_changes_its_numbers(path: Path) -> None:
    moved = Place("Door", Pose2D(1.5, 2.5, math.pi))
    assert changed_places(path, moved, WINDOW) == ["-     x_m: 1.00", "+     x_m: 1.5", "+     heading_deg: 180"]


@pytest.mark.parametrize("places", [(DOOR, WINDOW, KITCHEN), (KITCHEN, DOOR, WINDOW), (DOOR, KITCHEN, WINDOW)])
def test_a_new_place_is_one_line_more(path: Path, places: tuple[Place, ...]) -> None:
    line = "+   - {name: 'Kitchen, large', x_m: 1.25, y_m: -2, heading_deg: 0}"
    assert changed_places(path, *places) == [line]
    assert changed_places(path, DOOR, WINDOW) == []


@pytest.mark.parametrize(
    ("places", "gone"),
    [
        ((WINDOW,), ["  - name: Door      # north", "    x_m: 1.00", "    y_m: 2.50       # from the wall"]),
        ((DOOR,), ["  - {name: Window, x_m: 3, y_m: 4, heading_deg: 90}   # sunny"]),
    ],
)
def test_a_place_that_is_gone_takes_its_lines_along(path: Path, places: tuple[Place, ...], gone: list[str]) -> None:
    assert changed_places(path, *places) == [f"- {line}" for line in gone]


def test_no_place_at_all_is_an_empty_list(path: Path) -> None:
    changed_places(path)
    text = path.read_text(encoding="utf-8")
    assert "places: []   # measured with a tape\n  # the door\n  # nothing after this one\n" in text
    changed_places(path, KITCHEN)
    assert (
        "places:   # measured with a tape\n  - {name: 'Kitchen, large', x_m: 1.25, y_m: -2, heading_deg: 0}\n"
        "  # the door\n  # nothing after this one\n"
    ) in path.read_text(encoding="utf-8")


def test_a_renamed_place_keeps_its_line(path: Path) -> None:
    terrace = Place("Terrace", WINDOW.pose_in_map)
    assert changed_places(path, DOOR, terrace) == [
        "-   - {name: Window, x_m: 3, y_m: 4, heading_deg: 90}   # sunny",
        "+   - {name: Terrace, x_m: 3, y_m: 4, heading_deg: 90}   # sunny",
    ]


def test_other_weights_change_one_line(path: Path) -> None:
    assert changed_layout(path, SplitNode("horizontal", (VIDEO, BOTH), (55.5, 44.5))) == [
        "-   weights: [60, 40]     # percent",
        "+   weights: [55.5, 44.5]     # percent",
    ]


def test_another_layout_changes_what_moved(path: Path) -> None:
    more = SplitNode("vertical", (BOTH, PanelLeaf("drive")), (2.0, 1.0))
    assert changed_layout(path, SplitNode("horizontal", (VIDEO, more), (60.0, 40.0))) == [
        "-     - tabs: [speak, map]   # both",
        "-       current: map",
        "+     - split: vertical   # both",
        "+       weights: [2, 1]",
        "+       children:",
        "+         - tabs: [speak, map]",
        "+           current: map",
        "+         - {panel: drive}",
    ]


def test_a_layout_of_one_panel_leaves_the_comments_around_it(path: Path) -> None:
    changed_layout(path, PanelLeaf("map"))
    text = path.read_text(encoding="utf-8")
    assert text == WRITTEN.partition("layout:")[0] + "layout: {panel: map}   # by Anna\n# end of the file\n"


def test_every_setting_can_change_in_its_place(path: Path) -> None:
    scenario = load_scenario(path)
    changed = dataclasses.replace(
        scenario,
        title="Bar: study",
        phrases=("Hello, it's me", "Wait", "Good bye!"),
        filler="Hm",
        permissions=dataclasses.replace(scenario.permissions, photos=True, driving=False),
        driving=dataclasses.replace(scenario.driving, max_forward_mps=0.2),
    )
    save_scenario(changed, path)
    assert changes(WRITTEN, path.read_text(encoding="utf-8")) == [
        "- title:   Café study     # shown in the menu",
        "+ title: 'Bar: study'     # shown in the menu",
        "+ - Wait",
        "- filler: >-   # folded",
        "-   Let me",
        "-   # think",
        "+ filler: Hm   # folded",
        "-   photos: false     # no consent",
        "+   photos: true     # no consent",
        "+   driving: false",
        "+ driving: {max_forward_mps: 0.2, max_turn_radps: 1}",
    ]  # fmt: skip
    assert dataclasses.replace(load_scenario(path), sha256="") == dataclasses.replace(changed, sha256="")


def test_a_setting_back_at_its_default_goes(path: Path) -> None:
    path.write_text(WRITTEN + "recording:  # marks\n  labels: [Laughs]\n  lsl: true  # for EEG\n", encoding="utf-8")
    scenario = load_scenario(path)
    save_scenario(dataclasses.replace(scenario, recording=dataclasses.replace(scenario.recording, lsl=False)), path)
    assert path.read_text(encoding="utf-8") == WRITTEN + "recording:  # marks\n  labels: [Laughs]\n"


SHIPPED = [
    *layouts_dir().glob("*.yaml"),
    *(resources_dir() / "robots").glob("*.yaml"),
    *(resources_dir() / "faces").glob("*.yaml"),
]


@pytest.mark.long(
    "simulated-ros2",
    "pepper",
    "turtlebot*",
    "tiago*",
    "generic-ros2",
    "reception",
    "nao",
    "practice",
    "mental-health-check",
)
@pytest.mark.parametrize("shipped", sorted(SHIPPED), ids=lambda path: path.stem)
def test_each_section_of_a_shipped_file_is_written_as_it_is_read(shipped: Path) -> None:
    text = shipped.read_text(encoding="utf-8")
    data = parse_yaml(text).data
    for name in data:
        others = {key: value for key, value in data.items() if key != name}
        changed = edited(text, data, others | {name: "other", "new": [1]})
        assert parse_yaml(changed).data == others | {name: "other", "new": [1]}
        # Only lines of that section go, and no comment outside of it.
        kept = edited(changed, others | {name: "other", "new": [1]}, others)
        assert [line for line in changes(text, kept) if line[0] == "+" and line != "+ "] == []
    assert edited(text, data, data) == text


def test_an_entry_moves_with_its_comments() -> None:
    text = "a:\n  # one\n  - x   # X\n  # two\n  - y: 1\n    # in it\n  - [z]\n# after\nb: 1\n"
    moved = "a:\n  # two\n  - y: 1\n    # in it\n  - [z]\n  # one\n  - x   # X\n# after\nb: 1\n"
    assert with_entry_moved(text, ("a", 0), 2) == moved
    assert with_entry_moved(moved, ("a", 2), 0) == text
    assert with_entry_moved("a: [x, y]\n", ("a", 0), 1) == "a: [x, y]\n"


@pytest.mark.parametrize(
    ("text", "old", "new", "changed"),
    [
        ("a: [x]  # c\n", ["x"], "m\nn", "a: >-  # c\n  m\n\n  n\n"),
        ("a: >-   # c\n  one\n  two\n\nb: 1\n", "one two", "three", "a: three   # c\n\nb: 1\n"),
        (
            "a: >-   # c\n  one\n  two\n\n  three\n\nb: 1\n",
            "one two\nthree",
            "one two\nfour",
            "a: >-   # c\n  one\n  two\n\n  four\n\nb: 1\n",
        ),
        ("a:\n    - 'x'   # c\n    - 2\n", ["x", 2], ["y # z", 2], "a:\n    - 'y # z'   # c\n    - 2\n"),
        ("a: [on, 1:30, 2001-01-01, 1_0]\n", ["on", "1:30", "2001-01-01", "1_0"], ["on"], "a: [on]\n"),
        ('a: {b: "x",   c: y}\n', {"b": "x", "c": "y"}, {"b": "yes?", "c": "y"}, 'a: {b: "yes?", c: y}\n'),
        ("a:\n  b: 1\n  # c\n  d: 2\n", {"b": 1, "d": 2}, {"d": 2}, "a:\n  # c\n  d: 2\n"),
    ],
)
def test_a_value_of_another_kind_keeps_the_comments_around_it(
    text: str, old: object, new: object, changed: str
) -> None:
    rest = {"b": 1} if "\nb:" in text else {}
    assert edited(text, {"a": old} | rest, {"a": new} | rest) == changed


@pytest.mark.long("reception", "mental-health-check", "practice")
@pytest.mark.parametrize("shipped", sorted(layouts_dir().glob("*.yaml")), ids=lambda path: path.stem)
def test_a_shipped_scenario_is_copied_with_its_comments(shipped: Path, tmp_path: Path) -> None:
    own = tmp_path / "own" / shipped.name
    scenario = load_scenario(shipped)
    assert isinstance(scenario.layout, SplitNode)
    layout = dataclasses.replace(scenario.layout, weights=tuple(9.0 for _ in scenario.layout.weights))
    save_layout(dataclasses.replace(scenario, layout=layout, places=(*scenario.places, KITCHEN)), own)
    before, after = shipped.read_text(encoding="utf-8"), own.read_text(encoding="utf-8")
    came = [line for line in changes(before, after) if line[0] == "+"]
    assert came[0] == f"+ # yaml-language-server: $schema={schema_path().as_uri()}"
    assert len(came) == (3 if scenario.places else 4)
    went = [line for line in changes(before, after) if line[0] == "-"]
    assert len(went) == 2
    assert shipped.read_text(encoding="utf-8") == before


def test_text_written_by_hand_since_the_scenario_was_opened_stays(path: Path) -> None:
    opened = load_scenario(path)
    path.write_text(WRITTEN.replace("Good bye!", "See you!"), encoding="utf-8")
    save_layout(dataclasses.replace(opened, layout=PanelLeaf("map")), path)
    save_places(dataclasses.replace(opened, places=(DOOR,)), path)
    saved = load_scenario(path)
    assert (saved.phrases[1], saved.layout, len(saved.places)) == ("See you!", PanelLeaf("map"), 1)


def test_a_file_with_a_mistake_by_now_is_left_alone(path: Path) -> None:
    opened = load_scenario(path)
    broken = WRITTEN.replace("panel: video", "panel: vidoe")
    path.write_text(broken, encoding="utf-8")
    line = broken.splitlines().index("    - panel: vidoe      # the camera") + 1
    for save in (save_layout, save_places, save_scenario):
        with pytest.raises(ScenarioError, match=f"line {line}: unknown panel 'vidoe'"):
            save(opened, path)
    assert path.read_text(encoding="utf-8") == broken


def test_lines_of_another_system_stay_so(path: Path) -> None:
    path.write_bytes(WRITTEN.replace("\n", "\r\n").encode())
    save_places(dataclasses.replace(load_scenario(path), places=(DOOR, KITCHEN)), path)
    save_layout(dataclasses.replace(load_scenario(path), layout=SplitNode("vertical", (BOTH, VIDEO), (1.0, 1.0))), path)
    raw = path.read_bytes()
    assert raw.count(b"\n") == raw.count(b"\r\n") > 30


@pytest.mark.parametrize(
    "text",
    [
        "{version: 1, title: A, layout: {panel: video}}",
        "version: 1\ntitle: A\nlayout: {panel: video}",
        "? title\n: A\n? layout\n: panel: video\n",
        "version: 1\ntitle: A\nphrases: [a, # first\n  b]\nlayout:\n  {split: vertical, children: [{panel: map},\n"
        "    {panel: video}]}\n",
        "---\ntitle: |\n  A\n\n\nlayout: !!map\n  panel: video\n...\n",
        "layout:\n    children:\n    -   panel: video\n    -\n        panel: map\n    split: vertical\ntitle: A\n",
    ],
)
def test_a_file_of_any_layout_says_what_was_saved(tmp_path: Path, text: str) -> None:
    path = tmp_path / "odd.yaml"
    for layout in (PanelLeaf("map"), SplitNode("vertical", (BOTH, VIDEO), (2.0, 1.0)), TabNode(("drive", "map"))):
        path.write_text(text, encoding="utf-8")
        scenario = load_scenario(path)
        saved = save_layout(dataclasses.replace(scenario, layout=layout), path)
        assert dataclasses.replace(saved, sha256="") == dataclasses.replace(scenario, layout=layout, sha256="")
        assert save_places(dataclasses.replace(saved, places=(KITCHEN,)), path).places == (KITCHEN,)
        assert save_places(dataclasses.replace(saved, places=()), path).layout == layout


words = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=12)
placed = st.builds(
    Place, words, st.builds(Pose2D, st.integers(-9, 9).map(float), st.integers(-9, 9).map(float), st.just(0.0))
)


@given(
    places=st.lists(st.lists(placed, max_size=4, unique_by=lambda place: place.name.casefold()), min_size=1, max_size=2)
)
@settings(max_examples=examples(30), deadline=None)
def test_any_save_keeps_the_comments_outside(
    tmp_path_factory: pytest.TempPathFactory, places: list[list[Place]]
) -> None:
    path = tmp_path_factory.mktemp("edited") / "mine.yaml"
    path.write_text(WRITTEN, encoding="utf-8")
    scenario = load_scenario(path)
    head, tail = WRITTEN.partition("places:")[0], WRITTEN.partition("# --- what is allowed")[2]
    for some in places:
        scenario = save_places(dataclasses.replace(scenario, places=tuple(some)), path)
        assert scenario.places == tuple(some)
        text = path.read_text(encoding="utf-8")
        assert text.startswith(head)
        assert text.endswith(tail)


def test_a_text_that_is_no_list_of_keys_is_written_anew() -> None:
    assert edited("- a\n", {}, {"title": "A"}) == "title: A\n"


def test_a_text_is_written_only_over_what_it_was_made_from(path: Path, tmp_path: Path) -> None:
    known = load_scenario(path).sha256
    text = WRITTEN.replace("Café", "Bar")
    assert save_text(text, path, replaces=known) == text
    assert path.read_text(encoding="utf-8") == text
    with pytest.raises(ScenarioError, match="was changed elsewhere in the meantime"):
        save_text(WRITTEN, path, replaces=known)
    with pytest.raises(OtherFileError, match="already exists"):
        save_text(WRITTEN, path)
    with pytest.raises(ScenarioError, match="line 33: unknown panel 'vidoe'"):
        save_text(text.replace("panel: video", "panel: vidoe"), tmp_path / "new.yaml")
    assert [file.name for file in tmp_path.iterdir()] == ["mine.yaml"]
    assert path.read_text(encoding="utf-8") == text


def test_a_text_that_goes_to_another_folder_leads_editors_to_the_schema_from_there(tmp_path: Path) -> None:
    shipped = layouts_dir() / "tour-guide.yaml"
    text = shipped.read_text(encoding="utf-8")
    written = save_text(text, tmp_path / "own" / "tour-guide.yaml", came_from=shipped)
    assert changes(text, written) == [
        "- # yaml-language-server: $schema=../resources/schemas/scenario.schema.json",
        f"+ # yaml-language-server: $schema={schema_path().as_uri()}",
    ]
    assert (tmp_path / "own" / "tour-guide.yaml").read_text(encoding="utf-8") == written


def test_a_scenario_whose_own_file_is_gone_is_written_completely(path: Path, tmp_path: Path) -> None:
    opened: Scenario = load_scenario(path)
    path.unlink()
    copy = tmp_path / "copy.yaml"
    assert dataclasses.replace(save_layout(opened, copy), path=opened.path, sha256=opened.sha256) == opened
