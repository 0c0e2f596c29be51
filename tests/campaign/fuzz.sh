#!/bin/sh
# Fuzzes the parser for SECONDS each (default 600): tests/campaign/fuzz.sh [SECONDS]
# Needs the nightly compiler and cargo-fuzz. New inputs go to a temporary folder; what fails stays in
# tests/fuzz/artifacts, and belongs, shrunk, into tests/fuzz/corpus with the fix.
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-600}
found=$(mktemp -d)
for target in parse_line parse_stream; do
    mkdir -p "$found/$target"
    cargo +nightly fuzz run --fuzz-dir tests/fuzz "$target" "$found/$target" "tests/fuzz/corpus/$target" -- \
        -max_total_time="$seconds" -max_len=3000 -print_final_stats=1
done
