"""Measure for CARIS Desktop: the longest silence of a conversation."""

from caris_desktop.recording.tables.build import rows


class LongestSilence:
    """The contract is ``caris_desktop.recording.measures.measure_plugins.SessionMeasure``."""

    caris_interface = 1
    description = "Longest time between the end of an utterance and the start of the next, of anybody."
    empty = "There were fewer than two utterances."
    values = ()

    def measure(self, session):
        spoken = [row for row in rows(session, "utterances") if row["said"] and row["start_ns"] and row["end_ns"]]
        silences_s, ended_ns = [], None
        for row in sorted(spoken, key=lambda row: row["start_ns"]):
            if ended_ns is not None:
                silences_s.append(max(0, row["start_ns"] - ended_ns) / 1e9)
            ended_ns = max(ended_ns or 0, row["end_ns"])
        return max(silences_s, default=None)
