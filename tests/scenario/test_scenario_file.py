"""Scenario files: loading, refusals with messages, and saving."""

import dataclasses
import hashlib
import json
import math
import os
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import get_args

import jsonschema
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.control_definitions import CallService, Reading, RobotControl
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema_fields import is_group, keys_of
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario import scenario_model
from caris_desktop.scenario.phrases import Gesture
from caris_desktop.scenario.protocol_steps import Branch, ProtocolSettings, ProtocolStep
from caris_desktop.scenario.scenario_file import (
    MAX_FILE_BYTES,
    ScenarioError,
    load_scenario,
    parse_scenario,
    save_scenario,
    scenario_text,
    schema_path,
)
from caris_desktop.scenario.scenario_model import (
    AssistanceSettings,
    AssistantSettings,
    DriveSettings,
    ErrorKind,
    FaceSettings,
    ListeningSettings,
    LogSettings,
    ManualCheck,
    MapSettings,
    NamedText,
    PanelLeaf,
    PanelSettings,
    Place,
    QuestionSettings,
    RecordingSettings,
    Scenario,
    SoundSettings,
    SplitNode,
    TabNode,
    VideoSettings,
    VoiceSettings,
)
from tests.support.examples import examples
from tests.support.plugins import install
from tests.support.translated_messages import untranslated_part

TOUR = (layouts_dir() / "tour-guide.yaml").read_text(encoding="utf-8")
SMALL = "version: 1\ntitle: Small\nlayout: {panel: video}\n"


def refusal(tmp_path: Path, text: str | bytes) -> str:
    path = tmp_path / "mine.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    return message.replace(str(path), "mine.yaml")


def test_words_that_old_yaml_takes_for_something_else_are_words(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SMALL + "phrases: [Yes, off, 12:30, 2026-11-21, =, <<]\n")
    assert load_scenario(path).phrases == ("Yes", "off", "12:30", "2026-11-21", "=", "<<")


