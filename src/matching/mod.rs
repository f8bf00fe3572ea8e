//! Who is who: tracklets per view, hypotheses of camera pairs that whole tracklets vote for, the 3D tracker.
//!
//! Nothing is given: no identities, no camera poses. The way from detections to people is
//! [`detections`] (what every view saw, as rays) → [`tracklets`] (who is who within one view, split rather than swapped)
//! → [`pair_hypotheses`] (relative poses of two cameras that many tracklets agree on, judged by [`pair_score`]) →
//! [`view_graph`] (one pose per camera) → [`clusters`] (tracklets of one person, across views) → [`tracker`] (every
//! detection given to a person under known cameras).

pub mod assignment;
pub mod clusters;
pub mod consistency;
pub mod convex;
pub mod normalized;
pub mod pair_hypotheses;
pub mod pair_score;
pub mod tracker;
pub mod tracklets;
pub mod view_graph;
