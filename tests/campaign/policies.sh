#!/bin/sh
# Flies `station` once with each policy of looking, seed 1 and 1200 s unless given otherwise, and prints
# square metres explored per minute and coverage. About three minutes a policy on one free core.
#   tests/campaign/policies.sh [SEED [SECONDS]]
set -eu
cd "$(dirname "$0")/../.."
seed=${1:-1} seconds=${2:-1200}
cargo build --release --locked --quiet
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
fly() {
    printf '[mission]\n%b' "$2" >"$out/$1.toml"
    target/release/usar demo --seed "$seed" --time-limit "$seconds" \
        --config "$out/$1.toml" --out "$out/$1" >"$out/$1.txt" 2>&1
    value() { sed -n "s/^ *\"$1\": \([0-9.]*\),*\$/\1/p" "$2/report.json" | head -n 1; }
    nods=$(grep -c '"profile": "nod"' "$out/$1/report.json" || true)
    printf '%-10s | %9.2f | %8.3f | %5s\n' "$1" "$(value m2_per_minute "$out/$1")" \
        "$(value coverage "$out/$1")" "$nods"
}
echo 'policy     | m2 / min  | coverage | nods'
fly full 'looks = "full"\nnodding = false\n'
fly coarse 'looks = "coarse"\nnodding = false\n'
fly fan 'looks = "fan"\nnodding = false\n'
fly at-rest 'flowing_sweeps = false\nnodding = false\n'
fly chosen 'nodding = false\n'
fly nodding 'nodding = true\n'
