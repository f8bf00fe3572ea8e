//! The commands, one file each: arguments, one call into the library, what is printed.

pub mod evaluate;
pub mod simulate;
