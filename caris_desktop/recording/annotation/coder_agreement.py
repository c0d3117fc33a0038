"""Inter-coder agreement: Cohen's kappa per unit of time and per annotation, Krippendorff's alpha, boundary offsets.

Cohen, J. (1960). A coefficient of agreement for nominal scales. Educational and Psychological Measurement, 20, 37-46.
Krippendorff, K. (2019). Content Analysis, 4th edition, chapter 12: alpha for nominal data without missing codes.
Per unit of time, each interval counts by its length, including time that neither coder annotated. Per annotation, each
annotation counts once; one without a counterpart counts as a disagreement.
"""

import itertools
from collections import Counter
from collections.abc import Sequence

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import AnnotationError, coders_of, tier_of
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier

NOTHING = ""  # the code of a unit of time without an annotation
UNNAMED = "(no value)"  # the code of an annotation with an empty value
UNMATCHED = "(unmatched)"  # the code of an annotation without a counterpart from the other coder
LEAST_OVERLAP = 0.5
_MOST_UNITS = 50_000_000


class Agreement(Value):
    """Confusion matrix and kappa: ``matrix[i][j]`` counts ``labels[i]`` of the first coder against ``labels[j]`` of the
    second.

    ``kappa`` is None where it is undefined: no codes, or a single label throughout. ``observed`` is the share of equal
    codes, None without any code.
    """

    labels: tuple[str, ...]
    matrix: tuple[tuple[int, ...], ...]
    kappa: float | None
    observed: float | None

    @property
    def count(self) -> int:
        """Number of compared codes per coder."""
        return sum(map(sum, self.matrix))


class BoundaryOffsets(Value):
    """Second coder minus first, in milliseconds, over the matched annotations: offsets of starts and of ends.

    ``mean`` is signed: positive where the second coder is later. ``worst`` is the largest absolute offset.
    """

    matched: int
    start_mean_ms: float
    start_worst_ms: float
    end_mean_ms: float
    end_worst_ms: float


class TierAgreement(Value):
    """Comparison of two coders' tiers; ``per_unit`` counts units of ``unit_ms``.

    ``per_annotation`` counts annotations: two match if both boundaries lie within ``tolerance_ms``, or if their overlap
    is at least half of their union.
    """

    tier: str
    coders: tuple[str, str]
    unit_ms: int
    tolerance_ms: int
    per_unit: Agreement
    per_annotation: Agreement
    offsets: BoundaryOffsets | None


class CodersAgreement(Value):
    """Comparison of all coders who have a tier of this name: alpha per unit of ``unit_ms``, and each pair of them.

    ``alpha`` is None where it is undefined, as kappa.
    """

    tier: str
    coders: tuple[str, ...]
    unit_ms: int
    alpha: float | None
    pairs: tuple[TierAgreement, ...]


def krippendorff_alpha(codes: Sequence[Sequence[str]]) -> float | None:
    """Krippendorff's alpha for nominal codes: a sequence per coder, of equal length. None if all codes are equal."""
    units = Counter(zip(*codes, strict=True))
    totals: Counter[str] = Counter()
    disagreed = 0
    for unit, count in units.items():
        of_unit = Counter(unit)
        disagreed += count * (len(unit) ** 2 - sum(number**2 for number in of_unit.values()))
        for code, number in of_unit.items():
            totals[code] += count * number
    total = totals.total()
    by_chance = total**2 - sum(number**2 for number in totals.values())
    return None if not by_chance else 1 - disagreed * (total - 1) / ((len(codes) - 1) * by_chance)


def agreement(first: Sequence[str], second: Sequence[str]) -> Agreement:
    """Cohen's kappa of two sequences of codes of equal length. Raises ValueError for unequal lengths."""
    return _agreement(Counter(zip(first, second, strict=True)))


def compare_tiers(
    document: AnnotationDocument,
    first_tier_id: str,
    second_tier_id: str,
    *,
    unit_ms: int = 100,
    tolerance_ms: int = 500,
) -> TierAgreement:
    """Compare two tiers over the whole session. Raises AnnotationError for an unknown tier."""
    first, second = tier_of(document, first_tier_id), tier_of(document, second_tier_id)
    one, other = document.of_tier(first_tier_id), document.of_tier(second_tier_id)
    ended_ms = max([document.duration_ms, *(item.end_ms for item in (*one, *other))])
    if unit_ms < 1 or tolerance_ms < 0 or ended_ms // unit_ms > _MOST_UNITS:
        raise AnnotationError(
            QT_TR_NOOP("Units of {unit_ms} ms with a tolerance of {tolerance_ms} ms cannot be compared."),
            unit_ms=unit_ms,
            tolerance_ms=tolerance_ms,
        )
    codes, offsets = _matched(one, other, tolerance_ms)
    return TierAgreement(
        tier=first.name if first.name == second.name else f"{first.name} / {second.name}",
        coders=(first.coder or "record", second.coder or "record"),
        unit_ms=unit_ms,
        tolerance_ms=tolerance_ms,
        per_unit=agreement(unit_codes(one, ended_ms, unit_ms), unit_codes(other, ended_ms, unit_ms)),
        per_annotation=_agreement(codes),
        offsets=offsets,
    )


