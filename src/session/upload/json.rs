//! Streaming JSON: objects and lists are read piece by piece, and every error has its location.
//!
//! Why not derived structs: a derived reader holds a whole list in memory before its length can be checked, and its errors
//! contain only text. Here an implementation of [`Fields`] or [`Items`] receives one value at a time and refuses it with a
//! typed [`UploadError`].

use super::error::{Fault, UploadError, shown};
use super::guard::JsonGuard;
use super::limits::UploadLimits;
use super::warnings::Warnings;
use crate::session::parser_errors::{in_json_words, pointer_step};
use rayon::prelude::*;
use serde::Deserialize;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor,
};
use serde_json::error::Category;
use std::fmt;
use std::io::{self, BufReader, Read};
use std::marker::PhantomData;

/// State of reading one upload: limits, warnings and the current location.
pub(crate) struct Reading<'a> {
    /// Limits on the upload.
    pub limits: &'a UploadLimits,
    /// Warnings about the upload.
    pub warnings: &'a mut Warnings,
    /// Current location.
    pub place: Place,
    /// Number of keypoints counted against `max_keypoints`.
    n_keypoints: usize,
    failure: Option<UploadError>,
    /// Steps of the JSON pointer, innermost first, collected while an error propagates outwards.
    pointer: Vec<String>,
}

/// A location in an upload.
#[derive(Debug, Clone, Default)]
pub(crate) struct Place {
    pub file: Option<String>,
    pub camera: Option<String>,
    pub frame: Option<i64>,
    pub person: Option<usize>,
}

impl Place {
    /// The error with this location where it has none.
    pub(crate) fn of(&self, error: UploadError) -> UploadError {
        UploadError {
            file: error.file.or_else(|| self.file.clone()),
            camera: error.camera.or_else(|| self.camera.clone()),
            frame: error.frame.or(self.frame),
            person: error.person.or(self.person),
            ..error
        }
    }
}

/// Reads the values of an object, key by key.
pub(crate) trait Fields {
    /// Name of the object, for messages: `a camera`.
    const WHAT: &'static str;

    /// Reads the value of `key`; false, with the value left unread, where the key is unknown.
    fn field<'d, M: MapAccess<'d>>(&mut self, key: &str, map: &mut M, reading: &mut Reading) -> Result<bool, M::Error>;
}

/// Reads the items of a list, one by one.
pub(crate) trait Items {
    /// Reads item `i`; false at the end of the list.
    fn item<'d, S: SeqAccess<'d>>(&mut self, i: usize, seq: &mut S, reading: &mut Reading) -> Result<bool, S::Error>;
}

/// A JSON object to be read into `F`.
pub(crate) struct Object<'f, 'r, 'a, F>(pub &'f mut F, pub &'r mut Reading<'a>);

/// A JSON list to be read into `I`.
pub(crate) struct List<'i, 'r, 'a, I>(pub &'i mut I, pub &'r mut Reading<'a>);

impl<'a> Reading<'a> {
    pub(crate) fn new(limits: &'a UploadLimits, warnings: &'a mut Warnings) -> Self {
        Self { limits, warnings, place: Place::default(), n_keypoints: 0, failure: None, pointer: Vec::new() }
    }

    /// Refuses a value inside a reader: stores the typed error and returns a parser error to propagate.
    pub(crate) fn refuse<E: serde::de::Error>(&mut self, error: UploadError) -> E {
        self.failure = Some(self.place.of(error));
        E::custom("refused")
    }

    /// Counts memory, measured in keypoints, against the limit.
    pub(crate) fn spend(&mut self, n_keypoints: usize) -> Result<(), UploadError> {
        self.n_keypoints += n_keypoints;
        if self.n_keypoints <= self.limits.max_keypoints {
            return Ok(());
        }
        Err(Fault::TooManyKeypoints.with(format!("the session has more than {} keypoints", self.limits.max_keypoints)))
    }

