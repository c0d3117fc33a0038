"""Speech synthesis section of a scenario."""

from typing import Annotated

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class VoiceSettings:
    """Speech output of this computer."""

    name: Annotated[
        str,
        FieldSpec(
            "`piper:NAME` or `espeak:NAME`, as listed by the console; if empty, the best voice for the "
            "language, or the system voice if no language is given.",
            pattern="^((piper|espeak):.+)?$",
            allowed="piper:NAME or espeak:NAME.",
            longest=200,
        ),
    ] = ""
    language: Annotated[
        str,
        FieldSpec(
            "Spoken language: `en`, `de-AT`.",
            pattern="^([A-Za-z]{2,3}([-_][A-Za-z0-9]{2,8})*)?$",
            allowed="a language such as en or de-AT.",
            longest=20,
        ),
    ] = ""
    rate: Annotated[float, FieldSpec("Speaking rate; 1 is normal.", at_least=0.5, at_most=2)] = 1.0
    volume: Annotated[float, FieldSpec("Speech volume, before the computer's own volume.", at_least=0, at_most=1)] = 1.0
    device: Annotated[str, FieldSpec("Part of the name of the loudspeaker; the default one if empty.", longest=200)] = (
        ""
    )
