#!/bin/sh
# Reading a laser line beside the program of the reference folder, in turn, so that both see the same
# machine: tests/campaign/parse.sh [ROUNDS]
set -eu
cd "$(dirname "$0")/../.."
peer=${USAR_REFERENCE_BENCH:-../shared/bench/rust}
build=$(mktemp -d)
trap 'rm -rf "$build"' EXIT
CARGO_TARGET_DIR=$build cargo build --quiet --release --bin parse --manifest-path "$peer/Cargo.toml"
round=0
while [ "$round" -lt "${1:-5}" ]; do
    # A filter that no benchmark has: the interleaved comparison alone.
    cargo bench --quiet --bench parse -- none | grep -E 'MB/s|numbers|allocations'
    "$build/release/parse" | grep -E '^(nom|hand|str split)'
    round=$((round + 1))
done
