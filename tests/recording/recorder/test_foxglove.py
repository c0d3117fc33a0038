"""``events.mcap`` for other programs: validated with Foxglove's package and an independent computation of geometry."""

import base64
import json
from dataclasses import dataclass, replace
from typing import Any

import jsonschema
import numpy as np
import pytest
from foxglove import messages as foxglove_messages
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorSet
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import Problem, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import CameraLens, LaserScan, OccupancyGrid, People, PlannedPath, RobotPose
from caris_desktop.recording.session.session_reader import open_session
from tests.recording.exporters.test_frames import rerecorded
from tests.support.recorded_session import RecordedSession, make_session

MODEL = CameraModel(640, 480, 500.0, 510.0, 320.0, 240.0, 0.1, -0.05, 1.2, heading_rad=0.4, tilt_rad=0.3)


@dataclass(frozen=True, slots=True)
class Seen:
    """A message as read by a foreign program."""

    schema: str
    told_schema: dict[str, Any]
    topic: str
    publish_ns: int
    content: dict[str, Any]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    made = make_session(
        tmp_path_factory.mktemp("foxglove") / "s", seconds=6.0, cameras=(), audio=(), keep=True, utterance_every_s=0.5
    )
    at_ns = made.plan.started_ns + 2_000_000_000
    lens = CameraLens(at_ns, None, "front", MODEL)
    problem = Problem(at_ns, "warning", "The picture stopped.", "Driving goes on.", "Wait.")
    unplaced = next(value for _, value in made.values if isinstance(value, LaserScan))
    unplaced = replace(unplaced, stamp_ns=at_ns, robot_stamp_ns=None, map_from_laser=None)
    nowhere = replace(unplaced, robot_from_laser=None)
    more = [(at_ns, value) for value in (lens, replace(lens, camera="head", model=replace(MODEL, on_head=True)))]
    path = PlannedPath(at_ns, None, np.array([[1.0, 2.0], [1.5, 2.5]], np.float32))
    corrected = UtteranceCorrected(at_ns, "u-1", text="Hello robot.")
    more += [(at_ns, value) for value in (problem, corrected, unplaced, nowhere, path)]
    return rerecorded(made, sorted([*made.values, *more], key=lambda pair: pair[0]))


@pytest.fixture(scope="module")
def seen(made: RecordedSession) -> list[Seen]:
    with (made.folder / "events.mcap").open("rb") as file:
        return [
            Seen(
                schema.name,
                json.loads(schema.data),
                channel.topic,
                message.publish_time,
                json.loads(message.data, parse_constant=pytest.fail),
            )
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages()
            if schema is not None
        ]


def on(seen: list[Seen], topic: str) -> list[Seen]:
    return [one for one in seen if one.topic == topic]


def of(made: RecordedSession, kind: type[Any]) -> list[Any]:
    return [value for _, value in made.values if isinstance(value, kind)]


def schema_of_foxglove(name: str) -> dict[str, Any]:
    """JSON Schema of ``foxglove.NAME``, derived from the schema in Foxglove's package by the rules of its JSON
    messages.

    Unchanged names, all fields required, time as sec and nsec, bytes as base64, enumerations as numbers.
    """
    files = FileDescriptorSet.FromString(getattr(foxglove_messages, name).get_schema().data).file
    known = {f".{file.package}.{message.name}": message for file in files for message in file.message_type}
    return _message_schema(known[f".foxglove.{name}"], known)


def _message_schema(message: DescriptorProto, known: dict[str, DescriptorProto]) -> dict[str, Any]:
    enums = {enum.name: [value.number for value in enum.value] for enum in message.enum_type}
    properties = {}
    for field in message.field:
        kind = _field_schema(field, known, enums)
        many = field.label == FieldDescriptorProto.LABEL_REPEATED
        properties[field.name] = {"type": "array", "items": kind} if many else kind
    return {"type": "object", "properties": properties, "required": list(properties)}


