"""Recorded sessions shared by many tests."""

import pytest

from tests.support.recorded_session import RecordedSession, make_session


@pytest.fixture(scope="session")
def whole_session(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    """A session of 16 s with all streams, and its recorded values. Read-only."""
    folder = tmp_path_factory.mktemp("whole") / "session"
    return make_session(folder, seconds=16.0, fps=12.0, keep=True)


@pytest.fixture(scope="session")
def killed_session(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    """A session of 8 s as left by a kill. To be copied."""
    folder = tmp_path_factory.mktemp("killed") / "session"
    return make_session(folder, seconds=8.0, fps=10.0, beams=60, mark_every_s=0.5, killed=True, keep=True)