def compare_coders(
    document: AnnotationDocument,
    coders: Sequence[str] = (),
    *,
    tier: str = "",
    unit_ms: int = 100,
    tolerance_ms: int = 500,
) -> tuple[CodersAgreement, ...]:
    """Compare ``coders`` (none: all) on each tier that two of them have under the same name, or only on ``tier``.

    Raises AnnotationError if there is nothing to compare.
    """
    available = coders_of(document)
    for coder in coders:
        if coder not in available:
            known = QT_TR_NOOP("There are no annotations by {coder}. Available coders: {coders}.")
            nobody = QT_TR_NOOP("There are no annotations by {coder}. Nobody has annotated this session yet.")
            raise AnnotationError(known if available else nobody, coder=coder, coders=", ".join(available))
    coders = tuple(dict.fromkeys(coders)) or available
    by_name: dict[str, dict[str, Tier]] = {}
    for item in document.tiers:
        if item.coder in coders and tier in ("", item.name):
            by_name.setdefault(item.name, {})[item.coder] = item
    results = []
    for name, tiers in by_name.items():
        chosen = [coder for coder in coders if coder in tiers]
        if len(chosen) < 2:
            continue
        pairs = tuple(
            compare_tiers(
                document, tiers[one].tier_id, tiers[other].tier_id, unit_ms=unit_ms, tolerance_ms=tolerance_ms
            )
            for one, other in itertools.combinations(chosen, 2)
        )
        annotations = [document.of_tier(tiers[coder].tier_id) for coder in chosen]
        ended_ms = max([document.duration_ms, *(item.end_ms for items in annotations for item in items)])
        codes = [unit_codes(items, ended_ms, unit_ms) for items in annotations]
        results.append(CodersAgreement(name, tuple(chosen), unit_ms, krippendorff_alpha(codes), pairs))
    if not results:
        raise AnnotationError(
            QT_TR_NOOP(
                "Fewer than two of the coders ({coders}) have the tier “{tier}”. Tiers are compared by name: "
                "rename one of them."
            )
            if tier
            else QT_TR_NOOP(
                "No two of the coders ({coders}) have a tier with the same name. Tiers are compared by name: "
                "rename one of them."
            ),
            coders=", ".join(coders),
            tier=tier,
        )
    return tuple(results)


