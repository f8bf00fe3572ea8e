//! Choice of vector instructions at run time.

use pulp::{Simd, WithSimd};

/// Runs `work` with the widest vectors of this processor that have fused multiply-add in four lanes.
///
/// The processor decides about the last digits of a result that uses fused multiply-add, the number of threads does not. Everything that
/// `work` calls must be inlined to use the vectors.
pub fn vectorised<Work: WithSimd>(work: Work) -> Work::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return Simd::vectorize(simd, work);
    }
    pulp::Arch::new().dispatch(work)
}
