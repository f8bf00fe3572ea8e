//! Types and ranges of options, as the table of options states them.

/// Type and range of an option's values.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// `true` or `false`.
    Switch,
    /// A whole number of at least `min`.
    Whole {
        /// Smallest value.
        min: u64,
        /// Whether `null` is allowed.
        or_null: bool,
    },
    /// A number within a range, limits included.
    Number {
        /// Smallest and largest value.
        range: [f64; 2],
        /// Whether `null` is allowed.
        or_null: bool,
    },
    /// A text.
    Text,
    /// Ids of two cameras.
    TwoCameras,
    /// Number of a frame, which may be negative.
    Frame,
    /// A list of whole numbers: people, or a first and a last frame.
    Numbers,
    /// One of several names.
    Choice(&'static [Choice]),
    /// A list of names, each of which counts once.
    Choices(&'static [Choice]),
    /// An object whose field `from` selects one of several forms.
    Forms(&'static [Form]),
    /// A list of objects whose field `action` selects one of several forms.
    Actions(&'static [Form]),
}

/// One of the names that an option can have.
#[derive(Debug, Clone, Copy)]
pub struct Choice {
    /// The name.
    pub value: &'static str,
    /// What it selects.
    pub meaning: &'static str,
    /// Other names of it.
    pub aliases: &'static [&'static str],
}

/// One form of an object.
#[derive(Debug, Clone, Copy)]
pub struct Form {
    /// Value of the field `from` or `action`.
    pub from: &'static str,
    /// What it selects.
    pub meaning: &'static str,
    /// Name of its flag without `--`, and the flag's value as `--help` shows it; empty where it has none.
    pub flag: [&'static str; 2],
    /// The other fields.
    pub fields: &'static [Field],
}

/// A field of a form.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Key in the object.
    pub name: &'static str,
    /// Type and range.
    pub kind: Kind,
    /// Unit; empty where it has none.
    pub unit: &'static str,
    /// What the field states.
    pub effect: &'static str,
}

/// A name with its meaning.
pub(super) const fn choice(value: &'static str, meaning: &'static str) -> Choice {
    Choice { value, meaning, aliases: &[] }
}

impl Choice {
    /// The same with other names.
    pub(super) const fn or(self, aliases: &'static [&'static str]) -> Self {
        Self { aliases, ..self }
    }
}

impl Kind {
    /// Name of the type, as the documentation states it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Switch => "boolean",
            Self::Whole { or_null: true, .. } => "whole number or null",
            Self::Whole { or_null: false, .. } => "whole number",
            Self::Number { or_null: true, .. } => "number or null",
            Self::Number { or_null: false, .. } => "number",
            Self::Text => "text",
            Self::TwoCameras => "two camera ids",
            Self::Choice(_) => "one name",
            Self::Choices(_) => "list of names",
            Self::Frame => "frame number",
            Self::Numbers => "list of whole numbers",
            Self::Forms(_) => "object",
            Self::Actions(_) => "list of objects",
        }
    }

    /// The allowed values in words; empty for a text or an object.
    pub fn range(&self) -> String {
        let names = |choices: &[Choice]| {
            choices.iter().map(|choice| format!("`{}`", choice.value)).collect::<Vec<_>>().join(", ")
        };
        match self {
            Self::Switch => "`true`, `false`".to_owned(),
            Self::Whole { min, .. } => format!("{min} or more"),
            Self::Number { range: [min, max], .. } if max.is_finite() => format!("{min} to {max}"),
            Self::Number { range: [min, _], .. } => format!("above {min}"),
            Self::Text | Self::TwoCameras | Self::Frame | Self::Numbers => String::new(),
            Self::Choice(choices) | Self::Choices(choices) => names(choices),
            Self::Forms(forms) | Self::Actions(forms) => {
                forms.iter().map(|form| format!("`{}`", form.from)).collect::<Vec<_>>().join(", ")
            }
        }
    }
}
