"""Foreign text as it may stand in a terminal or a question: what is not seen, or steers a terminal, is written out."""


def printable(text: str, *, lines: bool = False) -> str:
    """``text`` with each character that cannot be seen as ``\\x1b`` or ``\\u202e``; with ``lines`` line breaks and tabs
    stay.
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or (lines and one in "\n\t") else one.encode("unicode_escape").decode() for one in text
    )
