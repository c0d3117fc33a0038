"""Numbers of trials and of the recordings of a trial."""

from dataclasses import replace

from caris_desktop.domain.events import TrialDetails
from caris_desktop.study.study_folder import following, with_recording_number

FIRST = TrialDetails("Lab tours", "P07", "B", "3", "W2")


def test_the_next_session_is_the_next_trial() -> None:
    assert following(replace(FIRST, recording="2")) == replace(FIRST, trial="4")
    assert following(replace(FIRST, trial="pilot")).trial == "pilot"


def test_recordings_of_one_trial_are_numbered() -> None:
    one = with_recording_number(FIRST, TrialDetails())
    assert one.recording == "1"
    two = with_recording_number(replace(FIRST, wizard="W3"), one)
    assert (two.recording, two.wizard) == ("2", "W3"), "whoever is the wizard"
    assert with_recording_number(following(two), two).recording == "1"
    assert with_recording_number(TrialDetails(), with_recording_number(TrialDetails(), TrialDetails())).recording == "1"
