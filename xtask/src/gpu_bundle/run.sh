#!/bin/sh
# Runs the checks that need a GPU and writes the folder `record` beside this script: the JSON and
# the log of each program, and gpu.md with every figure beside its bar.
#
# Needs x86-64 Linux with glibc 2.34 or newer, a Vulkan loader (libvulkan.so.1) and a driver, and no
# network. QUICK=1 takes smaller samples, for software drivers: rows that need the full samples then
# have no figure and miss. All steps end within TIME_LIMIT seconds (default 1200), each within
# STEP_LIMIT (default 600). ONLY=NAME runs one of lod, pom, culling and visual and writes its record
# in place of gpu.md. Most of the work of the last two is the CPU's: eight cores or more.
set -u
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-$here/record}
step_limit=${STEP_LIMIT:-600}
end=$(( $(date +%s) + ${TIME_LIMIT:-1200} ))
mkdir -p "$out" || exit 1
rm -f "$out"/*.json "$out"/*.log "$out"/*.png "$out"/steps.tsv "$out"/gpu.md
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp}

if [ "${QUICK:-0}" = 1 ]; then
    lod="--poses 2 --views 2"; pom="--rays 2000"
    culling="--poses 2 --drawn 1 --compared 2 --framed 1 --rounds 1"; visual="--poses 4"; frames=20
    samples="Quick: smaller samples. Rows that need the full ones have no figure and miss."
else
    # As `cargo xtask measure` takes them.
    lod="--poses 50 --views 200"; pom="--rays 2000000"; culling="--poses 300"
    visual=""; frames=300
    samples="Full samples."
fi
echo "$samples" > "$out/samples.txt"

failed=0
step() { # NAME PROGRAM ARGUMENTS...
    name=$1; program=$2; shift 2
    [ "${ONLY:-$name}" = "$name" ] || return 0
    began=$(date +%s)
    limit=$(( end - began < step_limit ? end - began : step_limit ))
    # A limit of 0 would be none.
    [ "$limit" -gt 0 ] || limit=1
    timeout "$limit" "$here/bin/$program" "$@" > "$out/$name.log" 2>&1
    code=$?
    seconds=$(( $(date +%s) - began ))
    printf '%s\t%s\t%s\n' "$name" "$code" "$seconds" >> "$out/steps.tsv"
    printf '%-10s exit %-3s %4s s\n' "$name" "$code" "$seconds"
    [ "$code" = 0 ] && return
    failed=1
    # The reason is the last line; a step at its limit has none.
    [ "$code" = 124 ] || tail -n 1 "$out/$name.log"
}
lab() { # NAME ARGUMENTS...
    name=$1
    step "$name" tombolo-lab "$@" --json "$out/$name.json"
}
view() { # NAME ARGUMENTS...
    name=$1; shift
    step "$name" tombolo-view "$@" --shot "$out/$name.png" --size 1920x1080 --frames $frames \
        --stats "$out/$name.json"
}

# The arguments are lists of words.
# shellcheck disable=SC2086
{
    lab digest
    lab timings
    view grass --scene grass
    "$here/bin/tombolo-server" --listen 127.0.0.1:7589 > "$out/server.log" 2>&1 &
    server=$!
    for quality in low medium high; do
        view "island_$quality" --connect ws://127.0.0.1:7589/v1/stream --quality $quality
    done
    kill $server
    lab pom $pom
    lab lod $lod
    lab culling $culling
    # Last: one thread of the processor builds its worlds, which takes seven minutes.
    lab visual $visual
}
# The folder that it was built in does not exist here.
CARGO_MANIFEST_DIR="$here/xtask" "$here/bin/xtask" gpu-record "$out" ${ONLY:+--only "$ONLY"} || failed=1
exit $failed
