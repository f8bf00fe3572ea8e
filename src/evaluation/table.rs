//! An evaluation as a text table.

use super::camera_error::CameraErrors;
use super::report::{Evaluation, PoseErrors};
use std::fmt;

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(cameras) = &self.cameras {
            writeln!(f, "{:<22}{:>12}{:>12}{:>12}{:>10}", "cameras", "mm", "degrees", "px", "scale")?;
            for errors in [&cameras.rigid, &cameras.sim3, &cameras.rigid_pose] {
                write_camera_row(f, errors)?;
            }
            for (id, error) in &cameras.sim3.per_camera {
                let label = format!("  sim3, camera {id}");
                let px = number(error.reprojection_px, 2);
                writeln!(f, "{label:<22}{:>12.2}{:>12.3}{px:>12}", error.position_mm, error.angle_deg)?;
            }
        }
        if let Some(worst) = &self.cameras_relative {
            writeln!(
                f,
                "worst camera pair     rotation {:.3}, direction {:.3} degrees",
                worst.rotation_deg, worst.direction_deg
            )?;
        }
        if let Some(world) = &self.world {
            writeln!(f, "way up                {:.2} degrees off, floor {:+.0} mm", world.up_deg, world.floor_mm)?;
        }
        for poses in self.poses.iter().chain(&self.other_poses) {
            write_poses(f, poses)?;
        }
        if let Some(identity) = &self.identity {
            writeln!(f, "\n{:<22}{:>12}{:>12}{:>18}", "identities", "accuracy", "coverage", "swapped recall")?;
            let recall = number(identity.swapped_recall, 4);
            writeln!(f, "  {:<20}{:>12.4}{:>12.4}{recall:>18}", identity.n, identity.accuracy, identity.coverage)?;
        }
        Ok(())
    }
}

fn write_camera_row(f: &mut fmt::Formatter<'_>, errors: &CameraErrors) -> fmt::Result {
    let (mm, degrees) = (number(errors.position_mm, 2), number(errors.angle_deg, 3));
    let px = number(errors.reprojection_px, 2);
    writeln!(f, "  {:<20}{mm:>12}{degrees:>12}{px:>12}{:>10.4}", errors.mode.name(), errors.scale)
}

fn write_poses(f: &mut fmt::Formatter<'_>, poses: &PoseErrors) -> fmt::Result {
    let (m, jitter) = (&poses.mpjpe, &poses.jitter);
    writeln!(f, "\n{:<22}{:>12}{:>12}{:>12}{:>10}", poses.joints_from, "raw mm", "root mm", "aligned mm", "recall")?;
    let rows = [("14 joints", m.raw14, m.root14, m.pa14), ("12 limb joints", m.raw12, m.root12, m.pa12)];
    for (name, raw, root, aligned) in rows {
        let (raw, root, aligned) = (number(raw, 2), number(root, 2), number(aligned, 2));
        writeln!(f, "  {name:<20}{raw:>12}{root:>12}{aligned:>12}{:>10.4}", m.recall)?;
    }
    for (name, pcp) in [("PCP", &poses.pcp), ("PCP one to one", &poses.pcp_one2one)] {
        let actors: Vec<String> =
            pcp.per_actor.iter().map(|(actor, percent)| format!("{actor}: {percent:.1}")).collect();
        writeln!(f, "  {name:<20}{:>12}   {}", number(pcp.average, 2), actors.join("  "))?;
    }
    let (solved, truth) = (number(jitter.pred.m_per_s2, 2), number(jitter.gt.m_per_s2, 2));
    writeln!(f, "  {:<20}{solved:>12}   truth: {truth}", "jitter m/s^2")?;
    writeln!(f, "  {:<20}{:>12}", "jitter error mm/fr^2", number(jitter.error_mm_per_frame2, 2))
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}
