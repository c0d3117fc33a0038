"""Tests of the fixture that fails a test on unexpected warnings of Qt or the log, in a separate process."""

import subprocess
import sys
from pathlib import Path

import pytest

_HEAD = "from tests.support.leak_checks import no_unexpected_warnings\n"
_QT = "from PySide6.QtCore import qWarning\ndef test_it(qapp):\n    qWarning('Something is out of range')\n"
_LOG = "import logging\ndef test_it():\n    logging.getLogger('x').warning('Something is out of range')\n"


@pytest.mark.parametrize("body", [_QT, _LOG], ids=["qt", "log"])
@pytest.mark.parametrize("expected", [False, True])
@pytest.mark.long
def test_a_warning_fails_the_test_unless_it_is_expected(body: str, expected: bool, tmp_path: Path) -> None:
    mark = "@pytest.mark.logs('out of range')\ndef test_it" if expected else "def test_it"
    (tmp_path / "test_said.py").write_text(f"import pytest\n{_HEAD}{body.replace('def test_it', mark)}", "utf-8")
    ran = subprocess.run(
        [
            sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "pyproject.toml",
            "--rootdir", str(tmp_path), str(tmp_path),
        ],
        cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (ran.returncode == 0) is expected, ran.stdout
    assert ("unexpected messages" in ran.stdout) is not expected
