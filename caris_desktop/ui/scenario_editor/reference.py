"""Generator of ``declared_texts.py``: texts of the schema, for Qt's translation tools.

Run by ``python -m caris_desktop.app.reference``.
"""

import json
from pathlib import Path

from caris_desktop.domain.declared_words import texts_of
from caris_desktop.scenario.model import Scenario

_HEAD = '''\
"""Texts of the declarations of scenario files, for Qt's tools alone: nothing imports this.

Written by ``python -m caris_desktop.app.reference`` from ``scenario/model.py``: change them there. Long because there
are many settings.
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
