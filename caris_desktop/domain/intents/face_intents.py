"""Intents of the robot's face."""

from typing import Literal

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class UseFace(Intent):
    """Another face, by its name."""

    face: str


@dataclass(frozen=True, slots=True)
class KeepFace(Intent):
    """Keep the face that ``content`` describes, as the text of a face file, under this name, and use it."""

    name: str
    content: str


@dataclass(frozen=True, slots=True)
class ShowExpression(Intent):
    """The face looks like that from now on; an expression of the face in use, by its name."""

    expression: str


@dataclass(frozen=True, slots=True)
class ShowOnFace(Intent):
    """In place of the face: a text, a photo by its file name, what the robot sees now, or the face again."""

    what: Literal["face", "text", "photo", "live"]
    text: str = ""


@dataclass(frozen=True, slots=True)
class ShowFaceWindow(Intent):
    """Open the face's own window, or close it."""

    on: bool


@dataclass(frozen=True, slots=True)
class ServeFace(Intent):
    """Let a phone or tablet on the robot show the face as a page, or no longer."""

    on: bool


FACE: IntentTable = {
    UseFace: IntentSpec(QT_TR_NOOP("Changing the face"), "face"),
    KeepFace: IntentSpec(QT_TR_NOOP("Saving the face"), "face"),
    ShowExpression: IntentSpec(QT_TR_NOOP("Showing the expression"), "face", proposable=True),
    ShowOnFace: IntentSpec(QT_TR_NOOP("Showing content on the face"), "face"),
    ShowFaceWindow: IntentSpec(QT_TR_NOOP("Opening the face window"), "face"),
    ServeFace: IntentSpec(QT_TR_NOOP("Serving the face page"), "face"),
}
