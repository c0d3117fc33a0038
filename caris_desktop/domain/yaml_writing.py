"""YAML writer for people: keys in the given order, few quotation marks."""

from typing import Any

import yaml

from caris_desktop.domain.yaml_source import PlainScalars, know_scalars


class _ReadableDumper(yaml.SafeDumper):
    """Dumper that indents list items under their key, as people do, and quotes what YAML 1.1 readers would misread."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)


class _PlainDumper(PlainScalars, yaml.SafeDumper):
    """Dumper with as few quotation marks as our own reader needs: a key of robot profiles is ``on``."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _plain_text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    """Plain text, also of a translatable text."""
    return dumper.represent_str("".join(text))


for _dumper in (_ReadableDumper, _PlainDumper):
    know_scalars(_dumper)
    _dumper.add_multi_representer(str, _plain_text)


def yaml_text(data: Any) -> str:
    """Text of a whole file."""
    return dumped(data, default_flow_style=False, width=110)


def dumped(value: Any, *, default_flow_style: bool | None, width: int, plain: bool = False) -> str:
    """Text of a part of a file; ``plain`` as robot profiles are written."""
    text: str = yaml.dump(
        value,
        Dumper=_PlainDumper if plain else _ReadableDumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=default_flow_style,
        width=width,
    )
    return text
