#!/bin/sh
# Prints the table of scan profiles: seconds beside the bound, true tilt errors, time budget, for UT2004
# and UDK timing with and without tilt readings, sweeps alternating direction.
set -eu
cd "$(dirname "$0")/../.."
cargo test --locked --test tests acquisition::profiles::table -- --ignored --nocapture
