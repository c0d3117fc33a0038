"""Texts of the schema of scenario files, as Python source for lupdate: ``python packaging/scenario_texts.py FILE``."""

import json
import sys
from pathlib import Path

from caris_desktop.domain.schema_paths import texts_of
from caris_desktop.scenario.scenario_model import Scenario

Path(sys.argv[1]).write_text(
    "".join(f"QT_TR_NOOP({json.dumps(text, ensure_ascii=False)})\n" for text in texts_of(Scenario)), encoding="utf-8"
)
