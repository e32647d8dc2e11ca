#!/usr/bin/env bash
# Everything that is to be known of a GPU: finds its OpenCL driver, checks that the kernels compute
# what they must on it, times the workloads, and leaves one JSON file in bench/results/.
#
#   bench/gpu.sh [--device WHICH] [--output FOLDER] [--find] [--no-tests] [-- BENCH-OPTIONS]
#
#   --device WHICH   an id of `tledface doctor`, or part of a device's or platform's name; without
#                    it the first GPU that works
#   --output FOLDER  instead of bench/results
#   --find           look for the driver and the device, and stop
#   --no-tests       time it only
#   BENCH-OPTIONS    of `tledface bench`, instead of --all --sizes
#
# TLEDFACE_PYTHON names a Python that has tledface; without it the environment .venv here is used,
# and made where there is none. Ends with 1 where there is no such device or a test fails.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

which="" output=bench/results find_only=0 tests=1 options=(--all --sizes)
while (($#)); do
  case $1 in
    --device | --output)
      (($# > 1)) || { echo "gpu.sh: $1: a value is missing" >&2; exit 2; }
      if [[ $1 == --device ]]; then which=$2; else output=$2; fi
      shift 2 ;;
    --find) find_only=1; shift ;;
    --no-tests) tests=0; shift ;;
    --) shift; options=("$@"); break ;;
    *) echo "gpu.sh: got '$1'; allowed: --device WHICH, --output FOLDER, --find, --no-tests, --" >&2
       exit 2 ;;
  esac
done
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
found=$scratch/found

# The lines given, in one; or "none".
in_one_line() {
  local text
  text=$(tr '\n' ' ' | sed 's/ *$//')
  echo "${text:-none}"
}

# -- the card and its driver, as the system has them ---------------------------------------------
folders=(/usr/lib/x86_64-linux-gnu /usr/lib/aarch64-linux-gnu /usr/lib64 /usr/lib
  /usr/local/nvidia/lib64 /usr/local/nvidia/lib /usr/local/cuda/lib64 /usr/lib/wsl/lib
  /run/opengl-driver/lib)

# Paths of a library: by the linker's cache, then in the usual folders.
library() {
  {
    ldconfig -p 2> /dev/null | sed -n "s|.*$1.* => ||p" || true
    for folder in "${folders[@]}"; do compgen -G "$folder/$1*" || true; done
  } | sort -u
}

