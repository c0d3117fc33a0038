"""Who takes part in what: the details that head a session."""

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class TrialDetails:
    """Answers of the start dialog; all of them may be left empty."""

    study: str = ""
    participant: str = ""
    condition: str = ""
    trial: str = ""
    wizard: str = ""
    recording: str = ""
    purpose: str = ""


def following(details: TrialDetails) -> TrialDetails:
    """What to suggest for the next session: the same, with a plain trial number counted on."""
    return replace(details, trial=str(int(details.trial) + 1)) if details.trial.isdecimal() else details
