//! Limits on the size of an upload.

/// Limits on an upload. They apply to the content that is read, not to sizes that the upload declares.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadLimits {
    /// Bytes of all members together after decompression, and of one document.
    pub max_unpacked_bytes: u64,
    /// Largest compression ratio of one member, for members above `ratio_free_bytes`.
    pub max_ratio: u64,
    /// Members that decompress to at most this many bytes may have any ratio.
    pub ratio_free_bytes: u64,
    /// Number of members of an archive.
    pub max_members: usize,
    /// Bytes of an archive's central directory.
    pub max_directory_bytes: u64,
    /// Number of cameras of a session.
    pub max_cameras: usize,
    /// Number of frames of the time line.
    pub max_frames: usize,
    /// Number of frames of the time line times number of cameras.
    pub max_view_frames: usize,
    /// Number of people in one frame of one camera.
    pub max_people_per_frame: usize,
    /// Keypoints of the whole session, missing ones included; a person counts as 4 more, a frame as 3 more.
    pub max_keypoints: usize,
    /// Levels of nesting of a JSON document.
    pub max_json_depth: usize,
    /// Bytes of one JSON string.
    pub max_string_bytes: u64,
}

impl Default for UploadLimits {
    fn default() -> Self {
        Self {
            max_unpacked_bytes: 8 << 30, // an hour of 8 cameras and 10 people of 133 points is about 6 GiB of text
            max_ratio: 200,              // pose files compress 3 to 10 times, empty frames up to 150 times
            ratio_free_bytes: 10_000_000, // small enough for any ratio
            max_members: 100_000,        // one file per camera and frame: 10 cameras for five minutes
            max_directory_bytes: 16 << 20, // 160 bytes a member; parsed it stays below 64 MiB
            max_cameras: 64,             // twice the largest rig of the literature (31 HD cameras)
            max_frames: 1_000_000,       // nine hours at 30 fps
            max_view_frames: 10_000_000, // an empty frame takes 24 bytes: 240 MB
            max_people_per_frame: 200,   // a crowd; association is designed for about ten
            max_keypoints: 50_000_000,   // 40 bytes each: 2 GB
            max_json_depth: 32,          // the layout has 8 levels; the rest is for ignored keys
            max_string_bytes: 1 << 20,   // longest name; longer strings occur only under ignored keys
        }
    }
}

/// Largest number of keypoints of a person, beyond every convention; longer lists are refused while they are read.
pub(crate) const MAX_KEYPOINTS_PER_PERSON: usize = 1000;
/// Memory of a person besides their keypoints, in keypoints of 40 bytes, rounded up: 40 bytes and an allocation. Without it,
/// millions of people without keypoints would cost nothing.
pub(crate) const PERSON_AS_KEYPOINTS: usize = 4;
/// Memory of a frame besides its people, in keypoints of 40 bytes, rounded up: 32 bytes and a share of a map node.
pub(crate) const FRAME_AS_KEYPOINTS: usize = 3;
