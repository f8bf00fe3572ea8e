//! The file of a trained prior: safetensors with its provenance as metadata.
//!
//! Tensors `pose.*` hold the linear code, `denoiser.*` or `latent.*` the network's variables. The same prior gives the same
//! bytes: names are sorted, and metadata is one JSON text.

use super::basis::{Basis, LATENT_DIM};
use super::chart::{Chart, LATENT_JOINTS, N_FEATURES};
use crate::geometry::svd::nearest_rotation;
use candle_core::{DType, Device, Tensor};
use candle_nn::VarBuilder;
use nalgebra::Matrix3;
use safetensors::{SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};

/// The networks of this program.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NetworkKind {
    /// [`Denoiser`](super::denoiser::Denoiser): completes unseen joints.
    #[default]
    Denoiser,
    /// [`Vae`](super::vae::Vae): motions as latent codes.
    Latent,
}

impl NetworkKind {
    /// The name, with which those of the variables begin.
    pub fn name(self) -> &'static str {
        match self {
            Self::Denoiser => "denoiser",
            Self::Latent => "latent",
        }
    }

    fn prefix(self) -> String {
        format!("{}.", self.name())
    }
}

/// Origin and facts of the weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The network.
    #[serde(default)]
    pub model: NetworkKind,
    /// SHA-256 over the training files.
    pub data_sha256: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// Training steps.
    pub steps: usize,
    /// Width of the network's layers.
    pub width: usize,
    /// Mean error on the held-out subjects, mm: of hidden joints by a denoiser, of all joints after encoding and decoding.
    pub held_out_error_mm: f64,
    /// Factor of the denoiser's covariances that makes 95 % ellipsoids hold 95 % of the held-out subjects' hidden joints; 1
    /// of other networks.
    pub temperature: f64,
}

/// A trained prior as it is stored.
#[derive(Debug, Clone)]
pub struct Weights {
    /// Origin of the weights.
    pub provenance: Provenance,
    /// The linear code of single poses.
    pub basis: Basis,
    /// The network's variables by name.
    pub network: BTreeMap<String, Tensor>,
}

/// Why a file cannot be read as a prior.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file is not in the safetensors format.
    #[error("not a motion prior: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    /// The metadata is missing or has other entries.
    #[error("not a motion prior: metadata entry {PROVENANCE}: {0}")]
    Provenance(String),
    /// A tensor is missing, or its shape or type is another.
    #[error("tensor {name}: {n} numbers of type {dtype} expected")]
    Tensor {
        /// Name of the tensor.
        name: &'static str,
        /// Expected count of numbers.
        n: usize,
        /// Expected type.
        dtype: &'static str,
    },
    /// The file holds another network.
    #[error("a {} expected, the file holds a {}", expected.name(), found.name())]
    Kind {
        /// The expected network.
        expected: NetworkKind,
        /// That of the file.
        found: NetworkKind,
    },
    /// The network's variables do not fit its width.
    #[error("network: {0}")]
    Network(#[from] candle_core::Error),
    /// A number is not finite.
    #[error("tensor {0}: finite numbers expected")]
    Values(String),
}

/// Metadata entry of the provenance.
const PROVENANCE: &str = "wandless_motion_prior";
const CHART: &str = "pose.mean_rotations";
const MEAN: &str = "pose.mean";
const SPREAD: &str = "pose.spread";
const CODE: &str = "pose.features_from_code";
/// Largest width that is accepted: a file cannot demand more memory than it has bytes for.
const MAX_WIDTH: usize = 2048;

