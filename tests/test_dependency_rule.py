"""Dependency rules between packages, as contracts in pyproject.toml."""

from importlinter.cli import lint_imports


def test_every_room_keeps_to_the_dependency_rule() -> None:
    assert lint_imports(no_cache=True) == 0, "run lint-imports to see which import breaks which contract"
