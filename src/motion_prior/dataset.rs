//! Takes for training and evaluation: reading, resampling to 30 Hz, splitting by subject.

use super::chart::LocalRotations;
use super::interpolation::{resampled, resampled_len};
use super::joints::Bones;
use super::motion_file::{MotionProblem, read_take};
use crate::body::kinematics::mirrored_rotations;
use nalgebra::Vector3;
use sha2::{Digest, Sha256};
use std::io;
use std::path::{Path, PathBuf};

/// The rate of the latent grid, Hz.
pub const GRID_FPS: f64 = 30.0;

/// One take at [`GRID_FPS`].
#[derive(Debug, Clone, PartialEq)]
pub struct Take {
    /// Subject: name of the take's folder.
    pub subject: String,
    /// File name.
    pub name: String,
    /// Local rotations of every frame; entry 0 is `world_from_pelvis`, y up.
    pub rotations: Vec<LocalRotations>,
    /// Position of the pelvis, m.
    pub pelvis: Vec<Vector3<f64>>,
    /// Whether the left and the right foot stand.
    pub contacts: Vec<[bool; 2]>,
}

/// All takes below a folder, by path, and the digest of their files.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// Takes in the order of their paths.
    pub takes: Vec<Take>,
    /// SHA-256 over all files, lowercase hexadecimal digits.
    pub sha256: String,
}

/// Why a dataset cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A folder or file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path of the folder or file.
        path: PathBuf,
        /// Error of the file system.
        source: io::Error,
    },
    /// A file is not a motion file.
    #[error("{}: {problem}", path.display())]
    Motion {
        /// The file.
        path: PathBuf,
        /// Why it cannot be read.
        problem: MotionProblem,
    },
    /// There are no `.npz` files.
    #[error("{}: no .npz files", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
}

/// Reads every `.npz` below `folder` (or that one file).
///
/// # Errors
/// [`DatasetError`] names the first file that cannot be read.
pub fn read_dataset(folder: &Path) -> Result<Dataset, DatasetError> {
    let mut paths = Vec::new();
    gather(folder, &mut paths)?;
    paths.sort();
    if paths.is_empty() {
        return Err(DatasetError::Empty { path: folder.to_owned() });
    }
    let mut hash = Sha256::new();
    let mut takes = Vec::with_capacity(paths.len());
    for path in &paths {
        hash.update(std::fs::read(path).map_err(|source| DatasetError::Io { path: path.clone(), source })?);
        takes.push(read(path)?);
    }
    Ok(Dataset { takes, sha256: hex::encode(hash.finalize()) })
}