@pytest.mark.parametrize("path", sorted(layouts_dir().glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_scenarios_load_and_say_where_their_schema_is(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.path == path.resolve()
    assert len(scenario.sha256) == 64
    comment = path.read_text(encoding="utf-8").splitlines()[0]
    assert comment == "# yaml-language-server: $schema=../resources/schemas/scenario.schema.json"
    assert (path.parent / comment.partition("$schema=")[2]).resolve() == schema_path().resolve()


def test_the_two_shipped_scenarios_differ_in_what_they_permit() -> None:
    tour = load_scenario(layouts_dir() / "tour-guide.yaml")
    check = load_scenario(layouts_dir() / "mental-health-check.yaml")
    assert tour.permissions.photos
    assert not check.permissions.photos
    assert check.driving.max_forward_mps == pytest.approx(0.2)
    assert tour.layout != check.layout
    assert {"Reception", "Robot arm", "Kitchen"} <= {place.name for place in tour.places}
    lab_bench = next(place for place in tour.places if place.name == "Lab bench")
    assert lab_bench.pose_in_map.heading_rad == pytest.approx(-math.pi / 2)


def test_the_schema_is_one_and_knows_what_the_model_knows() -> None:
    schema = json.loads(schema_path().read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert tuple(schema["$defs"]["panel"]["anyOf"][0]["enum"]) == get_args(scenario_model.BuiltInPanel)
    for key, value_type in {
        "permissions": scenario_model.Permissions,
        "driving": scenario_model.DrivingLimits,
        "assistant": scenario_model.AssistantSettings,
    }.items():
        assert set(schema["properties"][key]["properties"]) == {f.name for f in dataclasses.fields(value_type)}


def test_a_file_that_says_only_what_it_must_takes_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    scenario = load_scenario(path)
    assert scenario == Scenario(title="Small", layout=PanelLeaf("video"), path=path.resolve(), sha256=scenario.sha256)


@pytest.mark.parametrize(
    ("old", "new", "line_of", "expected"),
    [
        (
            "panel: video",
            "panel: vidoe",
            "vidoe",
            f"unknown panel 'vidoe'. Allowed: {', '.join(get_args(scenario_model.BuiltInPanel))}, plugin:NAME. "
            "Did you mean 'video'?",
        ),
        ("phrases:", "phrase:", "phrase:", "unknown key 'phrase'. Allowed: "),
        ("phrases:", "phrase:", "phrase:", "Did you mean 'phrases'?"),
        (
            "max_forward_mps: 0.5",
            "max_forward_mps: fast",
            "fast",
            "'driving.max_forward_mps' must be a number, found 'f",
        ),
        (
            "max_forward_mps: 0.5",
            "max_forward_mps: 0",
            "max_f",
            "'driving.max_forward_mps' is 0. Allowed: more than 0.",
        ),
        ("max_forward_mps: 0.5", "max_forward_mps: .inf", "max_f", ".inf is not a finite number"),
        ("photos: true", "photos: maybe", "maybe", "'permissions.photos' must be true or false, found 'maybe'."),
        ("voice: robot", "voice: loud", "loud", "unknown voice 'loud'. Allowed: robot, computer, both."),
        ("model: embedded", "model: embeded", "embeded", "Allowed: embedded, embedded:NAME, ollama:NAME, openai:"),
        ("title: Tour guide", "title: ''", "title", "'title' is empty."),
        ("title: Tour guide\n", "", "version", "'title' is missing."),
        ("version: 1", "version: 2", "version", "has version 2, this program reads up to version 1. Update"),
        ("version: 1", "version: one", "version", "the version must be a whole number, found 'one'"),
        ("weights: [66, 34]", "weights: [70]", "[70]", "1 weights for 2 children. Allowed: one weight for each child."),
        ("panel: speak", "panel: video", "panel: video", "duplicate panel 'video'."),
        (
            "current: people",
            "current: map",
            "current",
            "'map' is not one of these tabs. Allowed: people, assistant, notes, drive, session.",
        ),
        ("- panel: speak", "- {}", "- {}", "a layout part requires 'panel: NAME', 'tabs: [NAMES]', or 'split' with"),
        ("voice: robot", "voice: robot\nvoice: computer", "voice: computer", "duplicate key 'voice' (first in line "),
        ("voice: robot", "voice: !!python/object:os.system x", "voice", "python/object:os.system is not allowed"),
        ("voice: robot", "voice: [robot", "phrases", "not valid YAML: "),
        ("{name: Kitchen", "{name: reception", "{name: reception", "duplicate place 'reception'."),
        ("filler: Let me think...", "filler: &a x\nvoice2: *a", "*a", "references (*name) are not allowed"),
    ],
)
def test_an_error_is_reported_with_its_line_and_what_is_allowed(
    tmp_path: Path, old: str, new: str, line_of: str, expected: str
) -> None:
    assert old in TOUR
    text = TOUR.replace(old, new, 1)
    message = refusal(tmp_path, text)
    assert expected in message
    lines = [number for number, line in enumerate(text.splitlines(), start=1) if line_of in line]
    assert any(f"mine.yaml, line {number}: " in message for number in lines), message
    assert untranslated_part(lambda: refusal(tmp_path, text)) == []


def test_several_problems_are_reported_at_once_in_the_order_of_the_lines(tmp_path: Path) -> None:
    text = TOUR.replace("voice: robot", "voice: loud").replace("panel: map", "panel: mapp")
    first, second = refusal(tmp_path, text).splitlines()
    assert "'loud'" in first
    assert "'mapp'" in second


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "the file is empty"),
        (b"# nothing\n", "the file is empty"),
        (b"just words", "must be a list of 'key: value' lines"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"a" * (MAX_FILE_BYTES + 1), "too large for a scenario"),
        (b"layout: " + b"[" * 5000, "nested more than 40 levels deep"),
        (b"version: 1\ntitle: {1: 2}: x\n", "not valid YAML"),
        (b"? [a]\n: b\n", "a key must be plain text"),
        (b"title: x\n\x00", "line 2: the character #x0000 is not allowed"),
    ],
    ids=["empty", "comment", "words", "binary", "huge", "deep", "syntax", "odd key", "nul"],
)
def test_files_that_are_no_scenario_are_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    assert expected in refusal(tmp_path, content)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="cannot be read: No such file"):
        load_scenario(tmp_path / "none.yaml")


panels = st.permutations(get_args(scenario_model.BuiltInPanel))


@st.composite
def layouts(draw: st.DrawFn) -> scenario_model.LayoutNode:
    names = list(draw(panels))
    first = TabNode((names[0], names[1]), draw(st.sampled_from([None, names[0], names[1]])))
    inner = SplitNode("vertical", (PanelLeaf(names[2]), first), (draw(st.floats(0.1, 100)), 1.0))
    return draw(
        st.sampled_from([PanelLeaf(names[3]), first, SplitNode("horizontal", (inner, PanelLeaf(names[3])), (2.0, 1.5))])
    )


