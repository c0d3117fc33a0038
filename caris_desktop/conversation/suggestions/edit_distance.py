"""Edit distance of texts."""


def characters_changed(before: str, after: str) -> int:
    """Levenshtein distance between two texts.

    Bit-parallel (Myers 1999, in Hyyrö's form), so that long texts take less than a display frame.
    """
    if not before or not after:
        return len(before) + len(after)
    where: dict[str, int] = {}
    for place, character in enumerate(before):
        where[character] = where.get(character, 0) | 1 << place
    everything, last = (1 << len(before)) - 1, 1 << (len(before) - 1)
    more, less, distance = everything, 0, len(before)
    for character in after:
        same = where.get(character, 0)
        diagonal = (((same & more) + more) ^ more) | same | less
        across_more = less | ~(diagonal | more) & everything
        across_less = more & diagonal
        distance += bool(across_more & last) - bool(across_less & last)
        across_more = (across_more << 1 | 1) & everything
        across_less = across_less << 1 & everything
        more = across_less | ~(diagonal | across_more) & everything
        less = across_more & diagonal
    return distance
