"""YAML reader: scalars, refusals with line numbers, and no evaluation."""

import math
import time

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.yaml_files import YamlSourceError, know_scalars, parse_yaml
from tests.support.examples import examples


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True),
        ("False", False),
        ("yes", "yes"),
        ("off", "off"),
        ("12:30", "12:30"),
        ("2026-11-21", "2026-11-21"),
        ("<<", "<<"),
        ("=", "="),
        ("~", None),
        ("", None),
        ("-7", -7),
        ("0x1F", 31),
        ("017", 17.0),
        ("1_000", "1_000"),
        ("1e-3", 0.001),
        (".5", 0.5),
        ("!!str 5", "5"),
        ("'5'", "5"),
        ("!!float 5", 5.0),
    ],
)
def test_scalars_are_what_they_look_like(text: str, value: object) -> None:
    found = parse_yaml(f"a: {text}").data["a"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("a: 1\nb: 2\na: 3", 3, "duplicate key 'a' (first in line 1)"),
        ("a: &x 1\nb: *x", 2, "references (*name) are not allowed"),
        ("a: 1\nb: [", 2, "not valid YAML"),
        ("a: 1\n\nb: !!python/object/apply:os.system [ls]", 3, "python/object/apply:os.system is not allowed"),
        ("a: !!set {x, y}", 1, "set is not allowed"),
        ("a: !!map [x]", 1, "is not allowed"),
        ("a: !!timestamp 2026-11-21", 1, "timestamp is not allowed"),
        ("a: !!int x", 1, "'x' is not a number"),
        ("a: !!int ''", 1, "'' is not a number"),
        ("a: !!float ''", 1, "'' is not a number"),
        ("a: !!bool maybe", 1, "'maybe' is neither true nor false"),
        (f"a: {'9' * 5000}", 1, "is not a number"),
        (f"a: -{'9' * 20}", 1, "-9999999999999999999... is too large a number"),
        (f"a: 0x{'f' * 5000}", 1, "0xffffffffffffffffff... is too large a number"),
        ("a: -.inf", 1, "-.inf is not a finite number"),
        ("a: .nan", 1, ".nan is not a finite number"),
        ("a: 1\n? [b]\n: 2", 2, "a key must be plain text"),
        ("a: 1\nb: \x00", 2, "the character #x0000 is not allowed"),
        ("# nothing", 1, "the file is empty"),
        ("a: 1\n---\nb: 2", 2, "not valid YAML"),
        ("[" * 5000, 1, "nested more than 40 levels deep"),
    ],
)
def test_a_refusal_is_reported_with_its_line(text: str, line: int, words: str) -> None:
    with pytest.raises(YamlSourceError) as caught:
        parse_yaml(text)
    assert words in str(caught.value)
    assert caught.value.line == line


def test_references_that_unfold_to_billions_are_refused_at_once() -> None:
    bomb = "a: &a [x]\n" + "".join(f"{b}: &{b} [{f'*{a},' * 9}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
    begin_s = time.monotonic()
    with pytest.raises(YamlSourceError, match="references"):
        parse_yaml(bomb)
    assert time.monotonic() - begin_s < 1.0


def test_a_record_may_hold_numbers_that_are_not_finite() -> None:
    assert parse_yaml(f"a: 0x{'f' * 5000}", finite=False).data == {"a": math.inf}
    low, nan = parse_yaml("[-.inf, .nan]", finite=False).data
    assert low == -math.inf
    assert math.isnan(nan)


def test_lines_are_those_of_keys_and_items() -> None:
    found = parse_yaml("a:\n  b: 1\n  c:\n    - x\n    - y\n")
    assert found.data == {"a": {"b": 1, "c": ["x", "y"]}}
    assert [found.line_of(path) for path in (("a",), ("a", "b"), ("a", "c", 1), ("a", "c", 1, "none"))] == [1, 2, 5, 5]


@settings(max_examples=examples(200), deadline=None)
@given(st.text(max_size=80))
def test_no_text_raises_anything_else(text: str) -> None:
    for head in ("", "a: 1\n", "a: !!int "):
        try:
            parse_yaml(head + text)
        except YamlSourceError as error:
            assert error.line >= 1


class _Dumper(yaml.SafeDumper):
    pass


know_scalars(_Dumper)


@settings(max_examples=examples(200), deadline=None)
@given(st.one_of(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12), st.sampled_from(
    ["1e3", "017", "yes", "12:30", "0x1F", ".inf", "~", "null", "=", "<<", "1_000", "-.5", "+7"]
)))  # fmt: skip
def test_words_written_by_a_dumper_that_knows_the_scalars_are_read_as_words(word: str) -> None:
    assert parse_yaml(yaml.dump({"a": word}, Dumper=_Dumper, allow_unicode=True)).data == {"a": word}
