//! The table that closes a solve: verdict, cameras, people and scale of a result.

use anyhow::Context;
use serde::Deserialize;
use serde_json::Value;
use std::fmt;
use std::path::Path;

/// A written result whose verdict is `reject`: exit code 3.
#[derive(Debug, thiserror::Error)]
#[error("the result was written, but its verdict is `reject`: do not use it before the reasons above are resolved")]
pub(super) struct RejectedResult;

/// What the table shows.
#[derive(Debug)]
pub(super) struct Summary {
    report: Report,
    cameras: Vec<Camera>,
}

/// The fields of `report.json` that the table shows. Those of other versions may be missing.
#[derive(Debug, Deserialize)]
struct Report {
    quality: Quality,
    #[serde(default)]
    people: Vec<Person>,
    heldout_px: Option<f64>,
    scale: Option<Scale>,
}

#[derive(Debug, Deserialize)]
struct Quality {
    verdict: String,
    #[serde(default)]
    reasons: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Person {
    id: usize,
    first_frame: i64,
    last_frame: i64,
    n_detections: usize,
    reprojection_px: Option<Spread>,
    sigma_mm: Option<Spread>,
    joint_sigma_mm: Option<Spread>,
}

#[derive(Debug, Deserialize)]
struct Spread {
    median: f64,
}

#[derive(Debug, Deserialize)]
struct Scale {
    value: f64,
    interval95: [f64; 2],
    evidence: String,
}

#[derive(Debug, Deserialize)]
struct Cameras {
    cameras: Vec<Camera>,
}

/// A camera of `cameras.json`.
#[derive(Debug, Deserialize)]
struct Camera {
    id: String,
    status: String,
    reprojection_px: Option<Spread>,
    sigma_position_mm: Option<f64>,
    sigma_angle_deg: Option<f64>,
}

impl Summary {
    /// The summary of a result folder.
    ///
    /// # Errors
    /// A missing or damaged `report.json` or `cameras.json`.
    pub(super) fn of_folder(folder: &Path) -> anyhow::Result<Self> {
        let read = |name: &str| -> anyhow::Result<Value> {
            let path = folder.join(name);
            let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
            serde_json::from_slice(&text).with_context(|| path.display().to_string())
        };
        Self::of_documents(&read("report.json")?, &read("cameras.json")?)
    }

    /// The summary of the contents of `report.json` and `cameras.json`.
    ///
    /// # Errors
    /// A document of another form.
    pub(super) fn of_documents(report: &Value, cameras: &Value) -> anyhow::Result<Self> {
        let report = Report::deserialize(report).context("report.json")?;
        let Cameras { cameras } = Cameras::deserialize(cameras).context("cameras.json")?;
        Ok(Self { report, cameras })
    }

    /// The verdict.
    pub(super) fn verdict(&self) -> &str {
        &self.report.quality.verdict
    }

    /// # Errors
    /// [`RejectedResult`] if the verdict is `reject`.
    pub(super) fn accepted(&self) -> anyhow::Result<()> {
        if self.verdict() == "reject" { Err(RejectedResult.into()) } else { Ok(()) }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Report { quality, people, heldout_px, scale } = &self.report;
        writeln!(f, "verdict: {}", quality.verdict)?;
        for reason in &quality.reasons {
            writeln!(f, "  - {reason}")?;
        }
        writeln!(f, "{:<24}{:>12}{:>14}{:>14}", "camera", "median px", "± position mm", "± angle deg")?;
        for camera in &self.cameras {
            let id = shortened(&camera.id);
            if camera.status != "solved" {
                writeln!(f, "  {id:<22}  not solved")?;
                continue;
            }
            let px = cell(camera.reprojection_px.as_ref().map(|px| px.median), 2);
            let (mm, deg) = (cell(camera.sigma_position_mm, 1), cell(camera.sigma_angle_deg, 3));
            writeln!(f, "  {id:<22}{px:>12}{mm:>14}{deg:>14}")?;
        }
        writeln!(
            f,
            "{:<24}{:>12}{:>14}{:>14}{:>14}",
            "person", "median px", "± keypoint mm", "± joint mm", "detections"
        )?;
        for person in people {
            let frames = format!("{}, frames {} to {}", person.id, person.first_frame, person.last_frame);
            let px = cell(person.reprojection_px.as_ref().map(|px| px.median), 2);
            let [keypoint, joint] =
                [&person.sigma_mm, &person.joint_sigma_mm].map(|mm| cell(mm.as_ref().map(|mm| mm.median), 1));
            writeln!(f, "  {frames:<22}{px:>12}{keypoint:>14}{joint:>14}{:>14}", person.n_detections)?;
        }
        if let Some(px) = heldout_px {
            writeln!(f, "held-out error: {px:.2} px (cameras from half of the recording, judged on the other half)")?;
        }
        if let Some(Scale { value, interval95: [low, high], evidence }) = scale {
            // As shares of the result's lengths: the solver's own unit is arbitrary.
            let (below, above) = (100.0 * (1.0 - low / value), 100.0 * (high / value - 1.0));
            writeln!(f, "metric scale: 95 % interval -{below:.1} % to +{above:.1} %; {evidence}")?;
        }
        Ok(())
    }
}

/// A number with `decimals`, or a dash.
fn cell(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// A name of at most 22 characters, the width of its column.
fn shortened(name: &str) -> String {
    const WIDTH: usize = 22;
    if name.chars().count() <= WIDTH {
        return name.to_owned();
    }
    name.chars().take(WIDTH - 1).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn summary(verdict: &str) -> Summary {
        let report = json!({
            "quality": { "verdict": verdict, "reasons": ["short recording: 12 frames"] },
            "people": [{ "id": 0, "first_frame": 3, "last_frame": 90, "n_detections": 400,
                "reprojection_px": { "mean": 2.0, "median": 1.5 }, "sigma_mm": null, "joint_sigma_mm": { "median": 14.25, "p95": 30.0 } }],
            "heldout_px": 2.5,
            "scale": { "value": 2.0, "interval95": [1.9, 2.12], "evidence": "limb lengths of 1 person" },
        });
        let cameras = json!({ "cameras": [
            { "id": "left", "status": "solved", "reprojection_px": { "median": 1.25 }, "sigma_position_mm": 3.04 },
            { "id": "a camera with a very long name", "status": "unsolved", "reprojection_px": null },
        ] });
        Summary::of_documents(&report, &cameras).unwrap()
    }

    #[test]
    fn table_names_verdict_cameras_people_and_scale() {
        let text = summary("warn").to_string();
        for part in [
            "verdict: warn",
            "- short recording",
            "left",
            "1.25",
            "3.0",
            "a camera with a very …",
            "not solved",
            "0, frames 3 to 90",
            "14.2",
            "held-out error: 2.50 px",
            "-5.0 % to +6.0 %",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        assert!(!text.contains('\u{1b}'));
    }

    #[test]
    fn only_the_verdict_reject_is_an_error() {
        assert!(summary("pass").accepted().is_ok() && summary("warn").accepted().is_ok());
        assert!(summary("reject").accepted().unwrap_err().is::<RejectedResult>());
    }
}
