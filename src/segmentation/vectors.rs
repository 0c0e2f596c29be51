//! Work on vectors of the processor's own width.

use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Does work with vectors of the processor's own width, four numbers wide at least: what any processor does
/// well.
pub(super) fn run<W: WithSimd>(work: W) -> W::Output {
    match Arch::new() {
        Arch::Scalar => Scalar128b.vectorize(work),
        arch => arch.dispatch(work),
    }
}