def _field_schema(
    field: FieldDescriptorProto, known: dict[str, DescriptorProto], enums: dict[str, list[int]]
) -> dict[str, Any]:
    match field.type:
        case FieldDescriptorProto.TYPE_DOUBLE:
            return {"type": "number"}
        case FieldDescriptorProto.TYPE_STRING:
            return {"type": "string"}
        case FieldDescriptorProto.TYPE_FIXED32:
            return {"type": "integer", "minimum": 0, "maximum": 2**32 - 1}
        case FieldDescriptorProto.TYPE_BYTES:
            return {"type": "string", "pattern": "^[A-Za-z0-9+/]*={0,2}$"}
        case FieldDescriptorProto.TYPE_ENUM:
            return {"enum": enums[field.type_name.rpartition(".")[2]]}
        case FieldDescriptorProto.TYPE_MESSAGE if field.type_name == ".google.protobuf.Timestamp":
            number = {"type": "integer", "minimum": 0}
            return {
                "type": "object",
                "properties": {"sec": number, "nsec": {**number, "maximum": 999_999_999}},
                "required": ["sec", "nsec"],
                "additionalProperties": False,
            }
        case FieldDescriptorProto.TYPE_MESSAGE:
            return _message_schema(known[field.type_name], known)
    raise AssertionError(field)


def test_each_message_is_what_foxglove_itself_says_of_its_schema(seen: list[Seen]) -> None:
    validators = {
        one.schema: jsonschema.Draft202012Validator(schema_of_foxglove(one.schema.removeprefix("foxglove.")))
        for one in seen
        if one.schema.startswith("foxglove.")
    }
    assert set(validators) == {
        f"foxglove.{name}"
        for name in (
            "LaserScan", "Grid", "PoseInFrame", "PosesInFrame", "FrameTransforms", "ImageAnnotations",
            "CameraCalibration", "Log",
        )
    }  # fmt: skip
    checked = 0
    for one in seen:
        if one.schema in validators:
            validators[one.schema].validate(one.content)
            checked += 1
    assert checked > 150


@pytest.mark.long
def test_each_message_is_what_the_schema_of_its_channel_says(seen: list[Seen]) -> None:
    for one in seen:
        jsonschema.validate(one.content, one.told_schema)
        if one.schema.startswith("foxglove."):
            known = schema_of_foxglove(one.schema.removeprefix("foxglove."))["properties"]
            assert set(known) <= set(one.told_schema["properties"])


def test_the_moment_in_a_message_is_when_it_was_measured(seen: list[Seen]) -> None:
    for topic in ("/scan", "/pose", "/map", "/people", "/lens", "/path", "/event/utterance_changed", "/event/problem"):
        assert on(seen, topic)
        for one in on(seen, topic):
            stamp = one.content["timestamp"]
            assert stamp["sec"] * 1_000_000_000 + stamp["nsec"] == one.publish_ns


def placed(pose: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """Points in the frame of a pose, transformed to the parent frame."""
    position, turn = pose["position"], pose["orientation"]
    rotation = Rotation.from_quat([turn["x"], turn["y"], turn["z"], turn["w"]])
    moved: np.ndarray = rotation.apply(points) + np.array([position["x"], position["y"], position["z"]])
    return moved


def test_a_scan_lies_in_the_map_where_it_was_measured(made: RecordedSession, seen: list[Seen]) -> None:
    scans, told = of(made, LaserScan), [one.content for one in on(seen, "/scan")]
    assert len(scans) == len(told)
    for scan, message in zip(scans, told, strict=True):
        bearings = np.linspace(message["start_angle"], message["end_angle"], len(message["ranges"]))
        ranges = np.array(message["ranges"]).astype(np.float64)
        here = scan.map_from_laser or scan.robot_from_laser or Pose2D(0.0, 0.0, 0.0)
        place = np.array([here.x_m, here.y_m])
        frame = "map" if scan.map_from_laser else "base_link" if scan.robot_from_laser else scan.frame_id
        assert message["frame_id"] == frame
        near = ranges < 1e9
        assert near.sum() == len(scan.ranges_m) - 1
        points = np.stack([np.cos(bearings), np.sin(bearings), 0 * bearings], axis=1)[near] * ranges[near, None]
        directions = here.heading_rad + scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges))[near]
        expected = np.stack([np.cos(directions), np.sin(directions)], axis=1) * scan.ranges_m[near, None]
        np.testing.assert_allclose(placed(message["pose"], points)[:, :2], expected + place, atol=1e-4)


