//! Joint names and keypoint orders of detectors, and the mapping from one order to another.

use crate::body::hand::{N_HAND_POINTS, Side, face_keypoints};
use crate::body::skeleton::KeypointConvention;
use crate::session::recording::Keypoint;

/// Order in which a source writes a person's points: one canonical joint name each, `None` for unused points.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct JointOrder {
    /// Name for messages.
    pub(crate) name: String,
    pub(crate) joints: Vec<Option<String>>,
}

/// The order of the CMU Panoptic data set, which is not a [`KeypointConvention`].
const PANOPTIC19: [&str; 19] = [
    "neck", "nose", "mid_hip", "left_shoulder", "left_elbow", "left_wrist", "left_hip", "left_knee", "left_ankle",
    "right_shoulder", "right_elbow", "right_wrist", "right_hip", "right_knee", "right_ankle", "left_eye", "left_ear",
    "right_eye", "right_ear",
];
/// The 25 points of rtmlib's ViTPose: the number of BODY_25, in another order.
const VITPOSE25: [&str; 25] = [
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "neck", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "mid_hip", "left_knee", "right_knee",
    "left_ankle", "right_ankle", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe",
    "right_heel",
];

impl JointOrder {
    /// The order of a keypoint convention. Points of face and hands have names here, so that they are mapped between conventions.
    pub(crate) fn of_convention(convention: KeypointConvention) -> Self {
        let body = Self::of_body_of(convention);
        let Some(face) = face_keypoints(convention) else { return body };
        let face = (0..face.len()).map(|k| Some(format!("face_{k}")));
        let joints = body.joints.into_iter().chain(face).chain(Side::BOTH.into_iter().flat_map(hand_names));
        Self { joints: joints.collect(), ..body }
    }

    /// The order of a convention without face and hands.
    pub(crate) fn of_body_of(convention: KeypointConvention) -> Self {
        Self::of_body(convention.name(), convention.names())
    }

    /// The order with the points of the left hand and those of the right hand after its own.
    pub(crate) fn with_hands(self) -> Self {
        let name = format!("{}_hands", self.name);
        self.with_hands_in_order(name, Side::BOTH)
    }

    fn with_hands_in_order(self, name: String, sides: [Side; 2]) -> Self {
        Self { name, joints: self.joints.into_iter().chain(sides.into_iter().flat_map(hand_names)).collect() }
    }

    /// An order given by a detector's joint names; unknown names become unused points.
    pub(crate) fn of_names<'n>(name: &str, names: impl IntoIterator<Item = &'n str>) -> Self {
        Self { name: name.to_owned(), joints: names.into_iter().map(canonical).collect() }
    }

    fn of_body(name: &str, names: &[&str]) -> Self {
        Self { name: name.to_owned(), joints: names.iter().map(|joint| Some((*joint).to_owned())).collect() }
    }

    /// All orders in which detectors write this number of points, the most common first.
    pub(crate) fn candidates(n_points: usize) -> Vec<Self> {
        let whole = Self::whole(n_points);
        match n_points.checked_sub(N_HANDS_POINTS) {
            Some(n_body) if whole.is_empty() && n_body <= N_LARGEST_BODY => {
                Self::whole(n_body).into_iter().map(Self::with_hands).collect()
            }
            _ => whole,
        }
    }

    /// The orders of bodies alone, and those of conventions with hands.
    fn whole(n_points: usize) -> Vec<Self> {
        use KeypointConvention as C;
        let of = |conventions: &[C]| conventions.iter().map(|c| Self::of_convention(*c)).collect();
        match n_points {
            17 => of(&[C::Coco17]),
            18 => of(&[C::Coco18]),
            19 => vec![Self::of_body("panoptic19", &PANOPTIC19)],
            23 => vec![Self::of_body("coco_wholebody23", C::CocoWholebody133.names())],
            24 => of(&[C::Smpl24]),
            25 => {
                let mut orders: Vec<Self> = of(&[C::Body25, C::Body25b]);
                orders.push(Self::of_body("vitpose25", &VITPOSE25));
                orders
            }
            26 => of(&[C::Halpe26]),
            33 => of(&[C::Blazepose33]),
            // Exporters of MediaPipe write either hand first; the hand's wrist is at the end of its own arm.
            75 => {
                let right_first = Self::of_convention(C::Blazepose33)
                    .with_hands_in_order("blazepose75_right_first".to_owned(), [Side::Right, Side::Left]);
                vec![Self::of_convention(C::Blazepose75), right_first]
            }
            133 => of(&[C::CocoWholebody133]),
            136 => of(&[C::Halpe136]),
            _ => Vec::new(),
        }
    }

    /// Known orders that have every joint of this one at its place and differ by naming points of hands and face.
    ///
    /// Detectors name those in many ways (`left_hand_root`, `left_thumb1`, `face-0`) but write them in known orders.
    pub(crate) fn completions(&self) -> Vec<Self> {
        let is_detail = |joint: &Option<String>| {
            joint.as_deref().is_some_and(|joint| joint.starts_with("face_") || joint.contains("_hand_"))
        };
        let agrees =
            |(own, known): (&Option<String>, &Option<String>)| own == known || own.is_none() && is_detail(known);
        let mut known = Self::candidates(self.joints.len());
        known.retain(|order| order.n_named() > self.n_named() && self.joints.iter().zip(&order.joints).all(agrees));
        known
    }

    /// Number of points with a name.
    pub(crate) fn n_named(&self) -> usize {
        self.joints.iter().flatten().count()
    }

    /// Index in this order of each point of a convention.
    pub(crate) fn map_to(&self, convention: KeypointConvention) -> Vec<Option<usize>> {
        let place = |joint: Option<String>| self.joints.iter().position(|own| own.is_some() && *own == joint);
        Self::of_convention(convention).joints.into_iter().map(place).collect()
    }
}

