"""Manual pre-session checks of a scenario."""

from typing import Annotated

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass

CheckTitle = Annotated[str, FieldSpec(shortest=1, longest=80)]


@dataclass(frozen=True, slots=True)
class ManualCheck:
    """A check with what to do about it."""

    check: Annotated[CheckTitle, FieldSpec("What has to be so, as the wizard reads it.")]
    advice: Annotated[str, FieldSpec("What to do where it is not so.", longest=300, quiet=True)] = ""
    needed: Annotated[
        bool, FieldSpec("`false`: a recording that begins without it does not ask about it first.", quiet=True)
    ] = True


PreflightEntry = CheckTitle | ManualCheck


def manual_checks(entries: tuple[PreflightEntry, ...]) -> tuple[ManualCheck, ...]:
    """Checks in full form, without duplicate titles."""
    full = (entry if isinstance(entry, ManualCheck) else ManualCheck(entry) for entry in entries)
    return tuple({each.check: each for each in full}.values())
