"""Who takes part in what: the details that head a session."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrialDetails:
    """Answers of the start dialog; all of them may be left empty."""

    study: str = ""
    participant: str = ""
    condition: str = ""
    trial: str = ""
    wizard: str = ""
