#!/bin/sh
# A way of 300 m round a block of 48 like rooms, five seeds: the pose's error before and after the start
# is seen again, its NEES, pairs right and wrong. Seconds after the build.
set -eu
cd "$(dirname "$0")/../.."
cargo test --release --locked --test tests mapping::long_loop -- --ignored --nocapture