/// Number of points of both hands, and of the largest body that detectors write before them.
pub(crate) const N_HANDS_POINTS: usize = 2 * N_HAND_POINTS;
const N_LARGEST_BODY: usize = 26;

/// Names of the points of a hand.
fn hand_names(side: Side) -> impl Iterator<Item = Option<String>> {
    (0..N_HAND_POINTS).map(move |k| Some(format!("{}_hand_{k}", side.name())))
}

/// A person's points in a convention's order; points that the source does not have are missing.
pub(crate) fn mapped(points: &[Keypoint], map: &[Option<usize>]) -> Vec<Keypoint> {
    map.iter().map(|place| place.and_then(|i| points.get(i)).copied().unwrap_or(Keypoint::MISSING)).collect()
}

/// The canonical name of a joint from a detector's name: `LShoulder`, `l_shoulder`, `Left Shoulder`, `shoulder_left`.
pub(crate) fn canonical(name: &str) -> Option<String> {
    let words = words_of(name);
    let is_left = |word: &String| ["l", "left"].contains(&word.as_str());
    let is_right = |word: &String| ["r", "right"].contains(&word.as_str());
    let side = match (words.iter().any(is_left), words.iter().any(is_right)) {
        (true, false) => "left_",
        (false, true) => "right_",
        _ => "",
    };
    let rest: String = words.iter().filter(|word| !is_left(word) && !is_right(word)).map(String::as_str).collect();
    let joint = match rest.as_str() {
        "nose" => "nose",
        "eye" => "eye",
        "ear" => "ear",
        "shoulder" | "sho" => "shoulder",
        "elbow" | "elb" => "elbow",
        "wrist" | "wri" => "wrist",
        "hip" if !side.is_empty() => "hip",
        "hip" | "midhip" | "pelvis" | "root" | "hipcenter" | "hips" => "mid_hip",
        "knee" => "knee",
        "ankle" | "ank" => "ankle",
        "heel" => "heel",
        "bigtoe" | "footindex" => "big_toe",
        "smalltoe" | "littletoe" => "small_toe",
        "neck" | "upperneck" => "neck",
        "head" | "headtop" | "tophead" => "head_top",
        _ => return None,
    };
    let is_paired = !["nose", "mid_hip", "neck", "head_top"].contains(&joint);
    (is_paired != side.is_empty()).then(|| format!("{side}{joint}"))
}

