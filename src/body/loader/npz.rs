//! The arrays of an `.npz`.

use super::array::{Array, FIELDS, Fields, NumberType, max_elements, n_elements};
use super::assemble::refuse_other_models;
use super::error::BodyFileError;
use super::npy_head::with_flat_head;
use npyz::{DType, NpyHeader, Order};
use std::io::{Cursor, Read};
use zip::ZipArchive;

/// Reads the fields of a body model; members that hold Python objects are refused where a field is one.
pub(super) fn read_fields(bytes: &[u8]) -> Result<Fields, BodyFileError> {
    let not_a_zip = |_| BodyFileError::Malformed { offset: 0, expected: "a readable zip archive" };
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(not_a_zip)?;
    let mut fields = Fields::new();
    for field in FIELDS {
        if archive.index_for_name(&format!("{field}.npy")).is_some() {
            let member = archive.by_name(&format!("{field}.npy")).map_err(not_a_zip)?;
            let array = read_array(field, member)?;
            refuse_other_models(field, &array)?;
            fields.insert(field.to_owned(), array);
        }
    }
    Ok(fields)
}

fn read_array(field: &str, member: impl Read) -> Result<Array, BodyFileError> {
    let not_an_array = |expected| BodyFileError::NotAnArray { field: field.to_owned(), expected };
    // A header lives in the first kilobytes; the cap keeps a claimed length from being believed.
    let limit = max_elements(field);
    let member = member.take(8 * limit as u64 + (1 << 16));
    let mut member = with_flat_head(member).map_err(|_| not_an_array("a numpy array"))?;
    let header = NpyHeader::from_reader(&mut member).map_err(|_| not_an_array("a numpy array"))?;
    let DType::Plain(number) = header.dtype() else { return Err(not_an_array("an array of numbers")) };
    let spelling = number.to_string();
    let (order, code) = spelling.split_at_checked(1).ok_or_else(|| not_an_array("an array of numbers"))?;
    let number = NumberType::parse(code, order == ">").ok_or_else(|| not_an_array("an array of numbers"))?;
    let shape: Option<Vec<usize>> = header.shape().iter().map(|n| usize::try_from(*n).ok()).collect();
    let shape = shape.ok_or_else(|| not_an_array("a shape of this machine"))?;
    let too_large = BodyFileError::TooLarge { what: "an array", limit: limit as u64 };
    let count = n_elements(&shape).filter(|count| *count <= limit).ok_or(too_large)?;
    let is_fortran = header.order() == Order::Fortran;
    let mut bytes = Vec::with_capacity(count * number.size);
    member.take((count * number.size) as u64).read_to_end(&mut bytes)?;
    Array::decode(field, shape, number, is_fortran, &bytes)
}
