#!/usr/bin/env bash
# Retakes the pictures of README.md and the guide: rehearses both scenarios on a virtual screen and saves one picture of
# each, one of the tour in replay, one of the scenario editor, and those of the guide's pages.
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
bash packaging/setup.sh

# shellcheck source=packaging/virtual_screen.sh
source packaging/virtual_screen.sh
start_virtual_screen
output=$(mktemp -d -t caris-screenshots.XXXXXX)
mkdir -p resources/screenshots

# keep SCENARIO THEME STEP: rehearse, and save the picture of that step as SCENARIO-THEME.png.
keep() {
  .venv/bin/caris-desktop rehearse "layouts/$1.yaml" --theme "$2" --out "$output/$1"
  cp -- "$output/$1/screenshots/"*"-$3.png" "resources/screenshots/$1-$2.png"
  printf 'resources/screenshots/%s-%s.png\n' "$1" "$2"
}

keep tour-guide dark assistant
keep mental-health-check light assistant
.venv/bin/python packaging/replay_picture.py "$output/tour-guide/study/sessions/"* resources/screenshots/replay-dark.png dark
.venv/bin/python packaging/editor_picture.py tour-guide resources/screenshots/editor-light.png light
.venv/bin/python packaging/guide_pictures.py resources/screenshots/guide light
rm -rf -- "$output"