vendors=${OCL_ICD_VENDORS:-/etc/OpenCL/vendors}
nvidia=$(library libnvidia-opencl.so.1 | head -n 1)
registered=$(if [[ -d $vendors ]]; then cat "$vendors"/*.icd 2> /dev/null || true; else echo "$vendors"; fi)
{
  echo "card: $(compgen -G '/dev/nvidia[0-9]*' | in_one_line) (/dev/nvidiaN)," \
    "$(compgen -G '/dev/dri/renderD*' | in_one_line) (/dev/dri/renderD*)," \
    "$(compgen -G '/dev/kfd' | in_one_line) (/dev/kfd)"
  echo "NVIDIA's kernel driver: $(cat /proc/driver/nvidia/version 2> /dev/null | head -n 1 | in_one_line)" \
    "(/proc/driver/nvidia/version)"
  echo "NVIDIA's OpenCL driver: $(library libnvidia-opencl.so.1 | in_one_line)" \
    "(libnvidia-opencl.so.1 in the linker's cache and ${folders[*]})"
  echo "OpenCL library: $(library libOpenCL.so.1 | in_one_line) (libOpenCL.so.1 in the same places)"
  echo "registered drivers: $(in_one_line <<< "$registered") ($vendors${OCL_ICD_VENDORS:+, from OCL_ICD_VENDORS})"
} > "$found"
# In containers the driver is often there and not registered: the library then needs to be told.
if [[ -n $nvidia && $registered != *nvidia* && -z ${OCL_ICD_VENDORS:-} ]]; then
  mkdir "$scratch/vendors"
  cp /etc/OpenCL/vendors/*.icd "$scratch/vendors/" 2> /dev/null || true
  echo "$nvidia" > "$scratch/vendors/nvidia.icd"
  export OCL_ICD_VENDORS=$scratch/vendors/
  echo "set: OCL_ICD_VENDORS, to a folder that registers $nvidia beside the others" >> "$found"
fi
sed 's/^/gpu.sh: /' "$found"

# -- a Python that has tledface ------------------------------------------------------------------
python=${TLEDFACE_PYTHON:-.venv/bin/python}
if [[ -z ${TLEDFACE_PYTHON:-} ]] && ! "$python" -c 'import tledface' 2> /dev/null; then
  echo "gpu.sh: making .venv with tledface and what its tests need"
  [[ -e .venv ]] || python3 -m venv .venv
  "$python" -m pip install -q '.[test]'
fi
"$python" -c 'import tledface' || { echo "gpu.sh: $python cannot import tledface" >&2; exit 1; }

# -- the device ----------------------------------------------------------------------------------
"$python" - "$which" "$scratch/device.json" "$scratch/devices" << 'END'
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tledface import _core
from tledface.device import devices

wanted, listed = sys.argv[1].lower(), [d for d in devices() if d.kind != "native"]


def suits(device):
    if not wanted:
        return device.kind == "gpu"
    return wanted == device.id or wanted in f"{device.name} {device.platform}".lower()


lines = [f"OpenCL library that tledface uses: {_core.opencl_loader_report()}"]
for d in listed:
    state = "works" if d.works else f"does not work: {d.reason}"
    lines.append(f"{d.id}: {d.name} ({d.kind}; {d.platform}, driver {d.driver}): {state}")
if not listed:
    lines.append("OpenCL devices: none")
taken = next((asdict(d) for d in listed if d.works and suits(d)), None)
Path(sys.argv[2]).write_text(json.dumps(taken))
Path(sys.argv[3]).write_text("\n".join(lines) + "\n")
END
cat "$scratch/devices" >> "$found"
sed 's/^/gpu.sh: /' "$scratch/devices"
if [[ $(cat "$scratch/device.json") == null ]]; then
  echo "gpu.sh: no ${which:-working GPU} among the OpenCL devices: nothing was measured. The lines" \
    "above are what was looked for and found; docs/how-to/devices.md says how OpenCL is had." >&2
  exit 1
fi
id=$("$python" -c 'import json, sys; print(json.load(sys.stdin)["id"])' < "$scratch/device.json")
name=$("$python" -c 'import json, sys; print(json.load(sys.stdin)["name"])' < "$scratch/device.json")
echo "gpu.sh: taken: $id, $name"
((find_only)) && exit 0

# -- what its kernels compute --------------------------------------------------------------------
passed=()
if ((tests)); then
  echo "gpu.sh: tests on every executor, then physics against theory on this one"
  export TLEDFACE_REQUIRE_OPENCL=1
  # Kernels are compiled for each test: side by side where pytest-xdist is there.
  side_by_side=()
  if "$python" -c 'import xdist' 2> /dev/null; then side_by_side=(-n auto -p no:benchmark); fi
  for suite in "tests/device" "tests/verification -k $id"; do
    # shellcheck disable=SC2086
    if ! "$python" -m pytest -q -p no:cacheprovider "${side_by_side[@]}" $suite | tee "$scratch/tests"; then
      echo "gpu.sh: the tests above failed on $name; nothing was timed" >&2
      exit 1
    fi
    passed+=("$suite: $(tail -n 1 "$scratch/tests")")
  done
fi

# -- how fast ------------------------------------------------------------------------------------
echo "gpu.sh: tledface bench ${options[*]} --device $id"
# Kernels are chosen first, by timing them where no one did before: not while others are timed.
"$python" -c '
import sys
from tledface.autotune import tune, tune_recording
from tledface.cli import main
from tledface.device import resolve

device = resolve(sys.argv[sys.argv.index("--device") + 1])
for hourglass in ("physical", "joldes"):
    tune(device, precision="single", hourglass=hourglass)
tune_recording(device)
main()
' bench "${options[@]}" --device "$id" --json > "$scratch/bench.json"
slug=$(tr '[:upper:]' '[:lower:]' <<< "$name" | sed 's/[^a-z0-9]\+/-/g; s/^-//; s/-$//')
mkdir -p "$output"
file=$output/$slug-$(date -u +%F).json
"$python" - "$file" "$scratch" "$(IFS=";"; echo "${passed[*]}")" "$(git rev-parse HEAD 2> /dev/null || echo unknown)" << 'END'
import json
import sys
from pathlib import Path

from tledface import __version__, autotune

file, scratch, tests, commit = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], sys.argv[4]
device = json.loads((scratch / "device.json").read_text())
try:
    choices = json.loads(autotune.cache_file().read_text())
except (OSError, ValueError):
    choices = {}
bench = json.loads((scratch / "bench.json").read_text())
replayed = any(row.get("command_buffers", False) for row in bench.get("rows", [bench]))
result = {
    "tledface": __version__,
    "commit": commit,
    "device": device,
    "found": (scratch / "found").read_text().splitlines(),
    "tests": tests,
    "kernels": {key: value for key, value in choices.items() if key.startswith(device["name"])},
    "command_buffers": {"work": device["command_buffers"], "replayed": replayed},
    "bench": bench,
}
part = file.with_suffix(".part")
part.write_text(json.dumps(result, indent=1) + "\n")
part.replace(file)
yes = {True: "yes", False: "no"}
print(f"gpu.sh: command buffers work: {yes[device['command_buffers']]}, replayed: {yes[replayed]}")
END
echo "gpu.sh: wrote $file"