def unit_codes(annotations: Sequence[Annotation], ended_ms: int, unit_ms: int) -> list[str]:
    """Code of a tier in each unit of time: the value at the middle of the unit."""
    count = -(-ended_ms // unit_ms)
    codes = [NOTHING] * count
    for item in annotations:
        # The middle of unit n is at (n + 1/2) * unit_ms.
        first = max(0, -(-(2 * item.start_ms - unit_ms) // (2 * unit_ms)))
        beyond = min(count, -(-(2 * item.end_ms - unit_ms) // (2 * unit_ms)))
        codes[first:beyond] = [item.value or UNNAMED] * max(beyond - first, 0)
    return codes


def coders_report(result: CodersAgreement) -> str:
    """Report of all coders of a tier, and of each pair, as plain text."""
    heading = [
        f"Tier: {result.tier}",
        f"Coders: {', '.join(result.coders)}",
        f"Krippendorff's alpha (nominal) per unit of time ({result.unit_ms} ms): {_figure(result.alpha)}",
    ]
    return "\n\n".join(("\n".join(heading), *map(report, result.pairs)))


def report(result: TierAgreement) -> str:
    """Report of a comparison as plain text with tables."""
    first, second = result.coders
    units, items = result.per_unit, result.per_annotation
    lines = [
        f"Tier: {result.tier}",
        f"Coders: {first} and {second}",
        "",
        f"Per unit of time ({result.unit_ms} ms; {units.count} units, those without an annotation included):",
        f"  Cohen's kappa {_figure(units.kappa)}{_in_words(units.kappa)}, agreement {_percent(units.observed)}",
        *_table(units, first, second),
        "",
        f"Per annotation (boundaries within {result.tolerance_ms} ms, or at least half of the time shared):",
        f"  Cohen's kappa {_figure(items.kappa)}{_in_words(items.kappa)}, agreement {_percent(items.observed)}",
        f"  {_matches(result)}",
        *_table(items, first, second),
    ]
    if result.offsets is not None:
        offsets = result.offsets
        lines += [
            "",
            f"Boundaries of matched annotations, {second} minus {first}: "
            f"start {offsets.start_mean_ms:+.0f} ms on average (at most {offsets.start_worst_ms:.0f} ms), "
            f"end {offsets.end_mean_ms:+.0f} ms (at most {offsets.end_worst_ms:.0f} ms)",
        ]
    return "\n".join(lines) + "\n"


def _agreement(pairs: Counter[tuple[str, str]]) -> Agreement:
    labels = tuple(sorted({label for pair in pairs for label in pair}))
    matrix = tuple(tuple(pairs[one, other] for other in labels) for one in labels)
    total = sum(map(sum, matrix))
    if not total:
        return Agreement((), (), None, None)
    agreed = sum(matrix[index][index] for index in range(len(labels)))
    of_first = [sum(row) for row in matrix]
    of_second = [sum(column) for column in zip(*matrix, strict=True)]
    # Integers until the last step, so that the result is exact.
    by_chance = sum(one * other for one, other in zip(of_first, of_second, strict=True))
    kappa = None if by_chance == total * total else (agreed * total - by_chance) / (total * total - by_chance)
    return Agreement(labels, matrix, kappa, agreed / total)


def _matched(
    first: Sequence[Annotation], second: Sequence[Annotation], tolerance_ms: int
) -> tuple[Counter[tuple[str, str]], BoundaryOffsets | None]:
    """Greedy matching, best pairs first, each annotation in at most one pair; the rest has no counterpart."""
    candidates: list[tuple[float, int, int, int]] = []
    begin = 0
    for number, one in enumerate(first):
        # Both sequences are sorted and free of overlaps: what ends too early for this one does for the next.
        while begin < len(second) and second[begin].end_ms + tolerance_ms < one.start_ms:
            begin += 1
        for index in range(begin, len(second)):
            other = second[index]
            if other.start_ms > one.end_ms + tolerance_ms:
                break
            shared_ms = max(0, min(one.end_ms, other.end_ms) - max(one.start_ms, other.start_ms))
            covered_ms = max(one.end_ms, other.end_ms) - min(one.start_ms, other.start_ms)
            offset_ms = max(abs(one.start_ms - other.start_ms), abs(one.end_ms - other.end_ms))
            if offset_ms <= tolerance_ms or shared_ms >= LEAST_OVERLAP * covered_ms:
                candidates.append((-shared_ms / covered_ms, offset_ms, number, index))
    codes: Counter[tuple[str, str]] = Counter()
    taken_first: set[int] = set()
    taken_second: set[int] = set()
    starts_ms, ends_ms = [], []
    for _, _, number, index in sorted(candidates):
        if number in taken_first or index in taken_second:
            continue
        taken_first.add(number)
        taken_second.add(index)
        one, other = first[number], second[index]
        codes[one.value or UNNAMED, other.value or UNNAMED] += 1
        starts_ms.append(other.start_ms - one.start_ms)
        ends_ms.append(other.end_ms - one.end_ms)
    codes.update((one.value or UNNAMED, UNMATCHED) for n, one in enumerate(first) if n not in taken_first)
    codes.update((UNMATCHED, other.value or UNNAMED) for n, other in enumerate(second) if n not in taken_second)
    if not starts_ms:
        return codes, None
    return codes, BoundaryOffsets(
        matched=len(starts_ms),
        start_mean_ms=sum(starts_ms) / len(starts_ms),
        start_worst_ms=max(map(abs, starts_ms)),
        end_mean_ms=sum(ends_ms) / len(ends_ms),
        end_worst_ms=max(map(abs, ends_ms)),
    )


def _figure(kappa: float | None) -> str:
    return "undefined (the same code throughout, or no codes)" if kappa is None else f"{kappa:.3f}"


def _in_words(kappa: float | None) -> str:
    """Grade after Landis and Koch (1977)."""
    if kappa is None:
        return ""
    grades = ((0.0, "poor"), (0.2, "slight"), (0.4, "fair"), (0.6, "moderate"), (0.8, "substantial"))
    return f" ({next((word for limit, word in grades if kappa <= limit), 'almost perfect')})"


def _percent(share: float | None) -> str:
    return "not defined" if share is None else f"{100 * share:.1f} %"


def _matches(result: TierAgreement) -> str:
    labels, matrix = result.per_annotation.labels, result.per_annotation.matrix
    only_first = sum(row[at] for at, label in enumerate(labels) if label == UNMATCHED for row in matrix)
    only_second = sum(sum(row) for label, row in zip(labels, matrix, strict=True) if label == UNMATCHED)
    matched = result.offsets.matched if result.offsets is not None else 0
    return f"{matched} matched, {only_first} only by {result.coders[0]}, {only_second} only by {result.coders[1]}"


def _table(counts: Agreement, first: str, second: str) -> list[str]:
    """Confusion matrix as text: first coder in rows, second in columns, which are numbered so that long codes fit."""
    if not counts.labels:
        return []
    names = [" ".join(label.split()) or "(nothing)" for label in counts.labels]
    names = [name if len(name) <= 24 else f"{name[:23]}…" for name in names]
    wide = max(len(name) for name in names)
    figures = max(5, *(len(str(count)) for row in counts.matrix for count in row))
    numbers = "".join(f"{number:>{figures + 1}}" for number in range(1, len(names) + 1))
    lines = [f"  rows: {first}, columns: {second}", f"  {'':>{wide + 4}}{numbers}"]
    for number, (name, row) in enumerate(zip(names, counts.matrix, strict=True), start=1):
        lines.append(f"  {number:>3} {name:<{wide}}" + "".join(f"{count:>{figures + 1}}" for count in row))
    return lines
