#!/bin/sh
# Runs the checks that need a GPU and writes the folder `record` beside this script: the JSON and
# the log of each program, and record.md with every figure beside its bar.
#
# Needs x86-64 Linux with glibc, a Vulkan loader (libvulkan.so.1) and a driver. QUICK=1 takes
# smaller samples, for software drivers. Each step may take STEP_LIMIT seconds (default 240).
set -u
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-$here/record}
limit=${STEP_LIMIT:-240}
mkdir -p "$out" || exit 1
rm -f "$out"/*.json "$out"/*.log "$out"/steps.tsv
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp}

if [ "${QUICK:-0}" = 1 ]; then
    lod="--poses 2 --views 2"; pom="--rays 2000"; culling="--poses 2 --drawn 1 --compared 2 --framed 0"
else
    lod="--poses 50 --views 100"; pom="--rays 2000000"; culling="--poses 60 --drawn 60 --compared 24 --framed 0"
fi

failed=0
step() { # NAME ARGUMENTS...
    name=$1; shift
    began=$(date +%s)
    timeout "$limit" "$here/bin/tombolo-lab" "$@" --json "$out/$name.json" > "$out/$name.log" 2>&1
    code=$?
    seconds=$(( $(date +%s) - began ))
    printf '%s\t%s\t%s\n' "$name" "$code" "$seconds" >> "$out/steps.tsv"
    printf '%-10s exit %-3s %4s s\n' "$name" "$code" "$seconds"
    [ "$code" = 0 ] || failed=1
}

# The arguments are lists of words.
# shellcheck disable=SC2086
{
    step digest digest
    step timings timings
    step lod lod $lod
    step pom pom $pom
    step culling culling $culling
}
timeout "$limit" "$here/bin/tombolo-view" --scene grass --shot "$out/grass.png" --size 1920x1080 \
    --frames 20 --stats "$out/grass.json" > "$out/grass.log" 2>&1 || failed=1
"$here/bin/xtask" gpu-record "$out" || failed=1
exit $failed