/// Lower-case words of a name in snake case, camel case or with spaces; a leading `R` or `L` before a capital is a word.
fn words_of(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut previous = ' ';
    for c in name.chars().take(64) {
        let starts = !previous.is_ascii_alphanumeric()
            || (c.is_ascii_uppercase() && (previous.is_ascii_lowercase() || ['L', 'R'].contains(&previous)));
        if c.is_ascii_alphanumeric() {
            match words.last_mut() {
                Some(word) if !starts => word.push(c.to_ascii_lowercase()),
                _ => words.push(c.to_ascii_lowercase().to_string()),
            }
        }
        previous = c;
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recognises_joints_by_many_names() {
        for name in ["LShoulder", "left_shoulder", "l_shoulder", "shoulder_left", "Left Shoulder", "leftShoulder"] {
            assert_eq!(canonical(name).as_deref(), Some("left_shoulder"), "{name}");
        }
        for (name, ours) in
            [("RBigToe", "right_big_toe"), ("Hip", "mid_hip"), ("RHip", "right_hip"), ("Head", "head_top")]
        {
            assert_eq!(canonical(name).as_deref(), Some(ours));
        }
        assert_eq!((canonical("tail"), canonical("shoulder"), canonical("left_nose")), (None, None, None));
    }

    #[test]
    fn maps_limbs_from_every_order_to_every_convention() {
        for n in [17, 18, 19, 25, 26, 33, 59, 60, 67, 68, 75, 133, 136] {
            assert!(!JointOrder::candidates(n).is_empty(), "{n}");
            for order in JointOrder::candidates(n) {
                assert_eq!(order.joints.len(), n);
                for convention in KeypointConvention::ALL {
                    let map = order.map_to(convention);
                    assert_eq!(map.len(), convention.n_keypoints());
                    let knee = convention.index_of("left_knee").unwrap();
                    let place = map[knee].unwrap();
                    assert_eq!(order.joints[place].as_deref(), Some("left_knee"));
                }
            }
        }
    }

    #[test]
    fn maps_a_convention_to_itself_with_face_and_hands() {
        for convention in KeypointConvention::ALL {
            let order = JointOrder::of_convention(convention);
            assert_eq!(order.joints.len(), convention.n_keypoints());
            assert!(order.map_to(convention).into_iter().eq((0..convention.n_keypoints()).map(Some)));
            assert!(JointOrder::candidates(convention.n_keypoints()).contains(&order), "{}", convention.name());
        }
    }

    /// MMPose's names of 133 points had kept 23 of them.
    #[test]
    fn names_of_a_whole_body_lost_hands_and_face() {
        let whole = JointOrder::of_convention(KeypointConvention::CocoWholebody133);
        let body: Vec<&str> = KeypointConvention::CocoWholebody133.names().to_vec();
        let fingers = ["thumb", "forefinger", "middle_finger", "ring_finger", "pinky_finger"];
        let hand = |side: &str| {
            let joints = fingers.iter().flat_map(|finger| (1..=4).map(move |k| format!("{finger}{k}")));
            std::iter::once("hand_root".to_owned())
                .chain(joints)
                .map(|joint| format!("{side}_{joint}"))
                .collect::<Vec<_>>()
        };
        let face = (0..68).map(|k| format!("face-{k}"));
        let names: Vec<String> =
            body.iter().map(|name| (*name).to_owned()).chain(face).chain(hand("left")).chain(hand("right")).collect();
        let named = |names: &[String]| JointOrder::of_names("coco_wholebody", names.iter().map(String::as_str));
        assert_eq!((named(&names).n_named(), named(&names).completions()), (23, vec![whole]));
        let mut exchanged = names;
        exchanged.swap(5, 6);
        assert_eq!(named(&exchanged).completions(), [], "shoulders are at each other's places");
        let animal: Vec<&str> = std::iter::once("nose").chain(std::iter::repeat_n("tail", 16)).collect();
        assert_eq!(JointOrder::of_names("animal", animal).completions(), []);
    }

    #[test]
    fn maps_hands_between_conventions() {
        let order = JointOrder::candidates(60).remove(0);
        let map = order.map_to(KeypointConvention::CocoWholebody133);
        assert_eq!(order.name, "coco18_hands");
        // The tip of the left thumb and the wrist of the right hand; the order has no face.
        assert_eq!((map[91 + 4], map[112], map[30]), (Some(18 + 4), Some(18 + 21), None));
    }
}
