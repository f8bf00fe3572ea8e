//! Damaged files of every format are read or refused without a panic.

use crate::calibrations::damaged_sets;
use crate::dialects;
use crate::take::{COCO17, Files, read};
use proptest::prelude::*;
use std::sync::OnceLock;

/// Example files of every format; formats that are not listed share their readers.
fn sets() -> &'static [Files] {
    static SETS: OnceLock<Vec<Files>> = OnceLock::new();
    SETS.get_or_init(|| {
        let mut sets = vec![
            dialects::openpose(&COCO17),
            dialects::alphapose(6.0),
            dialects::coco(),
            dialects::mmpose(true),
            dialects::easymocap(false),
            dialects::easymocap(true),
            dialects::deeplabcut(),
        ];
        sets.extend(damaged_sets());
        // Two frames per camera are sufficient; files per camera are kept whole.
        sets.iter_mut().for_each(|files| files.retain(|(name, _)| !is_late_frame(name)));
        sets
    })
}

fn is_late_frame(name: &str) -> bool {
    let digits: String = name.rsplit('/').next().unwrap().rsplit('_').find(|part| part.len() >= 6).unwrap_or("").into();
    digits.trim_end_matches(".json").parse::<i64>().is_ok_and(|frame| frame > 1)
}

/// Longer files are truncated, so that damage hits their structure.
const MAX_BYTES: usize = 6000;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn reads_or_rejects_damaged_files(
        set in any::<prop::sample::Index>(),
        file in any::<prop::sample::Index>(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..5),
        doubled in prop::option::of((any::<prop::sample::Index>(), any::<prop::sample::Index>())),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut files = sets()[set.index(sets().len())].clone();
        let place = file.index(files.len());
        let bytes = &mut files[place].1;
        bytes.truncate(MAX_BYTES);
        for (at, byte) in &flips {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        if let Some((a, b)) = doubled {
            let (a, b) = (a.index(bytes.len()), b.index(bytes.len()));
            let part = bytes[a.min(b)..a.max(b)].to_vec();
            bytes.extend(part);
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Err(error) = read(&files) {
            prop_assert!(!error.detail.is_empty() && !error.to_string().contains('\n'));
        }
    }
}
