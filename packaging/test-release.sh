#!/usr/bin/env bash
# Sets this checkout up on a bare Debian 13, as somebody does who has just got it, and runs the demo, the suite, the wheel,
# the bundle and the containers.
#
#   bash packaging/test-release.sh            with the versions of packaging/lock.txt
#   bash packaging/test-release.sh --newest   with the newest version of everything, whatever pyproject.toml permits
#   bash packaging/test-release.sh -- tests/recording -k laser   the demo, and pytest with these arguments
#
# All tests run, soak tests included. Needs root, debootstrap, some 25 GB and several hours. The package sources,
# certificates and proxies are this machine's. The system stays in $CARIS_RELEASE_ROOT (/var/tmp/caris-debian-13) for the
# next run; --fresh builds it again.
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
root=${CARIS_RELEASE_ROOT:-/var/tmp/caris-debian-13}
newest=no
of_suite=()
for argument in "$@"; do
  if [[ ${suite_follows:-} == yes ]]; then
    of_suite+=("$argument")
    continue
  fi
  case $argument in
    --) suite_follows=yes ;;
    --newest) newest=yes ;;
    --fresh) if [[ ${CARIS_OWN_MOUNTS:-} != yes ]]; then rm -rf --one-file-system -- "$root"; fi ;;
    *)
      echo "test-release.sh: unknown argument '$argument' (known: --newest, --fresh)" >&2
      exit 2
      ;;
  esac
done
if ((${#of_suite[@]} == 0)); then of_suite=(--long); fi
[[ $(id -u) == 0 ]] || { echo "test-release.sh: only root can make a system of its own. Start it with sudo." >&2; exit 2; }
command -v debootstrap >/dev/null || { echo "test-release.sh: debootstrap is not installed (apt-get install debootstrap)." >&2; exit 2; }

# Everything from here on has its own mounts, which end with this process, whatever ends it.
if [[ ${CARIS_OWN_MOUNTS:-} != yes ]]; then
  CARIS_OWN_MOUNTS=yes exec unshare --mount --propagation private bash "${BASH_SOURCE[0]}" "$@"
fi

# --- the system ---------------------------------------------------------------------------------------------------------

# make_debian FOLDER: a bare Debian 13 with the package sources, certificates and pip settings of this machine.
make_debian() {
  local made=$1 mirror settings
  if [[ ! -e $made/made ]]; then
    rm -rf --one-file-system -- "$made"
    # The mirror of this machine where it is a Debian; else debootstrap has one.
    mirror=$(apt-get indextargets --format '$(REPO_URI) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' 'Origin: Debian' 2>/dev/null |
      awk '$2 !~ /security/ && $1 !~ /security/ && $3 == "main" { print $1; exit }')
    debootstrap --variant=minbase --include=ca-certificates trixie "$made" ${mirror:+"$mirror"}
    touch "$made/made"
  fi
  cp -L /etc/resolv.conf /etc/hosts "$made/etc/"
  cp -L /etc/ssl/certs/ca-certificates.crt "$made/etc/ssl/certs/"
  cp -aL /etc/apt/apt.conf.d/. "$made/etc/apt/apt.conf.d/"
  for settings in /etc/pip.conf /etc/xdg/pip; do
    if [[ -e $settings ]]; then mkdir -p "$made$(dirname "$settings")" && cp -aL "$settings" "$made$(dirname "$settings")/"; fi
  done
}
make_debian "$root"
mkdir -p "$root/containers"
make_debian "$root/containers/base"

mount --bind "$root" "$root"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount --rbind /sys "$root/sys"
# Folders of packages that pip looks into, and what tests find next to the checkout.
of_packages=()
while read -r folder; do
  mkdir -p "$root$folder" && mount --bind -o ro "$folder" "$root$folder"
  of_packages+=(--folder "$folder")
done < <(python3 -m pip config list 2>/dev/null | grep -o "/[^ ':]*" | sed 's|^//*|/|; s|/simple$||' | sort -u |
  while read -r path; do if [[ -d $path ]]; then printf '%s\n' "$path"; fi; done)
if [[ -d $repository/../shared ]]; then mkdir -p "$root/shared" && mount --bind -o ro "$repository/../shared" "$root/shared"; fi

# --- the checkout -------------------------------------------------------------------------------------------------------

checkout=/caris
mkdir -p "$root$checkout"
find "$root$checkout" -mindepth 1 -maxdepth 1 ! -name .venv -exec rm -rf -- {} +
git -C "$repository" ls-files -z --cached --others --exclude-standard |
  tar --create --directory "$repository" --null --ignore-failed-read --files-from - 2>/dev/null |
  tar --extract --no-same-owner --directory "$root$checkout"
if [[ $newest == yes ]]; then
  export CARIS_LOCKED=no
  sed -i -E '/^dependencies = \[/,/^\[project.scripts\]/s/,<[0-9.]+"/"/' "$root$checkout/pyproject.toml"
fi

# pip there gets the settings of the environment here; packages from an earlier run are updated.
mapfile -t environment < <(env | grep -iE '^(PIP_|SSL_CERT|REQUESTS_CA_BUNDLE|CARIS_TORCH|CARIS_LOCKED|(https?|no)_proxy)' || true)
inside() {
  env -i HOME=/root USER=root LANG=C.UTF-8 TERM=dumb PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    PIP_UPGRADE=1 PIP_UPGRADE_STRATEGY=eager "${environment[@]}" chroot "$root" sh -c "cd $checkout && exec \"\$@\"" sh "$@"
}

status=0
printf '\n== demo on %s\n' "$(inside sh -c '. /etc/os-release; echo "$PRETTY_NAME"')"
inside bash packaging/demo.sh || status=$?
printf '\n== suite\n'
# With a real ROS 2, for the links without rosbridge.
if inside bash packaging/ros2.sh --test /var/tmp/ros2; then
  environment+=(CARIS_ROS2_PYTHON=/var/tmp/ros2/bin/python ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST)
else
  status=1
fi
inside bash packaging/test.sh "${of_suite[@]}" || status=$?
printf '\n== wheel in an empty environment\n'
inside bash packaging/test-wheel.sh || status=$?
printf '\n== bundle\n'
inside bash packaging/bundle.sh --test || status=$?
printf '\n== containers\n'
inside .venv/bin/python packaging/containers/test.py "${of_packages[@]}" /containers/base || status=$?
printf '\n== tested with\n'
inside .venv/bin/python -c 'import platform; print("Python", platform.python_version())'
inside .venv/bin/python -m pip freeze --exclude-editable | tee "$root/tried-with.txt" |
  grep -iE '^(numpy|pyarrow|mcap|av|opencv-python-headless|PySide6_Essentials|torch|onnxruntime|websockets)=='
printf 'all of them: %s\n' "$root/tried-with.txt"
if ((status)); then printf '\nThis checkout does not run there as it should; see above.\n' >&2; fi
exit "$status"
