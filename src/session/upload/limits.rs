//! What an upload may cost.

/// Bounds on an upload. All of them are checked on what is read, not on what the upload says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadLimits {
    /// Bytes of all members together once unpacked, and of one document.
    pub max_unpacked_bytes: u64,
    /// Unpacked size over packed size of one member, above `ratio_free_bytes`.
    pub max_ratio: u64,
    /// Members that unpack to no more than this may be packed as tightly as they like.
    pub ratio_free_bytes: u64,
    /// Members of an archive.
    pub max_members: usize,
    /// Bytes of an archive's directory.
    pub max_directory_bytes: u64,
    /// Cameras of a session.
    pub max_cameras: usize,
    /// Length of the time line.
    pub max_frames: usize,
    /// Length of the time line times cameras.
    pub max_view_frames: usize,
    /// People in one frame of one camera.
    pub max_people_per_frame: usize,
    /// Keypoints of the whole session, missing ones included; a person takes the memory of 4 more, a frame of 3 more.
    pub max_keypoints: usize,
    /// Nesting of a JSON document.
    pub max_json_depth: usize,
    /// Bytes of one JSON string.
    pub max_string_bytes: u64,
}

impl Default for UploadLimits {
    fn default() -> Self {
        Self {
            max_unpacked_bytes: 8 << 30, // an hour of 8 cameras and 10 people of 133 points is some 6 GiB of text
            max_ratio: 200,              // pose files shrink 3 to 10 times, empty frames up to 150 times
            ratio_free_bytes: 10_000_000, // so small that no ratio hurts
            max_members: 100_000,        // one file per camera and frame: 10 cameras for five minutes
            max_directory_bytes: 16 << 20, // 160 bytes a member; parsed it stays below 64 MiB
            max_cameras: 64,             // twice the largest rig of the literature (31 HD cameras)
            max_frames: 1_000_000,       // nine hours at 30 fps
            max_view_frames: 10_000_000, // an empty frame takes 24 bytes: 240 MB
            max_people_per_frame: 200,   // a crowd; association is meant for some ten
            max_keypoints: 50_000_000,   // 24 bytes each: 1.2 GB
            max_json_depth: 32,          // the layout nests 8 levels; the rest is for keys that are ignored
            max_string_bytes: 1 << 20,   // a name; a string this long is only ever ignored
        }
    }
}

/// Memory of a person besides their keypoints, in keypoints of 24 bytes: 40 bytes and an allocation. Without it, millions
/// of people without keypoints would cost nothing.
pub(crate) const PERSON_AS_KEYPOINTS: usize = 4;
/// Memory of a frame besides its people, in keypoints of 24 bytes: 32 bytes and a share of a map node.
pub(crate) const FRAME_AS_KEYPOINTS: usize = 3;
