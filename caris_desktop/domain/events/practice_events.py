"""Events of the guided exercise for wizards."""

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class PracticeStepEnded:
    """A step was completed (``done``) or skipped, ``took_s`` after its start."""

    stamp_ns: int
    step_id: str
    number: int
    done: bool = True
    took_s: float = 0.0
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PracticeEnded:
    """The exercise ended: ``done`` of ``steps`` completed, in ``minutes``. ``score`` is out of 100."""

    stamp_ns: int
    done: int
    steps: int
    minutes: float
    score: int
    actor: Actor = ""
