"""``caris-desktop statistics``: measures of a study's sessions and conditions, with the SQL behind them."""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from caris_desktop.live.study_jobs import WorkersError, add_worker_arguments, run_jobs, workers_of
from caris_desktop.recording.csv_cells import add_csv_arguments, csv_style_of
from caris_desktop.recording.studies.statistics import StatisticsError, SummaryRow, study_statistics
from caris_desktop.recording.studies.study_index import study_dir_of
from caris_desktop.recording.terminal import ProgressLine, aligned, reporting


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", type=Path, help="study folder, or folder of its sessions")
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for tables and results (default: statistics in the study folder); created or updated",
    )
    add_csv_arguments(parser)
    add_worker_arguments(parser)


@reporting(
    StatisticsError, WorkersError, cancelled="Cancelled. The sessions exported so far are saved for the next time."
)
def run(args: argparse.Namespace) -> int:
    """Exit status: 0 if computed, 1 if not or if sessions were excluded (listed on stderr), 130 cancelled."""
    with ProgressLine() as line:
        out = args.out or study_dir_of(args.study) / "statistics"
        made = study_statistics(
            args.study, out, line.show, csv=csv_style_of(args), run=partial(run_jobs, workers=workers_of(args))
        )
    for problem in (*made.notices, *made.problems):
        print(problem, file=sys.stderr)
    conditions = list(dict.fromkeys(row.condition for row in made.summary))
    for condition in conditions:
        rows = [row for row in made.summary if row.condition == condition]
        title = "All sessions" if condition is None else f"Condition {condition or '(none)'}"
        print(f"{title}\n{as_table(rows)}\n")
    print(
        f"{made.sessions} sessions, {made.exported} of them newly read. Results in {made.out}: summary.csv,"
        " measures.csv, labels.csv, codes.csv, models.csv, model_functions.csv; meanings in codebook.csv, the SQL in"
        " queries.sql. Practice sessions are in measures.csv only."
    )
    return 1 if made.problems else 0


def as_table(rows: Sequence[SummaryRow]) -> str:
    """Lines for a terminal with aligned columns."""
    cells = [("measure", "unit", "n", "mean", "sd", "median", "min", "max")]
    cells += [
        (
            row.measure,
            row.unit,
            str(row.n),
            _number(row.mean),
            "" if row.sd is None else _number(row.sd),
            _number(row.median),
            _number(row.smallest),
            _number(row.largest),
        )
        for row in rows
    ]
    return "\n".join(aligned(cells, to_the_right=lambda column: column >= 2))


def _number(value: float) -> str:
    return f"{value:.2f}".removesuffix(".00") if abs(value) < 1e6 else f"{value:.3g}"