def test_the_robot_stands_in_the_map_where_it_was_and_its_camera_on_it(made: RecordedSession, seen: list[Seen]) -> None:
    transforms = [transform for one in on(seen, "/tf") for transform in one.content["transforms"]]
    robot = [one for one in transforms if one["child_frame_id"] == "base_link"]
    poses = of(made, RobotPose)
    assert len(robot) == len(poses) > 20
    for transform, value, message in zip(robot, poses, on(seen, "/pose"), strict=True):
        assert transform["parent_frame_id"] == message.content["frame_id"] == "map"
        for pose in (
            {"position": transform["translation"], "orientation": transform["rotation"]},
            message.content["pose"],
        ):
            ahead = value.pose_in_map @ Pose2D(1.0, 0.5, 0.0)
            np.testing.assert_allclose(placed(pose, np.array([[1.0, 0.5, 0.0]]))[0], [ahead.x_m, ahead.y_m, 0.0])
    # The head camera turns with the head, and has no fixed place.
    (camera,) = [one for one in transforms if one["child_frame_id"] != "base_link"]
    front = next(one.content for one in on(seen, "/lens") if one.content["camera"] == "front")
    assert (camera["parent_frame_id"], camera["child_frame_id"]) == ("base_link", front["frame_id"])
    pose = {"position": camera["translation"], "orientation": camera["rotation"]}
    intrinsic = np.array(front["K"]).reshape(3, 3)
    for u_px, v_px in ((320.0, 240.0), (0.0, 100.0), (600.0, 470.0)):
        optical = np.linalg.inv(intrinsic) @ [u_px, v_px, 1.0]
        ray = placed(pose, np.array([optical]))[0] - [MODEL.x_m, MODEL.y_m, MODEL.z_m]
        np.testing.assert_allclose(ray, MODEL.ray(u_px, v_px), atol=1e-9)


def test_the_map_has_its_cells_once(made: RecordedSession, seen: list[Seen]) -> None:
    (grid,), (one,) = of(made, OccupancyGrid), on(seen, "/map")
    message = one.content
    cells = np.frombuffer(base64.b64decode(message["data"]), np.int8).reshape(-1, message["row_stride"])
    np.testing.assert_array_equal(cells, grid.cells)
    assert message["cell_size"] == {"x": grid.resolution_m, "y": grid.resolution_m}
    assert len(json.dumps(message)) < len(message["data"]) + 1500


def test_boxes_are_drawn_with_whose_they_are(made: RecordedSession, seen: list[Seen]) -> None:
    for people, one in zip(of(made, People), on(seen, "/people"), strict=True):
        assert [text["text"] for text in one.content["texts"]] == [box.person_id for box in people.boxes]
        corners = [[(point["x"], point["y"]) for point in box["points"]] for box in one.content["points"]]
        drawn = [(*min(points), *max(points)) for points in corners]
        told = [(box.left_px, box.top_px, box.width_px, box.height_px) for box in people.boxes]
        expected = [(left, top, left + width, top + height) for left, top, width, height in told]
        np.testing.assert_allclose(drawn, expected, atol=0.051)


def test_a_log_reports_each_utterance_once_and_every_problem(made: RecordedSession, seen: list[Seen]) -> None:
    info = 2
    messages = [one.content for one in on(seen, "/event/utterance_changed") if one.content["level"] == info]
    spoken = [
        (utterance.speaker, utterance.text)
        for utterance in of(made, UtteranceChanged)
        if utterance.state == ("finished" if utterance.speaker == "participant" else "started")
    ]
    assert [(message["name"], message["message"]) for message in messages] == spoken
    assert len(spoken) >= 2
    (problem,) = on(seen, "/event/problem")
    assert problem.content["level"] == 3
    assert problem.content["message"] == "The picture stopped. Driving goes on. Wait."
    (corrected,) = on(seen, "/event/utterance_corrected")
    assert (corrected.content["level"], corrected.content["message"]) == (2, "corrected: Hello robot.")


def test_topics_for_other_programs_are_ignored_by_our_reader(
    made: RecordedSession, caplog: pytest.LogCaptureFixture
) -> None:
    kept = [(arrived_ns, type(value)) for arrived_ns, value in made.values]
    assert [(at_ns, type(value)) for at_ns, _, value in open_session(made.folder, repair=False).arrivals()] == kept
    assert not caplog.records
