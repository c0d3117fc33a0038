"""Sequence of trials: defaults for the next session."""

from dataclasses import replace

from caris_desktop.domain.trial_details import TrialDetails


def following(details: TrialDetails) -> TrialDetails:
    """Suggested details for the next session: the same, with a numeric trial incremented."""
    details = replace(details, recording="")
    return replace(details, trial=str(int(details.trial) + 1)) if details.trial.isdecimal() else details


def with_recording_number(details: TrialDetails, last: TrialDetails) -> TrialDetails:
    """Details with a recording number, incremented if the last session was the same trial of the same participant."""
    plain = replace(details, recording="", purpose="", wizard="")
    again = plain == replace(last, recording="", purpose="", wizard="") and plain != TrialDetails()
    number = int(last.recording) + 1 if again and last.recording.isdecimal() else 1
    return replace(details, recording=str(number))
