#!/usr/bin/env bash
# Builds wheel and source distribution with the tools of .venv, installs the wheel with pip in an empty environment and
# runs the command from it.
#
#   bash packaging/test-wheel.sh
#
# Downloads what pip does not have in its cache, up to 1 GB, and needs 3 GB of disk while it runs.
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
folder=$(mktemp -d -t caris-wheel.XXXXXX)
trap 'rm -rf -- "$folder"' EXIT

.venv/bin/python -m hatchling build -d "$folder/dist"
.venv/bin/python -m venv "$folder/environment"
# The version of torch that packaging/setup.sh takes: pip prefers a CPU build of it where one is available.
torch=$(grep -o -m 1 'torch==[0-9.]*' packaging/setup.sh)
PIP_ONLY_BINARY=:all: "$folder/environment/bin/pip" --no-input install --quiet "$folder"/dist/caris_desktop-*.whl "$torch"

# Neither this checkout nor the settings of this user may help it.
cd -- "$folder"
command=(env -u PYTHONPATH HOME="$folder/home" XDG_DATA_HOME="$folder/home" QT_QPA_PLATFORM=offscreen environment/bin/caris-desktop)
mkdir home
"${command[@]}" --help
# Without a robot, loudspeakers and models not everything is ready, so 1 is the status of a check that did its work.
status=0
"${command[@]}" check >check.txt || status=$?
cat check.txt
((status <= 1)) && grep -q "^ok   Scenario .*($folder/environment/.*/layouts/tour-guide.yaml)$" check.txt && grep -q '^ok   Disk ' check.txt ||
  { echo "test-wheel.sh: the installed command did not check the computer (exit $status)." >&2; exit 1; }
