//! Joint names and keypoint orders of detectors, and the mapping from one order to another.

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
    /// The order of a keypoint convention.
    pub(crate) fn of_convention(convention: KeypointConvention) -> Self {
        Self::padded(convention.name(), convention.names(), convention.n_keypoints())
    }

    /// An order given by a detector's joint names; unknown names become unused points.
    pub(crate) fn of_names<'n>(name: &str, names: impl IntoIterator<Item = &'n str>) -> Self {
        Self { name: name.to_owned(), joints: names.into_iter().map(canonical).collect() }
    }

    fn padded(name: &str, names: &[&str], n_points: usize) -> Self {
        let named = names.iter().map(|joint| Some((*joint).to_owned()));
        Self { name: name.to_owned(), joints: named.chain(std::iter::repeat(None)).take(n_points).collect() }
    }

    /// All orders in which detectors write this number of points, the most common first.
    pub(crate) fn candidates(n_points: usize) -> Vec<Self> {
        use KeypointConvention as C;
        let of = |conventions: &[C]| conventions.iter().map(|c| Self::of_convention(*c)).collect();
        match n_points {
            17 => of(&[C::Coco17]),
            18 => of(&[C::Coco18]),
            19 => vec![Self::padded("panoptic19", &PANOPTIC19, 19)],
            23 => vec![Self::padded("coco_wholebody23", C::CocoWholebody133.names(), 23)],
            24 => of(&[C::Smpl24]),
            25 => {
                let mut orders: Vec<Self> = of(&[C::Body25, C::Body25b]);
                orders.push(Self::padded("vitpose25", &VITPOSE25, 25));
                orders
            }
            26 => of(&[C::Halpe26]),
            33 => of(&[C::Blazepose33]),
            133 => of(&[C::CocoWholebody133]),
            // Halpe's face and hands follow its body and are not used.
            68 | 136 => vec![Self::padded(&format!("halpe{n_points}"), C::Halpe26.names(), n_points)],
            _ => Vec::new(),
        }
    }

    /// Index in this order of each point of a convention.
    pub(crate) fn map_to(&self, convention: KeypointConvention) -> Vec<Option<usize>> {
        if *self == Self::of_convention(convention) {
            return (0..convention.n_keypoints()).map(Some).collect();
        }
        let place = |joint: &str| self.joints.iter().position(|own| own.as_deref() == Some(joint));
        let mut map: Vec<Option<usize>> = convention.names().iter().map(|joint| place(joint)).collect();
        map.resize(convention.n_keypoints(), None);
        map
    }
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
        for n in [17, 18, 19, 25, 26, 33, 133, 136] {
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
    fn maps_a_convention_to_itself_with_unnamed_points() {
        let convention = KeypointConvention::CocoWholebody133;
        let map = JointOrder::of_convention(convention).map_to(convention);
        assert!(map.iter().enumerate().all(|(i, place)| *place == Some(i)));
    }
}
