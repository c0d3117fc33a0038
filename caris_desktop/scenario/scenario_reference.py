"""Derived documentation of scenario files: JSON Schema and guide page.

``python -m caris_desktop.app.generated_reference`` writes them into ``resources/``.
"""

from pathlib import Path

from caris_desktop.domain.schema_docs import reference
from caris_desktop.domain.schema_json import schema_text
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.scenario.scenario_file import schema_path
from caris_desktop.scenario.scenario_model import Scenario

_PAGE_HEAD = """\
<!-- Written by `python -m caris_desktop.app.generated_reference` from
caris_desktop/scenario/scenario_model.py: change it there. -->
# The scenario file

A scenario is a YAML file that configures the console for a study: the layout of the panels, the permissions of the
wizard, the prepared phrases of the robot and the places it can go to. It contains only data; nothing in it is executed.
For examples, see [Writing a scenario](scenarios.md).

The scenarios shipped with the program are in `layouts`. Your own can be anywhere
(`caris-desktop --scenario my-study.yaml`), or in the folder `scenarios` of your configuration folder
(`~/.config/caris-desktop/scenarios` on Linux), where the console lists them. A file there replaces a shipped one with
the same name. `caris-desktop check --scenario my-study.yaml` reports the file, the line and the allowed values for each
mistake.

```yaml
version: 1
title: My study
layout:
  split: horizontal
  weights: [60, 40]
  children:
    - panel: video
    - tabs: [speak, map]
```

Everything else is optional. Editors with YAML schema support complete and check every key if the first line is
`# yaml-language-server: $schema=PATH/scenario.schema.json`; the schema is in `resources/schemas`. When the console
saves a place or a panel layout, your comments, the order of your keys and all other lines stay unchanged.

## The file

"""


def reference_files() -> dict[Path, str]:
    """Content of each derived file."""
    return {
        schema_path(): schema_text(Scenario, schema_id="caris-desktop:scenario", title="CARIS Desktop scenario"),
        resources_dir() / "guide" / "scenario-file.md": _PAGE_HEAD + reference(Scenario),
    }