fn gather(path: &Path, found: &mut Vec<PathBuf>) -> Result<(), DatasetError> {
    let io = |source| DatasetError::Io { path: path.to_owned(), source };
    if !path.is_dir() {
        found.push(path.to_owned());
        return Ok(());
    }
    for entry in std::fs::read_dir(path).map_err(io)? {
        let inner = entry.map_err(io)?.path();
        if inner.is_dir() || inner.extension().is_some_and(|extension| extension == "npz") {
            gather(&inner, found)?;
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<Take, DatasetError> {
    let take = read_take(path).map_err(|problem| DatasetError::Motion { path: path.to_owned(), problem })?;
    let rotations: Vec<LocalRotations> = take.poses.iter().map(|pose| pose.rotations).collect();
    let n_samples = resampled_len(rotations.len(), take.fps, GRID_FPS);
    let rotations = resampled(&rotations, take.fps, GRID_FPS, n_samples);
    let path_at = |i: usize| {
        let at = (i as f64 * take.fps / GRID_FPS).min(take.poses.len() as f64 - 1.0);
        let [first, next] = [at.floor() as usize, at.ceil() as usize].map(|frame| take.poses[frame].pelvis);
        first.lerp(&next, at.fract())
    };
    let pelvis: Vec<Vector3<f64>> = (0..n_samples).map(path_at).collect();
    let bones = take.rest_joints.as_ref().map_or_else(Bones::of_default_body, Bones::of_rest_joints);
    let name = |part: Option<&std::ffi::OsStr>| part.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Take {
        subject: name(path.parent().and_then(Path::file_name)),
        name: name(path.file_name()),
        contacts: standing_feet(&bones, &rotations, &pelvis),
        rotations,
        pelvis,
    })
}

/// Joints of the left and of the right forefoot.
const FEET: [usize; 2] = [10, 11];
/// A foot that moves more slowly than this stands, m/s: a walking foot swings at 2 to 4 m/s, and recorded standing feet
/// tremble and slide by less than 0.2 m/s.
const STANDING_SPEED: f64 = 0.25;

/// Feet that stand: slower than [`STANDING_SPEED`] between the neighbouring frames.
fn standing_feet(bones: &Bones, rotations: &[LocalRotations], pelvis: &[Vector3<f64>]) -> Vec<[bool; 2]> {
    let feet: Vec<[Vector3<f64>; 2]> = rotations
        .iter()
        .zip(pelvis)
        .map(|(frame, pelvis)| FEET.map(|joint| frame[0] * bones.posed(frame).joints[joint] + pelvis))
        .collect();
    let stands = |t: usize, side: usize| {
        let [from, to] = [t.saturating_sub(1), (t + 1).min(feet.len() - 1)];
        (feet[to][side] - feet[from][side]).norm() * GRID_FPS <= STANDING_SPEED * (to - from) as f64
    };
    (0..feet.len()).map(|t| [stands(t, 0), stands(t, 1)]).collect()
}

/// The mirror image of a path at the plane x = 0.
pub fn mirrored_path(path: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    path.iter().map(|p| Vector3::new(-p.x, p.y, p.z)).collect()
}

/// A take with left and right exchanged.
pub fn mirrored(take: &[LocalRotations]) -> Vec<LocalRotations> {
    take.iter().map(mirrored_rotations).collect()
}

/// One of this number of subjects is held out of training.
const HELD_OUT_EVERY: usize = 9;

/// Splits takes by subject: training first, then the held out subjects, every ninth from the fifth on. With fewer than five
/// subjects every ninth take is held out, starting with the first, if there are at least two takes.
pub fn split_by_subject(takes: &[Take]) -> [Vec<&Take>; 2] {
    let mut subjects: Vec<&str> = takes.iter().map(|take| take.subject.as_str()).collect();
    subjects.sort_unstable();
    subjects.dedup();
    let held_out = |index: usize, take: &Take| {
        if subjects.len() < 5 {
            return takes.len() > 1 && index.is_multiple_of(HELD_OUT_EVERY);
        }
        subjects.binary_search(&take.subject.as_str()).is_ok_and(|i| i % HELD_OUT_EVERY == 4)
    };
    let mut sides = [Vec::new(), Vec::new()];
    for (index, take) in takes.iter().enumerate() {
        sides[usize::from(held_out(index, take))].push(take);
    }
    sides
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::N_JOINTS;
    use crate::geometry::rotation;
    use nalgebra::Vector3;

    #[test]
    fn mirroring_exchanges_the_sides_and_is_an_involution() {
        let frame: LocalRotations =
            std::array::from_fn(|j| rotation::exp(&Vector3::new(0.1 * j as f64, 0.2, -0.05 * j as f64)));
        let once = mirrored(&[frame]);
        let left_elbow = rotation::log(&once[0][18]);
        let right_elbow = rotation::log(&frame[19]);
        assert!((left_elbow - Vector3::new(right_elbow.x, -right_elbow.y, -right_elbow.z)).norm() < 1e-12);
        let twice = mirrored(&once);
        assert!((0..N_JOINTS).all(|j| (twice[0][j] - frame[j]).norm() < 1e-12));
    }

    #[test]
    fn no_subject_is_on_both_sides() {
        let take = |i: usize| Take {
            subject: format!("s{:02}", i % 20),
            name: format!("{i}"),
            rotations: Vec::new(),
            pelvis: Vec::new(),
            contacts: Vec::new(),
        };
        let takes: Vec<Take> = (0..60).map(take).collect();
        let [training, held_out] = split_by_subject(&takes);
        assert_eq!((training.len(), held_out.len()), (54, 6));
        assert!(held_out.iter().all(|h| training.iter().all(|t| t.subject != h.subject)));
    }
}
