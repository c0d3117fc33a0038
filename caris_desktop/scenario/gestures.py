"""What the robot does at one key without a word: it nods, looks at somebody, or uses a control of its own."""

from dataclasses import dataclass
from typing import Annotated

from caris_desktop.domain.declared import Rule

NOD, LOOK = "nod", "look"
MOST_GESTURES = 6
"""Ctrl+4 to Ctrl+9."""


@dataclass(frozen=True, slots=True)
class Gesture:
    """A gesture by the name that the wizard reads."""

    title: Annotated[str, Rule("What the wizard reads.", shortest=1, longest=40)]
    does: Annotated[
        str,
        Rule(
            "`nod`, `look` to turn the head to whom the robot speaks to, or a control of the Robot panel by its id.",
            shortest=1,
            longest=80,
        ),
    ]