    /// Reads parts of the upload side by side: each with the limits, the location and the counts as they stand, and with warnings
    /// of its own. The first error in the order of the parts is the one that is returned.
    pub(crate) fn side_by_side<P: Sync, T: Send>(
        &mut self,
        parts: &[P],
        read: impl Fn(&P, &mut Reading<'_>) -> Result<T, UploadError> + Sync,
    ) -> Result<Vec<T>, UploadError> {
        let (limits, place, n_before) = (self.limits, &self.place, self.n_keypoints);
        let of_part = |part: &P| {
            let mut warnings = Warnings::default();
            let mut own =
                Reading { place: place.clone(), n_keypoints: n_before, ..Reading::new(limits, &mut warnings) };
            let read = read(part, &mut own);
            let (n_keypoints, place) = (own.n_keypoints - n_before, own.place);
            (read, n_keypoints, place, warnings)
        };
        let mut all = Vec::with_capacity(parts.len());
        for (read, n_keypoints, place, warnings) in parts.par_iter().map(of_part).collect::<Vec<_>>() {
            self.warnings.append(warnings);
            all.push(read?);
            self.spend(n_keypoints).map_err(|error| place.of(error))?;
        }
        Ok(all)
    }

    /// The typed error behind a parser's error.
    fn explain(&mut self, error: serde_json::Error) -> UploadError {
        let pointer = self.pointer.drain(..).rev().collect::<String>();
        let error = match self.failure.take() {
            Some(failure) => failure,
            None => self.place.of(fault_of_parser(error)),
        };
        UploadError { pointer: Some(pointer).filter(|p| !p.is_empty()), ..error }
    }
}

fn fault_of_parser(error: serde_json::Error) -> UploadError {
    let text = in_json_words(&error);
    // The parser quotes the value, which may have any length.
    let detail = if text.chars().count() > 200 { shown(&text) } else { text };
    match error.classify() {
        Category::Io => fault_of_io(io::Error::from(error)),
        Category::Data => Fault::JsonType.with(detail),
        Category::Syntax if detail.starts_with("number out of range") => Fault::NumberNotFinite.with(detail),
        Category::Syntax if detail.starts_with("recursion limit") => Fault::JsonTooDeep.with(detail),
        Category::Syntax | Category::Eof => Fault::JsonInvalid.with(detail),
    }
}

/// Interprets a failed read: a broken limit, a disk error, or a member that does not decompress.
///
/// Memory that runs out ends the process, as in every other allocation; the service states it as such.
pub(crate) fn fault_of_io(error: io::Error) -> UploadError {
    if error.kind() == io::ErrorKind::OutOfMemory {
        std::alloc::handle_alloc_error(std::alloc::Layout::new::<u8>());
    }
    match error.downcast::<UploadError>() {
        Ok(error) => error,
        Err(error) if error.raw_os_error().is_some() => Fault::FileUnreadable.with(error.to_string()),
        Err(error) => Fault::ZipCorrupt.with(error.to_string()),
    }
}

/// Reads a small document as a whole.
///
/// # Errors
/// [`UploadError`] without a location.
pub(crate) fn document_from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, UploadError> {
    serde_json::from_slice(bytes).map_err(|error| {
        // The parser reports `NaN` as a syntax error; the guard identifies it.
        let limits = UploadLimits::default();
        let guarded = io::copy(&mut JsonGuard::new(bytes, &limits), &mut io::sink());
        guarded.map_or_else(fault_of_io, |_| fault_of_parser(error))
    })
}

/// A stream of JSON documents.
pub(crate) struct JsonStream<'a, R: Read> {
    parser: serde_json::Deserializer<serde_json::de::IoRead<BufReader<JsonGuard<'a, R>>>>,
}

impl<'a, R: Read> JsonStream<'a, R> {
    pub(crate) fn new(reader: R, limits: &'a UploadLimits) -> Self {
        let reader = BufReader::with_capacity(1 << 16, JsonGuard::new(reader, limits));
        Self { parser: serde_json::Deserializer::from_reader(reader) }
    }

