"""A process in the background says so for itself and, where it has one of its own, for its session."""

import subprocess
import sys
from pathlib import Path

import pytest

_STEP_BACK = """
import os
from pathlib import Path
from caris_desktop.domain.priority import step_back
step_back(7)
autogroup = Path("/proc/self/autogroup")
# The file of a process whose session has no group, as the first one of a system, is empty.
said = autogroup.read_text().split() if autogroup.exists() else []
print(os.nice(0), said[-1] if said else "none")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="niceness is a matter of Unix")
@pytest.mark.parametrize("own_session", [True, False], ids=["own session", "session of others"])
def test_a_process_that_steps_back_takes_its_own_session_along(own_session: bool) -> None:
    before = subprocess.run(["nice"], capture_output=True, text=True, check=True).stdout
    done = subprocess.run(
        [sys.executable, "-c", _STEP_BACK],
        capture_output=True,
        text=True,
        check=True,
        start_new_session=own_session,
    )
    niceness, session = done.stdout.split()
    assert int(niceness) == int(before) + 7
    if not Path("/proc/self/autogroup").exists():
        pytest.skip("this system does not share the processor among sessions")
    assert (session == "3") == own_session, "what others share is not changed"
