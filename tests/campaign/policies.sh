#!/bin/sh
# Flies `station` once with each policy of looking, seed 1 and 1200 s unless given otherwise, and prints
# square metres explored per minute and coverage. The first row is how scans were taken before there
# were others: the paper's profile, the tilt at rest at each of 220 rows, at every stop. The last is what
# `usar demo` does. Three to five minutes a policy on one free core; named policies alone if any are.
# USAR_BINARY names a program to fly instead of the one built from here.
#   tests/campaign/policies.sh [SEED [SECONDS [POLICY...]]]
set -eu
cd "$(dirname "$0")/../.."
seed=${1:-1} seconds=${2:-1200}
[ $# -gt 2 ] && shift 2 && only=" $* " || only=
[ -n "${USAR_BINARY:-}" ] || cargo build --release --locked --quiet
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
# A copy: what is built meanwhile does not change the rows that are still to come.
cp "${USAR_BINARY:-target/release/usar}" "$out/usar"
fly() {
    case "${only:- $1 }" in *" $1 "*) ;; *) return 0 ;; esac
    printf '[mission]\n%b' "$2" >"$out/$1.toml"
    "$out/usar" demo --seed "$seed" --time-limit "$seconds" \
        --config "$out/$1.toml" --out "$out/$1" >"$out/$1.txt" 2>&1 ||
        { cat "$out/$1.txt" >&2; exit 1; }
    value() { sed -n "s/^ *\"$1\": \"*\([a-z0-9.]*\)\"*,*\$/\1/p" "$2/report.json" | head -n 1; }
    sweeps=$(grep -c '"profile":' "$out/$1/report.json" || true)
    nods=$(grep -c '"profile": "nod"' "$out/$1/report.json" || true)
    printf '%-10s | %9.2f | %8.3f | %6s | %6s | %5.0f | %5.0f | %s after %.0f s\n' "$1" \
        "$(value m2_per_minute "$out/$1")" "$(value coverage "$out/$1")" "$sweeps" "$nods" \
        "$(value scan "$out/$1")" "$(value distance_m "$out/$1")" "$(value outcome "$out/$1")" \
        "$(value mission_time_s "$out/$1")"
}
echo 'policy     | m2 / min  | coverage | sweeps | nods   | scan s| m     | ended'
fly paper 'looks = "full"\nfine_sweep = "paper"\nflowing_sweeps = false\nnodding = false\n'
fly full 'looks = "full"\nnodding = false\n'
fly coarse 'looks = "coarse"\nnodding = false\n'
fly fan 'looks = "fan"\nnodding = false\n'
fly at-rest 'flowing_sweeps = false\nnodding = false\n'
fly chosen 'nodding = false\n'
fly nodding 'nodding = true\n'
