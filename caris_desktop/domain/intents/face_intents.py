"""Intents of the robot's face."""

from typing import Literal

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class UseFace(Intent):
    """Use another face, by name."""

    face: str


@dataclass(frozen=True, slots=True)
class KeepFace(Intent):
    """Save the face that ``content`` describes, as the text of a face file, under this name, and use it."""

    name: str
    content: str


@dataclass(frozen=True, slots=True)
class ShowExpression(Intent):
    """Show an expression of the current face, by its name, from now on."""

    expression: str


@dataclass(frozen=True, slots=True)
class ShowOnFace(Intent):
    """Replace the face: by a text, a photo by its file name, the robot's camera; or show the face again."""

    what: Literal["face", "text", "photo", "live"]
    text: str = ""


@dataclass(frozen=True, slots=True)
class ShowFaceWindow(Intent):
    """Open or close the face window."""

    on: bool


@dataclass(frozen=True, slots=True)
class ServeFace(Intent):
    """Serve the face as a page for a phone or tablet on the robot, or stop."""

    on: bool


FACE: IntentTable = {
    UseFace: IntentSpec(QT_TR_NOOP("Changing the face"), "face"),
    KeepFace: IntentSpec(QT_TR_NOOP("Saving the face"), "face"),
    ShowExpression: IntentSpec(QT_TR_NOOP("Showing the expression"), "face", proposable=True),
    ShowOnFace: IntentSpec(QT_TR_NOOP("Showing content on the face"), "face"),
    ShowFaceWindow: IntentSpec(QT_TR_NOOP("Opening the face window"), "face"),
    ServeFace: IntentSpec(QT_TR_NOOP("Serving the face page"), "face"),
}
