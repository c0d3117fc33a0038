#!/usr/bin/env bash
# Sets everything up and runs the console on a simulated robot with the tour-guide scenario. Without a display it plays a
# scripted rehearsal on a virtual screen and leaves the session, its exports and its screenshots in demo-output/.
# Arguments are passed on to caris-desktop (with a display) or to caris-desktop rehearse (without one).
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
bash packaging/setup.sh

# shellcheck source=packaging/virtual_screen.sh
source packaging/virtual_screen.sh
if has_display; then
  exec .venv/bin/caris-desktop --demo --scenario layouts/tour-guide.yaml "$@"
fi

start_virtual_screen
output=demo-output/$(date +%Y%m%d-%H%M%S)
printf 'No display: running a rehearsal on a virtual screen of 1920x1080. Results are written to %s\n' "$output"
status=0
.venv/bin/caris-desktop rehearse layouts/tour-guide.yaml --out "$output" "$@" || status=$?
exit "$status"
