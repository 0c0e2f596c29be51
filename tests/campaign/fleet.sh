#!/bin/sh
# Eight robots in the station for MINUTES of level time (default 30), memory printed each minute:
# tests/campaign/fleet.sh [MINUTES]
set -eu
cd "$(dirname "$0")/../.."
USAR_FLEET_MINUTES=${1:-30} cargo test --release --test fleet -- --nocapture
