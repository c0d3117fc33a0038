"""Face files: schema of eyes, mouth and expressions. Plain data; nothing in a file is ever evaluated."""

from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import platformdirs

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.schema_fields import Excluded, FieldSpec, Problem, data_of, value_from
from caris_desktop.domain.schema_validation import problem_lines, problems
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml, yaml_text

MAX_FILE_BYTES = 64 * 1024
DEFAULT_FACE = "calm"
_SHARE = "hundredths of the shorter side of the screen"

_Colour = Annotated[str, FieldSpec(pattern="^#[0-9a-fA-F]{6}$", allowed="a colour as #rrggbb.")]


class Eyes(Value):
    """Two rounded shapes, the middle of each `apart`/2 from the middle of the face."""

    width: Annotated[float, FieldSpec("Width of one eye.", unit=_SHARE, at_least=2, at_most=40)] = 12.0
    height: Annotated[float, FieldSpec("Height of one open eye.", unit=_SHARE, at_least=2, at_most=60)] = 22.0
    apart: Annotated[
        float, FieldSpec("Distance between the centres of the eyes.", unit=_SHARE, at_least=5, at_most=90)
    ] = 34.0
    above: Annotated[
        float, FieldSpec("Distance above the centre of the face.", unit=_SHARE, at_least=-30, at_most=45)
    ] = 12.0
    roundness: Annotated[float, FieldSpec("1: as round as can be; 0: with corners.", at_least=0, at_most=1)] = 1.0


class Mouth(Value):
    """One stroke, which opens while the robot speaks."""

    width: Annotated[float, FieldSpec("Width from corner to corner.", unit=_SHARE, at_least=4, at_most=80)] = 22.0
    stroke: Annotated[float, FieldSpec("Line thickness.", unit=_SHARE, at_least=0.5, at_most=10)] = 2.4
    below: Annotated[
        float, FieldSpec("Distance below the centre of the face.", unit=_SHARE, at_least=-10, at_most=45)
    ] = 20.0


class Expression(Value):
    """How the face looks with one expression."""

    name: Annotated[str, FieldSpec("Name of the expression; each name must be unique.", shortest=1, longest=30)]
    eyes_open: Annotated[float, FieldSpec("0: closed, 1: open, more: wide open.", at_least=0, at_most=1.4)] = 1.0
    lids_deg: Annotated[
        float,
        FieldSpec("Slant of the upper lids: above 0 worried, below 0 stern.", unit="degrees", at_least=-30, at_most=30),
    ] = 0.0
    smile: Annotated[float, FieldSpec("1: a broad smile, -1: the corners hang.", at_least=-1, at_most=1)] = 0.3
    mouth_open: Annotated[float, FieldSpec("Opening of the mouth at rest.", at_least=0, at_most=1)] = 0.0
    look_up: Annotated[float, FieldSpec("Gaze direction at rest: 1 up, -1 down.", at_least=-1, at_most=1)] = 0.0


_USUAL_EXPRESSIONS = (
    Expression("calm"),
    Expression("happy", eyes_open=0.8, smile=0.9),
    Expression("surprised", eyes_open=1.3, smile=0.0, mouth_open=0.5),
    Expression("thinking", eyes_open=0.85, smile=0.05, look_up=0.8),
    Expression("sad", eyes_open=0.75, lids_deg=18, smile=-0.6, look_up=-0.3),
)


class Face(Value):
    """A face. The first of its expressions is the one that it begins with."""

    title: Annotated[str, FieldSpec("Name shown to the wizard.", shortest=1, longest=60)]
    background: Annotated[_Colour, FieldSpec("Behind everything.")] = "#10151c"
    ink: Annotated[_Colour, FieldSpec("Eyes and mouth.")] = "#bfe3ff"
    words: Annotated[_Colour, FieldSpec("Captions.")] = "#9fc4e6"
    eyes: Eyes = field(default_factory=Eyes)
    mouth: Mouth = field(default_factory=Mouth)
    blink_every_s: Annotated[
        float, FieldSpec("Approximate interval between blinks; 0: never.", unit="seconds", at_least=0, at_most=60)
    ] = 4.0
    expressions: Annotated[
        tuple[Expression, ...], FieldSpec("On Ctrl+Shift+F1 to Ctrl+Shift+F8 in this order.", shortest=1, longest=8)
    ] = _USUAL_EXPRESSIONS
    name: Annotated[str, Excluded()] = ""
    version: Annotated[Literal[1], FieldSpec("Version of this file format.", wanted=True, order=-1)] = 1

    def expression(self, name: str) -> Expression:
        """Expression of this name, or the first one."""
        return next((one for one in self.expressions if one.name == name), self.expressions[0])


