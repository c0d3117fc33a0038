"""Scenarios and robot profiles with random mistakes: each loads, or is refused with a message that states a line.

A hundred of them, or a thousand with --long. A failure states the seed of the mistake.
"""

import os
import random
import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from caris_desktop.domain.shipped import layouts_dir, resources_dir
from caris_desktop.robot.profile import read_profile
from caris_desktop.robot.profile_model import ProfileError
from caris_desktop.scenario.scenario_file import ScenarioError, load_scenario

SHIPPED = [*sorted(layouts_dir().glob("*.yaml")), *sorted((resources_dir() / "robots").glob("*.yaml"))]
AT_MOST_COMPUTED_S = 10.0
"""CPU time of the thread: independent of load, and exceeded by exponential work."""
ODD_VALUES = (
    "!!python/object/apply:os.system ['touch CANARY']", "!!python/name:os.system", "!!python/module:os",
    "!!binary R0lGODlh", "!!set {a, b}", "!!timestamp 2001-12-14", "!!null x", "!unknown {a: 1}",
    "*nowhere", "&here [*here]", "{<<: *nowhere}", "<<", "{? [a]: b}", "- - - - 1",
    ".nan", ".inf", "-.inf", "1e999", "-0", "0x7fffffffffffffffffffffff", "0o17", "1_000", "12:30:45", "2026-11-22",
    "yes", "Null", "~", "''", '"\\x00"', '"\\ud800"', "{}", "[]", "[[]]", "{a: {b: {c: {}}}}", "|", ">-",
    "@x", "`x`", "%TAG",
    "9" * 400, "x" * 5000, "[" * 400, "{a: " * 400, "é\u202e\ufeff", "\t", "---", "...",
)  # fmt: skip
BOMB = "\n".join(["x0: &x0 [1, 2]", *(f"x{n}: &x{n} [{', '.join([f'*x{n - 1}'] * 9)}]" for n in range(1, 12))])

Mutation = Callable[[list[str], random.Random], object]


def other_value(lines: list[str], chance: random.Random) -> None:
    places = [number for number, line in enumerate(lines) if re.match(r"\s*(- )?\w+: \S", line)]
    number = chance.choice(places or [0])
    lines[number] = f"{lines[number].split(':', 1)[0]}: {chance.choice(ODD_VALUES)}"


def value_of_another_line(lines: list[str], chance: random.Random) -> None:
    first, second = (lines[chance.randrange(len(lines))] for _ in range(2))
    lines[lines.index(first)] = f"{first.split(':', 1)[0]}:{second.partition(':')[2]}"


def without_a_line(lines: list[str], chance: random.Random) -> None:
    del lines[chance.randrange(len(lines))]


def a_line_twice(lines: list[str], chance: random.Random) -> None:
    lines.insert(chance.randrange(len(lines)), chance.choice(lines))


def lines_swapped(lines: list[str], chance: random.Random) -> None:
    first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
    lines[first], lines[second] = lines[second], lines[first]


def indented_otherwise(lines: list[str], chance: random.Random) -> None:
    number = chance.randrange(len(lines))
    lines[number] = chance.choice(("", "  ", "   ", "\t")) + lines[number].lstrip()


def a_line_of_nonsense(lines: list[str], chance: random.Random) -> None:
    lines.insert(
        chance.randrange(len(lines) + 1), chance.choice((*ODD_VALUES, *(f"{value}: 1" for value in ODD_VALUES)))
    )


def a_letter_changed(lines: list[str], chance: random.Random) -> None:
    number = chance.randrange(len(lines))
    line = lines[number] or "x"
    at = chance.randrange(len(line))
    lines[number] = line[:at] + chance.choice("abXYZ019:-[]{}#&*!|>'\"%@`, \x00\x07\u2028") + line[at + 1 :]


def cut_off(lines: list[str], chance: random.Random) -> None:
    del lines[chance.randrange(1, len(lines)) :]


def a_bomb(lines: list[str], _chance: random.Random) -> None:
    lines.append(BOMB)


MUTATIONS: tuple[Mutation, ...] = (
    other_value, other_value, other_value, value_of_another_line, without_a_line, a_line_twice, lines_swapped,
    indented_otherwise, a_line_of_nonsense, a_letter_changed, a_letter_changed, cut_off, a_bomb,
)  # fmt: skip


def mutated(raw: bytes, chance: random.Random) -> bytes:
    lines = raw.decode("utf-8").splitlines()
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        if len(lines) > 2:
            chance.choice(MUTATIONS)(lines, chance)
    out = bytearray("\n".join(lines).encode("utf-8"))
    if chance.random() < 0.1:
        out[chance.randrange(len(out))] = chance.randrange(128, 256)
    return bytes(out)


def nothing_is_run(*_args: object, **_more: object) -> NoReturn:
    raise AssertionError("something in the file was executed")


def test_every_file_loads_or_is_refused_with_a_line(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "system", nothing_is_run)
    monkeypatch.setattr(subprocess, "Popen", nothing_is_run)
    loaded = refused = 0
    for seed in range(1000 if request.config.getoption("--long") else 100):
        chance = random.Random(seed)  # noqa: S311 - a test, not cryptography
        shipped = SHIPPED[seed % len(SHIPPED)]
        path = tmp_path / "mutated.yaml"
        path.write_bytes(mutated(shipped.read_bytes(), chance))
        began_s = time.thread_time()
        try:
            (load_scenario if shipped.parent == layouts_dir() else read_profile)(path)
            loaded += 1
        except (ScenarioError, ProfileError) as error:
            assert re.search(r"mutated\.yaml, line \d+: \S", str(error)), (seed, shipped.name, str(error))
            refused += 1
        except Exception as error:
            raise AssertionError(f"seed {seed} of {shipped.name}: {error!r}") from error
        assert time.thread_time() - began_s < AT_MOST_COMPUTED_S, (seed, shipped.name)
        assert [each.name for each in tmp_path.iterdir()] == ["mutated.yaml"], seed
    assert min(loaded, refused) > (loaded + refused) // 20, "both happen"
