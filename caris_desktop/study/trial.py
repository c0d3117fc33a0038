"""Who takes part in what: the details that head a session."""

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class TrialDetails:
    """Answers of the start dialog; all of them may be left empty.

    ``recording`` counts the recordings of one trial. ``purpose`` is practice for a wizard's training, else empty.
    """

    study: str = ""
    participant: str = ""
    condition: str = ""
    trial: str = ""
    wizard: str = ""
    recording: str = ""
    purpose: str = ""


def following(details: TrialDetails) -> TrialDetails:
    """What to suggest for the next session: the same, with a plain trial number counted on."""
    details = replace(details, recording="")
    return replace(details, trial=str(int(details.trial) + 1)) if details.trial.isdecimal() else details


def with_recording_number(details: TrialDetails, last: TrialDetails) -> TrialDetails:
    """Numbered: one more than the last session where that was the same trial of the same participant."""
    plain = replace(details, recording="", purpose="", wizard="")
    again = plain == replace(last, recording="", purpose="", wizard="") and plain != TrialDetails()
    number = int(last.recording) + 1 if again and last.recording.isdecimal() else 1
    return replace(details, recording=str(number))
