//! Shape and pose of each person: the articulated fit.
//!
//! Per person one shape, per frame a root motion and 21 joint rotations, and for the session the keypoint bias of its
//! detector. A fit straight to pixels gets stuck (docs/method.md 10.3), so that it runs in passes: a closed-form start, then the
//! triangulated points (of a single view: points lifted to 3D), then the detected pixels, then pixels with the keypoint
//! bias released.
//!
//! | file | content |
//! |---|---|
//! | `fit`, `config`, `context` | the steps over all persons, also for statures alone, and what they read |
//! | `observations`, `gathering` | triangulated points and detected pixels of one person; how they are gathered |
//! | `averaging` | observations of every few frames, with what the frames between say |
//! | `initial_motion`, `monocular` | the closed-form start; points of a single view lifted to 3D |
//! | `person_fit`, `window_fit`, `common_shape` | one person's windows, the passes over one, and the shape that all of them say |
//! | `local_fit`, `pixel_residuals` | runs fitted again; the detector's accuracy |
//! | `terms`, `objective`, `motion_problem`, `minimisation` | the terms, their list, its sum, the damped Gauss-Newton steps |
//! | `thinned_motion` | fits to every few frames, from which those between follow |
//! | `gap_completion` | joints that no camera shows for a while, completed by the motion prior |
//! | `latent_fit` | in place of the last pass the paper's: motions as latent codes, together with the cameras |
//! | `joint_problem` | all persons as one problem, with the detector's offsets and the cameras |
//! | `keypoint_bias`, `session_bias` | the detector's offsets, with the cameras held |
//! | `camera_adjustment`, `noise_measurement` | cameras and motions together, under errors correlated in time |
//! | `stated_covariances` | how far the covariances that a detector states decide |
//! | `local_noise` | how exact the detector is at each time, landmark by landmark and camera by camera |
//! | `joint_uncertainty`, `single_camera`, `unseen_limbs` | standard deviations of the joints; what one camera alone, and none, leaves open |
//! | `collision_resolution`, `capsule_overlaps` | overlaps between bodies |
//! | `person_motion` | a fit on the session's time line, its published motion and statistics |

mod averaging;
mod camera_adjustment;
mod camera_pose_prior;
mod camera_priors;
mod capsule_overlaps;
mod collision_resolution;
mod common_shape;
mod completed_joints;
mod config;
mod context;
mod depth_sides;
mod fit;
mod focal_prior;
mod gap_completion;
mod gaps;
mod gathering;
mod initial_motion;
mod joint_problem;
mod joint_uncertainty;
mod keypoint_bias;
mod latent_fit;
mod local_fit;
mod local_noise;
mod minimisation;
mod monocular;
mod motion_problem;
mod noise_measurement;
mod objective;
mod observations;
mod person_fit;
mod person_motion;
mod pixel_residuals;
mod session_bias;
mod session_state;
mod single_camera;
mod stated_covariances;
mod terms;
#[cfg(test)]
mod test_fixtures;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_simulated;
mod thinned_motion;
mod trunk_sides;
mod unseen_limbs;
mod window_fit;

pub use config::{BodyFitConfig, KnownCameras};
pub use fit::{FittedBodies, fit_bodies, fitted_statures};
pub use focal_prior::RefinedFocal;
pub use person_motion::landmark_trajectory;
