//! The arrays of an `.npz` body file.

use super::error::BodyFileError;
use super::fields::{FIELDS, Fields, max_elements};
use super::larger_models::LargerModel;
use crate::formats::npz::NpzReader;
use std::io::Cursor;

/// Reads the fields of a body model. A field that holds Python objects is an error; other members are not read.
pub(super) fn read_fields(bytes: &[u8]) -> Result<Fields, BodyFileError> {
    let mut archive = NpzReader::new(Cursor::new(bytes)).map_err(|error| BodyFileError::of_array("", error))?;
    let mut fields = Fields::new();
    let mut larger = None;
    for field in FIELDS {
        let array = match larger {
            None => archive.array(field, max_elements(field)),
            Some(_) => {
                let (n_leading, limits) = LargerModel::leading(field);
                archive.leading(field, n_leading, limits)
            }
        };
        if let Some(array) = array.map_err(|error| BodyFileError::of_array(field, error))? {
            if field == "weights" {
                larger = LargerModel::of_weights(&array);
            }
            fields.insert(field.to_owned(), array);
        }
    }
    match larger {
        Some(model) => model.folded(fields),
        None => Ok(fields),
    }
}
