//! `identities.json`: the person that each detection is assigned to, in the order of the input.

use crate::session::{Reconstruction, Session};
use serde::ser::{Serialize, SerializeMap, Serializer};

/// `{"<camera>": [[person | null per detection] per delivered frame]}`, cameras in the session's order.
pub(super) struct Identities<'a> {
    pub(super) session: &'a Session,
    pub(super) reconstruction: &'a Reconstruction,
}

impl Serialize for Identities<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut cameras = serializer.serialize_map(Some(self.session.views.len()))?;
        for (v, view) in self.session.views.iter().enumerate() {
            let of_frame = |frame: usize| -> Vec<Option<usize>> {
                let given = self.reconstruction.identities.get(v).and_then(|frames| frames.get(frame));
                // Detections of a frame that the reconstruction lacks are assigned to no person.
                let person = |d: usize| given.and_then(|people| *people.get(d)?).map(|person| person.0);
                (0..view.frames[frame].len()).map(person).collect()
            };
            let frames: Vec<_> = view.delivered.iter().map(|frame| of_frame(frame.0)).collect();
            cameras.serialize_entry(&view.id, &frames)?;
        }
        cameras.end()
    }
}
