"""Who is here: turns tracks into people, by pure logic on injected time."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PersonRow:
    """One row of the People panel. ``name`` is what to show: the given name, or "Person 3"."""

    person_id: str
    track: int
    name: str
    here: bool
    since_ns: int
    last_seen_ns: int
