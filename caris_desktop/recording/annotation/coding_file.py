"""Schema of a coder's annotation file; checks, reading, writing and JSON Schema derive from it."""

from typing import Annotated, Literal

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_model import Named, Text, Vocabulary

FORMAT: Literal["caris-desktop annotations"] = "caris-desktop annotations"
FORMAT_VERSION: Literal[1] = 1
_Id = Annotated[str, FieldSpec(shortest=1, longest=200)]
_Time = Annotated[int, FieldSpec(unit="milliseconds", at_least=0, at_most=2**32 - 1)]


class CodedInterval(Value):
    """A labelled stretch of time."""

    annotation_id: _Id
    start_ms: _Time
    end_ms: Annotated[_Time, FieldSpec("After start_ms.")]
    value: Text


class CodedTier(Value):
    """One row of the timeline."""

    tier_id: _Id
    name: Named
    vocabulary: Annotated[str, FieldSpec("A vocabulary of the file; empty: free text.", order=1)]
    annotations: Annotated[tuple[CodedInterval, ...], FieldSpec("In chronological order, without overlaps.", order=1)]
    participant: Annotated[Text, FieldSpec("Person that the tier is about.")] = ""


class Coding(Value):
    """What one coder made of a session: tiers of labelled stretches of time.

    Times are whole milliseconds since the session began (started_ns in session.json).
    """

    coder: Annotated[Named, FieldSpec("Coder of these tiers.")]
    vocabularies: Annotated[tuple[Vocabulary, ...], FieldSpec(order=1)]
    tiers: Annotated[tuple[CodedTier, ...], FieldSpec("In the order of the timeline.", order=1)]
    saved_utc: str = ""
    duration_ms: Annotated[_Time, FieldSpec("Duration of the session; 0: unknown.")] = 0
    format: Annotated[Literal["caris-desktop annotations"], FieldSpec(wanted=True, order=-1)] = FORMAT
    format_version: Annotated[Literal[1], FieldSpec("The version of this format.", wanted=True, order=-1)] = (
        FORMAT_VERSION
    )
