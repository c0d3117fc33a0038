"""Annotations of a session: tiers of labelled stretches of time, as in ELAN. Plain values; editing gives new ones."""

from collections.abc import Iterable
from typing import Annotated

from caris_desktop.domain.declared import Rule
from caris_desktop.domain.translation import QT_TR_NOOP, refilled
from caris_desktop.domain.value_class import dataclass

Named = Annotated[str, Rule(shortest=1, longest=200, pattern="\\S", allowed="more than blanks.")]
Text = Annotated[str, Rule(longest=20_000)]
DEFAULT_TIER = QT_TR_NOOP("Annotations")
"""Where a table names no tier. In a document, and so in every language, the tier has this name."""


@dataclass(frozen=True, slots=True)
class VocabularyEntry:
    """One permitted value, with what it means."""

    value: Annotated[Text, Rule(shortest=1)]
    description: Text = ""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """A controlled vocabulary: tiers that use it hold these values only."""

    name: Named
    entries: tuple[VocabularyEntry, ...]
    description: Text = ""


@dataclass(frozen=True, slots=True)
class Tier:
    """One row of the timeline. ``coder`` is empty for tiers made from the record, which nobody edits.

    ``vocabulary`` names a vocabulary of the document; free text without one. Annotations of a tier do not overlap.
    ``participant`` says whom the tier is about, where it is about one.
    """

    tier_id: str
    name: str
    coder: str = ""
    vocabulary: str = ""
    participant: str = ""

    @property
    def title(self) -> str:
        """The name, for ``tr_filled``: what a coder wrote stays as it is."""
        return refilled(self.name, (DEFAULT_TIER, QT_TR_NOOP("Annotations ({number})"))) if self.coder else self.name


def shown_names(tiers: Iterable[Tier]) -> dict[str, str]:
    """The name of each tier id, with the coder where several tiers are called so."""
    tiers = tuple(tiers)
    names = [tier.name for tier in tiers]
    return {
        tier.tier_id: f"{tier.name}@{tier.coder}" if names.count(tier.name) > 1 and tier.coder else tier.name
        for tier in tiers
    }


@dataclass(frozen=True, slots=True)
class Annotation:
    """A labelled stretch, in whole milliseconds since the session began; ``end_ms`` is after ``start_ms``."""

    annotation_id: str
    tier_id: str
    start_ms: int
    end_ms: int
    value: str


@dataclass(frozen=True, slots=True)
class AnnotationDocument:
    """Tiers in the order of the timeline; ``annotations`` sorted by tier, then start.

    ``duration_ms`` is how long the session is: no annotation ends later. 0: not known.
    """

    tiers: tuple[Tier, ...] = ()
    vocabularies: tuple[Vocabulary, ...] = ()
    annotations: tuple[Annotation, ...] = ()
    duration_ms: int = 0

    def of_tier(self, tier_id: str) -> tuple[Annotation, ...]:
        return tuple(annotation for annotation in self.annotations if annotation.tier_id == tier_id)
