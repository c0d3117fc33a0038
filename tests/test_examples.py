"""Examples: complete and small sessions, working notebooks and R script, and the results of the tutorial."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from caris_desktop.app.rehearse_command import read_back
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.scenario.scenario_file import load_scenario

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = REPOSITORY / "examples"
SESSIONS = sorted((EXAMPLES / "study" / "sessions").iterdir())
LARGEST_BYTES = 3_000_000
pytestmark = pytest.mark.timeout(600)  # they start the program several times
ENVIRONMENT = os.environ | {
    "PYTHONPATH": os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")])),
}


@pytest.fixture
def examples(tmp_path: Path) -> Path:
    """A copy, as commands write an index and pseudonyms into a study."""
    return Path(shutil.copytree(EXAMPLES, tmp_path / "examples"))


def test_the_sessions_are_small_and_name_no_machine() -> None:
    files = [file for file in (EXAMPLES / "study").rglob("*") if file.is_file()]
    assert sum(file.stat().st_size for file in files) <= LARGEST_BYTES
    assert {load_header(session)["trial"]["condition"] for session in SESSIONS} == {"A", "B"}
    for session in SESSIONS:
        assert load_header(session)["software"]["system"] == "Linux"
        texts = [file.read_text("utf-8") for file in session.rglob("*") if file.suffix in (".json", ".txt")]
        assert not re.search(r"/(?:home|root|tmp|Users)/", "".join(texts))


def load_header(session: Path) -> dict[str, dict[str, str]]:
    return dict(json.loads((session / "session.json").read_text("utf-8")))


def test_the_sessions_are_complete() -> None:
    for session in SESSIONS:
        assert verify_manifest(session) == []


@pytest.mark.long
def test_the_first_session_is_exported_to_every_format(examples: Path, tmp_path: Path) -> None:
    copied = examples / "study" / "sessions" / SESSIONS[0].name
    assert read_back(copied, tmp_path / "exports").problems == ()


def test_the_scenario_of_the_sessions_can_be_opened() -> None:
    assert load_scenario(EXAMPLES / "lab-visit.yaml").title == "Lab visit"


def code_of(notebook: Path) -> str:
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


# One in each run of the suite; the others with --long.
NOTEBOOKS = [
    pytest.param(path, marks=[pytest.mark.long] if number else [], id=path.stem)
    for number, path in enumerate(sorted(EXAMPLES.glob("*.ipynb")))
]


@pytest.mark.parametrize("notebook", NOTEBOOKS)
@pytest.mark.long("align_elan")
def test_the_code_of_a_notebook_runs(notebook: Path, examples: Path) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed: pip install '.[test]'")
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code"), "saved without outputs"
    run = subprocess.run(
        [sys.executable, "-c", code_of(notebook)],
        cwd=examples,
        env=ENVIRONMENT | {"TMPDIR": str(examples)},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.long
def test_the_r_script_reads_the_tables(examples: Path, tmp_path: Path) -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed")
    caris("export", examples / "study", tmp_path / "tables", "--to", "csv", "--plain-csv", cwd=tmp_path)
    script = ["Rscript", str(EXAMPLES / "tables.R"), str(tmp_path / "tables")]
    run = subprocess.run(script, capture_output=True, text=True, timeout=500, check=False)
    assert run.returncode == 0, run.stderr
    assert "Response times in seconds, by condition" in run.stdout


def caris(*words: object, cwd: Path) -> str:
    command = [sys.executable, "-m", "caris_desktop", *map(str, words)]
    run = subprocess.run(
        command,
        cwd=cwd,
        env=ENVIRONMENT | {"TMPDIR": str(cwd)},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.long  # other tests cover its commands, and each run executes a notebook
def test_the_tutorial_leads_to_a_table_of_results(examples: Path, tmp_path: Path) -> None:
    """Commands of the tutorial after the recording; those before need a display or minutes."""
    text = (REPOSITORY / "docs" / "tutorial.md").read_text("utf-8")
    commands = re.findall(r"^\.venv/bin/caris-desktop (.*examples/study.*)$", text, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["statistics", "export"]
    printed = [caris(*command.split(), cwd=tmp_path) for command in commands]
    assert "Condition A" in printed[0] and "Condition B" in printed[0]
    assert (tmp_path / "results" / "measures.csv").read_text("utf-8").count("\n") == 1 + len(SESSIONS)
    assert len(list((tmp_path / "results" / "export").rglob("report.html"))) == len(SESSIONS)
    pytest.importorskip("pandas", reason="pandas is not installed: pip install '.[test]'")
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert re.search(r"^A\b.*\n^B\b", run.stdout, re.MULTILINE), run.stdout