impl Weights {
    /// The file.
    ///
    /// # Errors
    /// A tensor cannot be read back from its device.
    pub fn to_bytes(&self) -> Result<Vec<u8>, WeightsError> {
        let means: Vec<f64> = self.basis.chart.means.iter().flat_map(|m| m.iter().copied()).collect();
        let mut stored = BTreeMap::from([
            (CHART.to_owned(), Stored::f64(&[LATENT_JOINTS.len(), 3, 3], &means)),
            (MEAN.to_owned(), Stored::f32(&[N_FEATURES], &self.basis.mean)),
            (SPREAD.to_owned(), Stored::f32(&[N_FEATURES], &self.basis.spread)),
            (CODE.to_owned(), Stored::f32(&[LATENT_DIM, N_FEATURES], &self.basis.features_from_code)),
        ]);
        let prefix = self.provenance.model.prefix();
        for (name, tensor) in &self.network {
            let values = tensor.flatten_all()?.to_vec1::<f32>()?;
            stored.insert(format!("{prefix}{name}"), Stored::f32(tensor.dims(), &values));
        }
        let views = stored.iter().map(|(name, stored)| Ok((name, stored.view()?)));
        let views = views.collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
        let provenance =
            serde_json::to_string(&self.provenance).map_err(|e| WeightsError::Provenance(e.to_string()))?;
        Ok(safetensors::serialize(views, Some(HashMap::from([(PROVENANCE.to_owned(), provenance)])))?)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`WeightsError`] names what is wrong.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let provenance = header.metadata().as_ref().and_then(|entries| entries.get(PROVENANCE));
        let provenance = provenance.ok_or_else(|| WeightsError::Provenance("missing".to_owned()))?;
        let provenance: Provenance =
            serde_json::from_str(provenance).map_err(|error| WeightsError::Provenance(error.to_string()))?;
        let has_temperature = provenance.temperature.is_finite() && provenance.temperature > 0.0;
        if !(1..=MAX_WIDTH).contains(&provenance.width) || !has_temperature {
            return Err(WeightsError::Provenance("width or temperature is outside its range".to_owned()));
        }
        let file = SafeTensors::deserialize(bytes)?;
        let means = numbers(&file, CHART, 9 * LATENT_JOINTS.len())?;
        let rotation = |i: usize| nearest_rotation(&Matrix3::from_column_slice(&means[9 * i..9 * i + 9]));
        let features = |name| -> Result<[f32; N_FEATURES], WeightsError> {
            let values = numbers(&file, name, N_FEATURES)?;
            Ok(std::array::from_fn(|i| values[i] as f32))
        };
        let code = numbers(&file, CODE, LATENT_DIM * N_FEATURES)?;
        let basis = Basis {
            chart: Chart { means: std::array::from_fn(rotation) },
            mean: features(MEAN)?,
            spread: features(SPREAD)?,
            features_from_code: code.into_iter().map(|x| x as f32).collect(),
        };
        let all = candle_core::safetensors::load_buffer(bytes, &Device::Cpu)?;
        let prefix = provenance.model.prefix();
        let named = all.into_iter().filter_map(|(name, tensor)| Some((name.strip_prefix(&prefix)?.to_owned(), tensor)));
        let network: BTreeMap<String, Tensor> = named.collect();
        for (name, tensor) in &network {
            if !tensor.sum_all()?.to_dtype(DType::F32)?.to_scalar::<f32>()?.is_finite() {
                return Err(WeightsError::Values(format!("{prefix}{name}")));
            }
        }
        Ok(Self { provenance, basis, network })
    }

    /// The variables as `expected` reads them, on their device.
    ///
    /// # Errors
    /// The file holds another network.
    pub(super) fn variables(&self, expected: NetworkKind) -> Result<VarBuilder<'static>, WeightsError> {
        let found = self.provenance.model;
        if found != expected {
            return Err(WeightsError::Kind { expected, found });
        }
        let device = self.network.values().next().map_or(Device::Cpu, |tensor| tensor.device().clone());
        let variables = self.network.iter().map(|(name, tensor)| (name.clone(), tensor.clone())).collect();
        Ok(VarBuilder::from_tensors(variables, DType::F32, &device))
    }
}

/// Numbers of one tensor, all finite.
fn numbers(file: &SafeTensors, name: &'static str, n: usize) -> Result<Vec<f64>, WeightsError> {
    let dtype = if name == CHART { "F64" } else { "F32" };
    let wrong = || WeightsError::Tensor { name, n, dtype };
    let view = file.tensor(name).map_err(|_| wrong())?;
    let values: Vec<f64> = match view.dtype() {
        safetensors::Dtype::F64 => view.data().as_chunks().0.iter().map(|x| f64::from_le_bytes(*x)).collect(),
        safetensors::Dtype::F32 => {
            view.data().as_chunks().0.iter().map(|x| f64::from(f32::from_le_bytes(*x))).collect()
        }
        _ => return Err(wrong()),
    };
    if values.len() != n {
        return Err(wrong());
    }
    if !values.iter().all(|x| x.is_finite()) {
        return Err(WeightsError::Values(name.to_owned()));
    }
    Ok(values)
}

/// A tensor's bytes.
struct Stored {
    dtype: safetensors::Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Stored {
    fn f32(shape: &[usize], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        Self { dtype: safetensors::Dtype::F32, shape: shape.to_vec(), bytes }
    }

    fn f64(shape: &[usize], values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        Self { dtype: safetensors::Dtype::F64, shape: shape.to_vec(), bytes }
    }

    fn view(&self) -> Result<TensorView<'_>, safetensors::SafeTensorError> {
        TensorView::new(self.dtype, self.shape.clone(), &self.bytes)
    }
}