class FaceError(UserFacingError):
    """Unusable face file."""


def user_faces_dir() -> Path:
    """Folder of the user's own faces; may not exist."""
    return Path(platformdirs.user_config_dir("caris-desktop", appauthor=False)) / "faces"


def face_names(user_dir: Path | None = None) -> tuple[str, ...]:
    """Names of all faces, including the user's own."""
    return tuple(
        sorted({path.stem for folder in _folders(user_dir) if folder.is_dir() for path in folder.glob("*.yaml")})
    )


def load_face(name: str, user_dir: Path | None = None) -> Face:
    """Face of this name; the user's own precedes a shipped one. Raises FaceError."""
    for folder in _folders(user_dir):
        path = folder / f"{name}.yaml"
        # A name is a plain file name, which cannot leave the folder.
        if path.parent == folder and path.is_file():
            return read_face(path)
    known = ", ".join(face_names(user_dir))
    raise FaceError(
        tr("There is no face “{name}”.").format(name=name),
        tr("The robot shows another face."),
        tr("Choose one of these: {known}.").format(known=known),
    )


def read_face(path: Path) -> Face:
    """Read a face file. Raises FaceError with file, line, value and allowed values."""
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_FILE_BYTES + 1)
        if len(raw) > MAX_FILE_BYTES:
            raise _unusable(
                tr("{path} is too large for a face.").format(path=path),
                tr("Allowed: {most} bytes.").format(most=MAX_FILE_BYTES),
            )
        return parse_face(raw.decode("utf-8-sig"), file_name=str(path), name=path.stem)
    except (OSError, UnicodeDecodeError) as error:
        raise _unusable(
            tr("{path} cannot be read ({error}).").format(path=path, error=error),
            tr("Check that the file exists and is a text file."),
        ) from error


def parse_face(text: str, *, file_name: str, name: str) -> Face:
    """Parse a face. Raises FaceError."""
    try:
        source = parse_yaml(text)
    except YamlSourceError as error:
        raise _unusable(
            tr("{file}, line {line}: {error}").format(file=file_name, line=error.line, error=error),
            tr("Correct the file."),
        ) from error
    if not isinstance(source.data, dict):
        raise _unusable(
            tr("{file}, line 1: a face is a list of 'key: value' lines.").format(file=file_name),
            tr("Correct the file."),
        )
    wrong = list(problems(Face, source.data)) or list(_twice(source.data))
    if wrong:
        raise _unusable(problem_lines(file_name, source, wrong), tr("Correct the file."))
    face: Face = value_from(Face, source.data)
    return replace(face, name=name)


def checked(face: Face) -> Face:
    """Validate a face against the file schema. Raises FaceError."""
    return parse_face(face_text(face), file_name=tr("The face"), name=face.name)


def face_text(face: Face) -> str:
    """Text of the face's file."""
    return yaml_text(data_of(Face, face))


def save_face(face: Face, user_dir: Path | None = None) -> Path:
    """Save it to the user's faces, atomically. Raises FaceError."""
    if not face.name or not all(character.isalnum() or character in "-_" for character in face.name):
        raise FaceError(
            tr("“{name}” is not a valid face name.").format(name=face.name),
            tr("Nothing was saved."),
            tr("Use letters and digits."),
        )
    folder = user_faces_dir() if user_dir is None else user_dir
    path = folder / f"{face.name}.yaml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(path, face_text(face).encode(), durable=True)
    except OSError as error:
        raise FaceError(
            tr("The face was not saved ({error}).").format(error=error),
            tr("The file is unchanged."),
            tr("Check the free disk space and the permissions of {folder}.").format(folder=folder),
        ) from error
    return path


def _folders(user_dir: Path | None) -> tuple[Path, Path]:
    return (user_faces_dir() if user_dir is None else user_dir, resources_dir() / "faces")


def _twice(data: dict[str, Any]) -> Iterator[Problem]:
    seen: set[str] = set()
    for index, expression in enumerate(data.get("expressions", [])):
        if expression["name"] in seen:
            yield (
                ("expressions", index),
                tr("duplicate expression '{expression}'.").format(expression=expression["name"]),
            )
        seen.add(expression["name"])


def _unusable(what: str, advice: str) -> FaceError:
    return FaceError(what, tr("The robot shows another face."), advice)
