"""Hooks of the documentation build: pages that also live in the root folder get the links of the site."""

import re
from typing import Any

_ROOT_PAGES = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CODE_OF_CONDUCT.md": "code-of-conduct.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "examples/README.md": "examples.md",
}
_LINK = re.compile(r"(?<=\]\()(?:\.\./)?([^)#\s]+)")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links of the repository as links of the site; ``docs/x.md`` is ``x.md`` there."""
    if page.file.src_uri not in _ROOT_PAGES.values():
        return markdown
    return _LINK.sub(lambda link: _of_site(link[1]), markdown)


def _of_site(target: str) -> str:
    if target in _ROOT_PAGES:
        return _ROOT_PAGES[target]
    return target.removeprefix("docs/").removeprefix("resources/")
