//! The arrays of an `.npz` body file.

use super::assemble::refuse_other_models;
use super::error::BodyFileError;
use super::fields::{FIELDS, Fields, max_elements};
use crate::formats::npz::NpzReader;
use std::io::Cursor;

/// Reads the fields of a body model. A field that holds Python objects is an error; other members are not read.
pub(super) fn read_fields(bytes: &[u8]) -> Result<Fields, BodyFileError> {
    let mut archive = NpzReader::new(Cursor::new(bytes)).map_err(|error| BodyFileError::of_array("", error))?;
    let mut fields = Fields::new();
    for field in FIELDS {
        let array = archive.array(field, max_elements(field)).map_err(|error| BodyFileError::of_array(field, error))?;
        if let Some(array) = array {
            refuse_other_models(field, &array)?;
            fields.insert(field.to_owned(), array);
        }
    }
    Ok(fields)
}