plain_text = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=60)
labels = plain_text.filter(lambda text: bool(text))


names = st.lists(labels, max_size=3, unique_by=str.casefold)
poses = st.builds(
    Pose2D,
    st.floats(-100, 100).map(lambda x_m: round(x_m, 4)),
    st.just(0.0),
    st.integers(-180, 180).map(math.radians),
)
CONTROLS = (
    RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {}), confirm=True),
    RobotControl("heat", "Heat", "readout", None, Reading("/heat", "std_msgs/Float32", "data"), "Motors", "°C"),
)


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    """Any scenario that a file can hold, with every setting."""
    return Scenario(
        title=draw(labels),
        layout=draw(layouts()),
        description=draw(plain_text),
        robot=draw(labels),
        voice=draw(st.sampled_from(["robot", "computer", "both"])),
        speech=VoiceSettings(
            draw(st.sampled_from(["", "piper:en_US-joe-medium", "espeak:de"])),
            draw(st.sampled_from(["", "en", "de-AT"])),
            draw(st.floats(0.5, 2)),
            draw(st.floats(0, 1)),
            draw(plain_text.map(lambda text: text[:200])),
        ),
        phrases=tuple(draw(st.lists(labels, max_size=8))),
        filler=draw(plain_text),
        places=tuple(Place(name, draw(poses)) for name in draw(names)),
        controls=CONTROLS[: draw(st.integers(0, 2))],
        permissions=scenario_model.Permissions(
            **{each.name: draw(st.booleans()) for each in fields(scenario_model.Permissions)}
        ),
        recording=RecordingSettings(
            labels=tuple(draw(st.lists(labels.map(lambda text: text[:40]), max_size=8, unique=True))),
            lsl=draw(st.booleans()),
            lsl_words=draw(st.booleans()),
        ),
        driving=scenario_model.DrivingLimits(draw(st.floats(0.01, 3)), draw(st.floats(0.01, 6))),
        assistant=scenario_model.AssistantSettings(
            draw(st.sampled_from(["embedded", "ollama:llama3.2", "openai:gpt"])),
            draw(plain_text),
            draw(st.integers(1, 8192)),
            draw(st.floats(0, 2)),
        ),
    )


def as_said(scenario: Scenario) -> Scenario:
    """Scenario as a file holds it: poses to a tenth of a millimetre, without path and checksum."""
    return dataclasses.replace(scenario, places=(), path=None, sha256="")


def assert_same(loaded: Scenario, expected: Scenario) -> None:
    assert as_said(loaded) == as_said(expected)
    for place, wanted in zip(loaded.places, expected.places, strict=True):
        assert place.name == wanted.name
        assert place.pose_in_map.x_m == pytest.approx(wanted.pose_in_map.x_m, abs=1e-4)
        assert place.pose_in_map.heading_rad == pytest.approx(wanted.pose_in_map.heading_rad, abs=1e-4)


@given(scenario=scenarios(), other=scenarios())
@settings(max_examples=examples(30), deadline=None)
def test_a_saved_scenario_loads_again(
    tmp_path_factory: pytest.TempPathFactory, scenario: Scenario, other: Scenario
) -> None:
    path = tmp_path_factory.mktemp("saved") / "s.yaml"
    saved = save_scenario(scenario, path)
    loaded = load_scenario(path)
    assert saved == loaded
    assert_same(loaded, scenario)
    first = path.read_bytes()
    save_scenario(loaded, path)
    assert path.read_bytes() == first
    assert [entry.name for entry in path.parent.iterdir()] == ["s.yaml"]
    save_scenario(other, path)
    assert_same(load_scenario(path), other)


