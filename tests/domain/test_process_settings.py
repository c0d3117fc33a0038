"""Background priority of a process, and of its session if it has one."""

import subprocess
import sys
from pathlib import Path

import pytest

from caris_desktop.domain import process_settings

_STEP_BACK = """
import os
from pathlib import Path
from caris_desktop.domain.process_settings import step_back
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


def test_a_session_that_was_not_heard_says_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system honours only the first of concurrent requests of a user's processes."""

    class Deaf:
        said = 0

        def write_text(self, _text: str) -> None:
            self.said += 1
            if self.said < 3:
                raise BlockingIOError("Resource temporarily unavailable")

    session = Deaf()
    monkeypatch.setattr(process_settings, "_SESSION", session)
    monkeypatch.setattr(process_settings, "_AGAIN_AFTER_S", 0.001)
    assert not process_settings._say_for_session(3)
    process_settings._say_until_heard(3)
    assert session.said == 3


def test_a_system_without_shares_for_sessions_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(process_settings, "_SESSION", tmp_path / "absent" / "autogroup")
    assert process_settings._say_for_session(3)