    /// Reads the next document, an object.
    ///
    /// # Errors
    /// [`UploadError`] with its location.
    pub(crate) fn next<F: Fields>(&mut self, fields: &mut F, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        Object(fields, reading).deserialize(&mut self.parser).map_err(|e| reading.explain(e))
    }

    /// Reads the next document, a list.
    ///
    /// # Errors
    /// [`UploadError`] with its location.
    pub(crate) fn next_list<I: Items>(&mut self, items: &mut I, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        List(items, reading).deserialize(&mut self.parser).map_err(|e| reading.explain(e))
    }

    /// Whether only white space is left.
    ///
    /// # Errors
    /// A failed read.
    pub(crate) fn at_end(&mut self, reading: &mut Reading<'_>) -> Result<bool, UploadError> {
        match self.parser.end() {
            Ok(()) => Ok(true),
            Err(e) if e.is_io() => Err(reading.explain(e)),
            Err(_) => Ok(false),
        }
    }

    /// Refuses content after the last document.
    ///
    /// # Errors
    /// [`Fault::TrailingData`].
    pub(crate) fn expect_end(&mut self, reading: &mut Reading<'_>) -> Result<(), UploadError> {
        if self.at_end(reading)? {
            return Ok(());
        }
        Err(reading.place.of(Fault::TrailingData.with("there is content after the JSON document")))
    }
}

impl<'de, F: Fields> DeserializeSeed<'de> for Object<'_, '_, '_, F> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de, F: Fields> Visitor<'de> for Object<'_, '_, '_, F> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} as an object", F::WHAT)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Self(fields, reading) = self;
        // Only known keys are stored, and their number is bounded.
        let mut seen: Vec<String> = Vec::new();
        while let Some(key) = map.next_key::<String>()? {
            if seen.contains(&key) {
                let error = Fault::DuplicateKey.with(format!("key {} occurs twice in {}", shown(&key), F::WHAT));
                return Err(reading.refuse(error));
            }
            match fields.field(&key, &mut map, reading) {
                Ok(true) => seen.push(key),
                Ok(false) => {
                    map.next_value::<IgnoredAny>()?;
                    let file = reading.place.file.as_deref().unwrap_or("upload");
                    reading.warnings.unknown_key(file, F::WHAT, &key);
                }
                Err(error) => {
                    reading.pointer.push(pointer_step(&key));
                    return Err(error);
                }
            }
        }
        Ok(())
    }
}

impl<'de, I: Items> DeserializeSeed<'de> for List<'_, '_, '_, I> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de, I: Items> Visitor<'de> for List<'_, '_, '_, I> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        let Self(items, reading) = self;
        for index in 0.. {
            match items.item(index, &mut seq, reading) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    reading.pointer.push(format!("/{index}"));
                    return Err(error);
                }
            }
        }
        Ok(())
    }
}

/// A short list of numbers: a vector or a row of a matrix.
pub(crate) type Numbers = ShortList<f64>;

/// A small matrix, row by row.
pub(crate) type Rows = ShortList<Numbers>;

/// A list that is refused where it is longer than any vector of a session.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct ShortList<T>(pub Vec<T>);

/// Largest length: distortion models have up to 14 coefficients; all other vectors are shorter.
const MAX_SHORT: usize = 32;

impl<'de, T: Deserialize<'de>> Deserialize<'de> for ShortList<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(ShortListVisitor(PhantomData))
    }
}

struct ShortListVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for ShortListVisitor<T> {
    type Value = ShortList<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a list of at most {MAX_SHORT} entries")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<ShortList<T>, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = seq.next_element()? {
            if items.len() == MAX_SHORT {
                return Err(A::Error::invalid_length(MAX_SHORT + 1, &self));
            }
            items.push(item);
        }
        Ok(ShortList(items))
    }
}
