//! Errors of the parsers of JSON and TOML: what is wrong, and where, without the types of this program.

/// Before what was expected instead, in a message of a parser.
const EXPECTED: &str = ", expected ";
/// Before the position, in a message of the parser of JSON.
const POSITION: &str = " at line ";

/// Names of a format for what has members.
struct Words {
    list: &'static str,
    object: &'static str,
}

const JSON: Words = Words { list: "a list", object: "an object" };
#[cfg(any(feature = "service", test))]
const TOML: Words = Words { list: "an array", object: "a table" };

/// One step of a JSON pointer (RFC 6901): the member `key` of an object.
pub(crate) fn pointer_step(key: &str) -> String {
    format!("/{}", key.replace('~', "~0").replace('/', "~1"))
}

/// The message of the parser with the names of JSON for what it expected.
pub(crate) fn in_json_words(error: &serde_json::Error) -> String {
    without_types(error.to_string(), &JSON)
}

/// A message of the parser with the names of TOML for what it expected.
#[cfg(any(feature = "service", test))]
pub(crate) fn in_toml_words(message: &str) -> String {
    without_types(message.trim_end().to_owned(), &TOML)
}

fn without_types(message: String, words: &Words) -> String {
    // The value comes before, and may have the same words.
    let Some((before, after)) = message.rsplit_once(EXPECTED) else { return message };
    let (expected, position) = after.split_at(after.rfind(POSITION).unwrap_or(after.len()));
    format!("{before}{EXPECTED}{}{position}", name_of(expected, words))
}

fn name_of(expected: &str, words: &Words) -> String {
    let name = match expected {
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" => "a whole number from 0 to 4294967295",
        "u64" | "usize" => "a whole number, 0 or more",
        "i64" | "isize" => "a whole number",
        "f32" | "f64" => "a number",
        "a sequence" => words.list,
        "a map" => words.object,
        _ if expected.starts_with("struct ") => words.object,
        _ => {
            let list = format!("{} of length", words.list);
            return expected.replace("an array of length", &list).replace("a tuple of size", &list);
        }
    };
    name.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use std::collections::BTreeMap;

    #[derive(Debug, Deserialize)]
    struct Pair {
        #[allow(dead_code, reason = "only errors are looked at")]
        left: f64,
    }

    fn words<T: serde::de::DeserializeOwned + std::fmt::Debug>(text: &str) -> String {
        in_json_words(&serde_json::from_str::<T>(text).unwrap_err())
    }

    #[test]
    fn types_of_the_program_are_not_named() {
        let cases = [
            (words::<i64>("\"u8\""), "invalid type: string \"u8\", expected a whole number at line 1 column 4"),
            (
                words::<u8>("300"),
                "invalid value: integer `300`, expected a whole number from 0 to 255 at line 1 column 3",
            ),
            (words::<Vec<f64>>("[true]"), "invalid type: boolean `true`, expected a number at line 1 column 5"),
            (words::<Vec<f64>>("3"), "invalid type: integer `3`, expected a list at line 1 column 1"),
            (words::<BTreeMap<String, f64>>("3"), "invalid type: integer `3`, expected an object at line 1 column 1"),
            (words::<Pair>("3"), "invalid type: integer `3`, expected an object at line 1 column 1"),
            (words::<[f64; 3]>("[1, 2]"), "invalid length 2, expected a list of length 3 at line 1 column 6"),
            (words::<Pair>("{}"), "missing field `left` at line 1 column 2"),
        ];
        for (words, expected) in cases {
            assert_eq!(words, expected);
        }
    }

    #[test]
    fn toml_has_tables_and_arrays() {
        #[derive(Debug, Deserialize)]
        struct Settings {
            #[allow(dead_code, reason = "only errors are looked at")]
            limits: Pair,
        }
        let words = |text: &str| in_toml_words(toml::from_str::<Settings>(text).unwrap_err().message());
        assert_eq!(words("limits = 3"), "invalid type: integer `3`, expected a table");
        assert_eq!(words("limits.left = \"a\""), "invalid type: string \"a\", expected a number");
    }

    #[test]
    fn values_are_quoted_as_they_are() {
        let value = r#"", expected usize at line 3""#;
        assert_eq!(
            words::<usize>(value),
            "invalid type: string \", expected usize at line 3\", expected a whole number, 0 or more at line 1 column 28"
        );
    }
}
