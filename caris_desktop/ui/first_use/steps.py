"""Set-up steps, each backed by preflight checks."""

from collections.abc import Sequence
from typing import Literal

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.live.status import PreflightCheck

StepName = Literal["robot", "camera", "sound", "model"]


class SetUpStep(Value):
    """A set-up step. ``checks``: ids of its checks; if the scenario has none of them, the step is skipped."""

    name: StepName
    title: str
    about: str
    checks: tuple[str, ...]

    def of(self, checks: Sequence[PreflightCheck]) -> tuple[PreflightCheck, ...]:
        return tuple(check for check in checks if check.id in self.checks)


STEPS: tuple[SetUpStep, ...] = (
    SetUpStep(
        "robot",
        QT_TR_NOOP("Robot"),
        QT_TR_NOOP("Choose the robot. It must run rosbridge and be on the same network as this computer."),
        ("robot",),
    ),
    SetUpStep(
        "camera",
        QT_TR_NOOP("Camera"),
        QT_TR_NOOP("This is what the robot sees now. The scenario determines which cameras are used."),
        ("video",),
    ),
    SetUpStep(
        "sound",
        QT_TR_NOOP("Sound"),
        QT_TR_NOOP("Check that the robot speaks and that the microphone picks up sound."),
        ("voice", "microphone"),
    ),
    SetUpStep(
        "model",
        QT_TR_NOOP("Language model"),
        QT_TR_NOOP("It suggests what to say. Everything else works without it."),
        ("model",),
    ),
)


def steps_for(checks: Sequence[PreflightCheck]) -> tuple[SetUpStep, ...]:
    """Steps that the scenario needs."""
    return tuple(step for step in STEPS if step.of(checks))
