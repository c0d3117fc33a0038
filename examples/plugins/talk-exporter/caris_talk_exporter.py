"""Exporter for CARIS Desktop: a numbered transcript with silences and overlaps, for conversation analysis."""

from caris_desktop.recording.tables.build import rows

NAMES = {"participant": "PAR", "robot": "ROB", "wizard": "WIZ", "": "???"}
LEAST_SILENCE_S = 0.2


def write_talk(session, out, context):
    """The contract is ``caris_desktop.recording.session_export.Exporter``."""
    spoken = rows(session, "utterances", context.progress)
    turns = [row for row in spoken if row["said"] and row["start_ns"] and row["end_ns"]]
    lines, ended_ns = [], None
    for number, row in enumerate(sorted(turns, key=lambda row: row["start_ns"]), start=1):
        silence_s = 0.0 if ended_ns is None else (row["start_ns"] - ended_ns) / 1e9
        if silence_s >= LEAST_SILENCE_S:
            lines.append(f"          ({silence_s:.1f})")
        text = " ".join(row["text"].split())
        lines.append(f"{number:>4} {NAMES[row['speaker']]}: {'[' if silence_s < 0 else ''}{text}")
        ended_ns = max(ended_ns or 0, row["end_ns"])
    path = out / "talk.txt"
    about = ", ".join(f"{name} {value}" for name, value in session.trial.items() if name != "wizard")
    path.write_text("\n".join([f"{session.folder.name} ({about})", "", *lines, ""]), encoding="utf-8", errors="replace")
    return [path]


write_talk.caris_interface = 1
