"""Recording section of a scenario: mark labels, wizard error kinds, markers."""

from typing import Annotated

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass

ERROR_KEYS = "FGHRUX"
"""Keys near the driving hand, or without another function: a digit that comes too late would send the robot to a
place."""

_ErrorName = Annotated[str, FieldSpec(shortest=1, longest=40)]


@dataclass(frozen=True, slots=True)
class ErrorKind:
    """A kind of wizard error with what is meant by it."""

    kind: Annotated[_ErrorName, FieldSpec("Word that is recorded and shown on its button.")]
    meaning: Annotated[str, FieldSpec("Meaning, for the person who marks it.", longest=200)] = ""


ErrorEntry = _ErrorName | ErrorKind
USUAL_ERRORS = (
    ErrorKind(QT_TR_NOOP("slip"), QT_TR_NOOP("You did something unintended: a wrong key, a wrong phrase.")),
    ErrorKind(QT_TR_NOOP("late"), QT_TR_NOOP("You did the right thing too late.")),
    ErrorKind(QT_TR_NOOP("wrong branch"), QT_TR_NOOP("You continued with the wrong step or answer.")),
)
"""The recorded words stay English; what is shown of them is translated."""


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """Recording settings of this scenario."""

    labels: Annotated[
        tuple[Annotated[str, FieldSpec(shortest=1, longest=40)], ...],
        FieldSpec(
            "Mark labels, on Shift+F1 to Shift+F8 in this order.",
            title="Mark labels",
            longest=8,
            unique=True,
            quiet=True,
        ),
    ] = ()
    errors: Annotated[
        tuple[ErrorEntry, ...],
        FieldSpec(
            "Kinds of wizard error, offered on F, G, H, R, U and X in this order when an error is marked: "
            "plain, or with a meaning. If not given: slip, late, wrong branch.",
            title="Kinds of wizard error",
            longest=len(ERROR_KEYS),
            unique=True,
            quiet=True,
        ),
    ] = ()
    lsl: Annotated[
        bool,
        FieldSpec(
            "Marks with their labels, and the steps of the protocol, are also sent to a Lab Streaming Layer "
            "outlet, for anybody on the network.",
            title="Send marks to the lab's network (LSL)",
            external="network",
            quiet=True,
        ),
    ] = False
    lsl_words: Annotated[
        bool,
        FieldSpec(
            "With `lsl`: all events are sent, with every spoken and written word. Anybody on the network can "
            "read them.",
            title="Send every word too",
            external="network",
            quiet=True,
        ),
    ] = False

    @property
    def error_kinds(self) -> tuple[ErrorKind, ...]:
        """Error kinds in the order of their keys."""
        given = (each if isinstance(each, ErrorKind) else ErrorKind(each) for each in self.errors)
        return tuple(given) or USUAL_ERRORS
