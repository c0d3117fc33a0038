#!/usr/bin/env bash
# Regenerates the lock files with the newest versions that pyproject.toml permits, and runs the suite on them.
#
#   bash packaging/lock.sh             the lock files, then packaging/test.sh
#   bash packaging/lock.sh --no-test   the lock files alone, in a minute
#
# lock.txt is what the console needs, lock-test.txt what the tests and the documentation need in addition, lock-cuda.txt
# what the CUDA build of torch needs in addition. Each holds Python 3.11 to 3.13 on every system, with the SHA-256 of each
# wheel. packaging/setup.sh installs from them. Needs uv on PATH or in $UV.
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
uv=${UV:-uv}
if [[ $# -gt 1 || ${1:---no-test} != --no-test ]]; then
  echo "lock.sh: unknown argument '$*' (known: --no-test)" >&2
  exit 2
fi
command -v "$uv" >/dev/null || { echo "lock.sh: uv is not installed (pip install uv, or name it: UV=/path/to/uv)." >&2; exit 2; }
folder=$(mktemp -d -t caris-lock.XXXXXX)
trap 'rm -rf -- "$folder"' EXIT

# The version of torch is chosen in setup.sh; the build tools make the editable install.
grep -oE 'torch(vision)?==[0-9.]+' packaging/setup.sh | sort -u >"$folder/constraints"
# uv heeds no upper bound of Requires-Python: this release is for Python 3.10 and older, and pip refuses it.
echo 'backports-strenum!=1.3.1' >>"$folder/constraints"
grep -oE 'hatchling>=[0-9.]+' pyproject.toml | head -n 1 >"$folder/build"
echo 'editables' >>"$folder/build"
# compile OPTIONS...: one resolution for all Pythons and systems.
compile() {
  "$uv" pip compile --quiet --universal --python-version 3.11 --generate-hashes --only-binary :all: --upgrade \
    --no-emit-index-url --no-emit-find-links --no-annotate --no-header --constraints "$folder/constraints" "$@" pyproject.toml "$folder/build"
}
compile --all-extras --output-file "$folder/all"
compile --extra embedded --extra listening --extra openvino --extra voices --constraints "$folder/all" --output-file "$folder/run"

python3 - "$folder" <<'PYTHON'
import re
import sys
from pathlib import Path

HEAD = "# Made by packaging/lock.sh. Do not edit.\n"
CUDA = re.compile(r"(cuda-|nvidia-(?!ml-py)|triton)")


def blocks(name):
    return re.findall(r"^[A-Za-z0-9].*(?:\n    .*)*\n", Path(sys.argv[1], name).read_text(), re.MULTILINE)


def name_of(block):
    return block.partition("==")[0]


needed = {name_of(block) for block in blocks("run")}
files = {"lock.txt": [], "lock-test.txt": [], "lock-cuda.txt": []}
for block in blocks("all"):
    name = name_of(block)
    file = "lock-cuda.txt" if CUDA.match(name) else "lock.txt" if name in needed else "lock-test.txt"
    files[file].append(block)
for file, content in files.items():
    Path("packaging", file).write_text(HEAD + "".join(content))
PYTHON

if (($# == 0)); then
  bash packaging/test.sh
fi
