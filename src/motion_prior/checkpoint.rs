//! The file of a trained prior.
//!
//! `WLPRIOR1`, the length of the header (u32, little endian), the header (JSON), single precision numbers (little
//! endian), and the SHA-256 of all preceding bytes. The header has the provenance, for people, and the shape, which the loader checks.

use super::basis::{Basis, LATENT_DIM};
use super::chart::{Chart, LATENT_JOINTS, N_FEATURES};
use super::shape::VaeShape;
use crate::body::skeleton::JOINT_NAMES;
use crate::geometry::svd::nearest_rotation;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

const MAGIC: &[u8; 8] = b"WLPRIOR1";
const DIGEST_LEN: usize = 32;
/// Largest width of a layer that is accepted.
const MAX_HIDDEN: usize = 4096;

/// Origin of the weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// SHA-256 over the training files.
    pub data_sha256: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// Training steps.
    pub steps: usize,
    /// Weight of the local linear term.
    pub local_linear: f64,
    /// Mean joint error over the held out subjects and all corruptions, mm.
    pub held_out_error_mm: f64,
}

/// A trained prior as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// Widths and form of the network.
    pub shape: VaeShape,
    /// Origin of the weights.
    pub provenance: Provenance,
    /// Frozen basis.
    pub basis: Basis,
    /// Trained parameters.
    pub parameters: Vec<f32>,
}

/// Why a file cannot be read as a prior.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// The file does not begin with the magic bytes.
    #[error("not a motion prior: the file must begin with WLPRIOR1")]
    Foreign,
    /// The file has the wrong length.
    #[error("a motion prior of {expected} bytes expected, found {found}")]
    Length {
        /// Length according to the header, bytes.
        expected: usize,
        /// Length of the file, bytes.
        found: usize,
    },
    /// The digest does not match the contents.
    #[error("the digest does not match the contents: the file is damaged")]
    Digest,
    /// The header cannot be read.
    #[error("header: {reason}")]
    Header {
        /// Error of the JSON parser.
        reason: String,
    },
    /// The prior describes other joints.
    #[error("a prior for {expected} joints in SMPL's order expected, found other joints")]
    Skeleton {
        /// Number of joints expected.
        expected: usize,
    },
    /// A width is out of range.
    #[error("widths of 1 to 4096 expected, found {encoder_hidden} and {decoder_hidden}")]
    Shape {
        /// Width of the encoder.
        encoder_hidden: usize,
        /// Width of the decoder.
        decoder_hidden: usize,
    },
    /// A number is not finite.
    #[error("number {index} is not finite")]
    Values {
        /// Index of the number.
        index: usize,
    },
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    joints: Vec<String>,
    shape: VaeShape,
    provenance: Provenance,
    means: Vec<[f64; 9]>,
}

fn joint_names() -> Vec<String> {
    LATENT_JOINTS.iter().map(|joint| JOINT_NAMES[*joint].to_owned()).collect()
}

/// How many numbers the basis has.
const N_BASIS: usize = 2 * N_FEATURES + 2 * N_FEATURES * LATENT_DIM + 2 * N_FEATURES;

/// The file of a checkpoint.
pub fn checkpoint_bytes(checkpoint: &Checkpoint) -> Vec<u8> {
    let basis = &checkpoint.basis;
    let row_major = |m: &Matrix3<f64>| std::array::from_fn(|k| m[(k / 3, k % 3)]);
    let header = Header {
        joints: joint_names(),
        shape: checkpoint.shape,
        provenance: checkpoint.provenance.clone(),
        means: basis.chart.means.iter().map(row_major).collect(),
    };
    let header = serde_json::to_vec(&header).expect("plain structs with string keys are always JSON");
    let mut bytes = MAGIC.to_vec();
    bytes.extend((header.len() as u32).to_le_bytes());
    bytes.extend(header);
    let numbers = basis.mean.iter().chain(&basis.spread).chain(&basis.code_from_features);
    let numbers = numbers.chain(&basis.features_from_code).chain(basis.autoregression.as_flattened());
    numbers.chain(&checkpoint.parameters).for_each(|value| bytes.extend(value.to_le_bytes()));
    let digest = Sha256::digest(&bytes);
    bytes.extend(digest);
    bytes
}

