//! Association of detections to persons: tracklets per view, hypotheses of camera pairs, the 3D tracker.
//!
//! Neither identities nor camera poses are given. Without poses the steps are
//!
//! 1. [`normalized`]: detections of every view in ideal normalised coordinates
//! 2. [`tracklets`]: consecutive detections of one person within a view, split rather than swapped in case of doubt
//! 3. [`view_pairs`]: which pairs of cameras are compared
//! 4. [`pair_hypotheses`]: relative poses of two cameras that many tracklets agree on, scored by [`pair_score`]
//! 5. [`view_graph`]: one pose per camera
//! 6. [`clusters`]: tracklets of one person, across views
//!
//! and under known poses [`tracker`], which assigns every detection to a person, and [`convex`], which matches the
//! detections of one frame by the affinities of [`consistency`]. [`assignment`] is the minimum-cost assignment for all, [`groups`]
//! are the cameras that pairs connect.

pub mod assignment;
pub mod clusters;
pub mod consistency;
pub mod convex;
pub mod groups;
pub mod normalized;
pub mod pair_hypotheses;
pub mod pair_score;
mod point_pairs;
pub mod tracker;
pub mod tracklets;
pub mod view_graph;
pub mod view_pairs;
