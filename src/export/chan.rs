//! `<camera>.chan`: Nuke's camera channels, one line per frame.
//!
//! `frame tx ty tz rx ry rz vfov`: metres, degrees, y up, looking along -z. The file does not state the order of rotation; it
//! is Nuke's default, ZXY (`R = R_y R_x R_z`). The vertical field of view is that of the whole image.
//!
//! Known limit: no principal point, pixel aspect, skew or distortion; they are in `cameras.json`, and the manifest lists the
//! losses.

use super::files::ResultFiles;
use super::film::{vertical_view, world_from_film};
use super::names::file_names;
use super::take::Take;
use crate::geometry::euler::yxz_angles;
use crate::session::formats::rounded;
use crate::session::recording::UpAxis;
use std::io;

/// Writes a file per camera.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    let names = file_names(take.cameras.iter().map(|camera| camera.id.as_str()));
    for (camera, name) in take.cameras.iter().zip(names) {
        let world_from_film = world_from_film(camera);
        let (t, angles) = (world_from_film.translation, yxz_angles(&world_from_film.rotation));
        let degrees =
            [angles.middle, angles.outer, angles.inner, vertical_view(&camera.intrinsics)].map(f64::to_degrees);
        // Rounded to 1e-9 m and degrees, far below a thousandth of a pixel.
        let values = [t.x, t.y, t.z].into_iter().chain(degrees).map(|value| format!("{:.9}", rounded(value, 9)));
        let values = values.collect::<Vec<_>>().join("\t");
        let lines: String = (0..take.n_frames).map(|i| format!("{}\t{values}\n", take.frame_number(i))).collect();
        files.bytes(&format!("{name}.chan"), "text/plain", lines.as_bytes())?;
    }
    Ok(())
}
