"""Text of a robot profile: YAML with line numbers, migrations, and formatting."""

from collections.abc import Iterable, Mapping
from typing import Any

from caris_desktop.domain.file_migrations import Migration, migrated
from caris_desktop.domain.key_path import Problem
from caris_desktop.domain.schema_validation import problem_lines
from caris_desktop.domain.translation import tr
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml
from caris_desktop.domain.yaml_writing import dumped
from caris_desktop.robot.profile_model import PROFILE_VERSION, ProfileError

MIGRATIONS: Mapping[int, Migration] = {}
MAX_BYTES = 2**20


class ProfileText:
    """Data of one profile in the newest version, with line numbers."""

    def __init__(self, text: str, file_name: str) -> None:
        """Parse ``text``; ``file_name`` is used in messages only. Raises ProfileError."""
        self.file_name = file_name
        if len(text) > MAX_BYTES:
            raise ProfileError(
                tr("{file_name}: the file is larger than 1 MB and is not a robot profile.").format(file_name=file_name)
            )
        try:
            self._source = parse_yaml(text)
        except YamlSourceError as error:
            message = tr("{file}, line {line}: {problem}").format(file=file_name, line=error.line, problem=error)
            raise ProfileError(f"{message.rstrip('.')}.") from error
        if not isinstance(self._source.data, dict):
            raise ProfileError(
                tr("{file_name}: a robot profile must be a list of 'name: value' lines.").format(file_name=file_name)
            )
        self.data: dict[str, Any] = self._source.data

    def raise_to_newest(self) -> None:
        """Migrate the data to the newest version. Raises ProfileError."""
        version, newest = self.data.get("version"), PROFILE_VERSION
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            wrong = tr("'version' is missing or not a whole number; write 'version: {newest}'.").format(newest=newest)
            self.refuse([(("version",), wrong)])
        elif version > newest:
            newer = tr(
                "this profile has version {version}, made for a newer CARIS Desktop; this program reads "
                "version {newest}. Update the program or use an older profile."
            )
            self.refuse([(("version",), newer.format(version=version, newest=newest))])
        else:
            self.data = migrated(self.data, MIGRATIONS, version=version, newest=newest)

    def refuse(self, found: Iterable[Problem]) -> None:
        """Raises ProfileError if there are problems."""
        if message := problem_lines(self.file_name, self._source, found):
            raise ProfileError(message)


def profile_yaml(data: Mapping[str, Any]) -> str:
    """Profile as text: sections separated, short values on one line."""
    chunks = ["# A robot profile of CARIS Desktop. The guide of robot profiles explains every line.\n"]
    previous = ""
    for key, value in data.items():
        chunk = _section(key, value, default_flow_style=None)
        if isinstance(value, Mapping) and chunk.count("\n") > 1 and chunk.startswith(f"{key}: {{"):
            # too long for one line
            chunk = _section(key, value, default_flow_style=False)
        if previous and (chunk.count("\n") > 1 or previous.count("\n") > 1):
            chunks.append("\n")
        chunks.append(chunk)
        previous = chunk
    return "".join(chunks)


def _section(key: str, value: Any, *, default_flow_style: bool | None) -> str:
    flow = default_flow_style if isinstance(value, (Mapping, list)) else False
    return dumped({key: value}, default_flow_style=flow, width=110, plain=True)
