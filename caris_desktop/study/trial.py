"""How one trial follows another."""

from dataclasses import replace

from caris_desktop.domain.trial import TrialDetails


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
