//! DMMR's `camparams.txt`: one block per camera with its number, three rows of K, `0 0`, and three rows of `[R t]`.
//!
//! The file contains neither distortion nor image sizes.

use super::values::{finite, invalid, rows_of, split_pose};
use crate::session::upload::error::UploadError;
use crate::session::upload::raw::RawCamera;

/// Numbers of a block after its first line: K, the two zeros, `[R t]`.
const BLOCK: usize = 9 + 2 + 12;

/// Whether the first lines are a number and three rows of three.
pub(super) fn recognise(head: &str) -> bool {
    let lines = head.lines().filter(|line| !line.trim().is_empty()).take(5);
    let counts: Vec<Option<usize>> = lines
        .map(|line| {
            let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
            numbers.ok().map(|numbers| numbers.len())
        })
        .collect();
    counts == [Some(1), Some(3), Some(3), Some(3), Some(2)]
}

/// All cameras, named by their numbers.
pub(super) fn read(text: &str) -> Result<Vec<RawCamera>, UploadError> {
    let words: Vec<&str> = text.split_whitespace().collect();
    if !words.len().is_multiple_of(BLOCK + 1) {
        return Err(invalid(format!("the file has {} numbers, expected {} per camera", words.len(), BLOCK + 1)));
    }
    words.chunks(BLOCK + 1).map(camera).collect()
}

fn camera(block: &[&str]) -> Result<RawCamera, UploadError> {
    let numbers: Option<Vec<f64>> = block[1..].iter().copied().map(finite).collect();
    let numbers = numbers.ok_or_else(|| invalid(format!("camera {:?} contains an invalid number", block[0])))?;
    let (rotation, translation) = split_pose(&numbers[11..]);
    Ok(RawCamera {
        id: block[0].to_owned(),
        matrix: rows_of(&numbers[..9]),
        rotation,
        translation: Some(translation),
        ..RawCamera::default()
    })
}