FROM_DATA_SHEET = CameraModel.from_field_of_view(width_px=640, height_px=480, horizontal_rad=math.radians(70.0))
COMPLETE = Scenario(
    title="Complete",
    layout=SplitNode("horizontal", (PanelLeaf("video"), TabNode(("map", "speak"), "map")), (2.0, 1.0)),
    layout_compact=TabNode(("video", "map", "speak"), "video"),
    layout_large=SplitNode("vertical", (PanelLeaf("video"), PanelLeaf("map"), PanelLeaf("speak"))),
    description="Every key",
    phrases=("Hello",),
    filler="Well",
    fillers=("So",),
    gestures=(Gesture("Wave", "wave", "Ctrl+Shift+W"),),
    preflight=("Consent form signed", ManualCheck("Lights on", "Switch them on.", needed=False)),
    places=(Place("Door", Pose2D(1.0, 2.0, 0.5)),),
    protocol=ProtocolSettings(
        (
            ProtocolStep(
                "Greet",
                "hello",
                "Hello",
                "Door",
                0.5,
                ("Coat off",),
                (Branch("Leaves again", "hello"),),
                "end",
                "Wait a little.",
            ),
        ),
        "by_hand",
    ),
    controls=CONTROLS,
    cameras=(
        scenario_model.CameraSettings("robot"),
        scenario_model.CameraSettings(
            "0", "desk", replace(FROM_DATA_SHEET, heading_rad=math.pi / 2.0, tilt_rad=math.pi / 6.0), "Kitchen"
        ),
        # Angles that no number of degrees represents exactly
        scenario_model.CameraSettings(
            "oak", "mast", replace(FROM_DATA_SHEET, fx_px=501.0, heading_rad=0.1, tilt_rad=0.3, on_head=True)
        ),
    ),
    recording=RecordingSettings(
        ("Laughs",), ("Slip", ErrorKind("Too close", "Nearer than a metre.")), lsl=True, lsl_words=True
    ),
    sound=SoundSettings("robot", hear=True, own_voice="both"),
    perception=scenario_model.PerceptionSettings(
        model="other.onnx",
        sha256="0" * 64,
        input_px=640,
        device="cpu",
        server="wss://lab:8768",
        tracker="bytetrack",
        classes=("chair",),
        recognise="faces",
        confirm_at=0.9,
        ask_at=0.75,
    ),
    speech=VoiceSettings("piper:en_US-joe-medium", "en-US", 1.2, 0.8, "USB"),
    listening=ListeningSettings("es", "server", "whisper-1", "0" * 64, "https://lab/v1", 0.4, 2.0),
    blur=scenario_model.BlurSettings("without_consent", "faces", shown=True),
    assistant=AssistantSettings(
        models=("embedded",),
        system_prompt="Be kind",
        people="names",
        pictures=True,
        roles=(NamedText("Expert", "You know it all."),),
        styles=(NamedText("Short", "Be brief."),),
        templates=(NamedText("Meaning", "What is meant by {said}?"),),
        notes="The arm rests.",
    ),
    assistance=AssistanceSettings("act", "suggest", "suggest", 5.0, 2.0),
    face=FaceSettings(live_picture=True, page="network"),
    permissions=scenario_model.Permissions(
        transcription=True, own_voice=True, cloud_models=False, face=True, notes=False
    ),
    panels_off=("diagnostics",),
    panels=PanelSettings(
        MapSettings(follow=True, up="robot", trail=False),
        VideoSettings("desk"),
        DriveSettings("stick"),
        LogSettings("problems"),
        QuestionSettings(("people", "notes")),
    ),
    notes="Offer a glass of water first.",
)


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("complete") / "complete.yaml"
    save_scenario(COMPLETE, path)
    return path.read_text(encoding="utf-8")


def keys_within(group: type) -> Iterator[str]:
    for key in keys_of(group):
        yield key.name
        form = key.form.item or key.form
        for inner in (form.kind,) if is_group(form.kind) and form.elsewhere is None else ():
            yield from keys_within(inner)


def test_the_complete_file_has_every_key(complete: str) -> None:
    keys = {*keys_within(Scenario), "panel", "tabs", "current", "split", "weights", "children"}
    assert {key for key in keys if not re.search(rf"^[- ]*{key}:", complete, re.MULTILINE)} == set()


@given(data=st.data())
@settings(max_examples=examples(100), deadline=None)
def test_a_misspelled_key_is_reported_with_its_line_and_a_suggestion(complete: str, data: st.DataObject) -> None:
    lines = complete.splitlines()
    # Keys of two letters are too short to be recognised with a mistake.
    keys = [(number, found) for number, line in enumerate(lines) if (found := re.search(r"^[- ]*([a-z_]{3,}):", line))]
    assert len(keys) > 40
    number, found = data.draw(st.sampled_from(keys))
    key, at = found[1], data.draw(st.integers(1, len(found[1]) - 1))
    typo = data.draw(
        st.sampled_from(
            [
                key[:at] + key[at + 1 :],
                key[:at] + key[at] + key[at:],
                key[: at - 1] + key[at] + key[at - 1] + key[at + 1 :],
            ]
        )
    )
    assume(typo != key)
    lines[number] = lines[number].replace(f"{key}:", f"{typo}:", 1)
    with pytest.raises(ScenarioError) as caught:
        parse_scenario("\n".join(lines), path=Path("mine.yaml"))
    (told,) = [line for line in str(caught.value).splitlines() if f"unknown key '{typo}'" in line]
    assert told.startswith(f"mine.yaml, line {number + 1}: unknown key '{typo}'")
    assert told.endswith(f" Did you mean '{key}'?")
    assert f"'{key}' is missing" not in str(caught.value)


