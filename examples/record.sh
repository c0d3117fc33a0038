#!/usr/bin/env bash
# Records the example sessions anew: bash examples/record.sh FOLDER. Needs the set-up of packaging/setup.sh and some minutes.
# Two rehearsals, one for each condition; the robot sends less often than usual, so that both take 3 MB at most.
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
out=$(realpath -m -- "${1:?usage: bash examples/record.sh FOLDER}")
cd -- "$repository"
# shellcheck source=packaging/virtual_screen.sh
source packaging/virtual_screen.sh
start_virtual_screen

# A profile of the user goes before the shipped one of the same name.
export HOME=$out/home XDG_CONFIG_HOME=$out/home/.config XDG_RUNTIME_DIR=
mkdir -p -- "$XDG_CONFIG_HOME/caris-desktop/robots"
sed -e '/^scan:/s/50/1000/' -e '/^odometry:/s/50/200/' -e '/^map:/s/500/10000/' -e '/^map_updates:/d' \
  -e 's/throttle_ms: 33$/throttle_ms: 400/' resources/robots/simulated.yaml >"$XDG_CONFIG_HOME/caris-desktop/robots/simulated.yaml"

# A profile of the user's own has to be confirmed; that it cannot be reached yet does not matter.
.venv/bin/python -m caris_desktop robots --listen simulated --seconds 1 --accept-named >"$out/confirmed.log" 2>&1 || true

rehearse() {
  .venv/bin/python -m caris_desktop rehearse examples/lab-visit.yaml --out "$out/$1" --participant "$1" --condition "$2" \
    --seed "$3" --size 1366x768 --accept-named
}
rehearse P01 A 7
rehearse P02 B 11

# One study of both sessions, without the name of this machine's kernel.
mkdir -p -- "$out/study/sessions"
cp -r -- "$out"/P01/study/sessions/* "$out"/P02/study/sessions/* "$out/study/sessions/"
.venv/bin/python - "$out/study/sessions" <<'SCRUB'
import hashlib, platform, re, sys
from pathlib import Path

for header in Path(sys.argv[1]).glob("*/session.json"):
    text = header.read_text("utf-8").replace(platform.platform(), "Linux")
    header.write_text(text, "utf-8")
    manifest = header.with_name("manifest-sha256.txt")
    digest = hashlib.sha256(text.encode()).hexdigest()
    manifest.write_text(re.sub(r"^\w+(?=  session\.json$)", digest, manifest.read_text("utf-8"), flags=re.MULTILINE), "utf-8")
SCRUB
chmod -R go+rX -- "$out/study"
