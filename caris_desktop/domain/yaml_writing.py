"""YAML as people write it, so that the one reader of YAML takes it: in the order given, with few quotation marks."""

from typing import Any

import yaml

from caris_desktop.domain.yaml_source import PlainScalars, know_scalars


class _ReadableDumper(yaml.SafeDumper):
    """Indents list items under their key, as people write them, and quotes what readers of old YAML would mistake."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)


class _PlainDumper(PlainScalars, yaml.SafeDumper):
    """As few quotation marks as our own reader needs: a key of robot profiles is ``on``."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _plain_text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    """Of a text of the program too, which keeps more than that."""
    return dumper.represent_str("".join(text))


for _dumper in (_ReadableDumper, _PlainDumper):
    know_scalars(_dumper)
    _dumper.add_multi_representer(str, _plain_text)


def yaml_text(data: Any) -> str:
    """A whole file."""
    return dumped(data, default_flow_style=False, width=110)


def dumped(value: Any, *, default_flow_style: bool | None, width: int, plain: bool = False) -> str:
    """A part of a file; ``plain`` as robot profiles are written."""
    text: str = yaml.dump(
        value,
        Dumper=_PlainDumper if plain else _ReadableDumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=default_flow_style,
        width=width,
    )
    return text
