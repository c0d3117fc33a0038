"""Manual pre-session checks of a scenario."""

from typing import Annotated

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass

CheckTitle = Annotated[str, FieldSpec(shortest=1, longest=80)]


@dataclass(frozen=True, slots=True)
class ManualCheck:
    """A check with what to do about it."""

    check: Annotated[CheckTitle, FieldSpec("Condition to check, as shown to the wizard.")]
    advice: Annotated[str, FieldSpec("What to do if the condition is not met.", longest=300, quiet=True)] = ""
    needed: Annotated[
        bool, FieldSpec("`false`: a recording starts without asking, even if this check is not ticked.", quiet=True)
    ] = True


PreflightEntry = CheckTitle | ManualCheck


def manual_checks(entries: tuple[PreflightEntry, ...]) -> tuple[ManualCheck, ...]:
    """Checks in full form, without duplicate titles."""
    full = (entry if isinstance(entry, ManualCheck) else ManualCheck(entry) for entry in entries)
    return tuple({each.check: each for each in full}.values())
