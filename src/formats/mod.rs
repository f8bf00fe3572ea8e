//! NumPy's array files: `.npy` arrays with size-guarded reading, and `.npz` archives of them with reproducible bytes.

pub mod npy;
pub mod npz;
