//! Arrays of many megabytes in large pages.
//!
//! An array that is written from end to end costs a page fault for every page that it touches, and with pages of 4 kB its addresses
//! do not fit into the processor's table of them. Linux gives pages of 2 MB where it is asked to (madvise, `MADV_HUGEPAGE`).

use memmap2::{MmapMut, MmapOptions};
use std::ops::{Deref, DerefMut, Range};

/// Numbers, zero at first. Their number may change within what was asked for at first.
#[derive(Default)]
pub struct LargeArray {
    memory: Memory,
    len: usize,
}

enum Memory {
    Heap(Vec<f64>),
    /// The bytes `used` of `mapped`, which begin and end with a large page.
    Pages {
        mapped: MmapMut,
        used: Range<usize>,
    },
}

/// Of a large page. Smaller arrays come from the heap.
const PAGE_BYTES: usize = 2 << 20;

impl LargeArray {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let memory = pages(len * size_of::<f64>()).unwrap_or_else(|| Memory::Heap(vec![0.0; len]));
        Self { memory, len }
    }

    /// The largest [`len`](Self::set_len).
    pub fn capacity(&self) -> usize {
        self.memory.numbers().len()
    }

    /// Uses the first `len` numbers, as they were left.
    ///
    /// # Panics
    /// Beyond the [`capacity`](Self::capacity).
    pub fn set_len(&mut self, len: usize) {
        assert!(len <= self.capacity(), "{len} numbers in an array of {}", self.capacity());
        self.len = len;
    }
}

/// Zeroed pages, large ones where the system has any; `None` for few bytes, and where it has none to give.
fn pages(n_bytes: usize) -> Option<Memory> {
    if n_bytes < PAGE_BYTES {
        return None;
    }
    let n_used = n_bytes.next_multiple_of(PAGE_BYTES);
    let mapped = MmapOptions::new().len(n_used + PAGE_BYTES).map_anon().ok()?;
    #[cfg(target_os = "linux")]
    let _ = mapped.advise(memmap2::Advice::HugePage); // refused where the kernel has no large pages: small ones serve as well
    let first = mapped.as_ptr().align_offset(PAGE_BYTES).min(PAGE_BYTES);
    Some(Memory::Pages { mapped, used: first..first + n_used })
}

impl Memory {
    fn numbers(&self) -> &[f64] {
        match self {
            Self::Heap(numbers) => numbers,
            Self::Pages { mapped, used } => bytemuck::cast_slice(&mapped[used.clone()]),
        }
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::Heap(Vec::new())
    }
}

impl Deref for LargeArray {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.memory.numbers()[..self.len]
    }
}

impl DerefMut for LargeArray {
    fn deref_mut(&mut self) -> &mut [f64] {
        let numbers = match &mut self.memory {
            Memory::Heap(numbers) => numbers,
            Memory::Pages { mapped, used } => bytemuck::cast_slice_mut(&mut mapped[used.clone()]),
        };
        &mut numbers[..self.len]
    }
}

impl Clone for LargeArray {
    fn clone(&self) -> Self {
        let mut copy = Self::zeros(self.len);
        copy.copy_from_slice(self);
        copy
    }
}

impl std::fmt::Debug for LargeArray {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_either_memory_are_zero_and_keep_what_they_hold() {
        for len in [0, 5, PAGE_BYTES / 8 + 3] {
            let mut array = LargeArray::zeros(len);
            assert!(array.len() == len && array.capacity() >= len && array.iter().all(|value| *value == 0.0));
            array.iter_mut().enumerate().for_each(|(i, value)| *value = i as f64);
            let copy = array.clone();
            array.set_len(len / 2);
            assert_eq!(array[..], copy[..len / 2]);
            array.set_len(len);
            assert_eq!(array[..], copy[..]);
        }
    }
}
