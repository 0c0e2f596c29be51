#!/bin/sh
# A thousand seeded runs of both modes of the mapper with noise drawn in all six degrees of freedom from
# the filter's own Q and R: RMS error, NEES of the last pose beside its 95 % band, associations.
# About a minute on two cores after the build.
set -eu
cd "$(dirname "$0")/../.."
cargo test --release --locked --test tests mapping::consistency -- --ignored --nocapture
