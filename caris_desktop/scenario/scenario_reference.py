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

A scenario is one YAML file. It says what a study needs of the console: which panels stand where, what the wizard may
do, what the robot says with one key, which places it knows. It is data only: nothing in it is ever executed. How one is
written, by examples: [Writing a scenario](scenarios.md).

The shipped ones are in `layouts`. Yours lie anywhere (`caris-desktop --scenario my-study.yaml`), or in the folder
`scenarios` of your configuration folder (`~/.config/caris-desktop/scenarios` on Linux), where the console lists them;
there a file goes before a shipped one of the same name. `caris-desktop check --scenario my-study.yaml` names the file,
the line and what is allowed when it has a mistake.

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

Everything else is optional. Editors that know YAML schemas complete and check every key when the first line is
`# yaml-language-server: $schema=PATH/scenario.schema.json`; the schema is in `resources/schemas`. When the console
saves a place or an arrangement of panels, your comments, the order of your keys and every other line stay as they are.

## The file

"""


def reference_files() -> dict[Path, str]:
    """Content of each derived file."""
    return {
        schema_path(): schema_text(Scenario, schema_id="caris-desktop:scenario", title="CARIS Desktop scenario"),
        resources_dir() / "guide" / "scenario-file.md": _PAGE_HEAD + reference(Scenario),
    }
