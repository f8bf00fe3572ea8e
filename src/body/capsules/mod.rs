//! The body as 21 tapered capsules, for collisions: fast distances with exact derivatives.
//!
//! Two side by side for the pelvis and for the chest, one across the waist, one each for neck and head; on either side
//! collar, upper arm, forearm, hand, thigh, shank, foot. Every end is fixed in a joint's frame and linear in the betas, as
//! a landmark is: `c = p_j + G_j (a + A beta)`, `r = r_0 + r_beta beta`.
//!
//! Known limits: fitted to the skin to some 6 mm (root mean square) at rest, 7 mm in poses near standing; where joints bend
//! far, some 9 to 17 mm (creases more), since a capsule follows one bone where the skin blends two. Thumbs and nose are
//! not covered.

mod body_capsules;
mod embedded;
mod fit;
mod start;

pub use body_capsules::{BodyCapsule, BodyCapsules, CapsuleEnd, N_CAPSULES, NearestBall};
