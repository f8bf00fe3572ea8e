//! Stand-in in this worktree only.
#![allow(missing_docs)]

use crate::session::reconstruction::ExportFormat;
use crate::session::{Reconstruction, Session};
use serde_json::json;
use sha2::Digest;
use std::io;
use std::path::Path;

pub struct ResultContext<'a> {
    pub input_sha256: &'a str,
    pub options: serde_json::Value,
    pub solver_version: &'a str,
    pub exports: &'a [ExportFormat],
}

pub fn supported(format: ExportFormat) -> bool {
    format == ExportFormat::SmplNpz
}

pub fn write_result(
    dir: &Path,
    session: &Session,
    context: &ResultContext<'_>,
    reconstruction: &Reconstruction,
) -> io::Result<()> {
    let cameras: Vec<_> = session
        .views
        .iter()
        .zip(&reconstruction.cameras)
        .map(|(view, camera)| {
            let position = camera.camera_from_world.map(|c| c.center().as_slice().to_vec());
            json!({"id": view.id, "status": if position.is_some() {"solved"} else {"unsolved"},
                "position": position, "n_observations": camera.n_observations, "reprojection_px": camera.reprojection_px})
        })
        .collect();
    let files = [
        ("cameras.json", json!({"units": "m", "cameras": cameras})),
        ("people.json", json!({"units": "m", "people": []})),
        ("report.json", serde_json::to_value(&reconstruction.report)?),
        ("smpl/about.json", json!({"people": 0})),
    ];
    std::fs::create_dir_all(dir.join("smpl"))?;
    let mut listed = Vec::new();
    for (name, value) in files {
        let text = value.to_string();
        let sha256: String = sha2::Sha256::digest(text.as_bytes()).iter().map(|b| format!("{b:02x}")).collect();
        listed.push(json!({"name": name, "bytes": text.len(), "sha256": sha256, "media_type": "application/json"}));
        std::fs::write(dir.join(name), text)?;
    }
    let manifest = json!({"files": listed, "input_sha256": context.input_sha256, "options": context.options,
        "solver_version": context.solver_version});
    std::fs::write(dir.join("manifest.json"), manifest.to_string())
}
