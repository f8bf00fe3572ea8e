//! Summary rows of a result, read from the published files, so that database and files agree.

use super::database::WriteTransaction;
use super::error::StoreError;
use super::sql::{ROWS_IN_ONE_STATEMENT, float, insert_rows};
use crate::session::reconstruction::{CameraReport, ErrorSummary, PersonReport, Quality, ScaleReport};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Summary of one result.
#[derive(Debug)]
pub struct Summary {
    report: ReportFile,
    cameras: Vec<CameraFile>,
    people: Vec<PersonFile>,
}

/// A published file is missing or has unexpected content.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {source}", file = .file.display())]
pub struct SummaryError {
    /// Path of the file.
    pub file: PathBuf,
    /// Error of the operating system, or of the parser.
    pub source: std::io::Error,
}

#[derive(Debug, Deserialize)]
struct ReportFile {
    stages: Vec<StageFile>,
    cameras: Vec<CameraReport>,
    people: Vec<PersonReport>,
    heldout_px: Option<f64>,
    scale: Option<ScaleReport>,
    rejected_detections: f64,
    quality: Quality,
    /// Kept as they are: a worker of a newer release writes codes that this one does not know.
    #[serde(default)]
    suspicions: Vec<serde_json::Value>,
}

#[derive(Debug, Deserialize)]
struct StageFile {
    stage: String,
    iterations: i64,
    cost_before: Option<f64>,
    cost_after: Option<f64>,
    termination: String,
    metrics: BTreeMap<String, Option<f64>>, // values that are not finite are null in the file
}

#[derive(Debug, Deserialize)]
struct CamerasFile {
    cameras: Vec<CameraFile>,
}

#[derive(Debug, Deserialize)]
struct CameraFile {
    id: String,
    status: String,
    n_observations: i64,
    reprojection_px: Option<ErrorSummary>,
    position: Option<[f64; 3]>,
    sigma_position_mm: Option<f64>,
    sigma_angle_deg: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct PeopleFile {
    people: Vec<PersonFile>,
}

#[derive(Debug, Deserialize)]
struct PersonFile {
    id: i64,
    frames: Vec<i64>,
    valid: Vec<bool>,
}

impl Summary {
    /// Reads `report.json`, `cameras.json` and `people.json` of a result folder.
    ///
    /// # Errors
    /// [`SummaryError`] with the file that is missing or has unexpected content.
    pub fn read(folder: &Path) -> Result<Self, SummaryError> {
        Ok(Self {
            report: read_json(folder.join("report.json"))?,
            cameras: read_json::<CamerasFile>(folder.join("cameras.json"))?.cameras,
            people: read_json::<PeopleFile>(folder.join("people.json"))?.people,
        })
    }

    /// Inserts the rows of a job that is about to succeed.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn insert(&self, transaction: &mut WriteTransaction, job: &str) -> Result<(), StoreError> {
        insert_verdict(transaction, job, &self.report).await?;
        insert_stages(transaction, job, &self.report.stages).await?;
        for (index, camera) in self.cameras.iter().enumerate() {
            let report = self.report.cameras.iter().find(|report| report.id == camera.id);
            insert_camera(transaction, job, index, camera, report).await?;
        }
        for person in &self.people {
            let report = self.report.people.iter().find(|report| report.id as i64 == person.id);
            insert_person(transaction, job, person, report).await?;
        }
        Ok(())
    }
}

fn read_json<T: DeserializeOwned>(file: PathBuf) -> Result<T, SummaryError> {
    // As a stream: `people.json` of an hour has hundreds of megabytes.
    let value = File::open(&file).and_then(|text| Ok(serde_json::from_reader(BufReader::new(text))?));
    value.map_err(|source| SummaryError { file, source })
}