def test_saving_that_fails_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SMALL)
    scenario = load_scenario(path)

    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ScenarioError, match="No space left on device"):
        save_scenario(dataclasses.replace(scenario, title="Other"), path)
    with pytest.raises(ScenarioError, match="'title' is empty"):
        save_scenario(dataclasses.replace(scenario, title=""), path)
    assert path.read_text() == SMALL
    assert [entry.name for entry in tmp_path.iterdir()] == ["s.yaml"]


def test_saving_places_leaves_every_other_line_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    text = (layouts_dir() / "tour-guide.yaml").read_text(encoding="utf-8")
    path.write_text("# my own notes\n" + text, encoding="utf-8")
    scenario = load_scenario(path)
    needed = {step.go_to for step in scenario.protocol.steps}
    kept = [place for place in scenario.places if place.name in needed]
    assert kept and len(kept) < len(scenario.places)
    places = (*kept, Place("It's: here", Pose2D(1.25, -2.0, math.pi / 2)))
    saved = save_scenario(dataclasses.replace(scenario, places=places), path, only=["places"])
    assert saved.places[-1].name == "It's: here"
    assert saved.places[-1].pose_in_map.heading_rad == pytest.approx(math.pi / 2)
    assert dataclasses.replace(saved, places=(), sha256="") == dataclasses.replace(scenario, places=(), sha256="")
    before, after = text.splitlines(), path.read_text(encoding="utf-8").splitlines()
    assert after[0] == "# my own notes"
    assert [line for line in before if not line.startswith("  - {name")] == [
        line for line in after[1:] if not line.startswith("  - {name")
    ]


