"""Generator of ``declared_texts.py``: texts of the schema, for Qt's translation tools.

Run by ``python -m caris_desktop.app.generated_reference``.
"""

import json
from pathlib import Path

from caris_desktop.domain.schema_labels import texts_of
from caris_desktop.scenario.scenario_model import Scenario

_HEAD = '''\
"""Texts of the declarations of scenario files, for Qt's tools alone: nothing imports this.

Written by ``python -m caris_desktop.app.generated_reference`` from ``scenario/scenario_model.py``: change
them there. Long because there are many settings.
"""

# fmt: off
# ruff: noqa: E501
from caris_desktop.domain.translation import QT_TR_NOOP

TEXTS = (
'''


def reference_files() -> dict[Path, str]:
    """Path and contents of the generated file."""
    lines = [f"    QT_TR_NOOP({json.dumps(text, ensure_ascii=False)}),\n" for text in texts_of(Scenario)]
    return {Path(__file__).with_name("declared_texts.py"): f"{_HEAD}{''.join(lines)})\n"}
