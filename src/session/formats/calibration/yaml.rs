//! A reader for the YAML that calibration tools write: nested mappings, lists in brackets or dashes, plain or quoted scalars.
//!
//! Why not a YAML library: OpenCV's files begin with `%YAML:1.0` and tag their matrices, which strict readers refuse; and
//! anchors and aliases, with which a small file can expand without bound, are not supported here.

use super::values::finite;
use crate::session::upload::error::{Fault, UploadError};

/// A YAML value.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Yaml {
    Scalar(String),
    List(Vec<Yaml>),
    Map(Vec<(String, Yaml)>),
}

impl Yaml {
    /// The value of a key of a mapping; `None` where it is missing.
    pub(super) fn get(&self, key: &str) -> Option<&Yaml> {
        match self {
            Self::Map(entries) => entries.iter().find(|(own, _)| own == key).map(|(_, value)| value),
            Self::Scalar(_) | Self::List(_) => None,
        }
    }

    pub(super) fn text(&self) -> Option<&str> {
        match self {
            Self::Scalar(text) => Some(text),
            Self::List(_) | Self::Map(_) => None,
        }
    }

    pub(super) fn number(&self) -> Option<f64> {
        finite(self.text()?)
    }

    /// A list of finite numbers.
    pub(super) fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::List(items) => items.iter().map(Self::number).collect(),
            Self::Scalar(_) | Self::Map(_) => None,
        }
    }
}

/// Largest number of levels of nesting; calibration files have three.
const MAX_DEPTH: usize = 12;

struct Line<'t> {
    indent: usize,
    text: std::borrow::Cow<'t, str>,
}

/// Reads a document.
///
/// # Errors
/// [`Fault::CalibrationInvalid`] with the line that cannot be read.
pub(super) fn parse(text: &str) -> Result<Yaml, UploadError> {
    let lines = logical_lines(text)?;
    let mut rest = lines.as_slice();
    let value = block(&mut rest, 0, 0)?;
    match rest.first() {
        None => Ok(value),
        Some(line) => Err(invalid(&line.text)),
    }
}

fn invalid(text: &str) -> UploadError {
    let start: String = text.chars().take(60).collect();
    Fault::CalibrationInvalid.with(format!("cannot read the line {start:?}"))
}

/// Lines with content; a list in brackets is joined to one line.
fn logical_lines(text: &str) -> Result<Vec<Line<'_>>, UploadError> {
    let mut lines: Vec<Line<'_>> = Vec::new();
    let mut open = 0usize;
    for raw in text.lines() {
        let content = without_comment(raw).trim_end();
        let trimmed = content.trim_start();
        if trimmed.is_empty() || trimmed.starts_with('%') || trimmed == "---" || trimmed == "..." {
            continue;
        }
        match lines.last_mut() {
            Some(line) if open > 0 => {
                let joined = line.text.to_mut();
                joined.push(' ');
                joined.push_str(trimmed);
            }
            _ => lines.push(Line { indent: content.len() - trimmed.len(), text: trimmed.into() }),
        }
        for c in trimmed.chars() {
            match c {
                '[' => open += 1,
                ']' => open = open.checked_sub(1).ok_or_else(|| invalid(trimmed))?,
                _ => {}
            }
        }
    }
    if open > 0 { Err(Fault::CalibrationInvalid.with("a list is not closed")) } else { Ok(lines) }
}

fn without_comment(line: &str) -> &str {
    let is_comment = |(at, _): &(usize, &str)| *at == 0 || line[..*at].ends_with([' ', '\t']);
    line.match_indices('#').find(is_comment).map_or(line, |(at, _)| &line[..at])
}

