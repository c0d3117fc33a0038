"""Annotation data model: tiers of labelled intervals as in ELAN, as immutable values."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Annotated

from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.translation import QT_TR_NOOP, parse_localized
from caris_desktop.domain.value_class import Value

Named = Annotated[str, FieldSpec(shortest=1, longest=200, pattern="\\S", allowed="text that is not blank.")]
Text = Annotated[str, FieldSpec(longest=20_000)]
DEFAULT_TIER = QT_TR_NOOP("Annotations")
"""Where a table names no tier. In a document, and so in every language, the tier has this name."""


class VocabularyEntry(Value):
    """One permitted value, with what it means."""

    value: Annotated[Text, FieldSpec(shortest=1)]
    description: Text = ""


class Vocabulary(Value):
    """A controlled vocabulary: tiers that use it hold these values only."""

    name: Named
    entries: tuple[VocabularyEntry, ...]
    description: Text = ""


class Tier(Value):
    """One row of the timeline. ``coder`` is empty for read-only tiers derived from the recording.

    ``vocabulary`` names a vocabulary of the document; empty: free text. Annotations of a tier do not overlap.
    ``participant`` is the person that the tier is about, if any.
    """

    tier_id: str
    name: str
    coder: str = ""
    vocabulary: str = ""
    participant: str = ""

    @property
    def title(self) -> str:
        """Tier name for ``tr_filled``; a coder's own text is never translated."""
        return (
            parse_localized(self.name, (DEFAULT_TIER, QT_TR_NOOP("Annotations ({number})")))
            if self.coder
            else self.name
        )


def shown_names(tiers: Iterable[Tier]) -> dict[str, str]:
    """Display name per tier id, with the coder where several tiers share a name."""
    tiers = tuple(tiers)
    names = [tier.name for tier in tiers]
    return {
        tier.tier_id: f"{tier.name}@{tier.coder}" if names.count(tier.name) > 1 and tier.coder else tier.name
        for tier in tiers
    }


class Annotation(Value):
    """Labelled interval, in whole milliseconds from the session start; ``end_ms`` is after ``start_ms``."""

    annotation_id: str
    tier_id: str
    start_ms: int
    end_ms: int
    value: str


class AnnotationDocument(Value):
    """Tiers in timeline order; ``annotations`` sorted by tier, then start.

    ``duration_ms`` is the length of the session, which limits annotations; 0: unknown.
    """

    tiers: tuple[Tier, ...] = ()
    vocabularies: tuple[Vocabulary, ...] = ()
    annotations: tuple[Annotation, ...] = ()
    duration_ms: int = 0

    def only(self, keep: Callable[[Tier], bool]) -> "AnnotationDocument":
        """Document with the tiers that ``keep`` accepts and their annotations."""
        tiers = tuple(filter(keep, self.tiers))
        kept = {tier.tier_id for tier in tiers}
        return replace(self, tiers=tiers, annotations=tuple(item for item in self.annotations if item.tier_id in kept))

    def of_tier(self, tier_id: str) -> tuple[Annotation, ...]:
        return tuple(annotation for annotation in self.annotations if annotation.tier_id == tier_id)

    def values_used(self) -> dict[str, dict[str, None]]:
        """Values in use of each vocabulary that a tier names, in order of first use."""
        vocabularies = {tier.tier_id: tier.vocabulary for tier in self.tiers if tier.vocabulary}
        used: dict[str, dict[str, None]] = {name: {} for name in vocabularies.values()}
        for annotation in self.annotations:
            if annotation.value and annotation.tier_id in vocabularies:
                used[vocabularies[annotation.tier_id]][annotation.value] = None
        return used