@pytest.mark.parametrize(
    "text",
    [
        "version: 1\ntitle: A\nplaces: [{name: a, x_m: 1, y_m: 2}]  # mine\n# layout\nlayout: {panel: video}\n",
        "version: 1\ntitle: A\nlayout: {panel: video}",
        "version: 1\nplaces:\n- name: a\n  x_m: 1\n  y_m: 2\n\n# next\ntitle: A\nlayout: {panel: video}\n",
    ],
)
def test_places_are_saved_in_a_file_of_any_style(tmp_path: Path, text: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    scenario = load_scenario(path)
    for places in ((Place("Kitchen", Pose2D(1.0, 2.0, 0.0)),), ()):
        assert save_scenario(dataclasses.replace(scenario, places=places), path, only=["places"]).places == places
    assert ("#" in path.read_text(encoding="utf-8")) == ("#" in text)


def test_a_shipped_scenario_without_a_copy_is_written_completely(tmp_path: Path) -> None:
    scenario = load_scenario(layouts_dir() / "tour-guide.yaml")
    saved = save_scenario(scenario, tmp_path / "tour-guide.yaml", only=["places"])
    assert saved.places == scenario.places
    assert saved.layout == scenario.layout


def test_a_velocity_in_a_control_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "spin.yaml"
    text = (
        "version: 1\ntitle: A\nrobot: mine\nlayout: {panel: robot}\ncontrols:\n"
        "  - {id: light, title: Light, kind: button, publish: {topic: /light, type: std_msgs/Bool}, moves: false}\n"
        "  - {id: spin, title: Spin, kind: button, publish: {topic: /base/vel, type: TYPE}, moves: false}\n"
    )
    path.write_text(text.replace("TYPE", "geometry_msgs/Twist"), encoding="utf-8")
    with pytest.raises(ScenarioError, match="line 7: 'spin' publishes velocities"):
        load_scenario(path)
    path.write_text(text.replace("TYPE", "std_msgs/Bool"), encoding="utf-8")
    assert [control.is_motion for control in load_scenario(path).controls] == [False, True]
    with pytest.raises(ScenarioError, match="line 7: 'spin' publishes velocities"):
        load_scenario(path, {"mine": "base/vel"}.get)


def test_controls_of_a_scenario_are_read_and_checked(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    good = "version: 1\ntitle: A\nlayout: {panel: robot}\ncontrols:\n"
    control = "  - {id: wave, title: Wave, kind: button, call: {service: /wave, type: std_srvs/Trigger}}\n"
    path.write_text(good + control, encoding="utf-8")
    assert load_scenario(path).controls[0].effect == CallService("/wave", "std_srvs/Trigger", {})
    path.write_text(good + control + control, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"line 6.*duplicate control 'wave'"):
        load_scenario(path)
    path.write_text(good + control.replace("button", "buton"), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"line 5.*button"):
        load_scenario(path)


def test_the_recorded_scenario_names_no_folder_of_this_computer(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    save_scenario(load_scenario(layouts_dir() / "tour-guide.yaml"), path)
    assert schema_path().as_uri() in path.read_text()
    scenario = load_scenario(path)
    content = scenario_text(scenario)
    assert content == path.read_text().partition("\n")[2]
    assert str(schema_path().parent) not in content
    assert scenario.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    again = parse_scenario(content, path=path.resolve())
    assert dataclasses.replace(again, sha256=scenario.sha256) == scenario


@pytest.mark.parametrize(
    ("reference", "stays"),
    [
        ("../resources/schemas/scenario.schema.json", True),
        ("https://example.org/scenario.schema.json", True),
        ("/home/anna/scenario.schema.json", False),
        (r"C:\Users\Anna\scenario.schema.json", False),
        ("file:///C:/Users/Anna/scenario.schema.json", False),
        (r"\\server\anna\scenario.schema.json", False),
        ("~/scenario.schema.json", False),
    ],
)
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_only_a_schema_of_this_computer_is_left_out(
    tmp_path: Path, reference: str, ending: str, *, stays: bool
) -> None:
    path = tmp_path / "mine.yaml"
    comment = f"# yaml-language-server: $schema={reference}{ending}"
    rest = SMALL.replace("\n", ending) + "# /home/anna is what its author wrote"
    path.write_bytes((comment + rest).encode())
    assert scenario_text(load_scenario(path)) == (comment + rest if stays else rest)


def test_a_tracker_of_others_is_named_only_where_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "version: 1\ntitle: Lab\nlayout: {panel: video}\nperception:\n  tracker: steady\n"
    message = refusal(tmp_path, text)
    assert "line 5: unknown tracker 'steady'. Allowed: own, deepsort, bytetrack, botsort." in message
    recorded = parse_scenario(text, path=tmp_path / "s.yaml", recorded=True)
    assert recorded.perception.tracker == "steady", "a session from elsewhere can be replayed"
    install(tmp_path / "packages", "trackers", "steady", "raise SystemError('imported')", monkeypatch)
    assert parse_scenario(text, path=tmp_path / "s.yaml").perception.tracker == "steady"
    assert "Did you mean 'steady'?" in refusal(tmp_path, text.replace("steady", "stedy"))
    assert "a plug-in that is installed" in refusal(tmp_path, text.replace("steady", "/home/me/tracker.py"))


@pytest.mark.parametrize(
    ("group", "lines"),
    [
        ("detectors", "perception:\n  model: plugin:steady\n"),
        ("language_models", "assistant:\n  model: plugin:steady\n"),
        ("language_models", "assistant:\n  models: ['plugin:steady']\n"),
        ("cameras", "cameras:\n- source: plugin:steady\n"),
        ("speech", "speech:\n  name: plugin:steady\n"),
        ("speech", "listening:\n  model: plugin:steady\n"),
    ],
)
def test_other_plug_ins_are_named_only_where_they_are_installed(
    group: str, lines: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = f"version: 1\ntitle: Lab\nlayout: {{panel: video}}\n{lines}"
    assert "line 5: unknown plug-in 'steady'. None is installed." in refusal(tmp_path, text)
    install(tmp_path / "packages", group, "steady", "raise SystemError('imported')", monkeypatch)
    parse_scenario(text, path=tmp_path / "s.yaml")
    assert "unknown plug-in 'other'. Allowed: plugin:steady." in refusal(tmp_path, text.replace("steady", "other"))
    forbidden = f"{text}permissions: {{cloud_models: false}}\n"
    if group == "speech":
        assert "may send speech to other computers" in refusal(tmp_path, forbidden)
