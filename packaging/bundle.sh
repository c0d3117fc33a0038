#!/usr/bin/env bash
# Makes a folder with the console and everything it needs, Python included: build/bundle/caris-desktop.
#
#   bash packaging/bundle.sh          the folder, in some ten minutes; needs 6 GB of disk
#   bash packaging/bundle.sh --test   the folder, and a rehearsed session by its program alone
#
# It runs on Linux systems that are as new as the one that made it, or newer. packaging/bundle.spec says what goes in.
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
if [[ $# -gt 1 || ${1:---test} != --test ]]; then
  echo "bundle.sh: unknown argument '$*' (known: --test)" >&2
  exit 2
fi
# PyInstaller is among the test tools.
bash packaging/setup.sh --test
.venv/bin/python -m PyInstaller --noconfirm --log-level WARN --distpath build/bundle --workpath build/bundle-work packaging/bundle.spec
cp packaging/caris-desktop.svg packaging/caris-desktop.desktop LICENSE docs/third-party.md build/bundle/caris-desktop/
printf 'The bundle is in build/bundle/caris-desktop: %s\n' "$(du -sh build/bundle/caris-desktop | cut -f 1)"
if (($# == 0)); then exit; fi

# Neither this checkout, nor its Python, nor the settings of this user may help it.
# shellcheck source=packaging/virtual_screen.sh
source packaging/virtual_screen.sh
start_virtual_screen
folder=$(mktemp -d -t caris-bundle.XXXXXX)
trap 'rm -rf -- "$folder"; stop_virtual_screen' EXIT
mv build/bundle/caris-desktop "$folder/caris-desktop"
mkdir "$folder/home"
status=0
(
  cd -- "$folder"
  env -i HOME="$folder/home" LANG=C.UTF-8 PATH=/usr/bin:/bin DISPLAY="$DISPLAY" XAUTHORITY="${XAUTHORITY:-}" \
    caris-desktop/caris-desktop rehearse tour-guide --out rehearsal
) || status=$?
mv "$folder/caris-desktop" build/bundle/caris-desktop
exit "$status"
