#!/bin/sh
# Prints the table of scan profiles: seconds beside the bound, true tilt errors, time budget, for UT2004
# and UDK timing with and without tilt readings, sweeps alternating direction; then how far the planes of
# `station` are off in the paper's profile and in the model profile.
set -eu
cd "$(dirname "$0")/../.."
cargo test --locked --test tests acquisition::profiles::table -- --ignored --nocapture
cargo test --locked --test tests acquisition::planes::station_by_profile -- --ignored --nocapture
