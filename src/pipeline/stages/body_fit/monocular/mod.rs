//! The monocular fit: points of a single view lifted to 3D.
//!
//! [`trunk_pose`] lists the poses of the trunk that the image of a frame allows, [`limb_configurations`] those of each limb
//! on it; [`lifting`] chooses among both over time.

pub(super) mod lifting;
pub(super) mod limb_configurations;
mod trunk_pose;
