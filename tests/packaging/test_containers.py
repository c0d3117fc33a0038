"""Containers: what the compose files and the Containerfile promise. packaging/containers/test.py runs them."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

CONTAINERS = Path(__file__).resolve().parents[2] / "packaging" / "containers"
TARGETS = {"perceive", "camera-server", "simulator", "worker", "models"}


def content(name: str) -> dict[str, Any]:
    return dict(yaml.safe_load((CONTAINERS / name).read_text("utf-8")))


SERVICES = content("compose.yaml")["services"]


@pytest.mark.parametrize("name", ["compose.yaml", "compose.gpu.yaml"])
def test_a_compose_file_keeps_the_schema(name: str) -> None:
    package = importlib.util.find_spec("check_jsonschema")  # not imported: its dependencies are not installed
    if package is None or package.origin is None:
        pytest.skip("check-jsonschema is not installed: packaging/test-tools.txt")
    file = Path(package.origin).parent / "builtin_schemas" / "vendor" / "compose-spec.json"
    jsonschema.validate(content(name), json.loads(file.read_text("utf-8")))


def test_the_containerfile_has_no_finding() -> None:
    hadolint = shutil.which("hadolint", path=str(Path(sys.executable).parent))
    if hadolint is None:
        pytest.skip("hadolint is not installed: packaging/test-tools.txt")
    result = subprocess.run([hadolint, CONTAINERS / "Containerfile"], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (0, "")


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_can_do_no_more_than_it_needs(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["user"].endswith(":-1000:1000}")
    assert service["healthcheck"]["test"][0] == "CMD"
    assert not {"privileged", "network_mode", "pid", "ipc", "environment"} & service.keys()
    for port in service.get("ports", ()):
        assert re.match(r"(\$\{CARIS_BIND:-127\.0\.0\.1\}|127\.0\.0\.1):", port)
    assert name == "simulator" or {"cert", "key"} <= set(service["secrets"])


def test_each_target_has_a_service_and_a_pinned_base() -> None:
    text = (CONTAINERS / "Containerfile").read_text("utf-8")
    assert set(re.findall(r"^FROM base AS (\S+)$", text, re.MULTILINE)) == TARGETS
    assert {service["build"]["target"] for service in SERVICES.values() if "build" in service} == TARGETS
    assert re.search(r"^FROM \S+:trixie-\d{8}-slim@sha256:[0-9a-f]{64} AS base$", text, re.MULTILINE)
    assert len(re.findall(r"^USER 10001:10001$", text, re.MULTILINE)) == len(TARGETS)
    assert content("compose.gpu.yaml")["services"].keys() <= SERVICES.keys()


def test_each_package_of_an_image_is_locked() -> None:
    script = (CONTAINERS / "install.sh").read_text("utf-8")
    lists = re.findall(r"^\s*\w+\+?=\(([^)$]*)\)", script, re.MULTILINE) + re.findall(r"names\+=\(([^)]*)\)", script)
    names = {word for words in lists for word in words.split() if not word.startswith(('"', "lib", "python3"))}
    locked = "".join(
        (CONTAINERS.parent / name).read_text("utf-8") for name in ("lock.txt", "lock-test.txt", "models.txt")
    )
    assert len(names) > 80
    assert names - set(re.findall(r"^([\w-]+)==", locked, re.MULTILINE)) == set()
