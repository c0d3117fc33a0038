"""HTML and Markdown pages from the program's templates; values in HTML pages are escaped."""

import functools
from pathlib import Path
from typing import Any

from caris_desktop.domain.shipped import resources_dir

# Characters that XML and HTML forbid; a recogniser or a robot may send anything.
_CONTROLS = {code: "\ufffd" for code in (*range(0x20), 0x7F) if chr(code) not in "\t\n\r"}


def write_page(path: Path, template: str, **values: Any) -> Path:
    """Fill ``resources/templates/TEMPLATE`` and write it as UTF-8. Raises OSError."""
    text = _environment().get_template(template).render(**values).translate(_CONTROLS)
    # Lone surrogates from input methods cannot be encoded.
    path.write_bytes(text.encode("utf-8", "replace"))
    return path


@functools.cache
def _environment() -> Any:
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(resources_dir() / "templates"),
        autoescape=jinja2.select_autoescape(disabled_extensions=("md.j2",), default=True),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
