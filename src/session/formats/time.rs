//! Time in files: frame rates as numbers or ratios, SMPTE time codes.

use serde::{Deserialize, Deserializer, de};

/// A frame rate, frames per second, as written: a number, or a ratio such as `"30000/1001"`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FrameRate(pub(crate) f64);

impl<'de> Deserialize<'de> for FrameRate {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Written {
            Number(f64),
            Ratio(String),
        }
        let unknown = || de::Error::custom("a frame rate must be a number or a ratio such as \"30000/1001\"");
        match Written::deserialize(deserializer).map_err(|_| unknown())? {
            Written::Number(number) => Ok(Self(number)),
            Written::Ratio(text) => {
                let (n, d) = text.split_once('/').ok_or_else(unknown)?;
                let whole = |part: &str| part.trim().parse::<u32>().ok().filter(|n| *n > 0).map(f64::from);
                Ok(Self(whole(n).ok_or_else(unknown)? / whole(d).ok_or_else(unknown)?))
            }
        }
    }
}

/// A frame rate as numerator and denominator, frames per second: 29.97 becomes 30000/1001.
///
/// Rates of television are recognised within 0.002, as they are commonly rounded; any other rate is expanded into a continued
/// fraction, which recovers every ratio with a denominator of up to 10,000.
pub(crate) fn ratio(fps: f64) -> [u64; 2] {
    for nominal in [24.0, 30.0, 48.0, 60.0, 120.0, 240.0] {
        if (fps - nominal * 1000.0 / 1001.0).abs() < 2e-3 {
            return [nominal as u64 * 1000, 1001];
        }
    }
    let (mut before, mut last, mut rest) = ([0.0, 1.0], [1.0, 0.0], fps);
    loop {
        let whole = f64::floor(rest);
        let next: [f64; 2] = std::array::from_fn(|i| whole * last[i] + before[i]);
        if next[1] > 1e4 {
            break;
        }
        (before, last) = (last, next);
        if (last[0] / last[1] - fps).abs() < 1e-9 * fps || rest - whole < 1e-9 {
            break;
        }
        rest = 1.0 / (rest - whole);
    }
    last.map(|n| n as u64)
}

/// Whether a text is an SMPTE time code (`HH:MM:SS:FF`; `;` before the frames for drop frame) at a frame rate.
pub(crate) fn is_timecode(text: &str, fps: f64) -> bool {
    let Some((front, frames)) = text.rsplit_once([':', ';']) else { return false };
    let two_digits = |part: &&str| (2..=3).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_digit());
    let parts: Vec<u32> =
        front.split(':').chain([frames]).filter(two_digits).filter_map(|part| part.parse().ok()).collect();
    let [hours, minutes, seconds, frames] = parts[..] else { return false };
    front.matches(':').count() == 2 && hours < 24 && minutes < 60 && seconds < 60 && f64::from(frames) < fps.ceil()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_written_frame_rates() {
        let read = |text: &str| serde_json::from_str::<FrameRate>(text).map(|rate| rate.0);
        assert_eq!(read("25").unwrap(), 25.0);
        assert_eq!(ratio(read("\"30000/1001\"").unwrap()), [30000, 1001]);
        assert_eq!(ratio(read("\"1000/33\"").unwrap()), [1000, 33]);
        assert_eq!(
            [ratio(25.0), ratio(29.97), ratio(23.976), ratio(12.5)],
            [[25, 1], [30000, 1001], [24000, 1001], [25, 2]]
        );
        for wrong in ["\"30\"", "\"1/0\"", "\"a/b\"", "[1]", "null"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn recognises_timecodes() {
        assert!(is_timecode("01:02:03:24", 25.0) && is_timecode("23:59:59;29", 29.97));
        for wrong in ["", "01:02:03", "01:02:03:25", "24:00:00:00", "1:2:3:4", "01:02:03:0a", "01:02:03:04:05"] {
            assert!(!is_timecode(wrong, 25.0), "{wrong}");
        }
    }
}