fn block(rest: &mut &[Line<'_>], indent: usize, depth: usize) -> Result<Yaml, UploadError> {
    Fault::CalibrationInvalid.when(depth > MAX_DEPTH, || "the document has too many levels of nesting")?;
    let Some(first) = rest.first() else { return Ok(Yaml::Scalar(String::new())) };
    if first.text.starts_with("- ") || first.text == "-" {
        return dashes(rest, first.indent, depth);
    }
    let (own, mut entries) = (first.indent.max(indent), Vec::new());
    while let Some(line) = rest.first().filter(|line| line.indent == own && !line.text.starts_with("- ")) {
        let (key, value) = line.text.split_once(':').ok_or_else(|| invalid(&line.text))?;
        let (key, value) = (unquoted(key), without_tag(value.trim()).to_owned());
        *rest = &rest[1..];
        let value = if !value.is_empty() {
            inline(&value)
        } else if rest
            .first()
            .is_some_and(|next| next.indent > own || (next.indent == own && next.text.starts_with('-')))
        {
            block(rest, 0, depth + 1)?
        } else {
            Yaml::Scalar(String::new())
        };
        entries.push((key, value));
    }
    Ok(Yaml::Map(entries))
}

fn dashes(rest: &mut &[Line<'_>], indent: usize, depth: usize) -> Result<Yaml, UploadError> {
    let mut items = Vec::new();
    while let Some(line) = rest.first().filter(|line| line.indent == indent && line.text.starts_with('-')) {
        let value = line.text[1..].trim().to_owned();
        *rest = &rest[1..];
        let deeper = rest.first().is_some_and(|next| next.indent > indent);
        items.push(if value.is_empty() && deeper { block(rest, 0, depth + 1)? } else { inline(&value) });
        // A mapping that begins beside its dash does not occur in a matrix; its further keys are skipped.
        while rest.first().is_some_and(|next| next.indent > indent) {
            *rest = &rest[1..];
        }
    }
    Ok(Yaml::List(items))
}

/// A scalar or a flat list of scalars.
fn inline(value: &str) -> Yaml {
    match value.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
        Some(inner) if inner.trim().is_empty() => Yaml::List(Vec::new()),
        Some(inner) => {
            let plain = inner.replace(['[', ']'], " ");
            Yaml::List(plain.split(',').map(|item| Yaml::Scalar(unquoted(item))).collect())
        }
        None => Yaml::Scalar(unquoted(value)),
    }
}

fn without_tag(value: &str) -> &str {
    match value.strip_prefix('!') {
        Some(tagged) => tagged.split_once(' ').map_or("", |(_, rest)| rest.trim()),
        None => value,
    }
}

fn unquoted(text: &str) -> String {
    text.trim().trim_matches(['"', '\'']).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_calibration_tools_write() {
        let text = "%YAML:1.0\r\n---\r\nnames:\r\n   - \"01\"\r\n   - '02'\r\nK_01: !!opencv-matrix\r\n   rows: 1\r\n   cols: 2\r\n   \
                    dt: d\r\n   data: [ 1., -2.5e3,\r\n       0. ]\r\nH_01: 720 # pixels\r\nempty:\r\nlist:\r\n- 1\r\n- 2\r\n";
        let yaml = parse(text).unwrap();
        assert_eq!(yaml.get("names").unwrap(), &Yaml::List(vec![Yaml::Scalar("01".into()), Yaml::Scalar("02".into())]));
        assert_eq!(yaml.get("K_01").unwrap().get("data").unwrap().numbers().unwrap(), [1.0, -2500.0, 0.0]);
        assert_eq!(yaml.get("H_01").unwrap().number(), Some(720.0));
        assert_eq!(yaml.get("list").unwrap().numbers().unwrap(), [1.0, 2.0]);
        assert_eq!(yaml.get("empty").unwrap().text(), Some(""));
    }

    #[test]
    fn rejects_open_lists_and_lines_without_a_key() {
        assert!(parse("K: [1, 2").is_err() && parse("a: 1]").is_err() && parse("a\nb").is_err());
        assert!(parse(&"a:\n ".repeat(3)).is_ok());
    }
}
