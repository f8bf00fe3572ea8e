//! Damage to an input: bytes, words, numbers, parts, and whole files.

use super::corpus::Input;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// What readers of text and of binary files stumble over.
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

/// Numbers that are put in a number's place.
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

/// Little-endian integers that headers lie with.
const HEADER_WORDS: [u32; 8] = [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff];

/// Most kinds of damage at once.
const MAX_DAMAGES: u32 = 6;

/// The input, damaged once to a few times; `others` lend their parts.
pub(super) fn damaged(mut input: Input, others: &[Input], max_bytes: usize, rng: &mut ChaCha8Rng) -> Input {
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

/// Files are lost, doubled, renamed, or exchanged with another input's.
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

fn damage_bytes(bytes: &mut Vec<u8>, others: &[Input], rng: &mut ChaCha8Rng) {
    if bytes.is_empty() {
        bytes.extend_from_slice(WORDS.choose(rng).expect("there are words"));
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
        4 => splice(bytes, at..at, WORDS.choose(rng).expect("there are words")),
        5 => {
            let word = WORDS.choose(rng).expect("there are words");
            let end = bytes.len().min(at + word.len());
            splice(bytes, at..end, word);
        }
        6 => {
            if let Some(number) = number_near(bytes, at) {
                splice(bytes, number, NUMBERS.choose(rng).expect("there are numbers").as_bytes());
            }
        }
        7 => {
            let value = HEADER_WORDS.choose(rng).expect("there are words").to_le_bytes();
            let n = (bytes.len() - at).min(*[1, 2, 4].choose(rng).expect("there are widths"));
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

/// A part, short ones more often than long ones.
fn part(length: usize, rng: &mut ChaCha8Rng) -> Range<usize> {
    let start = rng.random_range(0..length);
    let most = (length - start).min(1 << rng.random_range(0..16));
    start..start + rng.random_range(1..=most)
}

/// The first number in digits at `at` or behind it.
fn number_near(bytes: &[u8], at: usize) -> Option<Range<usize>> {
    let is_digit = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+' | b'e');
    let start = at + bytes[at..].iter().position(u8::is_ascii_digit)?;
    let start = start - bytes[..start].iter().rev().take_while(|byte| is_digit(byte)).count();
    Some(start..start + bytes[start..].iter().take_while(|byte| is_digit(byte)).count())
}

fn splice(bytes: &mut Vec<u8>, place: Range<usize>, with: &[u8]) {
    bytes.splice(place, with.iter().copied());
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn the_same_seed_does_the_same_damage_and_never_more_than_is_allowed() {
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
    fn numbers_are_found_whole() {
        assert_eq!(number_near(b"{\"x\": -1.5e3}", 8), Some(6..12));
        assert_eq!(number_near(b"{\"x\": -1.5e3}", 0), Some(6..12));
        assert_eq!(number_near(b"none", 0), None);
    }
}
