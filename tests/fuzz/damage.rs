//! Random damage to an input: to bytes, words, numbers, ranges and whole files.

use super::corpus::Input;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Words that are likely to break readers of text or binary files.
const WORDS: [&[u8]; 34] = [
    b"NaN",
    b"Infinity",
    b"-Infinity",
    b"1e400",
    b"-1e308",
    b"1e-320",
    b"-0",
    b"9007199254740993",
    b"99999999999999999999",
    b"-1",
    b"0",
    b"null",
    b"true",
    b"\"\"",
    b"{}",
    b"[]",
    b"[[[[[[[[[[[[[[[[",
    b"{\"a\":{\"a\":{\"a\":",
    b",",
    b":",
    b"\\u0000",
    b"\\ud800",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\0",
    b"../",
    b"\r\n\r\n",
    b"\n",
    b"--",
    b"\t",
    b"PK\x03\x04",
    b"PK\x01\x02",
    b"PK\x05\x06",
    b"\x80\x02}q\x00",
];

/// Numbers that replace other numbers.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "1",
    "2",
    "255",
    "65536",
    "-2147483649",
    "4294967296",
    "9223372036854775808",
    "1e9",
    "1e38",
    "1e308",
    "-1e-300",
    "0.5",
];

/// Little-endian integers for headers.
const HEADER_WORDS: [u32; 8] = [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff];

/// Maximum number of kinds of damage to one input.
const MAX_DAMAGES: u32 = 6;

/// Damages the input one to [`MAX_DAMAGES`] times. Parts may come from `others`.
pub(crate) fn damaged(mut input: Input, others: &[Input], max_bytes: usize, rng: &mut ChaCha8Rng) -> Input {
    let n_damages = if rng.random() { 1 } else { rng.random_range(1..=MAX_DAMAGES) };
    for _ in 0..n_damages {
        if input.members.len() > 1 && rng.random_range(0..12) == 0 {
            damage_files(&mut input, others, rng);
            continue;
        }
        if input.members.is_empty() {
            break;
        }
        let which = rng.random_range(0..input.members.len());
        let bytes = &mut input.members[which].1;
        damage_bytes(bytes, others, rng);
        bytes.truncate(max_bytes);
    }
    input
}

/// Removes, duplicates or renames a file, or replaces its content with that of another input.
fn damage_files(input: &mut Input, others: &[Input], rng: &mut ChaCha8Rng) {
    let which = rng.random_range(0..input.members.len());
    match rng.random_range(0..4) {
        0 => drop(input.members.remove(which)),
        1 => {
            let mut member = input.members[which].clone();
            damage_bytes(&mut member.1, others, rng);
            member.0.insert(0, 'x');
            input.members.push(member);
        }
        2 => {
            let mut name = std::mem::take(&mut input.members[which].0).into_bytes();
            damage_bytes(&mut name, &[], rng);
            name.truncate(300);
            input.members[which].0 = String::from_utf8_lossy(&name).into_owned();
        }
        _ => {
            let Some(member) = others.choose(rng).and_then(|other| other.members.choose(rng)) else { return };
            input.members[which].1.clone_from(&member.1);
        }
    }
}

/// Changes, removes, duplicates or inserts bytes once.
fn damage_bytes(bytes: &mut Vec<u8>, others: &[Input], rng: &mut ChaCha8Rng) {
    if bytes.is_empty() {
        bytes.extend_from_slice(WORDS.choose(rng).expect("the table is not empty"));
        return;
    }
    let at = rng.random_range(0..bytes.len());
    match rng.random_range(0..10) {
        0 => bytes[at] ^= 1 << rng.random_range(0..8),
        1 => bytes[at] = rng.random(),
        2 => drop(bytes.drain(part(bytes.len(), rng))),
        3 => {
            let copy = bytes[part(bytes.len(), rng)].to_vec();
            splice(bytes, at..at, &copy);
        }
        4 => splice(bytes, at..at, WORDS.choose(rng).expect("the table is not empty")),
        5 => {
            let word = WORDS.choose(rng).expect("the table is not empty");
            let end = bytes.len().min(at + word.len());
            splice(bytes, at..end, word);
        }
        6 => {
            if let Some(number) = number_near(bytes, at) {
                splice(bytes, number, NUMBERS.choose(rng).expect("the table is not empty").as_bytes());
            }
        }
        7 => {
            let value = HEADER_WORDS.choose(rng).expect("the table is not empty").to_le_bytes();
            let n = (bytes.len() - at).min(*[1, 2, 4].choose(rng).expect("the table is not empty"));
            bytes[at..at + n].copy_from_slice(&value[..n]);
        }
        8 => bytes.truncate(at),
        _ => {
            let Some((_, other)) = others.choose(rng).and_then(|other| other.members.choose(rng)) else { return };
            if !other.is_empty() {
                let piece = other[part(other.len(), rng)].to_vec();
                let target = part(bytes.len(), rng);
                splice(bytes, target, &piece);
            }
        }
    }
}

/// A random range; short ranges are more likely than long ones.
fn part(length: usize, rng: &mut ChaCha8Rng) -> Range<usize> {
    let start = rng.random_range(0..length);
    let most = (length - start).min(1 << rng.random_range(0..16));
    start..start + rng.random_range(1..=most)
}

/// Range of the first decimal number at or after `at`.
fn number_near(bytes: &[u8], at: usize) -> Option<Range<usize>> {
    let is_digit = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+' | b'e');
    let start = at + bytes[at..].iter().position(u8::is_ascii_digit)?;
    let start = start - bytes[..start].iter().rev().take_while(|byte| is_digit(byte)).count();
    Some(start..start + bytes[start..].iter().take_while(|byte| is_digit(byte)).count())
}

fn splice(bytes: &mut Vec<u8>, range: Range<usize>, replacement: &[u8]) {
    bytes.splice(range, replacement.iter().copied());
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn damage_is_reproducible_and_bounded() {
        let input =
            Input { members: vec![("a".to_owned(), b"{\"x\": -1.5e3}".to_vec()), ("b".to_owned(), vec![7; 50])] };
        let run = || {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            (0..500).map(|_| damaged(input.clone(), std::slice::from_ref(&input), 64, &mut rng)).collect::<Vec<_>>()
        };
        assert_eq!(run(), run());
        assert!(run().iter().any(|case| *case != input));
        assert!(run().iter().all(|case| case.members.iter().all(|(_, bytes)| bytes.len() <= 64 + 300)));
    }

    #[test]
    fn finds_whole_numbers() {
        assert_eq!(number_near(b"{\"x\": -1.5e3}", 8), Some(6..12));
        assert_eq!(number_near(b"{\"x\": -1.5e3}", 0), Some(6..12));
        assert_eq!(number_near(b"none", 0), None);
    }
}
