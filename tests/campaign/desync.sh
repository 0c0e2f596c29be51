#!/bin/sh
# Draws src/guide/desync.png: errors of the planes of a continuous scan of `station` against how much
# later than the laser's lines its tilts are.
set -eu
cd "$(dirname "$0")/../.."
cargo test --locked --test tests acquisition::desync::plot -- --ignored --nocapture
