"""Trial details: study, participant and condition of a session."""

from caris_desktop.domain.value_class import Value


class TrialDetails(Value):
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
