"""Units of columns and measures, from the ends of their names."""

_UNITS = {
    "ns": "ns",
    "ms": "ms",
    "s": "s",
    "m": "m",
    "mm": "mm",
    "mps": "m/s",
    "rad": "rad",
    "radps": "rad/s",
    "px": "px",
    "hz": "Hz",
    "bytes": "bytes",
    "fraction": "0-1",
    "confidence": "0-1",
}
_WHOLE_NAMES = {"confidence": "0-1", "fps": "1/s", "minutes": "min", "runner_up": "0-1", "turn_over": "0-1"}


def unit_of(name: str) -> str:
    """SI symbol, ``0-1`` for shares and probabilities; empty for counts, texts and names without a unit."""
    if name in _WHOLE_NAMES:
        return _WHOLE_NAMES[name]
    match name.split("_"):
        case [*_, "per", "10", "min"]:
            return "1/10 min"
        case [*_, "edit", "distance"]:
            return "characters"
        case [*_, amount, "per", "s"]:
            return f"{_UNITS[amount]}/s"
        case [_, *_, last]:
            return _UNITS.get(last, "")
    return ""