async fn insert_verdict(transaction: &mut WriteTransaction, job: &str, report: &ReportFile) -> Result<(), StoreError> {
    let verdict = serde_json::to_value(report.quality.verdict)?;
    let scale = report.scale.as_ref();
    sqlx::query(
        "INSERT INTO verdicts (job_id, verdict, reasons, heldout_px, scale, scale_low95, scale_high95, rejected_detections,
             suspicions)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)",
    )
    .bind(job)
    .bind(verdict.as_str())
    .bind(serde_json::to_string(&report.quality.reasons)?)
    .bind(float(report.heldout_px))
    .bind(float(scale.map(|scale| scale.value)))
    .bind(float(scale.map(|scale| scale.interval95[0])))
    .bind(float(scale.map(|scale| scale.interval95[1])))
    .bind(report.rejected_detections)
    .bind(serde_json::to_string(&report.suspicions)?)
    .execute(&mut **transaction)
    .await?;
    Ok(())
}

/// The rows of all stages, and of all their metrics.
async fn insert_stages(transaction: &mut WriteTransaction, job: &str, stages: &[StageFile]) -> Result<(), StoreError> {
    let stages: Vec<(i64, &StageFile)> = (0..).zip(stages).collect();
    for stages in stages.chunks(ROWS_IN_ONE_STATEMENT) {
        let columns = ["job_id", "stage_index", "stage", "iterations", "cost_before", "cost_after", "termination"];
        let mut insert = insert_rows("stage_metrics", &columns, stages.len());
        for (index, stage) in stages {
            insert = insert.bind(job).bind(index).bind(&stage.stage).bind(stage.iterations);
            insert = insert.bind(float(stage.cost_before)).bind(float(stage.cost_after)).bind(&stage.termination);
        }
        insert.execute(&mut **transaction).await?;
    }
    let metrics = stages.iter().flat_map(|(index, stage)| stage.metrics.iter().map(move |metric| (index, metric)));
    for metrics in metrics.collect::<Vec<_>>().chunks(ROWS_IN_ONE_STATEMENT) {
        let columns = ["job_id", "stage_index", "name", "value"];
        let mut insert = insert_rows("stage_metric_values", &columns, metrics.len());
        for (index, (name, value)) in metrics {
            insert = insert.bind(job).bind(*index).bind(*name).bind(float(**value));
        }
        insert.execute(&mut **transaction).await?;
    }
    Ok(())
}

async fn insert_camera(
    transaction: &mut WriteTransaction,
    job: &str,
    index: usize,
    camera: &CameraFile,
    report: Option<&CameraReport>,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO camera_results (job_id, camera_index, camera, status, n_observations, reprojection_mean_px,
             reprojection_median_px, sigma_position_mm, sigma_angle_deg, position_x, position_y, position_z,
             n_detections, n_rejected_detections)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14)",
    )
    .bind(job)
    .bind(index as i64)
    .bind(&camera.id)
    .bind(&camera.status)
    .bind(camera.n_observations)
    .bind(float(camera.reprojection_px.map(|error| error.mean)))
    .bind(float(camera.reprojection_px.map(|error| error.median)))
    .bind(float(camera.sigma_position_mm))
    .bind(float(camera.sigma_angle_deg))
    .bind(float(camera.position.map(|[x, _, _]| x)))
    .bind(float(camera.position.map(|[_, y, _]| y)))
    .bind(float(camera.position.map(|[_, _, z]| z)))
    .bind(report.map(|report| report.n_detections as i64))
    .bind(report.map(|report| report.n_rejected_detections as i64))
    .execute(&mut **transaction)
    .await?;
    Ok(())
}

async fn insert_person(
    transaction: &mut WriteTransaction,
    job: &str,
    person: &PersonFile,
    report: Option<&PersonReport>,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO person_results (job_id, person, first_frame, last_frame, n_frames, n_valid_frames, n_detections,
             reprojection_mean_px, reprojection_median_px, bone_length_spread, jitter_m_per_s2)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11)",
    )
    .bind(job)
    .bind(person.id)
    .bind(person.frames.first())
    .bind(person.frames.last())
    .bind(person.frames.len() as i64)
    .bind(person.valid.iter().filter(|valid| **valid).count() as i64)
    .bind(report.map(|report| report.n_detections as i64))
    .bind(float(report.and_then(|report| report.reprojection_px).map(|error| error.mean)))
    .bind(float(report.and_then(|report| report.reprojection_px).map(|error| error.median)))
    .bind(float(report.and_then(|report| report.bone_length_spread)))
    .bind(float(report.and_then(|report| report.jitter_m_per_s2)))
    .execute(&mut **transaction)
    .await?;
    Ok(())
}