/// Reads a file.
///
/// # Errors
/// [`CheckpointError`]; nothing of a file that fails one check is used.
pub fn checkpoint_from_bytes(bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or(CheckpointError::Foreign)?;
    let short = |expected: usize| CheckpointError::Length { expected, found: bytes.len() };
    let (length, rest) = rest.split_first_chunk::<4>().ok_or(short(MAGIC.len() + 4 + DIGEST_LEN))?;
    let header_len = u32::from_le_bytes(*length) as usize;
    let least = MAGIC.len() + 4 + header_len + DIGEST_LEN;
    if bytes.len() < least {
        return Err(short(least));
    }
    let (header, rest) = rest.split_at(header_len);
    let header: Header =
        serde_json::from_slice(header).map_err(|e| CheckpointError::Header { reason: e.to_string() })?;
    let shape = header.shape;
    let in_range = |width: usize| (1..=MAX_HIDDEN).contains(&width);
    if !in_range(shape.encoder_hidden) || !in_range(shape.decoder_hidden) {
        let VaeShape { encoder_hidden, decoder_hidden, .. } = shape;
        return Err(CheckpointError::Shape { encoder_hidden, decoder_hidden });
    }
    let n_numbers = N_BASIS + shape.n_parameters();
    if rest.len() != 4 * n_numbers + DIGEST_LEN {
        return Err(short(least + 4 * n_numbers));
    }
    let (contents, digest) = bytes.split_at(bytes.len() - DIGEST_LEN);
    if Sha256::digest(contents)[..] != *digest {
        return Err(CheckpointError::Digest);
    }
    if header.joints != joint_names() || header.means.len() != LATENT_JOINTS.len() {
        return Err(CheckpointError::Skeleton { expected: LATENT_JOINTS.len() });
    }
    let numbers: Vec<f32> =
        rest[..4 * n_numbers].as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    if let Some(index) = numbers.iter().position(|value| !value.is_finite()) {
        return Err(CheckpointError::Values { index });
    }
    let mut reader = numbers.as_slice();
    let mut take = |n: usize| reader.split_off(..n).unwrap_or_default();
    let array = |values: &[f32]| std::array::from_fn(|i| values[i]);
    Ok(Checkpoint {
        shape,
        provenance: header.provenance,
        basis: Basis {
            chart: Chart {
                means: std::array::from_fn(|i| nearest_rotation(&Matrix3::from_row_slice(&header.means[i]))),
            },
            mean: array(take(N_FEATURES)),
            spread: array(take(N_FEATURES)),
            code_from_features: take(N_FEATURES * LATENT_DIM).to_vec(),
            features_from_code: take(N_FEATURES * LATENT_DIM).to_vec(),
            autoregression: {
                let pairs = take(2 * N_FEATURES);
                std::array::from_fn(|i| [pairs[2 * i], pairs[2 * i + 1]])
            },
        },
        parameters: take(shape.n_parameters()).to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::shape::VaeForm;
    use super::*;

    fn checkpoint() -> Checkpoint {
        let shape = VaeShape { encoder_hidden: 4, decoder_hidden: 3, form: VaeForm::Recurrent };
        let numbers = |n: usize| (0..n).map(|i| (i as f32).sin()).collect::<Vec<f32>>();
        Checkpoint {
            shape,
            provenance: Provenance {
                data_sha256: "00".repeat(32),
                seed: 1,
                steps: 10,
                local_linear: 0.1,
                held_out_error_mm: 9.5,
            },
            basis: Basis {
                chart: Chart { means: [Matrix3::identity(); LATENT_JOINTS.len()] },
                mean: [0.1; N_FEATURES],
                spread: [0.2; N_FEATURES],
                code_from_features: numbers(N_FEATURES * LATENT_DIM),
                features_from_code: numbers(N_FEATURES * LATENT_DIM),
                autoregression: [[1.8, -0.9]; N_FEATURES],
            },
            parameters: shape.initial_parameters(3),
        }
    }

    #[test]
    fn reads_what_it_writes() {
        let checkpoint = checkpoint();
        assert_eq!(checkpoint_from_bytes(&checkpoint_bytes(&checkpoint)), Ok(checkpoint));
    }

    #[test]
    fn rejects_foreign_short_and_damaged_files() {
        let bytes = checkpoint_bytes(&checkpoint());
        assert_eq!(checkpoint_from_bytes(b"PK\x03\x04"), Err(CheckpointError::Foreign));
        assert_eq!(checkpoint_from_bytes(&[]), Err(CheckpointError::Foreign));
        for n in [8, 11, 40, 300, bytes.len() - 1] {
            assert!(matches!(checkpoint_from_bytes(&bytes[..n]), Err(CheckpointError::Length { .. })), "{n}");
        }
        let mut flipped = bytes.clone();
        let middle = bytes.len() / 2;
        flipped[middle] ^= 1;
        assert_eq!(checkpoint_from_bytes(&flipped), Err(CheckpointError::Digest));
        let mut header = bytes;
        header[14] = b'!';
        assert!(matches!(checkpoint_from_bytes(&header), Err(CheckpointError::Header { .. })));
    }

    #[test]
    fn rejects_nan() {
        let mut checkpoint = checkpoint();
        checkpoint.parameters[5] = f32::NAN;
        let index = N_BASIS + 5;
        assert_eq!(checkpoint_from_bytes(&checkpoint_bytes(&checkpoint)), Err(CheckpointError::Values { index }));
    }
}
