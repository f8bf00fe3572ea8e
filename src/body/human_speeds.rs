//! Speeds of human bodies, m/s: the limits beyond which two detections show two persons, or a foot does not stand.

/// A foot slower than this stands: a tenth of a walking leg's swing.
pub const STANDING_FOOT_M_S: f64 = 0.15;

/// Walking. Tracklets of faster persons split, which the association across views repairs; persons that no view sees
/// wander this fast.
pub const WALK_M_S: f64 = 1.2;

/// A slow run: a simulated person's feet do not slide faster over the floor.
pub const JOG_M_S: f64 = 2.5;

/// A running person's middle, between two frames of a view.
pub const RUN_M_S: f64 = 5.0;

/// A hand in a throw: a keypoint that seems faster is another point.
pub const THROWN_HAND_M_S: f64 = 10.0;
